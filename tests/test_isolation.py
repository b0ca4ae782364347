"""FMUs in processes of their own: the same numbers, whatever they do, and nothing is left of them."""

import contextlib
import gc
import json
import logging
import math
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim._isolation import kernels as _isolated_kernels, protocol as _isolated_protocol
from bayesftc.cosim._isolation.turns import one_processor
from bayesftc.cosim._repeat import repeat
from bayesftc.cosim.errors import FMUCrashed, FMUError, ModelError, SimulationError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")

FMI = ("2.0", "3.0")
ENGINES = ("interpreted", "compiled")
STEP = Fraction(1, 50)


def car(fmi="2.0", isolate=True, **options):
    return cosim.FMU(fmus.path("CruiseControl", fmi=fmi), isolate=isolate, **options)


def cruise(block, dt=0.02, every=1):
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(block, "car", every=every)
    controller = diagram.add(cosim.Gain(-500.0, offset=10_000.0))
    noise = diagram.add(cosim.Gaussian(std=0.03), "noise")
    diagram.connect(plant["v"], controller["u"])
    diagram.connect(controller["y"], plant["force"])
    diagram.connect(noise["y"], plant["disturbance"])
    return diagram


def alone(lying, way, fmi="2.0", **options):
    path, ways = lying(fmi)
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(cosim.FMU(path, parameters={"b": ways[way], "force": 100.0}, isolate=True, **options), "car")
    return diagram


def children():
    """Return the processes that this one has started and that are not gone, zombies among them."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == os.getpid():
                found.add(int(entry.name))
    return found


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def read(path):
    try:
        return path.read_text()
    except OSError:
        return ""


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def nothing_left(tmp_path, monkeypatch):
    """Check that a test leaves no process, no descriptor, no shared memory and no temporary file behind."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))

    def held():
        gc.collect()  # an error that was caught holds on to what it has passed through
        return children(), len(os.listdir("/proc/self/fd"))

    before = held()
    yield
    assert held() == before
    assert not list(folder.iterdir())
    assert not [name for name in os.listdir("/dev/shm") if "bayesftc" in name]


# --- the same numbers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fmi", "engine"),
    [
        ("2.0", "compiled"),
        ("3.0", "interpreted"),
        *(pytest.param(*p, marks=pytest.mark.slow) for p in zip(FMI, ENGINES)),
    ],
)
def test_the_same_bits_as_in_process(fmi, engine, same_bits, nothing_left):
    options = {"seed": 4, "engine": engine, "record": ["car.*", "car.force", "car.disturbance"]}
    for every, dt in ((1, 0.02), (3, "1/30")) if engine == "interpreted" else ((3, "1/30"),):
        settings = {"parameters": {"m": 120.0, "b": 7, "v0": 3.5}}
        wanted = cruise(car(fmi, isolate=False, **settings), dt, every).simulate(
            9, **options | {"engine": "interpreted"}
        )
        found = cruise(car(fmi, **settings), dt, every).simulate(9, **options)
        for name in wanted:
            same_bits(found[name], wanted[name], name)


@pytest.mark.parametrize(
    ("engine", "ports"),
    [*((engine, {}) for engine in ENGINES), ("interpreted", {"inputs": (), "outputs": ()})],
)
def test_sampled_and_mute_ones(engine, ports, same_bits):
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


def test_both_ends_of_the_way_have_the_same_words():
    kernels, protocol = _isolated_kernels, _isolated_protocol
    names = [
        "COMMAND",
        "STATUS",
        "AHEAD",
        "READ_STATUS",
        "PHASE",
        "ASKED",
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
def test_states_stay_with_the_fmu_and_go_on_elsewhere_as_bytes(fmi, same_bits, nothing_left):
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


@pytest.mark.parametrize("engine", ["interpreted", pytest.param("compiled", marks=pytest.mark.slow)])
def test_coupled_tightly_and_in_steps_of_their_own(engine, same_bits, nothing_left):
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


def test_saved_states_are_forgotten_and_refused():
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
    with pytest.raises(FMUError, match="is gone: it was forgotten"):
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


# --- what FMUs do to their process --------------------------------------------------------------------------------------------

CRASHES = [
    # (way, steps whose outputs are kept, what the sentence says)
    (
        "SEGFAULT",
        6,
        r"crashed in its step: its process was killed by a segmentation fault \(SIGSEGV\)\. It logged nothing",
    ),
    ("EXIT", 6, r"crashed in its step: it ended its own process with exit code 3\. It logged nothing\."),
    ("ABORT", 6, r"its process was killed by abort\(\) \(SIGABRT\)"),
    ("KILLED", 6, r"its process was killed by the system or someone else \(SIGKILL\)"),
    ("CRASH_IN_GET", 5, r"crashed while its outputs were computed: its process was killed by a segmentation fault"),
    ("LAST_WORDS", 6, r"\(SIGSEGV\)\. Its log says: these are my last words$"),
    ("ENDLESS", 6, r"was ended, for its step took more than 1\.5 s; if it needs longer, give a larger time_limit\."),
    ("ENDLESS_IN_GET", 5, r"was ended, for the computation of its outputs took more than 1\.5 s; if it needs"),
]


QUICK = {("SEGFAULT", "compiled"), ("EXIT", "interpreted"), ("CRASH_IN_GET", "compiled"), ("LAST_WORDS", "interpreted")} | {
    ("ENDLESS", "compiled"), ("ENDLESS_IN_GET", "interpreted")
}  # fmt: skip


@pytest.mark.parametrize(
    ("way", "rows", "sentence", "engine"),
    [
        pytest.param(*crash, engine, marks=[] if (crash[0], engine) in QUICK else pytest.mark.slow)
        for crash in CRASHES
        for engine in ENGINES
    ],
)
def test_a_crash_stops_the_run_and_keeps_the_result(way, rows, sentence, engine, lying, nothing_left):
    fmi = FMI[(len(way) + len(engine)) % 2]
    limit = 1.5 if way.startswith("ENDLESS") else None
    _, ways = lying(fmi)
    with pytest.raises(FMUCrashed, match=sentence) as caught:
        alone(lying, way, fmi, time_limit=limit).simulate(1.0, engine=engine)
    error = caught.value
    assert str(error).startswith("The run stopped at t = 0.1 s (step 5): the FMU of 'car' ")
    assert isinstance(error, SimulationError)
    assert (error.step, error.time) == (5, 0.1)
    assert error.log == (("these are my last words",) if way == "LAST_WORDS" else ())
    assert error.result.stopped == str(error)
    b = ways[way]
    v = [0.0]
    while len(v) < rows:
        v.append((1 - b / 100.0 * 0.02) * v[-1] + 0.02)
    np.testing.assert_allclose(error.result["car.v"], v, rtol=1e-12)


@pytest.mark.parametrize(
    ("way", "fmi"),
    [("CRASH_AT_START", "2.0"), ("EXIT_AT_START", "3.0"), ("ENDLESS_AT_START", "2.0"), *(("at once", f) for f in FMI)],
)
def test_a_crash_before_the_run(way, fmi, lying, nothing_left):
    path, ways = lying(fmi)
    name = "crashes_at_once" if way == "at once" else "car"
    diagram = cosim.Diagram(dt=0.02)
    limit = 0.5 if way == "ENDLESS_AT_START" else None
    diagram.add(cosim.FMU(path, parameters={"b": ways.get(way, 5.0)}, isolate=True, time_limit=limit), name)
    with pytest.raises(FMUCrashed) as caught:
        diagram.simulate(1.0, engine="interpreted")
    assert isinstance(caught.value, FMUError)
    assert (caught.value.result, caught.value.step, caught.value.time) == (None, None, None)
    wanted = {
        "CRASH_AT_START": "crashed while it was instantiated or initialized: its process was killed by a segmentation fault "
        "(SIGSEGV). Its log says: starting badly",
        "EXIT_AT_START": "it ended its own process with exit code 4.",
        "ENDLESS_AT_START": "was ended, for its instantiation or initialization took more than 0.5 s; if it needs longer",
        "at once": "crashed while it was instantiated or initialized: its process was killed by a segmentation fault",
    }[way]
    assert wanted in str(caught.value)
    assert str(caught.value).startswith(f"The FMU of '{name}' ")


def test_a_crash_while_it_is_freed_is_a_warning(lying, caplog, nothing_left):
    with caplog.at_level(logging.WARNING, "bayesftc.fmu"):
        result = alone(lying, "CRASH_IN_FREE").simulate(0.5, engine="interpreted")
    assert len(result.time) == 26
    assert "car: while it was freed: The FMU of 'car' crashed" in caplog.text


def test_what_an_fmu_has_started_ends_with_it(lying, nothing_left):
    def sleepers():
        found = []
        for entry in Path("/proc").iterdir():
            try:
                if entry.name.isdigit() and b"1000.25" in (entry / "cmdline").read_bytes().split(b"\0"):
                    found.append(entry.name)
            except OSError:
                continue
        return found

    with pytest.raises(FMUCrashed, match="took more than"):
        alone(lying, "STARTS_A_PROGRAM", time_limit=0.3).simulate(1.0, engine="interpreted")
    until(lambda: not sleepers())


def test_a_crash_is_seen_and_all_is_ended_where_a_child_holds_everything_open(lying, nothing_left):
    started = time.monotonic()
    with pytest.raises(FMUCrashed, match=r"crashed in its step: its process was killed by a segmentation fault"):
        alone(lying, "LEAVES_A_CHILD").simulate(1.0, engine="interpreted")
    assert time.monotonic() - started < 8.0  # not the time limit
    until(lambda: not [comm for comm in Path("/proc").glob("[0-9]*/comm") if "left-by-an-fmu" in read(comm)])


@pytest.mark.parametrize("engine", ["interpreted", pytest.param("compiled", marks=pytest.mark.slow)])
def test_what_an_fmu_does_to_its_connections(engine, lying, nothing_left):
    fmi = FMI[engine == "compiled"]
    sentence = r"at t = 0\.1 s \(step 5\): the FMU of 'car' crashed: its connections to this process were closed\."
    with pytest.raises(FMUCrashed, match=sentence):
        alone(lying, "CLOSES_ALL", fmi).simulate(1.0, engine=engine)
    # A child that goes on as if it were the FMU's process comes to an end, and each answer is there once.
    _, ways = lying(fmi)
    result = alone(lying, "GOES_ON_TWICE", fmi).simulate(0.14, engine=engine)
    v = [0.0]
    while len(v) < 8:
        v.append((1 - ways["GOES_ON_TWICE"] / 100.0 * 0.02) * v[-1] + 0.02)
    np.testing.assert_allclose(result["car.v"], v, rtol=1e-12)
    # What is no answer is not taken for one: the run goes on with the right numbers, or stops.
    v = [0.0]
    while len(v) < 51:
        v.append((1 - ways["BABBLES"] / 100.0 * 0.02) * v[-1] + 0.02)
    try:
        found = alone(lying, "BABBLES", fmi).simulate(1.0, engine=engine)["car.v"]
    except FMUCrashed as error:
        found = error.result["car.v"]
    np.testing.assert_allclose(found, v[: len(found)], rtol=1e-12)


def test_after_a_crash_the_session_begins_anew(lying, nothing_left):
    with alone(lying, "SEGFAULT").start(engine="interpreted") as session:
        begin = session.save_state()
        for _ in range(2):
            with pytest.raises(FMUCrashed, match=r"\(step 5\)"):
                session.advance(1.0)
            with pytest.raises(FMUCrashed, match="crashed in its step"):
                session.restore(begin)  # the process that knew it is gone
            session.reset()
        assert len(session.advance(0.08).time) == 5


@pytest.mark.parametrize("engine", ["interpreted", pytest.param("compiled", marks=pytest.mark.slow)])
def test_slow_steps_within_the_limit_are_waited_for(engine, lying):
    started = time.monotonic()
    result = alone(lying, "SLEEPS").simulate(0.14, engine=engine)
    assert time.monotonic() - started > 0.6
    assert len(result.time) == 8


def test_failures_and_messages_are_those_in_process(lying, caplog):
    path, ways = lying("2.0")
    for way in ("DISCARD", "FATAL", "INFINITE"):
        said = []
        for isolate in (False, True):
            diagram = cosim.Diagram(dt=0.02)
            diagram.add(cosim.FMU(path, parameters={"b": ways[way], "force": 1.0}, isolate=isolate), "car")
            with pytest.raises(SimulationError) as caught:
                diagram.simulate(1.0, engine="interpreted")
            assert type(caught.value) is SimulationError
            said.append((str(caught.value), caught.value.result["car.v"].tolist()))
        assert said[0] == said[1]
    texts = []
    for isolate in (False, True):
        caplog.clear()
        instance = car(isolate=isolate).instantiate(STEP, "car")
        u, y = np.zeros(2), np.zeros(1)
        with caplog.at_level(logging.INFO, "bayesftc"):
            status = instance.update(u, y, 5.0)  # not the time at which it stands
        texts.append(
            (status, instance.explain(status), [(r.name, r.levelname, r.getMessage()) for r in caplog.records])
        )
        instance.close()
    assert texts[0] == texts[1]
    assert "the communication point 5 is not the time 0" in texts[1][1]


@pytest.mark.parametrize("fmi", FMI)
def test_refusals_are_those_in_process(fmi, tmp_path):
    path = tmp_path / "reference.fmu"
    with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'valueReference="3"', b'valueReference="77"')
            new.writestr(name, content)
    said = []
    for isolate in (False, True):
        with pytest.raises(FMUError) as caught:
            cosim.FMU(path, parameters={"b": 6.0}, isolate=isolate).instantiate(STEP, "car")
        assert type(caught.value) is FMUError
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "could not be initialized as 'car'" in said[1]


# --- settings, many at once, threads, forks -------------------------------------------------------------------------------------


def test_settings():
    block = car(time_limit=2)
    assert (block.isolate, block.time_limit) == (True, 2)
    assert pickle.loads(pickle.dumps(block)) == block
    car(time_limit=math.inf)
    for options, sentence in (
        ({"isolate": 1}, "isolate=1; it must be True or False"),
        ({"time_limit": 0}, "time_limit=0; it must be a positive number of seconds, or None"),
        ({"time_limit": math.nan}, "it must be a positive number"),
        ({"time_limit": "3"}, "it must be a positive number"),
        ({"isolate": False, "time_limit": 3.0}, "cannot be ended: give isolate=True as well"),
    ):
        with pytest.raises(ModelError, match=sentence):
            car(**options)


def test_many_at_once_and_one_of_them_crashes(lying, nothing_left):
    path, ways = lying("2.0")
    diagram = cosim.Diagram(dt=0.02)
    for i in range(4):
        diagram.add(car(FMI[i % 2], parameters={"force": 100.0 * i}), f"car{i}")
    run = diagram.simulate(0.2, engine="interpreted")
    assert np.all(np.diff([run[f"car{i}.v"][-1] for i in range(4)]) > 0.0)
    diagram = cosim.Diagram(dt=0.02)
    good = diagram.add(car(parameters={"force": 100.0}), "good")
    diagram.add(cosim.FMU(path, parameters={"b": ways["SEGFAULT"]}, isolate=True), "bad")
    diagram.connect(good["v"], diagram.add(cosim.Gain(1.0), "after")["u"])
    with pytest.raises(FMUCrashed, match="FMU of 'bad'") as caught:
        diagram.simulate(1.0, engine="interpreted")
    np.testing.assert_array_equal(caught.value.result["after.y"], caught.value.result["good.v"])
    assert caught.value.result["good.v"][-1] > 0.0


def test_one_that_may_exist_only_once_may_exist_twice(tmp_path):
    path = tmp_path / "once.fmu"
    with zipfile.ZipFile(fmus.path("CruiseControl")) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b'OnlyOncePerProcess="false"', b'OnlyOncePerProcess="true"'))
    first, second = (cosim.FMU(path, isolate=True).instantiate(STEP, name) for name in ("first", "second"))
    first.close()
    second.close()


def test_threads_do_not_mix_and_may_end(nothing_left):
    wanted = [cruise(car(FMI[s % 2], isolate=False)).simulate(2.0, seed=s)["car.v"] for s in range(3)]
    found, kept = [None] * 3, []

    def work(s):
        found[s] = cruise(car(FMI[s % 2])).simulate(2.0, seed=s)["car.v"]
        kept.append(car().instantiate(STEP, "kept"))  # outlives its thread

    threads = [threading.Thread(target=work, args=(s,)) for s in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(a, b) for a, b in zip(found, wanted, strict=True))
    time.sleep(0.1)
    for instance in kept:
        assert instance.update(np.zeros(2), np.zeros(1), 0.0) == 0
        instance.close()


def test_a_fork_does_not_end_it(nothing_left):
    instance = car().instantiate(STEP, "car")
    u, y = np.array([100.0, 0.0]), np.zeros(1)
    pid = os.fork()
    if pid == 0:
        try:
            instance.close()
        finally:
            os._exit(0)
    os.waitpid(pid, 0)
    assert instance.update(u, y, 0.0) == 0
    assert instance.output(u, y, 0.02) == 0
    assert y[0] == 0.02
    instance.close()


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_a_fork_that_uses_it_is_refused_and_does_not_end_it(engine, nothing_left):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(car(), "car")
    with diagram.start(engine=engine) as session:
        session.advance(0.1)
        read, write = os.pipe()
        pid = os.fork()
        if pid == 0:
            try:
                session.advance(0.1)
            except cosim.FMUCrashed as error:
                os.write(write, str(error).encode())
            finally:
                os._exit(0)
        os.waitpid(pid, 0)
        os.close(write)
        said = os.read(read, 1000).decode()
        os.close(read)
        assert "belongs to the process that this one was forked from; begin a new run here" in said
        assert session.advance(0.1)["car.v"].shape == (5,)


def _in_a_fork(engine, session, tell):
    """Use a run of the parent's in a forked process, whose new connections take the numbers that the fork has freed."""
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(20)]
    files = [os.memfd_create("mine") for _ in range(20)]
    said = []
    for attempt in (lambda: session.advance(0.5), session.save_state, lambda: session.advance(0.5)):
        try:
            attempt()
            said.append("nothing")
        except cosim.BayesFTCError as error:
            said.append(str(error))
    for pair in pairs:
        for end in pair:
            end.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                said.append(f"a stranger was sent {end.recv(100)!r}")
    said += [f"a stranger's file was written to: {os.fstat(file).st_size}" for file in files if os.fstat(file).st_size]
    session.reset()
    tell((said, session.advance(2.0)["car.v"], cruise(car()).simulate(2.0, engine=engine)["car.v"]))


@pytest.mark.parametrize("engine", ENGINES)
def test_parent_and_fork_go_on_at_once_and_know_nothing_of_each_other(engine, nothing_left, same_bits):
    """As a pool of `multiprocessing` that forks does it, while the parent's run goes on."""
    fork = multiprocessing.get_context("fork")
    with cruise(car()).start(engine=engine) as session:
        whole = session.advance(4.0)["car.v"]
        session.reset()
        pieces = [session.advance(1.0)["car.v"]]
        ours, theirs = fork.Pipe(duplex=False)
        process = fork.Process(target=_in_a_fork, args=(engine, session, theirs.send), daemon=True)
        process.start()
        pieces += [session.advance(0.02)["car.v"] for _ in range(150)]
        theirs.close()
        assert ours.poll(60.0)
        said, again, anew = ours.recv()
        process.join()
        same_bits(np.concatenate(pieces), whole, "the parent's run")
    assert len(said) == 3
    assert "belongs to the process that this one was forked from; begin a new run here" in said[0]
    assert all("forked from" in sentence or "reset" in sentence for sentence in said)
    same_bits(again, whole[:101], "the fork's run")
    same_bits(anew, whole[:101], "the fork's own")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_reset_takes_the_process_again_and_gives_the_bits_of_a_new_one(engine, nothing_left, same_bits):
    block = car(parameters={"v0": 3.0})
    anew = [cruise(block).simulate(1.0, seed=seed, engine="interpreted")["car.v"] for seed in (1, 2)]
    before, everywhere = children(), os.sched_getaffinity(0)
    with cruise(block).start(engine=engine, seed=1) as session:
        (process,) = children() - before
        for seed in (1, 2, 1):
            session.reset(seed=seed)
            session.advance(0.1)
            state = session.save_state()
            session.advance(0.1)
            session.restore(state)
            same_bits(np.concatenate([anew[seed - 1][:6], session.advance(0.9)["car.v"]]), anew[seed - 1], str(seed))
            assert children() - before == {process}
        os.kill(process, signal.SIGKILL)
        with pytest.raises(FMUCrashed):
            session.advance(0.1)
        session.reset(seed=2)
        assert process not in children()
        same_bits(session.advance(1.0)["car.v"], anew[1], "in a new process")
        (other,) = children() - before
    assert other not in children()
    assert os.sched_getaffinity(0) == everywhere


def test_repeated_runs_take_one_process(nothing_left, same_bits):
    before, seen = children(), set()
    runs = []
    for result in repeat(cruise(car()), 0.4, range(3), ["car.v"]):
        runs.append(result["car.v"])
        seen |= children() - before
    assert len(seen) == 1
    for seed, run in enumerate(runs):
        same_bits(run, cruise(car()).simulate(0.4, seed=seed)["car.v"], str(seed))
    some = repeat(cruise(car()), 0.4, range(3), ["car.v"])
    next(some)
    some.close()
    assert children() == before


def test_one_that_nobody_closes_ends_with_what_held_it(nothing_left):
    before = children()
    instance = car().instantiate(STEP, "car")
    assert len(children() - before) == 1
    del instance
    assert children() == before


ORPHANS = """
import json, os, sys
import numpy as np
from fractions import Fraction
from bayesftc import cosim
way, engine, path = float(sys.argv[1]), sys.argv[2], sys.argv[3]
block = cosim.FMU(path, parameters={"b": way}, isolate=True, time_limit=float("inf"))
diagram = cosim.Diagram(dt=0.02)
diagram.add(block, "car")
with diagram.start(engine=engine) as session:
    session.advance(0.08)
    def parent(n):
        try:
            return open(f"/proc/{n}/stat").read().rpartition(")")[2].split()[1]
        except OSError:
            return ""  # it has ended meanwhile
    pids = [n for n in os.listdir("/proc") if n.isdigit() and parent(n) == str(os.getpid())]
    print(json.dumps(pids), flush=True)
    try:
        session.advance(1.0)
    except KeyboardInterrupt:
        print("heard", flush=True)
        sys.exit(7)
"""


@pytest.mark.parametrize(
    ("with_signal", "engine"),
    [
        (signal.SIGKILL, "interpreted"),
        (signal.SIGINT, "compiled"),
        pytest.param(signal.SIGKILL, "compiled", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, "interpreted", marks=pytest.mark.slow),
    ],
)
def test_no_orphan_is_left_and_ctrl_c_is_heard_in_an_endless_step(with_signal, engine, lying):
    path, ways = lying("3.0")
    process = subprocess.Popen(
        [sys.executable, "-c", ORPHANS, str(ways["ENDLESS"]), engine, str(path)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        (worker,) = map(int, json.loads(process.stdout.readline()))
        assert is_running(worker)
        time.sleep(0.3)  # into the endless step
        process.send_signal(with_signal)
        rest, _ = process.communicate(timeout=20)
    finally:
        process.kill()
    assert (process.returncode, rest) == ((7, "heard\n") if with_signal == signal.SIGINT else (-9, ""))
    until(lambda: not is_running(worker))


def test_starting_loads_nothing_heavy(python):
    loaded = python(
        "import json, sys\n"
        "import bayesftc.cosim._isolation.worker, bayesftc.cosim.fmu, fmpy.fmi2, fmpy.fmi3\n"
        "print(json.dumps(sorted(sys.modules)))"
    )
    assert not {"scipy", "control", "matplotlib", "numba", "pandas", "sklearn", "casadi", "filterpy"} & set(loaded)


def test_a_scenario_file_isolates_and_keeps_what_was_before_the_crash(lying, tmp_path):
    from typer.testing import CliRunner

    from bayesftc.cli.commands import app
    from bayesftc.cosim.result import Result

    path, ways = lying("2.0")
    text = Path(cosim.__file__).parents[1].joinpath("examples/cruise_control/cruise_control.toml").read_text()
    text = text.replace('fmu = "CruiseControl"', f'fmu = "{path}"\nisolate = true\ntime_limit = 5')
    scenario, out = tmp_path / "car.toml", tmp_path / "out"
    scenario.write_text(text.replace("{ v0 = 20.0 }", f"{{ b = {ways['SEGFAULT']} }}"))
    done = CliRunner().invoke(app, ["run", str(scenario), "--engine", "interpreted", "--out", str(out), "--quiet"])
    assert done.exit_code == FMUCrashed.exit_code == 17
    said = " ".join(done.output.split())
    assert "The run stopped at t = 0.1 s (step 5): the FMU of 'plant' crashed in its step" in said
    assert "result.npz" in said
    assert len(Result.load(out / "result.npz").time) == 6


# --- plants travel ------------------------------------------------------------------------------------------------------------

ELSEWHERE = """
import json, pickle, sys
from bayesftc import cosim
block = pickle.loads(bytes.fromhex(sys.argv[1]))
diagram = cosim.Diagram(dt=0.02)
diagram.add(block, "car")
print(json.dumps(diagram.simulate(0.2, engine="interpreted")["car.v"].tolist()))
"""


@pytest.mark.parametrize("isolate", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_pickled_plant_runs_in_other_processes_which_share_one_extraction(isolate, tmp_path):
    block = car("3.0", isolate=isolate, parameters={"force": 100.0, "m": 110.0})
    command = [sys.executable, "-c", ELSEWHERE, pickle.dumps(block).hex()]
    environment = {**os.environ, "BAYESFTC_CACHE": str(tmp_path)}
    running = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    answers = {process.communicate(timeout=120)[0] for process in running}
    assert [process.returncode for process in running] == [0] * 3
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(block, "car")
    (answer,) = answers
    assert json.loads(answer) == diagram.simulate(0.2, engine="interpreted")["car.v"].tolist()
    assert len([p for p in (tmp_path / "fmus").iterdir() if p.is_dir()]) == 1


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="isolation needs Linux")
def test_a_thread_keeps_to_its_processor_only_while_an_fmu_follows_it():
    everywhere = os.sched_getaffinity(0)

    def fail(follows, processors):
        with one_processor([SimpleNamespace(follows=follows)]):
            assert len(os.sched_getaffinity(0)) == processors
            raise ZeroDivisionError

    for follows, processors in ((True, 1), (False, len(everywhere))):
        with pytest.raises(ZeroDivisionError):
            fail(follows, processors)
        assert os.sched_getaffinity(0) == everywhere
