"""Subsystems wherever a block can be used; random ones are among the diagrams of tests/cosim/run/test_engines.py."""

import pickle

import control
import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.random import numbers


def pi(gain=2.0, dt=0.02):
    inside = cosim.Diagram(dt)
    error = inside.add(cosim.Sum("+-"), "error")
    proportional, integral = inside.add(cosim.Gain(gain), "gain"), inside.add(cosim.Integrator(), "integral")
    total = inside.add(cosim.Sum("++"), "total")
    inside.connect(error["y"], proportional["u"])
    inside.connect(error["y"], integral["u"])
    inside.connect([proportional["y"], integral["y"]], total["u"])
    return cosim.Subsystem(inside, inputs={"goal": "error.u[0]", "y": "error.u[1]"}, outputs={"u": "total.y"})


def loop(controller, plant=None):
    return cosim.closed_loop(
        plant or cosim.TransferFunction([1.0], [1.0, 0.5]),
        controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(1, 0.1),
        reference=1.0,
        faults=cosim.Freeze(start=2.0),
        dt=0.02,
    )


def by_hand():
    """The loop with the same blocks and names, connected one by one."""
    diagram = cosim.Diagram(0.02)
    add = lambda block, name: diagram.add(block, name)  # noqa: E731
    goal, plant = add(cosim.Constant(1.0), "reference"), add(cosim.TransferFunction([1.0], [1.0, 0.5]), "plant")
    sensors, freeze = add(cosim.Sensors(1, 0.1), "sensors"), add(cosim.Freeze(start=2.0, channels=1), "freeze_0")
    error = add(cosim.Sum("+-"), "controller.error")
    gain, integral = add(cosim.Gain(2.0), "controller.gain"), add(cosim.Integrator(), "controller.integral")
    total = add(cosim.Sum("++"), "controller.total")
    diagram.connect(plant["y"], sensors["u"])
    diagram.connect(sensors["y"], freeze["u"])
    diagram.connect([goal["y"], freeze["y"]], error["u"])
    diagram.connect(error["y"], gain["u"])
    diagram.connect(error["y"], integral["u"])
    diagram.connect([gain["y"], integral["y"]], total["u"])
    diagram.connect(total["y"], plant["u"])
    return diagram


def test_a_closed_loop_of_subsystems(run_both, same_bits):
    inside = cosim.Diagram(0.02)
    inside.add(cosim.TransferFunction([1.0], [1.0, 0.5]), "process")
    plant = cosim.Subsystem(inside, inputs={"u": "process.u"})
    expected = run_both(by_hand(), 6.0, seed=3)
    for diagram in (loop(pi()), loop(pi(), plant)):
        result = run_both(diagram, 6.0, seed=3)
        same_bits(result["plant.y"], expected["plant.y"])
        same_bits(result["controller.u"], expected["controller.total.y"])


def test_a_plant_that_is_a_subsystem_has_each_faulty_input_once():
    inside = cosim.Diagram(0.02)
    inside.add(cosim.TransferFunction([1.0], [1.0, 0.5]), "process")
    plant = cosim.Subsystem(inside, inputs={"force": "process.u"})
    halved = cosim.GainFault(factor=0.5)
    diagram = cosim.closed_loop(
        plant, pi(), control="force", measured="y", reference=1.0, input_faults={"force": halved}, dt=0.02
    )
    roles = diagram.simulate(0.1, engine="interpreted").roles
    assert [(role.name, role.sent, role.faults) for role in roles.inputs] == [
        ("force", ("controller.total.y", 0), ("force_gain_fault_0",))
    ]


def test_settings_inside_are_factors_of_campaigns(campaign_as_alone):
    table = campaign_as_alone(loop(pi()), 4.0, points={"controller.gain.gain": [1.0, 4.0]})
    assert (table["status"] == "ok").all()
    changed = cosim.varied(loop(pi()), {"controller.gain.gain": 4.0}).simulate(4.0, seed=1)
    np.testing.assert_array_equal(changed["plant.y"], loop(pi(4.0)).simulate(4.0, seed=1)["plant.y"])
    assert not np.array_equal(changed["plant.y"], loop(pi()).simulate(4.0, seed=1)["plant.y"])
    with pytest.raises(cosim.ConnectionError, match="A subsystem cannot replace 'controller'; replace blocks inside"):
        cosim.varied(loop(pi()), {"controller": pi(3.0)})


def test_a_subsystem_makes_no_algebraic_loop(run_both):
    inside = cosim.Diagram(0.1)
    inside.add(cosim.Gain(2.0), "through")
    inside.add(cosim.UnitDelay(initial=1.0), "late")
    both = cosim.Subsystem(
        inside, inputs={"a": "through.u", "b": "late.u"}, outputs={"doubled": "through.y", "kept": "late.y"}
    )
    diagram = cosim.Diagram(0.1)
    node = diagram.add(both, "both")
    diagram.connect(node["kept"], node["a"])
    diagram.connect(node["doubled"], node["b"])
    np.testing.assert_array_equal(run_both(diagram, 1.0)["both.kept"], 2.0 ** np.arange(11))


def test_rates_inside_and_outside(run_both):
    inside = cosim.Diagram("1/10")
    inside.add(cosim.Sine(1.0, period=3.0), "slow", every=2)
    block = cosim.Subsystem(inside)
    diagram = cosim.Diagram("1/20")
    diagram.add(block, "part", every=2)
    assert diagram["part.slow"].every == 4
    result = run_both(diagram, 2.0)
    assert len(np.unique(result["part.y"])) == 11
    wrong = cosim.Diagram("1/20")
    wrong.add(block, "part")
    with pytest.raises(cosim.StepSizeError, match=r"Block 'part' must run every 0\.1 s"):
        wrong.simulate(1.0)


def test_inputs_without_a_source():
    diagram = cosim.Diagram(0.02)
    diagram.add(pi(), "pi")
    with pytest.raises(cosim.UnconnectedInputError, match=r"pi\.goal has no source"):
        diagram.simulate(1.0)
    inside = cosim.Diagram(0.1)
    inside.add(fmu := cosim.FMU(fmus.path("CruiseControl")), "car")
    started = next(port for port in fmu.inputs if port.default is not None)
    live = cosim.Diagram(0.1)
    live.add(cosim.Subsystem(inside, {"force": f"car.{started.name}"}, {"v": "car.v"}), "part")
    live.start(record=["part.v"])
    live.set("part.force", 500.0)
    fast = live.advance(5.0)["part.v"][-1]
    live.reset()
    live.set("part.force", 0.0)
    assert fast > live.advance(5.0)["part.v"][-1]


def test_random_inputs_draw_under_the_name_of_the_subsystem(same_bits):
    inside = cosim.Diagram(0.1)
    inside.add(cosim.Gaussian(2.0), "noise")
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Subsystem(inside, {"e": "noise.noise"}, {"y": "noise.y"}), "part")
    same_bits(diagram.simulate(1.0, seed=5)["part.y"], 2.0 * numbers(5, "part.e", 11, channel=0))


@pytest.mark.slow
def test_exports_and_python_control(tmp_path, same_bits):
    times, rng = 0.02 * np.arange(100), np.random.default_rng(1)
    goal, y = rng.normal(size=(2, 100))
    diagram = cosim.Diagram(0.02)
    node = diagram.add(pi(), "pi")
    for name, values in (("goal", goal), ("y", y)):
        diagram.connect(
            diagram.add(cosim.Table(times - 0.01, values, interpolate=False), f"from_{name}")["y"], node[name]
        )
    expected = diagram.simulate(1.98)["pi.u"]
    system = pi().to_control()
    assert system.input_labels == ["goal", "y"]
    assert system.output_labels == ["u"]
    response = control.input_output_response(system, times, [goal, y])
    np.testing.assert_allclose(np.ravel(response.outputs), expected, rtol=1e-12)
    online = pi().online()
    same_bits([online(goal=a, y=b).u for a, b in zip(goal, y)], expected)
    plain = pi().online(compiled=False)
    same_bits([plain(goal=a, y=b).u for a, b in zip(goal, y)], expected)
    path = cosim.export_fmu(pi(), tmp_path / "pi.fmu")
    fmu = cosim.FMU(path)
    assert [port.name for port in fmu.inputs] == ["goal", "y"]
    assert [port.name for port in fmu.outputs] == ["u"]
    parameters = [each.name for each in fmu.description.variables if each.causality == "parameter"]
    assert parameters == ["gain.gain", "gain.offset"]
    verification = cosim.verify_fmu(path, loop(pi()), "controller", duration=4.0)
    assert [each.signal for each in verification.beside] == ["controller.u"]
    assert {each.largest for each in (*verification.beside, *verification.in_loop)} == {0.0}
    assert not [note for note in verification.notes if "which change in the diagram" in note]
    renamed = cosim.FMU(cosim.export_fmu(pi(), tmp_path / "renamed.fmu", outputs={"u": "force", "gain.y": "p"}))
    assert [port.name for port in renamed.outputs] == ["force", "p"]


def test_pickles_and_later_changes(same_bits):
    inside = cosim.Diagram(0.1)
    delay = inside.add(cosim.UnitDelay(initial=1.0), "delay")
    block = cosim.Subsystem(inside)
    assert [port.name for port in block.inputs] == ["u"]
    assert [port.name for port in block.outputs] == ["y"]
    inside.connect(inside.add(cosim.Constant(3.0), "later")["y"], delay["u"])
    for each in (block, pickle.loads(pickle.dumps(block))):
        diagram = cosim.Diagram(0.1)
        node = diagram.add(each, "part")
        diagram.connect(node["y"], node["u"])
        assert [n.name for n in diagram.nodes] == ["part", "part.delay"]
        same_bits(pickle.loads(pickle.dumps(diagram)).simulate(0.3)["part.y"], np.ones(4))


def test_the_drawing_shows_one_box():
    text = loop(pi())._repr_html_()
    assert "Subsystem" in text
    assert "integral" not in text
    assert "integral" in pi()._repr_html_()
    assert repr(pi()) == "<Subsystem of 4 blocks at 0.02 s: goal, y -> u>"


def filled():
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Gain(2.0), "gain")
    diagram.add(cosim.UnitDelay(2), "pair")
    return diagram


@pytest.mark.parametrize(
    ("inputs", "outputs", "error", "words"),
    [
        ({"u": "gain.w"}, None, cosim.UnknownNameError, "Block 'gain' has no port 'w'"),
        ({"u": "gian.u"}, None, cosim.UnknownNameError, "The subsystem has no block for 'gian.u'.*'gain'"),
        ({"u": "gain.y"}, None, cosim.ModelError, "gain.y is an output; it cannot be an input"),
        ({"u": ["gain.u", "pair.u"]}, None, cosim.ModelError, r"differ in size: gain.u \(1\), pair.u \(2\)"),
        ({"u": "gain.u", "v": "gain.u"}, None, cosim.ModelError, "feed the same port inside"),
        ({"y": "gain.u"}, {"y": "gain.y"}, cosim.ModelError, "Two ports of the subsystem have the name 'y'"),
        ({"inside": "gain.u"}, None, cosim.ModelError, "cannot be named 'inside'"),
        ({"a b": "gain.u"}, None, cosim.ModelError, "must not be empty or contain spaces"),
        ({"u": []}, None, cosim.ModelError, "refers to no port"),
        ({"u": 3}, None, cosim.ModelError, "refers to a port"),
        (["gain.u"], None, cosim.ModelError, "mapping from names to ports"),
        (None, {}, cosim.ModelError, "at least one output"),
    ],
)
def test_refusals(inputs, outputs, error, words):
    with pytest.raises(error, match=words):
        cosim.Subsystem(filled(), inputs, outputs)


def test_further_refusals():
    diagram = filled()
    diagram.connect(diagram.add(cosim.Constant(1.0), "one")["y"], diagram["gain"]["u"])
    with pytest.raises(cosim.ModelError, match=r"gain\.u has a source inside the subsystem"):
        cosim.Subsystem(diagram, {"u": "gain.u"})
    with pytest.raises(cosim.ModelError, match="another diagram"):
        cosim.Subsystem(diagram, {"u": filled()["pair"]["u"]})
    with pytest.raises(cosim.ModelError, match="needs a diagram"):
        cosim.Subsystem(cosim.Gain(2.0))
    outside = cosim.Diagram(0.1)
    outside.add(cosim.Gain(1.0), "part.gain")
    with pytest.raises(cosim.ModelError, match=r"already has a block 'part\.gain'"):
        outside.add(cosim.Subsystem(filled()), "part")
    assert [node.name for node in outside.nodes] == ["part.gain"]
    with pytest.raises(cosim.ModelError, match="runs only in a diagram"):
        cosim.Subsystem(filled()).define(1)
