"""The order of a step: direct feedthrough, rates, loops; and the contract of step functions."""

import itertools
import math

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.ops import exp


def copy_through(u, y):
    for i in range(y.shape[0]):
        y[i] = u[i]


def copy_late(u, held):
    for i in range(held.shape[0]):
        held[i] = u[i]


def write_held(held, y):
    for i in range(y.shape[0]):
        y[i] = held[i]


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_no_hidden_delay_in_any_order_of_adding(order, run_both):
    blocks = [cosim.Ramp(1.0), cosim.Gain(2.0), cosim.Sum("++"), cosim.UnitDelay()]
    diagram = cosim.Diagram(1)
    nodes = {i: diagram.add(blocks[i]) for i in order}
    ramp, gain, total, delay = (nodes[i] for i in range(4))
    diagram.connect([gain["y"], delay["y"]], total["u"])
    diagram.connect(ramp["y"], gain["u"])
    diagram.connect(total["y"], delay["u"])
    result = run_both(diagram, 4, record=["*", "gain.u", "sum.u", "unitdelay.u"])
    assert result["gain.y"].tolist() == [0, 2, 4, 6, 8]
    assert result["sum.y"].tolist() == [0, 2, 6, 12, 20]  # the running sum of gain.y
    assert result["unitdelay.y"].tolist() == [0, 0, 2, 6, 12]
    assert result["unitdelay.u"].tolist() == result["sum.y"].tolist()
    assert result["sum.u"].tolist() == np.stack([result["gain.y"], result["unitdelay.y"]], 1).tolist()


def test_rates(run_both):
    diagram = cosim.Diagram(1)
    ramp = diagram.add(cosim.Ramp(1.0))
    last = ramp
    for every in (2, 3):
        node = diagram.add(cosim.Gain(10.0), f"g{every}", every=every)
        diagram.connect(last["y"], node["u"])
        last = node
    huge = diagram.add(cosim.Gain(1.0, offset=5.0), "huge", every=2**53)
    diagram.connect(ramp["y"], huge["u"])
    result = run_both(diagram, 9)
    assert result["g2.y"].tolist() == [0, 0, 20, 20, 40, 40, 60, 60, 80, 80]
    assert result["g3.y"].tolist() == [0, 0, 0, 200, 200, 200, 600, 600, 600, 800]
    assert result["huge.y"].tolist() == [5.0] * 10


@pytest.mark.parametrize("feedthrough", [True, False])
def test_a_nonlinear_system_in_an_algebraic_loop_is_named_with_its_setting(feedthrough):
    system = control.nlsys(lambda t, x, u, p: -x + u, lambda t, x, u, p: x, inputs="u", outputs="y", states=1)
    diagram = cosim.Diagram(0.1)
    plant = diagram.add(cosim.StateSpace(system, feedthrough=feedthrough), "plant")
    gain = diagram.add(cosim.Gain(-1.0), "gain")
    diagram.connect(plant["y"], gain["u"])
    diagram.connect(gain["y"], plant["u"])
    if feedthrough:
        with pytest.raises(
            cosim.AlgebraicLoopError, match=r"of 'plant' .* cosim\.StateSpace\(system, feedthrough=False\)"
        ):
            diagram.build()
    else:
        diagram.build()


def test_algebraic_loop_is_printed_port_by_port():
    diagram = cosim.Diagram(1)
    start = diagram.add(cosim.Constant(1.0), "start")
    a, b = diagram.add(cosim.Sum("+-"), "a"), diagram.add(cosim.Gain(2.0), "b")
    outside = diagram.add(cosim.Gain(1.0), "outside")
    diagram.connect([start["y"], b["y"]], a["u"])
    diagram.connect(a["y"], b["u"])
    diagram.connect(b["y"], outside["u"])
    for _ in range(2):  # a failed build leaves the diagram open
        with pytest.raises(cosim.AlgebraicLoopError) as caught:
            diagram.build()
    text = str(caught.value)
    assert text.startswith("The diagram has an algebraic loop, in which each value at t_k depends on itself:\n")
    lines = text.splitlines()[1:-1]
    assert sorted(lines) == ["  a.y -> b.u  (b feeds it through)", "  b.y -> a.u  (a feeds it through)"]
    assert lines[0].split(" -> ")[1].split(".")[0] == lines[1].strip().split(".")[0]  # one hop leads to the next
    assert text.splitlines()[-1].startswith("Put a UnitDelay into one of these connections")
    assert "outside" not in text
    assert "start" not in text
    delay = diagram.add(cosim.UnitDelay())
    diagram.connect(outside["y"], delay["u"])
    with pytest.raises(cosim.AlgebraicLoopError):
        diagram.build()


def test_a_block_that_feeds_itself():
    diagram = cosim.Diagram(1)
    gain = diagram.add(cosim.Gain(2.0))
    diagram.connect(gain["y"], gain["u"])
    with pytest.raises(cosim.AlgebraicLoopError, match=r"\n  gain.y -> gain.u  \(gain feeds it through\)\nPut"):
        diagram.build()


def test_loops_are_closed_by_ports_that_do_not_feed_through(make_block, run_both):
    diagram = cosim.Diagram(1)
    late = make_block(
        inputs=[Port("u", feedthrough=False)],
        outputs=[Port("y")],
        output=write_held,
        update=copy_late,
        state={"held": 1.0},
    )
    a, b = diagram.add(late, "a"), diagram.add(cosim.Gain(2.0), "b")
    diagram.connect(a["y"], b["u"])
    diagram.connect(b["y"], a["u"])
    assert run_both(diagram, 4)["b.y"].tolist() == [2, 4, 8, 16, 32]
    assert diagram.schedule.describe().splitlines() == ["at t_k     a", "at t_k     b", "to t_k+1   a"]


def test_updates_all_see_the_same_instant(run_both):
    diagram = cosim.Diagram(1)
    a, b = diagram.add(cosim.UnitDelay(initial=1.0), "a"), diagram.add(cosim.UnitDelay(initial=2.0), "b")
    diagram.connect(a["y"], b["u"])
    diagram.connect(b["y"], a["u"])
    result = run_both(diagram, 3)
    assert result["a.y"].tolist() == [1, 2, 1, 2]
    assert result["b.y"].tolist() == [2, 1, 2, 1]


def test_sample_time(make_block):
    def own(dt, every):
        diagram = cosim.Diagram(dt)
        diagram.add(make_block(sample_time=cosim.Diagram("1/50").step), "controller", every=every)
        return diagram

    own("1/50", 1).build()
    own("1/100", 2).build()
    with pytest.raises(cosim.StepSizeError) as caught:
        own("1/30", 2).build()
    assert str(caught.value).startswith(
        "Block 'controller' must run every 0.02 s, but the diagram runs it every 1/15 s; change the diagram's dt"
    )


def test_matrices_random_inputs_and_defaults(make_block, run_both):
    ports = [Port("z", (2, 2), draw="normal"), Port("p", draw="uniform"), Port("bias", (2,), default=0.5)]

    def mix(z, p, bias, y):
        y[0] = z[0, 1] + bias[1]
        y[1] = z[1, 0] + p[0]

    diagram = cosim.Diagram(1)
    diagram.add(make_block(inputs=ports, outputs=[Port("y", (2,))], output=mix), "m")
    fed = diagram.add(make_block(inputs=ports, outputs=[Port("y", (2,))], output=mix), "fed")
    diagram.connect(diagram.add(cosim.Constant(7.0))["y"], fed["z"][1])
    result = run_both(diagram, 999, seed=2, record=["*", "m.z", "m.p", "fed.z"])
    np.testing.assert_array_equal(result["m.y"][:, 0], result["m.z"][:, 0, 1] + 0.5)
    np.testing.assert_array_equal(result["m.y"][:, 1], result["m.z"][:, 1, 0] + result["m.p"])
    assert 0 < result["m.p"].min() < 0.01
    assert 0.99 < result["m.p"].max() < 1
    assert (result["fed.z"][:, 0, 1] == 7).all()  # the source goes before the random number
    z = result["m.z"].reshape(1000, 4)
    assert abs(z.mean()) < 0.1
    assert np.abs(np.corrcoef(z.T) - np.eye(4)).max() < 0.12


# --- the contract of step functions -------------------------------------------------------------------------------------------


def asks(y, spede):
    y[0] = spede[0]


def too_early(u, y):
    y[0] = u[0]


def with_default(y, a=1.0):
    y[0] = a


def with_star(y, *rest):
    y[0] = 1.0


def with_keyword(y, *, a):
    y[0] = 1.0


def writes_x(x):
    x[0] = 1.0


def shows_constant(y):
    y[0] = 1.0


def update_writes_output(u, y):
    y[0] = u[0]


def update_writes_side(u, outputs):
    for i in range(outputs.shape[0]):
        outputs[i] += u[i]


def writes_input(u, held):
    u[0], held[0] = held[0], u[0]


def writes_inputs(held, inputs):
    inputs[held.shape[0] - 1] = 2.0 * held[0]


CASES = {
    "unknown argument": (
        {"output": asks},
        r"'asks' of block 'b' has the argument 'spede', which is no port, state, parameter or scratch array",
    ),
    "late input": (
        {"output": too_early},
        r"'too_early' of block 'b' reads 'u' to write the outputs, but .* feedthrough=False",
    ),
    "default": ({"output": with_default}, r"'with_default' must have plain arguments: no defaults"),
    "star": ({"output": with_star}, r"'with_star' must have plain arguments"),
    "keyword": ({"output": with_keyword}, r"'with_keyword' must have plain arguments"),
    "no function": ({"output": math.sin}, r"must be a plain Python function, not <built-in function sin>"),
    "forgotten output": (
        {"output": writes_x, "state": {"x": 0.0}},
        r"Block 'b' has the output 'y', but no output function",
    ),
    "no output function": ({"update": too_early}, r"Block 'b' has the output 'y', but no output function"),
    "update writes an output": (
        {"output": shows_constant, "update": update_writes_output},
        r"The update function 'update_writes_output' of block 'b' writes the output 'y', which other blocks would read too early",
    ),
    "update writes a side": (
        {"output": shows_constant, "update": update_writes_side},
        r"'update_writes_side' of block 'b' writes the output 'outputs'",
    ),
    "writes an input": (
        {"output": shows_constant, "update": writes_input, "state": {"held": 0.0}},
        r"'writes_input' of block 'b' writes into its input 'u', which belongs to the block that feeds it",
    ),
    "writes a side of inputs": (
        {"output": shows_constant, "update": writes_inputs, "state": {"held": 0.0}},
        r"'writes_inputs' of block 'b' writes into its input 'inputs'",
    ),
    "shape of scratch space": (
        {"output": write_held, "state": {"held": 0.0}, "scratch": {"k1": np.zeros(4), "k2": (4,)}},
        r"Block 'b' has scratch={'k2': \(4,\)}, which is a shape; give an array of this shape: np.zeros\(\(4,\)\)",
    ),
    "same name twice": ({"output": write_held, "state": {"held": 0.0, "u": 0.0}}, r"uses the name 'u' twice"),
    "reserved name": ({"output": write_held, "state": {"held": 0.0, "t": 0.0}}, r"uses the name 't' twice"),
}


@pytest.mark.parametrize("case", CASES)
def test_contract(case, make_block):
    parts, sentence = CASES[case]
    block = make_block(inputs=[Port("u", feedthrough=False, default=0.0)], outputs=[Port("y")], **parts)
    diagram = cosim.Diagram(1)
    diagram.add(block, "b")
    with pytest.raises(cosim.KernelError, match=sentence):
        diagram.build()
    with pytest.raises(cosim.KernelError, match=sentence.replace("'b'", "Custom")):
        block.online(1, compiled=False)


@pytest.mark.parametrize("values", [0, 4.0, (1,), (0, 0), (4.0,), [4, 2], np.array([4, 2]), ()])
def test_scratch_space_may_have_any_values(values, make_block):
    block = make_block(
        inputs=[Port("u", default=2.0)], outputs=[Port("y")], output=copy_through, scratch={"work": values}
    )
    assert block.online(1, compiled=False)(u=3.0).y == 3.0


def rebinds(u, y):
    y = u  # noqa: F841


def rebinds_after_reading(u, y):
    y = 2.0 * y + u


def ignores(u, y):
    pass


def adds_in_place(u, y):
    y[0] = 0.0
    y += u


def lets_another_write(u, y):
    copy_through(u, y)


def through_another_name(u, y):
    out = y
    out[0] = u[0]


@pytest.mark.parametrize("output", [rebinds, rebinds_after_reading, ignores])
def test_an_output_into_which_nothing_is_written_is_warned_of(output, make_block):
    diagram = cosim.Diagram(1)
    diagram.add(make_block(inputs=[Port("u", default=0.0)], outputs=[Port("y")], output=output), "b")
    sentence = (
        rf"The step function '{output.__name__}' of block 'b' writes nothing into its output 'y', which has no value \(NaN\). "
        r"Write y\[0\] = "
    )
    with pytest.warns(UserWarning, match=sentence) as caught:
        diagram.build()
    assert len(caught) == 1


@pytest.mark.parametrize("output", [copy_through, adds_in_place, lets_another_write, through_another_name])
def test_an_output_that_is_written_in_some_way_is_not_warned_of(output, make_block, recwarn):
    diagram = cosim.Diagram(1)
    diagram.add(make_block(inputs=[Port("u", (1,), default=0.0)], outputs=[Port("y", (1,))], output=output), "b")
    diagram.build()
    assert not recwarn.list


def test_a_block_must_say_what_it_does():
    diagram = cosim.Diagram(1)
    diagram.add(cosim.Block(), "b")
    with pytest.raises(cosim.KernelError, match="Block has no step functions; give it a method define"):
        diagram.build()


def test_python_callbacks_run_interpreted_only(make_block):
    calls = []

    def callback(t, y):
        calls.append(float(t))
        y[0] = math.exp(float(t)) + len(calls)

    diagram = cosim.Diagram(1)
    callback_node = diagram.add(make_block(outputs=[Port("y")], output=callback, compiled=False), "callback")
    gain = diagram.add(cosim.Gain(2.0))
    diagram.connect(callback_node["y"], gain["u"])
    result = diagram.simulate(2)
    assert result.metadata["engine"] == "interpreted"
    np.testing.assert_allclose(result["gain.y"], [2 * (math.exp(k) + k + 1) for k in range(3)])
    with pytest.raises(cosim.KernelError, match="The block callback calls back into Python and cannot be compiled"):
        diagram.simulate(2, engine="compiled")


def test_whole_sides(make_block, run_both):
    def twice(inputs, outputs):
        for i in range(outputs.shape[0]):
            outputs[i] = exp(inputs[i]) if i == 0 else 2.0 * inputs[i]

    diagram = cosim.Diagram(1)
    block = make_block(inputs=[Port("a"), Port("b", (2,))], outputs=[Port("p", (2,)), Port("q")], output=twice)
    node = diagram.add(block, "side")
    values = [diagram.add(cosim.Constant(v), f"c{i}") for i, v in enumerate((0.0, 2.0, 3.0))]
    diagram.connect(values[0]["y"], node["a"])
    diagram.connect([v["y"] for v in values[1:]], node["b"])
    result = run_both(diagram, 0)
    assert result["side.p"].tolist() == [[1.0, 4.0]]
    assert result["side.q"].tolist() == [6.0]


@pytest.mark.parametrize("between", [cosim.Gain(2.0), cosim.UnitDelay(), cosim.TransferFunction([1.0], [1.0, 1.0])])
def test_a_nan_that_reaches_a_plant_is_followed_back_to_the_sensor(between):
    diagram = cosim.Diagram(dt=0.1)
    level, sensor = (
        diagram.add(cosim.Constant(1.0)),
        diagram.add(cosim.Dropout(start=0.2, duration=0.2, channels=1), "sensor"),
    )
    last = diagram.add(between, "filter")
    plant = diagram.add(cosim.StateSpace(control.ss(-1, 1, 1, 0, inputs="force", outputs="x")), "plant")
    diagram.connect(level["y"], sensor["u"])
    diagram.connect(sensor["y"], last["u"])
    diagram.connect(last["y"], plant["force"])
    with pytest.raises(
        cosim.SimulationError, match=r"(plant\.x|filter\.y) came out NaN\. The NaN may come from (sensor|filter)\.y"
    ):
        diagram.simulate(1.0)


def test_a_nan_of_the_plant_itself_came_from_nowhere_else():
    root = control.nlsys(None, lambda t, x, u, p: np.sqrt(1.0 - u), inputs=1, outputs=1, dt=0)
    diagram = cosim.Diagram(dt=0.1)
    ramp, plant = diagram.add(cosim.Ramp(10.0)), diagram.add(cosim.StateSpace(root), "plant")
    diagram.connect(ramp["y"], plant["u[0]"])
    with pytest.raises(cosim.SimulationError, match=r"came out NaN\. Check the plant's parameters"):
        diagram.simulate(1.0)
