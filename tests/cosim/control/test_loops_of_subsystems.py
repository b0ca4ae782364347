"""Figures of loops whose plant and controller are subsystems, against the same loop of single blocks, built flat."""

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError

DT = 0.02
BLOCKS = {
    "error": cosim.Sum("+-"),
    "gain": cosim.Gain(2.0),
    "integral": cosim.Integrator(low=-5.0, high=5.0),
    "total": cosim.Sum("++"),
    "motor": cosim.TransferFunction([1.0], [0.1, 1.0]),
    "load": cosim.TransferFunction([1.0], [1.0, 0.5]),
}
WIRES = (("error", "gain", "u"), ("error", "integral", "u"), ("gain", "total", "u[0]"), ("integral", "total", "u[1]"))


def part(names, wires, rates=None, **ports):
    inside = cosim.Diagram(DT)
    nodes = {name: inside.add(BLOCKS[name], name, (rates or {}).get(name, 1)) for name in names}
    for source, target, port in wires:
        inside.connect(nodes[source]["y"], nodes[target][port])
    return cosim.Subsystem(inside, **ports)


def pi(**options):
    names, ports = ("error", "gain", "integral", "total"), {"goal": "error.u[0]", "y": "error.u[1]"}
    return part(names, WIRES, inputs=ports, outputs={"u": "total.y"}, **options)


def drive():
    return part(("motor", "load"), [("motor", "load", "u")], inputs={"u": "motor.u"}, outputs={"y": "load.y"})


def loop(plant, controller, **options):
    return cosim.closed_loop(plant, controller, control="u", measured="y", reference=1.0, **options)


def flat(broken):
    """Return all blocks in one diagram, closed or broken at the motor, as a linear system of python-control."""
    diagram = cosim.Diagram(DT)
    nodes = {name: diagram.add(block, name) for name, block in BLOCKS.items()}
    goal = diagram.add(cosim.Constant(1.0), "goal")
    for source, target, port in (*WIRES, ("motor", "load", "u"), ("load", "error", "u[1]"), ("total", "motor", "u")):
        diagram.connect(nodes[source]["y"], nodes[target][port])
    diagram.connect(goal["y"], nodes["error"]["u[0]"])
    outputs = ["total.y"] if broken else ["load.y"]
    system = diagram.to_control(inputs=["motor.u" if broken else "goal.y"], outputs=outputs)
    return system.linearize(system.initial_state, 0.0)


@pytest.mark.slow
def test_plant_and_controller_of_blocks_are_the_loop_built_flat():
    nested = loop(drive(), pi(), faults=[cosim.Freeze(start=3.0)], sensors=cosim.Sensors(1, 0.1))
    broken, closed = -flat(broken=True), flat(broken=False)
    for z in np.exp(1j * DT * np.logspace(-1, np.log10(0.99 * np.pi / DT), 30)):
        np.testing.assert_allclose(nested.linear().open()(z), broken(z), rtol=1e-7)
        np.testing.assert_allclose(nested.linear().closed[0, 0](z), closed(z), rtol=1e-7)
    np.testing.assert_allclose(np.sort(nested.poles()), np.sort(np.linalg.eigvals(closed.A)), rtol=1e-6)
    gain, phase, *_ = control.stability_margins(broken, method="frd")
    margins = nested.margins()
    np.testing.assert_allclose([margins.gain, margins.phase], [gain, phase], rtol=1e-3)
    assert nested.step_info()["SteadyStateValue"] == pytest.approx(1.0, abs=1e-3)
    assert nested.bode().axes


def test_a_part_of_one_block_is_that_block():
    inside = cosim.Diagram(DT)
    inside.add(cosim.Subsystem(part(("load",), ()).diagram), "deep")
    nested = loop(cosim.Subsystem(inside), pi())
    plain = loop(BLOCKS["load"], pi())
    np.testing.assert_allclose(nested.poles(), plain.poles(), rtol=1e-9)
    assert nested.margins().gain == pytest.approx(plain.margins().gain, rel=1e-6)


def test_parts_of_several_rates_are_refused():
    with pytest.raises(ModelError, match=r"The blocks of 'controller' run at different rates"):
        loop(drive(), pi(rates={"integral": 2})).linear()


def test_blocks_between_controller_and_plant_are_refused_with_the_way_out():
    between = {"blocks": {"limit": cosim.RateLimiter(1.0)}}
    between["connections"] = [("controller.u", "limit.u"), ("limit.y", "plant.u")]
    with pytest.raises(ModelError, match=r"does not lead to the plant 'plant' .* Linearize the whole loop"):
        loop(drive(), pi(), **between).linear()


@pytest.mark.parametrize(
    ("smooth", "filtered"),
    [
        (cosim.ExponentialFilter(0.5), control.tf([1 - np.exp(-0.04), 0], [1, -np.exp(-0.04)], 0.02)),
        (cosim.MovingAverage(10), control.tf([0.1] * 10, [1] + 9 * [0], 0.02)),
    ],
)
def test_a_filter_in_the_controller_is_in_the_linear_loop(smooth, filtered):
    """Its first sample passes unfiltered: an unstable loop had a gain margin of 10."""
    inside = cosim.Diagram(dt=0.02)
    error, gain = inside.add(cosim.Sum("+-"), "error"), inside.add(cosim.Gain(10.0), "gain")
    between = inside.add(smooth, "filter")
    inside.connect(error["y"], between["u"])
    inside.connect(between["y"], gain["u"])
    law = cosim.Subsystem(inside, inputs={"goal": "error.u[0]", "y": "error.u[1]"}, outputs={"u": "gain.y"})
    plant = cosim.TransferFunction([1.0], [1.0, 0.5])
    loop = cosim.closed_loop(plant, law, control="u", measured="y", reference=1.0)
    open_loop = 10.0 * control.c2d(control.tf([1.0], [1.0, 0.5]), 0.02) * filtered
    _, phase, _, crossover = control.margin(open_loop)
    found = loop.margins()
    assert (found.phase, found.gain_crossover) == pytest.approx((phase, crossover), rel=1e-3)
    slowest = np.abs(control.feedback(open_loop).poles()).max()
    assert np.abs(loop.poles()).max() == pytest.approx(slowest, abs=1e-6)
