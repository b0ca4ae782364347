"""Step functions that take records of arrays, and scratch space: the same bits as without, in every form in which they run."""

import pickle
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Definition, Port, ops
from bayesftc.cosim.stepping.records import as_written, named_alike, with_arrays
from bayesftc.cosim.types import argument_names


class Model(NamedTuple):
    A: np.ndarray
    B: np.ndarray


class Motion(NamedTuple):
    mean: np.ndarray
    next: np.ndarray


class Whole(NamedTuple):
    model: Model
    motion: Motion


def advance(whole, u):
    A, B = whole.model
    for i in range(A.shape[0]):
        total = B[i, 0] * u[0]
        for j in range(A.shape[1]):
            total = total + A[i, j] * whole.motion.mean[j]
        whole.motion.next[i] = total


def show(y, motion, u, model):
    again = Whole(model, motion)
    advance(again, u)
    mean, following = again.motion
    for i in range(y.shape[0]):
        y[i] = ops.maximum(mean[i], -5.0) + following[i]


def go_on(motion, u, model):
    advance(Whole(model, motion), u)
    for i in range(motion.mean.shape[0]):
        motion.mean[i] = motion.next[i]


def show_one_by_one(y, mean, next, u, A, B):
    for i in range(A.shape[0]):
        total = B[i, 0] * u[0]
        for j in range(A.shape[1]):
            total = total + A[i, j] * mean[j]
        next[i] = total
    for i in range(y.shape[0]):
        y[i] = ops.maximum(mean[i], -5.0) + next[i]


def go_on_one_by_one(mean, next, u, A, B):
    for i in range(A.shape[0]):
        total = B[i, 0] * u[0]
        for j in range(A.shape[1]):
            total = total + A[i, j] * mean[j]
        next[i] = total
    for i in range(mean.shape[0]):
        mean[i] = next[i]


PORTS = {"inputs": (Port("u"),), "outputs": (Port("y", (2,)),)}
PARTS = {
    "state": {"mean": [1.0, 2.0]},
    "parameters": {"A": [[0.9, 0.1], [0.0, 0.8]], "B": [[0.0], [3.0]]},
    "scratch": {"next": np.zeros(2)},
}
RECORDS = {"model": Model("A", "B"), "motion": named_alike(Motion)}
ENGINES = ["interpreted", "compiled"]


@pytest.fixture
def block(make_block):
    return make_block(output=show, update=go_on, records=RECORDS, **PORTS, **PARTS)


def fed(block):
    diagram = cosim.Diagram(0.1)
    diagram.connect(diagram.add(cosim.Sine(amplitude=2.0, period=3.0), "u")["y"], diagram.add(block, "block")["u"])
    return diagram


@pytest.mark.parametrize("engine", ENGINES)
def test_the_bits_are_those_of_arrays_one_by_one(block, make_block, engine, same_bits):
    plain = make_block(output=show_one_by_one, update=go_on_one_by_one, **PORTS, **PARTS)
    runs = [fed(one).simulate(5.0, engine=engine)["block.y"] for one in (block, plain)]
    same_bits(*runs)
    assert np.ptp(runs[0]) > 1.0


def test_the_same_block_alone_as_an_fmu_and_as_c(block, tmp_path, same_bits, c_compiler):
    result = fed(block).simulate(5.0)
    expected, step = result["block.y"], block.online(0.1)
    same_bits(np.array([step(u=u).y for u in result["u.y"]]), expected)
    fmu = cosim.export_fmu(block, tmp_path / "block.fmu", dt=0.1)
    result = fed(cosim.FMU(fmu)).simulate(5.0)
    same_bits(np.column_stack([result["block.y[0]"], result["block.y[1]"]]), expected)
    source = cosim.export_c(block, tmp_path, dt=0.1)[0].read_text()
    assert source.count("static void show(") == 1
    assert "show_2" not in source  # no second function that only hands arrays on


def test_scratch_is_no_state(block, make_block):
    system = block.to_control(0.1)
    assert system.state_labels == ["mean[0]", "mean[1]"]
    with fed(block).start() as session:
        session.advance(1.0)
        state = session.save_state()
        after = session.advance(1.0)["block.y"]
        session.restore(state)
        np.testing.assert_array_equal(session.advance(1.0)["block.y"], after)
    parts = {"parameters": PARTS["parameters"], "state": {**PARTS["state"], **PARTS["scratch"]}}
    kept = make_block(output=show, update=go_on, records=RECORDS, **PORTS, **parts)
    with fed(kept).start() as session:
        assert len(session.save_state().memory) == len(state.memory) + PARTS["scratch"]["next"].size


def test_the_same_function_and_records_make_one_function():
    made = [with_arrays(show, {**RECORDS, "other": Motion("a", "b")}) for _ in range(2)]
    assert made[0] is made[1]
    assert as_written(made[0]) is show
    assert with_arrays(advance, {"nothing": Model("A", "B")}) is advance
    assert with_arrays(None, RECORDS) is None


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        (
            {"records": {"model": Model("A", "C"), "motion": named_alike(Motion)}},
            "has the argument 'C', which is no port",
        ),
        ({"records": {"model": ("A", "B"), "motion": named_alike(Motion)}}, "is no valid record"),
        ({"state": {"mean": [1.0, 2.0], "next": 0.0}}, "uses the name 'next' twice"),
    ],
)
def test_what_is_wrong_with_records(make_block, parts, sentence):
    with pytest.raises(cosim.KernelError, match=sentence):
        fed(make_block(output=show, update=go_on, **{"records": RECORDS, **PORTS, **PARTS, **parts})).build().simulate(
            0.1
        )


def test_a_store_into_an_input_is_found_in_a_record(make_block):
    class Ports(NamedTuple):
        u: np.ndarray
        y: np.ndarray

    def wrong(ports):
        ports.y[0] = ports.u[0]
        ports.u[0] = 0.0

    block = make_block(output=wrong, records={"ports": named_alike(Ports)}, inputs=(Port("u"),), outputs=(Port("y"),))
    with pytest.raises(cosim.KernelError, match="'wrong' of block 'block' writes into its input 'u'"):
        fed(block).simulate(0.1)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_field_that_is_not_there_is_a_sentence(make_block, engine):
    def reads(y, motion):
        y[0] = motion.men[0]

    block = make_block(output=reads, records=RECORDS, **{**PORTS, **PARTS})
    if engine == "compiled":
        with pytest.raises(cosim.KernelError, match="uses the attribute 'men'"):
            fed(block).simulate(0.1, engine=engine)
    else:
        with pytest.raises(AttributeError, match="men"):
            fed(block).simulate(0.1, engine=engine)


def test_of_arrays_no_methods_can_be_called(make_block):
    def calls(y, motion):
        y[0] = motion.mean.sum()

    with pytest.raises(cosim.KernelError, match="uses the attribute 'sum'"):
        fed(make_block(output=calls, records=RECORDS, **{**PORTS, **PARTS})).simulate(0.1)


def test_operations_of_a_module_that_stands_elsewhere(make_block, same_bits):
    """As in a notebook, where ops is imported in another cell: Python then calls them as it calls methods."""
    names = {"ops": ops}
    exec("def cell(u, y):\n    y[0] = ops.sqrt(ops.absolute(u[0]))\n    y[1] = ops.sin(u[0])\n", names)
    runs = [fed(make_block(output=names["cell"], **PORTS)).simulate(1.0, engine=e)["block.y"] for e in ENGINES]
    same_bits(*runs)


def test_methods_of_arrays_are_refused_under_any_name(make_block):
    def bound(u, y):
        total = u.sum
        y[0] = total()
        y[1] = total()

    with pytest.raises(cosim.KernelError, match="uses the attribute 'sum'"):
        fed(make_block(output=bound, **PORTS)).simulate(0.1)


class Pair(NamedTuple):
    a: float
    T: np.ndarray


def keep(x, y):
    pair = Pair(x, y)
    x = x + 1.0
    pair.T[0] = pair.a + 100.0 * x
    pair.T[1] = x


def keeps(u, y):
    keep(u[0], y)


def test_a_record_keeps_what_a_number_was_in_c_too(make_block, tmp_path, same_bits, c_compiler):
    block = make_block(output=keeps, **PORTS)
    expected = [fed(block).simulate(1.0, engine=engine)["block.y"] for engine in ENGINES]
    result = fed(cosim.FMU(cosim.export_fmu(block, tmp_path / "keeps.fmu", dt=0.1))).simulate(1.0)
    same_bits(*expected)
    same_bits(np.column_stack([result["block.y[0]"], result["block.y[1]"]]), expected[0])


def test_definitions_are_pickled_and_replaced():
    definition = Definition(show, go_on, **PARTS, records=RECORDS)
    again = pickle.loads(pickle.dumps(definition))
    assert again.output is definition.output
    other = replace(definition, records={**RECORDS, "model": Model("B", "A")})
    assert argument_names(other.output) == ("y", "mean", "next", "u", "B", "A")


class Default(NamedTuple):
    a: str = "A"


@pytest.mark.parametrize(
    ("records", "sentence"),
    [
        ({"motion": Default()}, "without defaults"),
        ({"motion": Motion("mean", "a b")}, "has the name 'a b', which cannot be an argument"),
        ({"motion": Motion("mean", "lambda")}, "has the name 'lambda'"),
        (
            {"y": named_alike(Motion), "motion": named_alike(Motion)},
            "a record 'y' and also a port or entry of that name",
        ),
    ],
)
def test_records_that_cannot_be(make_block, records, sentence):
    with pytest.raises(cosim.KernelError, match=sentence):
        fed(make_block(output=show, update=go_on, **PORTS, **PARTS, records={**RECORDS, **records})).simulate(0.1)


def test_a_lambda_takes_records(make_block):
    block = make_block(output=lambda y, motion: advance(motion, y), records=RECORDS, **PORTS, **PARTS)
    assert argument_names(block.define(1).output) == ("y", "mean", "next")
