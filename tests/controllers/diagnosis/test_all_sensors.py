"""A control that follows all sensors tells the filter of some of them about the others' noise: no error of the model."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.judge import Explanation
from bayesftc.controllers.estimation.observers import observers

L, R, W, C, V, CURRENT, VD, VQ = 2e-3, 0.08, 314.16, 1.1e-3, 700.0, 21.5, 325.0, -13.5
MEASURED = ["id", "iq", "vdc"]


def converter():
    """A grid-connected converter about its operating point: currents in the rotating frame, and the voltage behind it."""
    A = [
        [-R / L, W, 0],
        [-W, -R / L, 0],
        [1.5 * VD / V / C, 1.5 * VQ / V / C, -1.5 * VD * CURRENT / V**2 / C],
    ]
    B = [[-1 / L, 0, 1 / L, 0, 0], [0, -1 / L, 0, 1 / L, 0], [1.5 * CURRENT / V / C, 0, 0, 0, -1 / C]]
    return control.ss(A, B, np.eye(3), 0, inputs=["vd", "vq", "egd", "egq", "load"], outputs=MEASURED)


def run(plant, seed):
    """Return a finding about a run at a constant goal, with the noise that the controller knows."""
    sensors, std = (2, 2, 2), [0.15] * 4 + [0.6] * 2
    noise = {"egd": 2.0, "egq": 2.0, "load": 0.3}
    controller = controllers.design(
        converter(), measured=MEASURED, actuated=["vd", "vq"], goal=["vdc", "iq"], sensors=sensors,
        sensor_std=std, noise=noise, dt=1e-4, acceptable_error=[3.0, 1.0],
        acceptable_control=[40.0, 40.0],
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control=["vd", "vq"], measured=MEASURED,
        sensors=cosim.Sensors(sensors, std), reference=[0.0, 0.0],
        noise={name: cosim.Gaussian(std=size) for name, size in noise.items()},
    )  # fmt: skip
    return controllers.diagnose(loop.simulate(0.2, seed=seed), loop)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 6, 7, 8, 9])
def test_a_right_model_is_not_called_slower_where_only_noise_moves_the_plant(seed):
    assert run(converter(), seed) is None


def test_a_wrong_model_is_still_found_there():
    slower = converter()
    finding = run(
        control.ss(0.5 * slower.A, 0.5 * slower.B, slower.C, 0, inputs=slower.input_labels, outputs=MEASURED), 1
    )
    assert finding is not None
    assert finding.kind in {"dt", "gain", "dynamics"}
    assert finding.kind == "dynamics" or finding.values[0] < 0.8


@pytest.mark.parametrize("rounding", [1e-9, 1e-7, 1e-6])
def test_a_mode_that_a_set_hardly_sees_gives_its_filter_no_endless_covariance(rounding):
    """A temperature moves nothing else. In identified coordinates rounding lets currents and voltage see it."""
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    A = turn @ np.array([[0.996, 0.03, 0.0], [-0.03, 0.996, 0.0], [0.01, 0.0, 0.99998]]) @ turn.T
    C = np.eye(3)[[0, 0, 1, 1, 2]] @ turn.T
    C[:4] += rounding * np.repeat(rng.normal(size=(2, 3)), 2, axis=0)
    Q = turn @ np.diag([0.1, 0.1, 1e-3]) @ turn.T
    model = controllers.LinearModel(A, np.ones((3, 1)), C, Q, 0.1, dt=1e-4)
    bank = observers(model)
    assert len(bank) == 2
    alone = 1e-3 / (1.0 - 0.99998**2)  # the temperature's own variance, if no sensor sees it
    for covariance in bank.covariance:
        values = np.linalg.eigvalsh(covariance)
        assert 0.0 < values.min() < values.max() < 10.0 * alone


@pytest.mark.parametrize(
    ("support", "counts"),
    [
        ((11.0,), True),
        ((9.0,), False),
        ((1e4, 11.0), True),
        ((1e4, 9.0), False),  # of two sets, the other one alone
        ((1e4, 6.0, 6.0), True),  # of three, the other two
        ((1e4, 30.0, 4.0), False),  # faults of two sensors leave the third set without evidence
    ],
)
def test_the_evidence_for_an_error_of_the_model_must_not_be_that_of_one_set(support, counts):
    few = (0.9,) * len(support)
    assert Explanation("late", (0.1, 0.0), support, few, few, 1).counts == counts
