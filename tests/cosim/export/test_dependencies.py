"""What outputs depend on: nothing is missing where the compiled C is probed, and zeros and other channels are left out."""

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc import cosim
from bayesftc.cosim.export.dependencies import feeding, feeding_elements
from bayesftc.cosim.export.program import program_of
from bayesftc.cosim.export.sets import MOST
from bayesftc.cosim.ports import labels


def flat(values):
    return np.concatenate([np.zeros(0), *values])


@pytest.mark.sampled(2)
def test_what_changes_an_output_is_among_its_dependencies(block, sample_time, compiled):
    rng = np.random.default_rng(11)
    c = compiled(block, dt=sample_time(block))
    program, fed = c.program, feeding_elements(c.program)
    outputs = [each for signal in program.outputs for each in fed[signal.name]]
    sizes = {signal.name: len(signal.places) for signal in program.inputs}
    drawn = {signal.name for signal in program.inputs if signal.draw == "uniform"}

    def draw():
        return {n: rng.uniform(size=size) if n in drawn else rng.normal(size=size) for n, size in sizes.items()}

    def probe(state, inputs):
        c.state[:] = state
        return flat(c.evaluate(**inputs).values())

    tuned = [name for tunable in program.tunables for name in labels(tunable.name, tunable.shape)]
    for steps in (0, 1, 40):  # at the beginning, later, and while faults are present
        for _ in range(steps):
            c(**draw())
        state, inputs = c.state.copy(), draw()
        before = probe(state, inputs)
        for _ in range(3):
            other = draw()
            for signal in program.inputs:
                for i, name in enumerate(labels(signal.name, signal.shape)):
                    mixed = {n: v.copy() for n, v in inputs.items()}
                    mixed[signal.name][i] = other[signal.name][i]
                    assert_declared(name, before, probe(state, mixed), outputs)
            for i, name in enumerate(tuned):
                moved = state.copy()
                moved[c.file.memory + i] *= rng.uniform(0.5, 1.5)
                assert_declared(name, before, probe(moved, inputs), outputs)
        c.state[:] = state


def assert_declared(name, before, after, outputs):
    for changed, of in zip(before.view(np.int64) != after.view(np.int64), outputs, strict=True):
        assert not changed or name in of


def test_only_what_acts_is_named():
    bias = program_of(cosim.Bias(sensor=1, magnitude=1.0, stop=2.0, channels=3), dt=0.1)
    assert feeding_elements(bias)["y"] == ({"u[0]"}, {"u[1]", "start", "stop", "magnitude"}, {"u[2]"})
    assert feeding(bias, feeding_elements(bias))["active"] == {"start", "stop"}
    identity = program_of(cosim.Gain([[1, 0], [0, 1]]), dt=0.1)
    assert feeding_elements(identity)["y"] == ({"u[0]", "gain[0,0]", "offset"}, {"u[1]", "gain[1,1]", "offset"})
    delay = program_of(cosim.UnitDelay(), dt=0.1)
    assert feeding(delay, feeding_elements(delay))["y"] == set()


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_gains_in_a_row(data):
    sizes = data.draw(st.lists(st.integers(1, 4), min_size=3, max_size=4))
    matrices = [
        np.reshape(data.draw(st.lists(st.sampled_from([0.0, 1.0, -2.0]), min_size=m * n, max_size=m * n)), (m, n))
        for n, m in pairwise(sizes)
    ]
    diagram, last, pattern = cosim.Diagram(0.1), None, np.eye(sizes[0], dtype=bool)
    for i, matrix in enumerate(matrices):
        node = diagram.add(cosim.Gain(matrix.tolist()), f"g{i}")
        if last is not None:
            diagram.connect(last["y"], node["u"])
        last, pattern = node, (matrix != 0).astype(int) @ pattern.astype(int) > 0
    found = feeding_elements(program_of(diagram, outputs={f"g{len(matrices) - 1}.y": "out"}))["out"]
    inputs = [{name for name in of if ".u[" in name} for of in found]
    assert inputs == [{f"g0.u[{j}]" for j in np.flatnonzero(row)} for row in pattern]


def branching(u, other, y):
    if u[0] > 0.0:
        y[0] = u[0]
    y[1] = other[0]


@dataclass(frozen=True)
class Branching(cosim.Block):
    """A block whose step function branches on data, so that it is not known what acts on what."""

    @property
    def inputs(self):
        return cosim.Port("u"), cosim.Port("other")

    @property
    def outputs(self):
        return (cosim.Port("y", (2,)),)

    def define(self, step: Fraction):
        return cosim.Definition(branching)


def test_where_a_step_function_branches_all_that_it_reads_counts():
    assert feeding_elements(program_of(Branching(), dt=0.1))["y"] == ({"u", "other"},) * 2


def adding(u, y):
    total = 0.0
    for _ in range(MOST + 1):
        total = total + u[0]
    y[0] = total


def remembering(u, x, y):
    y[0] = x[0]
    x[0] = u[0]


@dataclass(frozen=True)
class Long(cosim.Block):
    """A block whose step function makes as many operations as are followed, or that has more numbers than that."""

    adds: bool
    inputs = (cosim.Port("u"),)
    outputs = (cosim.Port("y"),)

    def define(self, step: Fraction):
        if self.adds:
            return cosim.Definition(adding)
        return cosim.Definition(remembering, state={"x": np.zeros(MOST + 1)})


def test_only_operations_are_counted_and_each_program_by_itself():
    """Neither what was exported before it nor a large state makes a program too long."""
    for long, fed in ((Long(adds=True), {"u"}), (Long(adds=False), set()), (Long(adds=True), {"u"})):
        assert feeding_elements(program_of(long, dt=0.1))["y"] == (fed,)
    assert feeding_elements(program_of(cosim.UnitDelay(), dt=0.1))["y"] == (set(),)
