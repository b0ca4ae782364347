"""What FMUs do to a process of their own ends in a sentence, the result up to there is kept, and nothing is left of them."""

import logging
import sys
import time
import zipfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import FMUCrashed, FMUError, SimulationError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")

FMI = ("2.0", "3.0")
ENGINES = ("interpreted", "compiled")
STEP = Fraction(1, 50)


def alone(lying, way, fmi="2.0", **options):
    path, ways = lying(fmi)
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(cosim.FMU(path, parameters={"b": ways[way], "force": 100.0}, isolate=True, **options), "car")
    return diagram


def read(path):
    try:
        return path.read_text()
    except OSError:
        return ""


CRASHES = [
    # (way, steps whose outputs are kept, what the sentence says)
    (
        "SEGFAULT",
        6,
        r"crashed in its step: its process was killed by a segmentation fault \(SIGSEGV\)\. It logged nothing",
    ),
    ("EXIT", 6, r"crashed in its step: it ended its own process with exit code 3\. It logged nothing\."),
    ("ABORT", 6, r"its process was killed by abort\(\) \(SIGABRT\)"),
    ("KILLED", 6, r"its process was killed by the system or a user \(SIGKILL\)"),
    ("CRASH_IN_GET", 5, r"crashed while its outputs were computed: its process was killed by a segmentation fault"),
    ("LAST_WORDS", 6, r"\(SIGSEGV\)\. Its log: these are my last words$"),
    ("ENDLESS", 6, r"was ended because its step took more than 1\.5 s; if it needs longer, give a larger time_limit\."),
    ("ENDLESS_IN_GET", 5, r"was ended because the computation of its outputs took more than 1\.5 s; if it needs"),
]


QUICK = {("SEGFAULT", "compiled"), ("EXIT", "interpreted"), ("CRASH_IN_GET", "compiled"), ("LAST_WORDS", "interpreted")} | {
    ("ENDLESS", "compiled"), ("ENDLESS_IN_GET", "interpreted")
}  # fmt: skip


@pytest.mark.sampled(1)
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
    assert "the FMU of 'car' (Lying.fmu) " in str(error)
    assert isinstance(error, SimulationError)
    assert (error.step, error.time) == (5, 0.1)
    assert error.log == (("these are my last words",) if way == "LAST_WORDS" else ())
    assert error.result.stopped == str(error)
    b = ways[way]
    v = [0.0]
    while len(v) < rows:
        v.append((1 - b / 100.0 * 0.02) * v[-1] + 0.02)
    np.testing.assert_allclose(error.result["car.v"], v, rtol=1e-12)


@pytest.mark.sampled(1)
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
        "(SIGSEGV). Its log: starting badly",
        "EXIT_AT_START": "it ended its own process with exit code 4.",
        "ENDLESS_AT_START": "was ended because its instantiation or initialization took more than 0.5 s; if it needs longer",
        "at once": "crashed while it was instantiated or initialized: its process was killed by a segmentation fault",
    }[way]
    assert wanted in str(caught.value)
    assert str(caught.value).startswith(f"The FMU of '{name}' ")


def test_a_crash_while_it_is_freed_is_a_warning(lying, caplog, nothing_left):
    with caplog.at_level(logging.WARNING, "bayesftc.fmu"):
        result = alone(lying, "CRASH_IN_FREE").simulate(0.5, engine="interpreted")
    assert len(result.time) == 26
    assert "car: while it was freed: The FMU of 'car' (Lying.fmu) crashed" in caplog.text


def test_what_an_fmu_has_started_ends_with_it(lying, nothing_left, until):
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


@pytest.mark.slow
def test_a_crash_is_seen_and_all_is_ended_where_a_child_holds_everything_open(lying, nothing_left, until):
    started = time.monotonic()
    with pytest.raises(FMUCrashed, match=r"crashed in its step: its process was killed by a segmentation fault"):
        alone(lying, "LEAVES_A_CHILD").simulate(1.0, engine="interpreted")
    assert time.monotonic() - started < 8.0  # not the time limit
    until(lambda: not [comm for comm in Path("/proc").glob("[0-9]*/comm") if "left-by-an-fmu" in read(comm)])


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_what_an_fmu_does_to_its_connections(engine, lying, nothing_left):
    fmi = FMI[engine == "compiled"]
    # In its step, or in the answer after it: the compiled loop says in which. While both processes watch their memory, they
    # need no connection, and the numbers are right.
    sentence = (
        r"at t = 0\.1\d* s \(step [5-9]\): the FMU of 'car' \(Lying\.fmu\) crashed( in its step)?: its connections to this "
        r"process were closed\."
    )
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
        found = alone(lying, "BABBLES", fmi, time_limit=2.0).simulate(1.0, engine=engine)["car.v"]
    except FMUCrashed as error:
        found = error.result["car.v"]
    np.testing.assert_allclose(found, v[: len(found)], rtol=1e-12)


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_slow_steps_within_the_limit_are_waited_for(engine, lying):
    started = time.monotonic()
    result = alone(lying, "SLEEPS").simulate(0.14, engine=engine)
    assert time.monotonic() - started > 0.6
    assert len(result.time) == 8


@pytest.mark.slow
def test_failures_and_messages_are_those_in_process(lying, caplog, car):
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


@pytest.mark.sampled(1)
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
