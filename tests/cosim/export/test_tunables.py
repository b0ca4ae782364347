"""Tunable parameters: a block whose number is changed does what the block with that setting does."""

import re
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.export.program import program_of


def with_setting(holder, path, values):
    """Return a block whose setting at a path has other values."""
    name, indices, rest = re.fullmatch(r"(\w+)((?:\[[\d,]+\])?)\.?(.*)", path).groups()
    old = getattr(holder, name)
    if rest and indices:
        i = int(indices[1:-1])
        new = [*old[:i], with_setting(old[i], rest, values), *old[i + 1 :]]
    elif rest:
        new = with_setting(old, rest, values)
    else:
        array = np.array(old, dtype=float)
        if indices:
            array[tuple(map(int, indices[1:-1].split(",")))] = values[0]
        else:
            array = np.reshape(values, array.shape)
        new = array.tolist()
    return replace(holder, **{name: new})


def replaced_inside(subsystem, name, block):
    """Return the subsystem with another block inside."""
    diagram = cosim.varied(subsystem.diagram, {name: block})
    sides = (
        {
            port: [diagram[r.node.name][r.port.name][i] for r in references for i in r.elements]
            for port, references in side.items()
        }
        for side in (subsystem.fed, subsystem.shown)
    )
    return cosim.Subsystem(diagram, *sides)


def changed(block, tunable, rng):
    """Return other values of a tunable that the block allows, and the block that has them."""
    for _ in range(20):
        values = np.array(tunable.start) * rng.uniform(0.6, 1.3, len(tunable.start))
        values += (values == 0.0) * rng.uniform(0.1, 0.9, len(values))
        try:
            if not isinstance(block, cosim.Subsystem):
                return values, with_setting(block, tunable.setting, values)
            inside = block.diagram[tunable.name.split(".")[0]]
            other = with_setting(inside.block, tunable.setting, values)
            return values, replaced_inside(block, inside.name, other)
        except cosim.ModelError:
            continue
    raise AssertionError(f"no other value of {tunable.name} is allowed")


@pytest.mark.sampled(3)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_changed_number_is_a_changed_setting(block, sample_time, random_inputs, compiled):
    dt = sample_time(block)
    c, at = compiled(block, dt=dt), 0
    for tunable in c.program.tunables:
        rng = np.random.default_rng(7)
        values, other = changed(block, tunable, rng)
        c.begin()
        c.parameters[at : at + len(values)] = values
        at += len(values)
        plain = other.online(dt, compiled=False)
        for k in range(45):
            inputs = random_inputs(block, rng)
            expected, got = plain(**inputs), c(**inputs)
            for name, value in expected.items():
                np.testing.assert_array_equal(got[name], np.ravel(value), err_msg=f"{tunable.name}: {name} at {k}")


def names(block, **settings):
    return [tunable.name for tunable in program_of(block, **settings).tunables]


def test_what_is_found():
    model = controllers.LinearModel(
        [[0.9]], [[0.1]], [[1], [1]], process_covariance=0.1, sensor_covariance=[1, 2], dt=0.1
    )
    brain = controllers.BayesianController(
        model, precision=controllers.GammaPrecision(calibration=controllers.Calibration(1.0, -2.0)), u_max=3.0
    )
    assert names(brain) == [
        "precision.forgetting",
        "precision.calibration.slope",
        "precision.calibration.intercept",
        "u_max",
    ]
    # The number of a channel is none to tune, and an infinite end cannot be written.
    assert names(cosim.Bias(sensor=2, magnitude=1.0, channels=8), dt=0.1) == ["start", "magnitude"]
    assert names(cosim.Bias(sensor=2, magnitude=1.0, stop=9.0, channels=8), dt=0.1) == ["start", "stop", "magnitude"]


def test_elements_that_may_not_change_leave_the_others_alone():
    law = controllers.Proportional([[1.0, 0.0], [0.0, 2.0]], states=2, u_max=(float("inf"), 4.0))
    assert names(law, dt=0.1) == ["gain[0,0]", "gain[1,1]", "u_max[1]"]


def test_many_numbers_are_data():
    (gain, _) = program_of(cosim.Gain((1.0 + np.arange(100.0).reshape(10, 10)).tolist()), dt=0.1).tunables
    assert gain.shape == (10, 10)
    assert gain.parameter == "gain"
    assert names(cosim.Gain(np.ones((10, 11)).tolist()), dt=0.1) == ["offset"]
    assert names(cosim.Table([0.0, 1.0], [0.0, 2.0], interpolate=False), dt=0.1) == ["times", "values"]
    assert names(cosim.Saturation(-1.0, float("inf"), size=3000), dt=0.1) == ["low"]


def pair(u, gain, twice, y):
    y[0] = gain[0] * u[0] + twice[0]


@dataclass(frozen=True)
class Pair(cosim.Block):
    """A block one of whose settings is used twice.

    Parameters
    ----------
    gain : float
        Seconds. What
        ``u`` is multiplied with; and more.
    shift : float
        See elsewhere.
    """

    gain: float = 2.0
    shift: float = 1.0
    derived: bool = False

    @property
    def inputs(self):
        return (cosim.Port("u"),)

    @property
    def outputs(self):
        return (cosim.Port("y"),)

    def define(self, step: Fraction):
        twice = 2.0 * self.gain if self.derived else self.shift
        return cosim.Definition(pair, parameters={"gain": self.gain, "twice": twice})


def test_a_setting_from_which_something_else_is_computed_is_not_tunable():
    assert names(Pair(), dt=0.1) == ["gain", "shift"]
    assert names(Pair(derived=True), dt=0.1) == []


def test_descriptions_come_from_the_docstring():
    gain, shift = program_of(Pair(), dt=0.1).tunables
    assert gain.description == "Seconds. What u is multiplied with"
    assert shift.description == "shift of Pair"


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_in_an_fmu_it_is_set_before_and_while_it_runs(fmi, tmp_path, c_compiler):
    made = cosim.export_fmu(Pair(), tmp_path / "Pair.fmu", fmi=fmi, dt=0.1)
    diagram = cosim.Diagram(0.1)
    fmu = diagram.add(cosim.FMU(str(made), parameters={"shift": 10.0}, tunable=["gain"]), "pair")
    factor, one = diagram.add(cosim.Ramp(slope=10.0, offset=2.0)), diagram.add(cosim.Constant(1.0))
    diagram.connect(factor["y"], fmu["gain"])
    diagram.connect(one["y"], fmu["u"])
    result = diagram.simulate(0.5, engine="interpreted")
    np.testing.assert_allclose(result["pair.y"][:4], [12.0, 13.0, 14.0, 15.0], rtol=1e-12)
