"""Many seeds with one engine give what single runs give."""

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.run.repeat import repeat


def loop(gain=0.5):
    """An FMU with a random fault in front of a gain, so that engine, instance and random state all matter."""
    diagram = cosim.Diagram("0.02")
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), "car")
    noise = diagram.add(cosim.Gaussian(0.1), "noise")
    fault = diagram.add(
        cosim.Injection(magnitude=5.0, mean_time_to_fault=0.5, mean_time_to_recovery=0.5, channels=1), "fault"
    )
    back = diagram.add(cosim.Gain(gain), "back")
    diagram.connect(car["v"], fault["u"])
    diagram.connect(fault["y"], back["u"])
    diagram.connect(back["y"], car["force"])
    diagram.connect(noise["y"], car["disturbance"])
    return diagram


def test_same_bits_as_single_runs_in_any_order():
    diagram, names = loop(), ["car.v", "fault.*"]
    seeds = [3, 1, 4, 1, 5, 9, 2, 6]
    for seed, result in zip(seeds, repeat(diagram, 10.0, seeds, names), strict=True):
        alone = loop().simulate(10.0, seed=seed, record=names)
        assert list(result) == list(alone)
        for name in alone:
            assert np.array_equal(result[name], alone[name])


def test_results_do_not_share_memory():
    first, second = repeat(loop(), 1.0, [1, 2], ["car.v"])
    kept = first["car.v"].copy()
    second["car.v"][:] = 0.0
    assert np.array_equal(first["car.v"], kept)


def test_a_run_that_must_stop_says_at_which_seed():
    with pytest.raises(cosim.SimulationError, match=r"With seed 7: .*car\.v came out") as caught:
        list(repeat(loop(gain=1e300), 10.0, [7], ["car.v"]))
    assert caught.value.result is not None


def test_bad_names_and_durations_are_told_as_by_simulate():
    with pytest.raises(cosim.UnknownNameError, match="no signal"):
        list(repeat(loop(), 1.0, [0], ["nothing"]))
    with pytest.raises(cosim.StepSizeError):
        list(repeat(loop(), 0.03, [0], ["car.v"]))
