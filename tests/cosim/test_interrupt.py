"""Ctrl-C ends the command line at once, with one sentence and exit code 130, also while numba compiles."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from bayesftc._interrupt import SENTENCE, Interrupted, heard
from bayesftc.cli.guard import guarded
from bayesftc.cosim import Result

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals")

WHERE_IT_IS_LOST = {
    "a callback": ("llvmlite.binding.executionengine", "ExecutionEngine", "_find_module_ptr"),
    "a finaliser": ("llvmlite.binding.ffi", "ObjectRef", "__del__"),
}
HIT = """
import importlib, signal, sys
from bayesftc.cosim.stepping.machine import shipped
shipped.sources_digest = lambda: "of other sources, so that numba translates them"
module, cls, name = sys.argv.pop(1).split()
owner = getattr(importlib.import_module(module), cls)
usual, hits = getattr(owner, name), []
def hit(self, *given):
    hits.append(1)
    if len(hits) == 3:
        print("hit", flush=True)
        signal.raise_signal(signal.SIGINT)
    return usual(self, *given)
setattr(owner, name, hit)
from bayesftc.__main__ import main
main()
"""
PACED = """
import bayesftc.cosim.run.pacing as pacing
wait = pacing.Pacer.wait
def said(self, k):
    if k == 1:
        print("waits", flush=True)
    wait(self, k)
pacing.Pacer.wait = said
from bayesftc.__main__ import main
main()
"""
COMPILING = ("run", "cruise_control", "--engine", "compiled", "--quiet", "--out", "out")
WRITTEN = ["figure.png", "figures.json", "result.npz"]


@pytest.fixture
def compiling(tmp_path):
    """Return a process that compiles, with an empty cache, in a folder of its own."""
    started = []

    def start(*command):
        environment = {**os.environ, "BAYESFTC_CACHE": str(tmp_path / "cache")}
        (tmp_path / "here").mkdir()
        process = subprocess.Popen(
            [sys.executable, *command, *COMPILING],
            cwd=tmp_path / "here",
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # A test runner in the background hands down an ignored SIGINT; the process is to have the usual one.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()


def assert_stopped(process, folder, out=""):
    said, errors = process.communicate(timeout=60)
    assert (process.returncode, said, errors) == (130, out, SENTENCE + "\n")
    assert not list((folder / "here").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("where", list(WHERE_IT_IS_LOST))
def test_where_python_ignores_it(where, compiling, tmp_path):
    assert_stopped(compiling("-c", HIT, " ".join(WHERE_IT_IS_LOST[where])), tmp_path, "hit\n")


def stop_after(seconds, compiling, folder):
    process = compiling("-c", "from bayesftc.__main__ import main\nprint(flush=True)\nmain()")
    process.stdout.readline()
    time.sleep(seconds)
    if process.poll() == 0:
        pytest.skip(f"The command took less than {seconds:g} s here, so there was nothing to stop.")
    for _ in range(3):  # somebody in a hurry
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    process.wait(60.0)
    if (folder / "here/out").exists():  # it came after the last file: nothing is missing, and nothing says so wrongly
        assert sorted(path.name for path in (folder / "here/out").iterdir()) == WRITTEN
        said, errors = process.communicate()
        assert (process.returncode, said, errors) in [(0, "", ""), (130, "", SENTENCE + "\n")]
    else:
        assert_stopped(process, folder)


@pytest.mark.parametrize("seconds", [0.3, 2.0])
def test_while_modules_load_and_while_numba_compiles(seconds, compiling, tmp_path):
    stop_after(seconds, compiling, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.1 + 0.25 * i for i in range(30)])
def test_at_any_moment(seconds, compiling, tmp_path):
    stop_after(seconds, compiling, tmp_path)


@pytest.fixture
def usual():
    """The usual answers to a signal and to ignored exceptions, before and after."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler), sys.unraisablehook
    yield
    signal.signal(signal.SIGINT, before[0])
    sys.unraisablehook = before[1]


def test_without_one_all_is_as_before(usual):
    before = sys.unraisablehook
    with heard():
        assert sys.unraisablehook is not before
    assert sys.unraisablehook is before
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def stopped(work):
    with pytest.raises(Interrupted), heard():
        work()


class Deaf:
    """Is hit by Ctrl-C where Python ignores what is raised."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def test_one_that_is_lost_comes_again_and_ends_a_wait(usual):
    begin = time.monotonic()

    def wait():
        deaf = Deaf()
        del deaf
        time.sleep(60.0)

    stopped(wait)
    assert time.monotonic() - begin < 30.0
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # what comes thereafter disturbs nobody


def test_an_error_that_comes_of_it_is_none_of_ours(usual, capsys):
    def turn():
        with guarded():
            try:
                signal.raise_signal(signal.SIGINT)
            except Interrupted:
                raise ImportError("half a module") from None

    stopped(turn)
    assert capsys.readouterr().err == ""


def test_one_that_c_code_loses_without_a_word_comes_again(usual):
    class Key:
        def __hash__(self):
            return 1

        def __eq__(self, other):
            signal.raise_signal(signal.SIGINT)
            return False

    def compare():
        get = ctypes.pythonapi.PyDict_GetItem  # ignores all errors
        get.argtypes, get.restype = (ctypes.py_object, ctypes.py_object), ctypes.c_void_p
        assert get({Key(): 0}, Key()) is None
        time.sleep(60.0)

    begin = time.monotonic()
    stopped(compare)
    assert time.monotonic() - begin < 30.0


def test_one_that_is_swallowed_is_told_at_the_end(usual):
    def swallow():
        with suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        raise ValueError("what comes of it")

    stopped(swallow)


def test_a_second_one_does_not_disturb_what_puts_files_away(usual):
    tidied = []

    def tidy():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.2)
            signal.raise_signal(signal.SIGINT)
            tidied.append(True)

    stopped(tidy)
    assert tidied


def test_other_ignored_exceptions_and_other_handlers_stay_as_they_are(usual, monkeypatch):
    class Broken:
        def __del__(self):
            raise ValueError("lost")

    seen = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: seen.append(lost.exc_type))
    with heard():
        broken = Broken()
        del broken
    assert seen == [ValueError]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with heard():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    monkeypatch.undo()


@pytest.mark.slow
def test_while_a_run_waits_for_the_clock(tmp_path):
    slow = "run", "cruise_control", "--engine", "interpreted", "--pace", "0.001", "--out", "out"
    process = subprocess.Popen(
        [sys.executable, "-c", PACED, *slow],
        cwd=tmp_path,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        assert process.stdout.readline() == "waits\n"
        process.send_signal(signal.SIGINT)
        said, errors = process.communicate(timeout=15)  # a step is 20 s long
        sentence = "Stopped by Ctrl-C at t = 0 s of 20 s. The signals up to then are in out/result.npz.\n"
        assert (process.returncode, said, errors) == (130, "", sentence)
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == WRITTEN
        assert Result.load(tmp_path / "out/result.npz").time.tolist() == [0.0]
    finally:
        process.kill()
        process.wait()


HALF_IMPORTED = """
import signal, sys
from bayesftc import cosim
from bayesftc.cosim.stepping.machine import shipped
if sys.argv[1].startswith("numba"):
    shipped.sources_digest = lambda: "of other sources, so that numba translates them"

class Finder:
    def find_spec(self, name, path, target=None):
        if name == sys.argv[1]:
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, Finder())
diagram = cosim.Diagram(0.1)
one = diagram.add(cosim.Constant(2.0), "one")
try:
    diagram.simulate(1.0)
    print("not interrupted")
except KeyboardInterrupt:
    sys.meta_path.pop(0)
    print(float(diagram.simulate(1.0)["one.y"][-1]))
"""


@pytest.mark.parametrize("half", ["llvmlite.binding.ffi", pytest.param("numba.core.types", marks=pytest.mark.slow)])
def test_what_is_imported_at_the_first_run_is_imported_whole(half, tmp_path):
    """Ctrl-C in the middle of it is heard at its end, and the next run finds no half of a library."""
    environment = {**os.environ, "BAYESFTC_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", HALF_IMPORTED, half]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.stdout == "2.0\n", done.stderr


STOPPED = """
import os, signal, sys, threading
from bayesftc import cosim
diagram = cosim.Diagram(dt="1/1000")
diagram.add(cosim.Gaussian(std=1.0), "noise")

def interrupt(done, *_):
    if done:
        os.kill(os.getpid(), signal.SIGINT)

campaign = cosim.Campaign(diagram, duration=1.0, seeds=8, metrics=[cosim.Mean("noise.y")], piece=2)
actions = {
    "simulate": lambda: diagram.simulate(1000.0, progress=interrupt, engine="interpreted"),
    "memory": lambda: campaign.run(executor=cosim.Threads(1), progress=interrupt),
    "store": lambda: campaign.run("kept", executor=cosim.Threads(1), progress=interrupt),
}
try:
    actions[sys.argv[1]]()
except KeyboardInterrupt as stop:
    print(type(stop).__name__, *stop.__notes__, sep="|")
if sys.argv[1] == "store":
    print(len(campaign.run("kept").table), threading.active_count())
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("action", "words"),
    [
        ("simulate", "KeyboardInterrupt|Stopped by Ctrl-C at t = "),
        pytest.param(
            "memory",
            "KeyboardInterrupt|Stopped by Ctrl-C: none of the 8 runs is kept, because the campaign has no store.\n",
            marks=pytest.mark.slow,
        ),
        ("store", "KeyboardInterrupt|Stopped by Ctrl-C: 2 of 8 runs are kept in "),
    ],
)
def test_in_python_ctrl_c_says_what_was_done_and_how_to_continue(action, words, tmp_path):
    if action == "store":
        pytest.importorskip("zarr")
    done = subprocess.run(
        [sys.executable, "-c", STOPPED, action], capture_output=True, text=True, cwd=tmp_path, timeout=120
    )
    assert done.stdout.startswith(words), done.stdout + done.stderr
    assert done.stdout.count("Stopped") == 1
    if action == "store":
        assert done.stdout.endswith("\n8 1\n")
        assert {path.name for path in tmp_path.iterdir()} == {"kept"}
