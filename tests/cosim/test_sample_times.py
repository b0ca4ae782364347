"""A block of one's own may have its sample time as a number, a text or a fraction: everything runs at the same exact step."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.errors import StepSizeError

GIVEN = [0.02, "0.02", "1/50", Fraction(1, 50), np.float64(0.02)]
PLANT = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.02, inputs=["u"], outputs=["h"])


def law(y, goal, u, total, gain):
    total[0] = total[0] + 0.02 * (goal[0] - y[0])
    u[0] = gain[0] * (goal[0] - y[0]) + total[0]


@dataclass(frozen=True)
class Law(cosim.Block):
    sample_time: Any = Fraction(1, 50)
    gain: float = 2.0
    preview: int = 0
    inputs = (Port("y", (1,)), Port("goal", (1,)))
    outputs = (Port("u", (1,)),)

    def define(self, step):
        assert step == Fraction(1, 50)
        return cosim.Definition(law, state={"total": 0.0}, parameters={"gain": self.gain})


def rise(t, y):
    y[0] = 2.0 * t


@dataclass(frozen=True)
class Rise(cosim.Block):
    sample_time: Any = Fraction(1, 50)
    outputs = (Port("y"),)

    def define(self, step):
        return cosim.Definition(rise)


def loop(law, plant=PLANT, **settings):
    return cosim.closed_loop(
        cosim.StateSpace(plant), law, control="u", measured="h",
        **{"sensors": cosim.Sensors(1, 0.1), "reference": cosim.Step(1.0, 0.1)} | settings,
    )  # fmt: skip


def values(run):
    return {name: run[name] for name in run}


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("given", GIVEN, ids=repr)
def test_a_loop_runs_at_the_same_step(given, engine):
    expected = loop(Law()).simulate(0.5, seed=1, engine=engine)
    made = loop(Law(given))
    assert made.step == Fraction(1, 50)
    found = made.simulate(0.5, seed=1, engine=engine)
    np.testing.assert_equal(values(found), values(expected))
    ticks = loop(Law(given), control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.01, inputs=["u"], outputs=["h"]), dt=0.01)
    assert ticks["controller"].every == 2
    assert loop(Law(given, preview=5))["reference"].block.time == Fraction(1, 10)


@pytest.mark.parametrize("given", GIVEN, ids=repr)
def test_a_block_runs_alone_and_in_a_campaign(given):
    step, expected = Law(given).online(), Law().online()
    for y in (0.0, 0.5, 0.3):
        assert step(y=[y], goal=[1.0]).u == expected(y=[y], goal=[1.0]).u
    assert Law(given).to_control().dt == 0.02
    ahead = cosim.Preview(Rise(given), 0.1)
    assert ahead.sample_time == Fraction(1, 50)
    assert ahead.online()().ahead == pytest.approx(0.2)
    grid = cosim.Grid({"controller.gain": [1.0, 2.0]})
    tables = [
        cosim.Campaign(loop(Law(each)), duration=0.5, grid=grid, metrics=[cosim.LoopFigures()]).run().table
        for each in (given, Fraction(1, 50))
    ]
    assert (tables[0]["status"] == "ok").all()
    np.testing.assert_array_equal(*(table.filter(like="tracking").to_numpy() for table in tables))


@pytest.mark.parametrize("given", [0.02, "1/50"])
def test_a_block_is_exported_with_its_step(given, tmp_path, c_compiler):
    fmu = cosim.FMU(cosim.export_fmu(Law(given), tmp_path / "law.fmu"))
    assert fmu.description.default_experiment["stepSize"] == 0.02
    runs = [loop(each).simulate(0.5, seed=1) for each in (Law(given), fmu)]
    np.testing.assert_array_equal(*(run["plant.h"] for run in runs))


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (-0.02, "The sample_time of Law is -0.02 s; it must be positive"),
        (0, "The sample_time of Law is 0 s; it must be positive"),
        ("fast", "The sample_time of Law 'fast' is no finite number; give seconds, as 0.02 or '1/50'"),
        (np.nan, "The sample_time of Law nan is no finite number"),
        ([0.02], r"The sample_time of Law \[0.02\] is no finite number"),
    ],
)
def test_a_wrong_sample_time_is_refused(given, sentence):
    with pytest.raises(StepSizeError, match=sentence):
        loop(Law(given), dt=0.02)
    with pytest.raises(StepSizeError, match=sentence):
        Law(given).online()
    diagram = cosim.Diagram(0.02)
    law = diagram.add(Law(given), "law")
    diagram.connect(diagram.add(cosim.Constant(0.0))["y"], law["y"])
    diagram.connect(diagram.add(cosim.Constant(1.0), "goal")["y"], law["goal"])
    with pytest.raises(StepSizeError, match=sentence):
        diagram.simulate(0.1)


def test_another_step_is_refused_with_both():
    with pytest.raises(StepSizeError, match=r"must run every 0.02 s, which is no whole multiple of dt, 0.03 s"):
        loop(Law(0.02), dt=0.03)
    with pytest.raises(StepSizeError, match=r"Law runs every 0.02 s, not every 0.03 s"):
        Law(0.02).online(0.03)
