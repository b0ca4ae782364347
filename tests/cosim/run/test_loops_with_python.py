"""Loops with a block that calls back into Python: from some steps on they call the compiled step functions of the others."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.run import engines


def pendulum():
    """A nonlinear plant of python-control, two rates, noise, a fault, and a learner."""
    plant = control.nlsys(
        lambda t, x, u, params: np.array([x[1], u[0] - np.sin(x[0]) - 0.2 * x[1]]), lambda t, x, u, params: x[:1],
        inputs=["torque"], outputs=["angle"], states=["angle", "speed"],
    )  # fmt: skip
    controller = controllers.design(
        plant, measured="angle", actuated="torque", sensors=2, sensor_std=0.01, dt=0.04,
        precision=controllers.GammaPrecision(),
    )  # fmt: skip
    return cosim.closed_loop(
        plant, controller, control="torque", measured="angle", sensors=cosim.Sensors(2, 0.01), dt=0.02,
        faults=cosim.Freeze(sensor=0, start=1.0), reference=cosim.Sine(amplitude=0.3, period=2.0),
    )  # fmt: skip


@pytest.fixture
def compiled(monkeypatch):
    """Lower the number of steps, and return the step functions that are called compiled."""
    called = []

    def counted(kernel, *others):
        called.append(kernel.__name__)
        return engines_compiled_step(kernel, *others)

    engines_compiled_step = engines.compiled_step
    monkeypatch.setattr(engines, "compiled_step", counted)
    monkeypatch.setattr(engines, "CALLED_COMPILED", 100)
    return called


def assert_same_bits(one, other):
    assert set(one) == set(other)
    for name in one:
        assert one[name].tobytes() == other[name].tobytes(), name


def test_it_has_the_bits_of_plain_python(compiled):
    loop = pendulum()
    plain = loop.simulate(2.0, seed=3, engine="interpreted")
    assert not compiled
    quick = loop.simulate(2.0, seed=3)
    assert len(compiled) >= 3  # reference, sensors, fault, controller, each once
    assert len(compiled) == len(set(compiled))
    assert quick.metadata["engine"] == plain.metadata["engine"] == "interpreted"
    assert_same_bits(quick, plain)


def test_a_short_run_compiles_nothing(compiled):
    pendulum().simulate(1.0)
    assert not compiled


def test_a_short_run_that_takes_long_compiles_all_the_same(compiled, monkeypatch):
    loop = pendulum()
    plain = loop.simulate(1.0, seed=3)
    monkeypatch.setattr(engines, "LONG", 0.0)  # from the second piece of the run on
    quick = loop.simulate(1.0, seed=3)
    assert compiled
    assert_same_bits(quick, plain)


def test_in_pieces_after_restore_and_in_time(compiled):
    loop = pendulum()
    whole = loop.simulate(5.0, seed=5, engine="interpreted")["plant.angle"]
    with loop.start(seed=5) as session:
        first = session.advance(1.0)["plant.angle"]
        assert not compiled  # 50 steps
        state = session.save_state()
        long = session.advance(4.0)["plant.angle"]
        assert compiled
        session.restore(state)
        again = session.advance(4.0)["plant.angle"]
        assert long.tobytes() == again.tobytes()
        assert np.array_equal(np.concatenate([first, long]), whole)
    compiled.clear()
    with loop.start(seed=5) as session:
        session.advance(2.2, pace=1e6)  # compiling would make it late
        assert not compiled


def test_runs_of_a_campaign_are_those_alone(compiled, campaign_as_alone):
    campaign_as_alone(pendulum(), 1.0)
    assert compiled


def test_what_cannot_be_compiled_stays_plain(make_block, compiled, monkeypatch):
    def refuse(kernel, *others):
        raise KernelError("it cannot be compiled")

    def double(u, y):
        y[0] = 2.0 * u[0]

    def root(u, y):
        y[0] = abs(u[0]) ** 0.5

    diagram = cosim.Diagram(0.1)
    noise = diagram.add(cosim.Gaussian(1.0), "noise")
    ports = {"inputs": [Port("u")], "outputs": [Port("y")]}
    twice = diagram.add(make_block(**ports, output=double), "twice")
    python = diagram.add(make_block(**ports, output=root, compiled=False), "python")
    diagram.connect(noise["y"], twice["u"])
    diagram.connect(twice["y"], python["u"])
    quick = diagram.simulate(20.0, seed=1)
    assert "double" in compiled
    assert "root" not in compiled
    monkeypatch.setattr(engines, "compiled_step", refuse)
    assert_same_bits(quick, diagram.simulate(20.0, seed=1))
