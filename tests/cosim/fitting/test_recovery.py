"""After a gap the state of an FMU is unknown, because its inputs were: that is no fault of the sensors."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.fitting import sentences
from bayesftc.cosim.fitting.recovery import WINDOW, recovering
from bayesftc.cosim.fitting.samples import Samples, sample

STEPS, BEFORE, AFTER = 1200, 400, 450


def residuals(seed, sensors=3):
    """Return samples of a quantity that an FMU predicts as 0, and to which it returns within 300 steps after the gap."""
    y = np.random.default_rng(seed).standard_normal((STEPS, sensors))
    y[BEFORE + 1 : AFTER] = np.nan
    y[AFTER:] += 30.0 * np.exp(-np.arange(STEPS - AFTER) / 60.0)[:, None]
    return y


def late(y, **more):
    given = {"inputs": {"u": np.zeros((STEPS, 1))}, "gaps": ((BEFORE, AFTER),), **more}
    names = tuple("abc"[: y.shape[1]])
    return recovering(Samples(Fraction(1), 0.0, sensors={"x": names}, y=y, **given), np.zeros((STEPS, 1)), np.ones(3))


@pytest.mark.parametrize("seed", range(5))
def test_samples_count_again_when_the_error_is_as_small_as_before_the_gap(seed):
    found = late(residuals(seed))
    assert not found[:AFTER].any()
    (end,) = {int(np.flatnonzero(column)[-1]) for column in found.T}
    assert AFTER + 150 < end < AFTER + 400  # the error is from 2.5 to 0.04 standard deviations of the noise
    assert found[AFTER : end + 1].all()


def test_a_failed_sensor_does_not_prevent_it():
    y = residuals(0)
    y[600:, 1] += 20.0
    y[300:500, 0] = np.nan
    end = np.flatnonzero(late(y)[:, 2])[-1]
    assert end < AFTER + 400


def test_an_error_that_crosses_zero_is_no_recovery():
    y = residuals(0)
    y[AFTER:] = (
        np.random.default_rng(1).standard_normal((STEPS - AFTER, 3)) + np.linspace(20, -10, STEPS - AFTER)[:, None]
    )
    assert late(y)[AFTER:].all()


def test_without_a_gap_or_an_input_or_with_few_samples_all_count():
    y = residuals(0)
    assert not late(y, gaps=()).any()
    assert not late(y, inputs={}).any()
    y[WINDOW : -WINDOW + 1] = np.nan
    assert not late(y).any()


def test_gaps_are_stretches_without_rows():
    times = np.delete(np.arange(60.0), [*range(10, 15), 30, 31])
    table = pd.DataFrame({"t": times, "y": times})
    assert sample(table, (), "y", None, 1).gaps == ((9, 15),)
    assert sample(table, (), "y", None, "1/4").gaps == ((36, 60),)  # no row at most steps
    assert sample(table.assign(y=np.where(times < 40, np.nan, times)), (), "y", None, 1).gaps == ((9, 15),)


@pytest.mark.slow
def test_no_sensor_is_blamed_after_a_gap():
    diagram = cosim.Diagram(dt=0.1)
    car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 110.0, "b": 6.0}), "car")
    force = diagram.add(cosim.PRBS(300.0, 15.0, offset=200.0), "force")
    diagram.connect(force["y"], car["force"])
    run = diagram.simulate(200.0)
    v = run["car.v"] + 0.1 * np.random.default_rng(0).standard_normal((2, len(run.time)))
    table = pd.DataFrame({"time": run.time, "u": run["force.y"], "v1": v[0], "v2": v[1]})
    table = table.drop(index=range(960, 1148))  # the force changes at 105 s
    ranges, names = {"m": (50, 200), "b": (1, 20)}, {"inputs": {"force": "u"}, "outputs": {"v": ["v1", "v2"]}}
    names["settings"] = cosim.FitSettings(screened=4, starts=1, rounds=4)
    fitted = cosim.fit(fmus.path("CruiseControl"), table, ranges, **names)
    for name, true in (("m", 110.0), ("b", 6.0)):
        assert abs(fitted.parameters[name] - true) < 3 * fitted.std[name]
    assert not any("faulty" in sentence for sentence in fitted.sentences)
    (sentence,) = [sentence for sentence in fitted.sentences if "gap" in sentence]
    assert sentence.startswith("From 95.9 to 114.8 s the recording has a gap, in which the inputs are unknown.")
    assert "v up to 200 s. These samples do not count. v differs up to the end: either the state of" in sentence
    every = cosim.fit(fmus.path("CruiseControl"), table, ranges, **names, weigh=None)
    assert any("These samples count all the same." in sentence for sentence in every.sentences)


def said(y):
    """Return the sentence about the gap."""
    found, sensors, gaps = late(y), {"x": ("a", "b", "c")}, ((BEFORE, AFTER),)
    (sentence,) = sentences.gaps(sensors, gaps, found, 1.0 - found, np.isfinite(y), np.arange(float(STEPS)))
    return sentence


def test_only_where_the_fmu_recovers_has_no_sensor_failed():
    y = residuals(0)
    assert said(y).endswith("These samples do not count. They are no faults.")
    y = np.random.default_rng(0).standard_normal((STEPS, 3))
    y[BEFORE + 1 : AFTER] = np.nan
    y[AFTER:] += 2.0  # for good: a bias, or a wrong state
    assert "x up to 1199 s. These samples do not count. x differs up to the end: either the state of the FMU" in said(y)
    assert "no fault" not in said(y)
    y[1000:] = np.nan
    assert "x up to 999 s" in said(y)
    assert "no fault" not in said(y)


def test_each_output_is_told_from_the_others():
    known, found = np.ones((STEPS, 3), dtype=bool), np.zeros((STEPS, 3), dtype=bool)
    found[AFTER:, 0] = found[AFTER:700, 1] = True
    sensors = {"x": ("a",), "y": ("b",), "z": ("c",)}
    (sentence,) = sentences.gaps(sensors, ((BEFORE, AFTER),), found, 1.0 - found, known, np.arange(float(STEPS)))
    assert (
        "x up to 1199 s, y up to 699 s. These samples do not count. Those of y are no faults. x differs up to"
        in sentence
    )
