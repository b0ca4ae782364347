"""A run has a row for each base step; a diagnosis compares only the samples of the controller with the model."""

import control
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import ModelError

PLANT = control.ss([[-0.1]], [[0.1]], [[1.0]], 0, inputs=["u"], outputs=["y"])
CONTROLLER = controllers.design(
    PLANT, measured="y", actuated="u", dt=1.0, sensors=3, sensor_std=0.005, acceptable_error=0.02,
    acceptable_control=0.1, precision=controllers.FixedPrecision(),
)  # fmt: skip


def loop(dt, every, plant=PLANT):
    """Return a loop at base step `dt`, with a sample of each sensor in `every` seconds."""
    every = [round(seconds / dt) for seconds in every]
    return cosim.closed_loop(
        plant, CONTROLLER, control="u", measured="y", sensors=cosim.Sensors(3, 0.005, every=every),
        reference=cosim.Sine(amplitude=0.1, period=40.0), dt=dt,
    )  # fmt: skip


@pytest.mark.parametrize("every", [(1.0, 1.0, 1.0), (1.0, 3.0, 5.0)])
@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
def test_the_base_step_does_not_change_a_diagnosis(dt, every):
    one, slow = loop(dt, every), loop(dt, every, control.ss([[-0.05]], [[0.05]], [[1.0]], 0, inputs="u", outputs="y"))
    assert controllers.diagnose(one.simulate(150.0, seed=1, engine="interpreted"), one) is None
    finding = controllers.diagnose(slow.simulate(150.0, seed=1, engine="interpreted"), slow)
    assert finding.kind == "dt"
    assert finding.values[0] == pytest.approx(0.5, abs=0.1)


def test_a_decimated_run_is_diagnosed_if_it_has_every_sample_of_the_controller():
    one = loop(0.1, (1.0, 1.0, 1.0))
    runs = [one.simulate(100.0, seed=1, decimation=n, engine="interpreted") for n in (1, 5, 10)]
    assert {controllers.check_kalman(run, CONTROLLER).steps for run in runs} == {101}
    assert max(controllers.check_kalman(run, CONTROLLER).mean_difference for run in runs) < 1e-9
    rare = one.simulate(100.0, seed=1, decimation=20, engine="interpreted")
    for reader in (controllers.diagnose, controllers.check_kalman):
        with pytest.raises(ModelError, match=r"needs every sample, one in 1 s .* a row in 2 s. Run with decimation=1"):
            reader(rare, CONTROLLER)
