"""The experiments for a linear model of an FMU are made once, with their warnings each time."""

import shutil
import warnings

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers.models import pulse_responses

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


def test_its_warnings_are_given_each_time(tmp_path):
    car = cosim.FMU(shutil.copy(fmus.path("CruiseControl"), tmp_path / "car.fmu"))
    texts = []
    for _ in range(2):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            controllers.LinearModel.from_fmu(
                car, measured="v", actuated="force", sensors=2, sensor_std=1.0, noise={"force": 1.0}, dt=0.02
            )
        texts.append([str(each.message) for each in caught])
    assert texts[0] == texts[1]
