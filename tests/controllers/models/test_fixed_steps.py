"""An exported plant makes steps of one size only: models for a slower controller, and loops with the plant's own step."""

import control
import numpy as np
import pytest
from scipy.linalg import expm

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import StepSizeError

LAG = control.ss([[-0.5, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0, inputs=["u"], outputs=["y"])


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    path = cosim.export_fmu(cosim.StateSpace(LAG), tmp_path_factory.mktemp("plant") / "lag.fmu", dt=0.02)
    return cosim.FMU(path)


def test_a_model_may_have_a_multiple_of_the_plants_only_step(fmu):
    model = controllers.LinearModel.from_fmu(fmu, measured="y", actuated="u", dt=0.1)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(model.A)), np.sort(np.diag(expm(0.1 * LAG.A))), rtol=1e-6)
    given = {"control": "u", "measured": "y", "sensors": cosim.Sensors(1, 0.01), "reference": 0.0}
    controller = controllers.LQGController(model, goal_covariance=0.01)
    run = cosim.closed_loop(fmu, controller, dt=0.02, **given).simulate(0.4, engine="interpreted")
    assert len(run.time) == 21
    with pytest.raises(StepSizeError) as caught:
        cosim.closed_loop(fmu, controller, **given).simulate(0.4, engine="interpreted")
    assert str(caught.value) == (
        "The FMU 'lag' makes steps of 0.02 s only, but 'plant' has steps of 0.1 s. Give the loop dt = 0.02, in a scenario below "
        "[simulation]. The controller keeps its own sample time."
    )


def test_another_step_is_refused_with_the_only_one(fmu):
    with pytest.raises(
        StepSizeError, match=r"makes steps of 0\.02 s only, but the model has dt = 0\.03 s\. Give a dt that is"
    ):
        controllers.LinearModel.from_fmu(fmu, measured="y", actuated="u", dt=0.03)
