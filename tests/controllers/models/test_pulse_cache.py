"""The experiments for a linear model of an FMU are made once, with their warnings each time."""

import shutil
from contextlib import nullcontext

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers.models import pulse_responses
from bayesftc.cosim.base.warnings_shown import warn_user

SERVO = {"measured": "angle", "actuated": "voltage", "sensors": 2}


def test_a_second_design_makes_no_experiments(monkeypatch, tmp_path):
    copy = shutil.copy(fmus.path("PositionServo"), tmp_path / "servo.fmu")
    first = controllers.design(cosim.FMU(copy), **SERVO)
    monkeypatch.setattr(pulse_responses, "Experiments", None)
    again = controllers.design(cosim.FMU(copy), **SERVO)
    for name in "ABC":
        np.testing.assert_array_equal(getattr(first.model, name), getattr(again.model, name))
    with pytest.raises(TypeError):  # other settings of the FMU are another plant
        controllers.design(cosim.FMU(copy, parameters={"J": 0.02}), **SERVO)


@pytest.mark.parametrize("fails", [False, True])
def test_its_warnings_are_given_each_time(fails, monkeypatch, tmp_path):
    servo = cosim.FMU(shutil.copy(fmus.path("PositionServo"), tmp_path / "servo.fmu"), parameters={"J": 0.03})
    experiments, calls = pulse_responses._experimented, []

    def bent(*arguments):
        calls.append(arguments)
        warn_user("It is bent.", pulse_responses.PoorFitWarning)
        if fails:
            raise cosim.FMUError("It has ended.")
        return experiments(*arguments)

    monkeypatch.setattr(pulse_responses, "_experimented", bent)
    for _ in range(2):
        ends = pytest.raises(cosim.FMUError, match="It has ended") if fails else nullcontext()
        with pytest.warns(pulse_responses.PoorFitWarning, match="It is bent"), ends:
            controllers.design(servo, **SERVO)
    assert len(calls) == (2 if fails else 1)  # an error is not kept
