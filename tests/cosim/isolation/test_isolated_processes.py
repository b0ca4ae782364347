"""Many FMUs in processes of their own, with threads and forks of the host, used again and pickled; none outlives its host."""

import contextlib
import json
import multiprocessing
import os
import pickle
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import zipfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import FMUCrashed
from bayesftc.cosim.isolation.protocol import ANYWHERE, APART, PAUSE, TOGETHER
from bayesftc.cosim.isolation.turns import Turns
from bayesftc.cosim.run.repeat import repeat

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")

FMI = ("2.0", "3.0")
ENGINES = ("interpreted", "compiled")
STEP = Fraction(1, 50)


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_many_at_once_and_one_of_them_crashes(lying, nothing_left, car):
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


@pytest.mark.slow
def test_one_that_may_exist_only_once_may_exist_twice(tmp_path):
    path = tmp_path / "once.fmu"
    with zipfile.ZipFile(fmus.path("CruiseControl")) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b'OnlyOncePerProcess="false"', b'OnlyOncePerProcess="true"'))
    first, second = (cosim.FMU(path, isolate=True).instantiate(STEP, name) for name in ("first", "second"))
    first.close()
    second.close()


@pytest.mark.slow
def test_threads_do_not_mix_and_may_end(nothing_left, car, cruise):
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


@pytest.mark.parametrize("count", [3, pytest.param(2000, marks=pytest.mark.slow)])
def test_of_many_that_are_made_and_ended_nothing_is_left(nothing_left, car, children, count):
    """Closed, dropped unclosed or killed: after two thousand there are no more processes and files than before."""
    u, y, before, sizes = np.array([100.0, 0.0]), np.zeros(1), children(), []
    for k in range(count):
        instance = car(FMI[k % 2]).instantiate(STEP, "car")
        status = instance.update(u, y, 0.0) or instance.output(u, y, 0.02)
        assert status == 0, f"{k}: {instance.explain(status)}"
        assert y[0] == 0.02
        (process,) = children() - before
        if k % 3 == 1:
            os.kill(process, signal.SIGKILL)
        if k % 3 < 2:
            instance.close()
        del instance
        assert children() == before
        sizes.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE"))
    assert sizes[-1] - sizes[count // 4] < 30e6


SCRIBBLED = """
import os, sys
from fractions import Fraction
import numpy as np
from bayesftc import cosim, fmus
from bayesftc.cosim.isolation import protocol

car = cosim.FMU(fmus.path("CruiseControl"), isolate=True).instantiate(Fraction(1, 50), "car")
u, y = np.array([100.0, 0.0]), np.zeros(1)
assert car.output(u, y, 0.0) == 0
for name in ("LOOKS", "HOST_SLEPT", "WORKER_SLEPT", "LOGGED", "HOST", "WORKER", "DONE"):
    car.shared.words[getattr(protocol, name)] = 2**62
os.kill(car._process._process.pid, 9)
status = car.update(u, y, 0.0)
print(car.explain(status))
"""


@pytest.mark.slow
def test_what_an_fmu_writes_into_the_shared_memory_keeps_the_host_from_nothing():
    """An FMU that writes before its inputs changes words by which the host decides how long it looks for an answer."""
    done = subprocess.run([sys.executable, "-c", SCRIBBLED], capture_output=True, text=True, timeout=120, check=True)
    assert re.search(r"The FMU of 'car'.* (crashed|was ended)", done.stdout), done.stderr


def test_a_fork_does_not_end_it(nothing_left, car):
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


@pytest.mark.sampled(1)
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_a_fork_that_uses_it_is_refused_and_does_not_end_it(engine, nothing_left, car):
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
        assert "belongs to the process from which this one was forked; start a new run here" in said
        assert session.advance(0.1)["car.v"].shape == (5,)


def _in_a_fork(engine, session, tell, car, cruise):
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


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_parent_and_fork_go_on_at_once_and_know_nothing_of_each_other(engine, nothing_left, same_bits, car, cruise):
    """As a pool of `multiprocessing` that forks does it, while the parent's run goes on."""
    fork = multiprocessing.get_context("fork")
    with cruise(car()).start(engine=engine) as session:
        whole = session.advance(4.0)["car.v"]
        session.reset()
        pieces = [session.advance(1.0)["car.v"]]
        ours, theirs = fork.Pipe(duplex=False)
        process = fork.Process(target=_in_a_fork, args=(engine, session, theirs.send, car, cruise), daemon=True)
        process.start()
        pieces += [session.advance(0.02)["car.v"] for _ in range(150)]
        theirs.close()
        assert ours.poll(60.0)
        said, again, anew = ours.recv()
        process.join()
        same_bits(np.concatenate(pieces), whole, "the parent's run")
    assert len(said) == 3
    assert "belongs to the process from which this one was forked; start a new run here" in said[0]
    assert all("was forked" in sentence or "reset" in sentence for sentence in said)
    same_bits(again, whole[:101], "the fork's run")
    same_bits(anew, whole[:101], "the fork's own")


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_a_reset_takes_the_process_again_and_gives_the_bits_of_a_new_one(
    engine, nothing_left, same_bits, car, cruise, children
):
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


@pytest.mark.slow
def test_repeated_runs_take_one_process(nothing_left, same_bits, car, cruise, children):
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


def test_one_that_nobody_closes_ends_with_what_held_it(nothing_left, car, children):
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


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("with_signal", "engine"),
    [
        (signal.SIGKILL, "interpreted"),
        (signal.SIGINT, "compiled"),
        pytest.param(signal.SIGKILL, "compiled", marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, "interpreted", marks=pytest.mark.slow),
    ],
)
def test_no_orphan_is_left_and_ctrl_c_is_heard_in_an_endless_step(with_signal, engine, lying, until):
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
        "import bayesftc.cosim.isolation.worker, bayesftc.cosim.fmi.fmu, fmpy.fmi2, fmpy.fmi3\n"
        "print(json.dumps(sorted(sys.modules)))"
    )
    assert not {"scipy", "control", "matplotlib", "numba", "pandas", "sklearn", "casadi", "filterpy"} & set(loaded)


@pytest.mark.slow
def test_a_scenario_file_isolates_and_keeps_what_was_before_the_crash(lying, tmp_path):
    from typer.testing import CliRunner

    from bayesftc.cli.application import app
    from bayesftc.cosim.run.result import Result

    path, ways = lying("2.0")
    text = Path(cosim.__file__).parents[1].joinpath("examples/cruise_control/cruise_control.toml").read_text()
    text = text.replace('fmu = "CruiseControl"', f'fmu = "{path}"\nisolate = true\ntime_limit = 5')
    scenario, out = tmp_path / "car.toml", tmp_path / "out"
    scenario.write_text(text.replace("{ v0 = 20.0 }", f"{{ b = {ways['SEGFAULT']} }}"))
    done = CliRunner().invoke(app, ["run", str(scenario), "--engine", "interpreted", "--out", str(out), "--quiet"])
    assert done.exit_code == FMUCrashed.exit_code == 17
    said = " ".join(done.output.split())
    assert "The run stopped at t = 0.1 s (step 5): the FMU of 'plant' (Lying.fmu) crashed in its step" in said
    assert "result.npz" in said
    assert len(Result.load(out / "result.npz").time) == 6


ELSEWHERE = """
import json, pickle, sys
from bayesftc import cosim
block = pickle.loads(bytes.fromhex(sys.argv[1]))
diagram = cosim.Diagram(dt=0.02)
diagram.add(block, "car")
print(json.dumps(diagram.simulate(0.2, engine="interpreted")["car.v"].tolist()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("isolate", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_pickled_plant_runs_in_other_processes_which_share_one_extraction(isolate, tmp_path, car):
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


def test_host_and_fmu_are_apart_where_that_is_quicker():
    turns = Turns(processors=2)
    assert [turns.next(True, 2 * PAUSE), turns.next(True, 3), turns.next(False, 0), turns.next(True, PAUSE)] == [
        APART,  # whoever runs anywhere sleeps at each command
        APART,
        ANYWHERE,
        APART,
    ]
    # On a busy machine they share a processor, and try ever more rarely.
    tries = [i for i in range(5000) if turns.next(True, PAUSE) == APART]
    gaps = np.diff(tries)
    assert gaps[0] > 10
    assert (np.diff(gaps) >= 0).all()
    assert len(tries) < 12
    alone = Turns(processors=1)
    assert {alone.next(True, slept) for slept in (0, PAUSE)} == {TOGETHER}


@pytest.mark.slow
def test_an_interrupted_wait_loses_no_count(car, cruise):
    """Signals come while host and FMU look, sleep and are woken."""
    heard = []
    before = signal.signal(signal.SIGALRM, lambda *_: heard.append(1))
    plain = cruise(car(isolate=False)).simulate(2000.0, engine="compiled")["car.v"]
    signal.setitimer(signal.ITIMER_REAL, 1e-3, 7e-4)
    try:
        found = cruise(car()).simulate(2000.0, engine="compiled")["car.v"]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert heard
    np.testing.assert_array_equal(found, plain)
