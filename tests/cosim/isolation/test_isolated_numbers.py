"""FMUs in processes of their own give the numbers that they give in process; saved states, settings."""

import math
import pickle
import sys
import time
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import FMUError, ModelError
from bayesftc.cosim.isolation import kernels as _isolated_kernels, protocol as _isolated_protocol

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")

FMI = ("2.0", "3.0")
ENGINES = ("interpreted", "compiled")
STEP = Fraction(1, 50)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("fmi", "engine"),
    [
        ("2.0", "compiled"),
        ("3.0", "interpreted"),
        *(pytest.param(*p, marks=pytest.mark.slow) for p in zip(FMI, ENGINES)),
    ],
)
def test_the_same_bits_as_in_process(fmi, engine, same_bits, nothing_left, car, cruise):
    options = {"seed": 4, "engine": engine, "record": ["car.*", "car.force", "car.disturbance"]}
    for every, dt in ((1, 0.02), (3, "1/30")) if engine == "interpreted" else ((3, "1/30"),):
        settings = {"parameters": {"m": 120.0, "b": 7, "v0": 3.5}}
        wanted = cruise(car(fmi, isolate=False, **settings), dt, every).simulate(
            9, **options | {"engine": "interpreted"}
        )
        found = cruise(car(fmi, **settings), dt, every).simulate(9, **options)
        for name in wanted:
            same_bits(found[name], wanted[name], name)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("engine", "ports"),
    [*((engine, {}) for engine in ENGINES), ("interpreted", {"inputs": (), "outputs": ()})],
)
def test_sampled_and_mute_ones(engine, ports, same_bits, car):
    runs = []
    for isolate in (False, True):
        diagram = cosim.Diagram(dt=0.02)
        node = diagram.add(car(isolate=isolate, timing="sampled", parameters={"force": 30.0}, **ports), "car")
        sine = diagram.add(cosim.Sine(300.0, 1.7), "sine")
        if "inputs" not in ports:
            diagram.connect(sine["y"], node["force"])
        runs.append(diagram.simulate(2, engine=engine))
    assert list(runs[0]) == list(runs[1])
    for name in runs[0]:
        same_bits(runs[1][name], runs[0][name], name)


def test_both_ends_of_the_way_have_the_same_words(car):
    kernels, protocol = _isolated_kernels, _isolated_protocol
    names = [
        "COMMAND",
        "STATUS",
        "AHEAD",
        "READ_STATUS",
        "PHASE",
        "WANTED",
        "TIME",
        "COUNT",
        "READ",
        "STEP",
        "INTERRUPTED",
    ]
    for name in names:
        assert getattr(kernels, name) == getattr(protocol, name)
    assert protocol.INTERRUPTED > 500  # no status of an FMU in process
    instance = car().instantiate(STEP, "car")
    assert len(instance.table) == kernels.STEP_SIZE + 1 <= 32
    assert instance.step_word == kernels.STEP_SIZE
    instance.close()


@pytest.mark.parametrize("fmi", ["2.0", pytest.param("3.0", marks=pytest.mark.slow)])
def test_states_stay_with_the_fmu_and_go_on_elsewhere_as_bytes(fmi, same_bits, nothing_left, car, cruise):
    diagram = cruise(car(fmi))
    whole = cruise(car(fmi, isolate=False)).simulate(2.0, seed=3, engine="interpreted")["car.v"]
    with diagram.start(seed=3, engine="interpreted") as session:
        session.advance(1.0)
        state = session.save_state()
        first = session.advance(1.0)["car.v"]
        session.restore(state)
        same_bits(session.advance(1.0)["car.v"], first)
        moved = pickle.dumps(state)
    same_bits(first[-50:], whole[-50:])
    for other in (diagram, cruise(car(fmi, isolate=False))):  # whoever can read bytes
        with other.start(seed=3, engine="interpreted") as session:
            session.restore(pickle.loads(moved))
            same_bits(session.advance(1.0)["car.v"], first)
    with diagram.start(seed=3, engine="interpreted") as session:
        session.restore(state)  # of a run that is closed
        same_bits(session.advance(1.0)["car.v"], first)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_coupled_tightly_and_in_steps_of_their_own(engine, same_bits, nothing_left, car):
    ways = [cosim.Coupling("iterated", tolerance=1e-12), cosim.Coupling("jacobi", step_error=1e-3)]
    for way in ways:
        runs = []
        for isolate in (False, True):
            diagram = cosim.Diagram(dt="1/10")
            a, b = (diagram.add(car(FMI[i], isolate, parameters={"v0": 1.0 + i}), "ab"[i]) for i in range(2))
            for source, target in ((a, b), (b, a)):
                gain = diagram.add(cosim.Gain(-50.0), f"from_{source.name}")
                diagram.connect(source["v"], gain["u"])
                diagram.connect(gain["y"], target["force"])
            runs.append(diagram.build(way).simulate(1, engine=engine))
        for name in runs[0]:
            same_bits(runs[1][name], runs[0][name], name)


@pytest.mark.slow
def test_saved_states_are_forgotten_and_refused(car):
    first, second = (car(name=name).instantiate(STEP, name) for name in ("first", "second"))
    u, y = np.array([100.0, 0.0]), np.zeros(1)
    zero = first.save()
    assert first.update(u, y, 0.0) == 0
    assert first.output(u, y, 0.02) == 0
    assert y[0] == 0.02
    second.restore(zero)  # travels as bytes
    first.restore(zero)
    assert first.output(u, y, 0.0) == 0
    assert y[0] == 0.0
    first.forget(zero)
    with pytest.raises(FMUError, match="no longer exists: it was deleted"):
        first.restore(zero)
    with pytest.raises(FMUError, match="is no saved state of the FMU 'CruiseControl'"):
        second.restore("nonsense")
    for _ in range(50):
        first.save()  # nobody keeps them
    assert first.update(u, y, 0.0) == 0
    for instance in (first, second):
        instance.close()
        instance.close()
        with pytest.raises(FMUError, match="is closed"):
            instance.save()


def test_settings(car):
    block = car(time_limit=2)
    assert (block.isolate, block.time_limit) == (True, 2)
    assert pickle.loads(pickle.dumps(block)) == block
    car(time_limit=math.inf)
    for options, sentence in (
        ({"isolate": 1}, "isolate=1; it must be True or False"),
        ({"time_limit": 0}, "time_limit=0; it must be a positive number of seconds, or None"),
        ({"time_limit": math.nan}, "it must be a positive number"),
        ({"time_limit": "3"}, "it must be a positive number"),
        ({"isolate": False, "time_limit": 3.0}, "cannot be ended. Give isolate=True as well"),
    ):
        with pytest.raises(ModelError, match=sentence):
            car(**options)


def test_a_message_that_comes_late_asks_for_no_further_step(same_bits, car):
    """On a busy machine the host was stopped between seeing that the FMU sleeps and waking it: one step was made twice."""
    runs = []
    for isolate in (False, True):
        diagram = cosim.Diagram(dt=0.02)
        node, force = diagram.add(car(isolate=isolate), "car"), diagram.add(cosim.Sine(300.0, 1.7))
        diagram.connect(force["y"], node["force"])
        with cosim.Session(diagram) as session:
            pieces = [session.advance(1.0)["car.v"]]
            for _ in range(3):
                for instance in session._run.instances.values() if isolate else ():
                    time.sleep(0.01)  # until it sleeps
                    message = _isolated_protocol.STEP.to_bytes(_isolated_protocol.MESSAGE, sys.byteorder)
                    instance._process.steps.send(message)
                pieces.append(session.advance(1.0)["car.v"])
            runs.append(np.concatenate(pieces))
    same_bits(runs[1], runs[0], "car.v")
