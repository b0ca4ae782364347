"""A filter that does not use a sensor because its model predicts it exactly is named."""

import warnings

import control
import numpy as np
import pytest

from bayesftc import controllers

TANKS = control.ss([[-0.1, 0.0], [0.0, -0.2]], np.eye(2), np.eye(2), 0, inputs=["q_1", "q_2"], outputs=["h_1", "h_2"])


def designed(**settings):
    names = {"measured": ["h_1", "h_2"], "actuated": ["q_1", "q_2"]}
    return controllers.design(TANKS, **names, sensors=(1, 2), dt=1.0, **settings)


def test_noise_that_reaches_only_one_of_two_tanks():
    words = r"no process noise on what sensors 1, 2 \(h_2\) measure\. The filter takes .*Give disturbance=, for an unknown load"
    with pytest.warns(UserWarning, match=words):
        designed(noise={"q_1": 0.1})


@pytest.mark.parametrize(
    "settings", [{}, {"noise": {"q_1": 0.1, "q_2": 1e-4}}, {"noise": {"q_1": 0.1}, "disturbance": 1e-4}]
)
def test_noise_that_reaches_both(settings):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        designed(**settings)
