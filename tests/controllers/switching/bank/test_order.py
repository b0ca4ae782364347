"""The order of the sensors: a surprise that they share is no fault of the first one."""

from itertools import product

import control
import numpy as np
import pytest
from scipy import stats

from bayesftc import controllers, cosim

BEGINS, DT = 1e-3, 0.02


def exact(errors, variance, nodes=12):
    """Return each sensor's probability of more noise at a first sample: sums over sets of sensors, integrals over precisions.

    The errors are in standard deviations of a healthy sensor's noise. The precision of a noisier one is gamma distributed, as
    that of `controllers.Noisier`.
    """
    x, weights = np.polynomial.legendre.leggauss(nodes)
    precision, weights = stats.gamma.ppf(0.5 * (x + 1.0), 1.0, scale=1.0 / 16.0), 0.5 * weights
    total, share = 0.0, np.zeros(len(errors))
    for noisy in product((0, 1), repeat=len(errors)):
        those, density = np.flatnonzero(noisy), 0.0
        for places in product(range(nodes), repeat=len(those)):
            noise = np.ones(len(errors))
            noise[those] = 1.0 / precision[list(places)]
            covariance = variance + np.diag(noise)
            density += np.prod(weights[list(places)]) * stats.multivariate_normal.pdf(errors, cov=covariance)
        density *= np.prod(np.where(noisy, BEGINS, 1.0 - BEGINS))
        total, share = total + density, share + density * np.array(noisy)
    return share / total


@pytest.mark.parametrize("variance", [0.5, 2.0])
@pytest.mark.parametrize(
    "errors",
    [[6.0, 4.0, 4.2], [4.0, 6.0, 4.2], [4.2, 4.0, 6.0], [5.0, 5.0, 5.0], [0.0, 1.0, 8.0], [6.0, 4.0], [4.0, 6.0]],
)
def test_the_first_sample_is_judged_as_by_all_sensors_at_once(errors, variance):
    """In the first case the exact probability is .066; judged before the others, the first sensor had .94."""
    m = len(errors)
    model = controllers.LinearModel([[0.999]], [[0.0]], [[1.0]] * m, 1e-3, np.ones(m), DT)
    modes = (
        controllers.Noisier(time_to_fault=DT / BEGINS),
        controllers.Offset(time_to_fault=1e12),
    )  # the joint form needs one
    learner = controllers.SwitchingPrecision(modes, process_modes=(), noise_factor=1.0, start_doubt=0.0)
    step = controllers.StateEstimator(model, learner, 0.0, variance).online(compiled=False)
    np.testing.assert_allclose(step(y=errors, u=0.0).fault_probability, exact(errors, variance), atol=0.06)


def test_a_load_step_is_blamed_on_no_sensor():
    """A load steps by 8 times what the model expects in a sample: the first of three sensors was sometimes blamed."""
    inertia, turbine, governor, droop = 0.167, 0.3, 0.08, 2.4
    A = [[-0.05, 1 / inertia, 0], [0, -1 / turbine, 1 / turbine], [-1 / (droop * governor), 0, -1 / governor]]
    B = [[0, -1 / inertia], [0, 0], [1 / governor, 0]]
    area = control.ss(A, B, [[1, 0, 0]], 0, inputs=["power", "load"], outputs=["frequency"])
    controller = controllers.design(
        area, measured="frequency", actuated="power", sensors=3, sensor_std=0.002, dt=0.05, loads={"load": (0.05, 20.0)},
        acceptable_error=0.02, acceptable_control=0.2,
    )  # fmt: skip
    loop = cosim.closed_loop(
        area, controller, control="power", measured="frequency", sensors=cosim.Sensors(3, 0.002), reference=0.0,
        blocks={"step": cosim.Step(time=2.0, after=0.03)}, connections=[("step.y", "plant.load")],
    )  # fmt: skip
    for seed in range(12):
        assert (loop.simulate(4.0, seed=seed)["controller.fault_probability"][40:] < 0.5).all()
