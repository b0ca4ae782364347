"""FMUs that lie: each ends in one clear sentence, in process and isolated, never in a hang or a silent zero."""

import logging
import signal
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import FMUError, SimulationError
from bayesftc.cosim.fmi.fmu import describe
from bayesftc.cosim.fmi.reading import messages as _fmi_messages

FMI = ("2.0", "3.0")
ISOLATED = pytest.param(True, marks=pytest.mark.slow, id="isolated")
ENGINES = pytest.mark.parametrize("engine", ["interpreted", "compiled"])
WHERE = pytest.mark.parametrize("isolate", [pytest.param(False, id="in process"), ISOLATED])
EVERYWHERE = pytest.mark.parametrize(
    ("fmi", "isolate"),
    [("2.0", False), ("3.0", False), ("2.0", True), pytest.param("3.0", True, marks=pytest.mark.slow)],
)


def run(path, b, isolate, engine="interpreted", steps=50, name="car"):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(cosim.FMU(path, parameters={"b": b, "force": 100.0}, isolate=isolate), name)
    return diagram.simulate(steps * diagram.step, engine=engine)


def stopped(*arguments, error=SimulationError, **options):
    """Return the error of a run that must stop; its text is one sentence or a few, and quick to come."""
    started = time.monotonic()
    with pytest.raises(error) as caught:
        run(*arguments, **options)
    assert time.monotonic() - started < 30.0
    text = str(caught.value)
    assert len(text) < 1500
    assert "\n" not in text
    return caught.value


def rewritten(fmi, target, *pairs):
    """Copy the shipped car with other words in its model description."""
    with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                for before, after in pairs:
                    assert before.encode() in content
                    content = content.replace(before.encode(), after.encode())
            new.writestr(name, content)
    return target


def speeds(b, steps):
    v = [0.0]
    for _ in range(steps):
        v.append((1 - b / 100.0 * 0.02) * v[-1] + 0.02)
    return np.array(v)


# --- outputs ------------------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@WHERE
@pytest.mark.parametrize(("way", "word"), [("NOT_A_NUMBER", "NaN"), ("INFINITE", "infinite")])
def test_outputs_that_are_no_numbers(lying, way, word, isolate):
    path, ways = lying(FMI[way == "INFINITE"])
    error = stopped(path, ways[way], isolate)
    assert f"at t = 0.1 s (step 5): car.v came out {word}." in str(error)
    np.testing.assert_allclose(error.result["car.v"], speeds(ways[way], 4), rtol=1e-12)


@pytest.mark.sampled(1)
@EVERYWHERE
def test_outputs_that_are_never_written(lying, fmi, isolate):
    path, ways = lying(fmi)
    error = stopped(path, ways["WRITES_NOTHING"], isolate, error=FMUError)
    assert "returns OK, but has not written 'v' of 'car'" in str(error)


@pytest.mark.sampled(1)
@EVERYWHERE
def test_what_is_written_beyond_the_outputs(lying, fmi, isolate):
    """It would be another block's value, or break the heap."""
    path, ways = lying(fmi)
    error = stopped(path, ways["WRITES_TOO_MUCH"], isolate, error=FMUError)
    assert "The FMU 'CruiseControl' writes beyond the memory for 'v' of 'car'" in str(error)
    assert str(error).endswith("Export it again.")


@WHERE
def test_arrays_of_another_size_than_the_binary_has(tmp_path, isolate):
    pattern = '<Float64 name="{}" valueReference="{}"'
    for name, reference, sentence in (
        ("v", 2, "fmi3GetFloat64 of 'v"),
        ("force", 0, "fmi3SetFloat64 of 'force'"),
    ):
        path = tmp_path / f"{name}.fmu"
        with zipfile.ZipFile(fmus.path("CruiseControl", fmi="3.0")) as old:
            text = old.read("modelDescription.xml").decode()
        start = text.index(pattern.format(name, reference))
        end = text.index("/>", start) + 2
        element = text[start:end]
        wide = element.replace('start="0.0"', 'start="0 0 0"').replace("/>", '><Dimension start="3"/></Float64>')
        diagram = cosim.Diagram(dt=0.02)
        diagram.add(cosim.FMU(rewritten("3.0", path, (element, wide)), isolate=isolate), "car")
        with pytest.raises((SimulationError, FMUError)) as caught:
            diagram.simulate(1.0, engine="interpreted")
        assert "returned Error" in str(caught.value)
        assert sentence.partition(" ")[0] in str(caught.value)
        assert "Its log: " in str(caught.value)


# --- steps that fail ----------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@EVERYWHERE
def test_steps_that_fail_at_random(lying, fmi, isolate):
    path, ways = lying(fmi)
    error = stopped(path, ways["RANDOM"], isolate, steps=1000)
    assert f"fmi{fmi[0]}DoStep returned " in str(error)
    assert any(word in str(error) for word in ("Discard", "Error", "Fatal"))
    rows = len(error.result.time)
    assert rows < 1000
    np.testing.assert_allclose(error.result["car.v"], speeds(ways["RANDOM"], rows - 1), rtol=1e-9)
    assert f"(step {rows - 1})" in str(error)


@EVERYWHERE
def test_steps_that_are_discarded_for_ever(lying, fmi, isolate):
    path, ways = lying(fmi)
    error = stopped(path, ways["DISCARD"], isolate)
    assert "at t = 0.1 s (step 5)" in str(error)
    assert "Discard" in str(error)
    assert len(error.result.time) == 6


@pytest.mark.sampled(3)
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
@pytest.mark.parametrize(("way", "status"), [("BAD_STATUS", 77), ("MINUS_ONE", -1)])
@EVERYWHERE
def test_a_status_that_does_not_exist(lying, fmi, isolate, way, status, engine):
    path, ways = lying(fmi)
    error = stopped(path, ways[way], isolate, engine=engine)
    assert f"fmi{fmi[0]}DoStep returned {status}, which is no status of FMI." in str(error)


# --- logs ---------------------------------------------------------------------------------------------------------------------


def logged(caplog):
    """Return what the FMU has logged: asyncio logs at any moment, if tasks of an earlier test are collected."""
    return [record.getMessage() for record in caplog.records if record.name == "bayesftc.fmu"]


@pytest.mark.sampled(1)
@EVERYWHERE
def test_ten_megabytes_of_log_in_one_message(lying, fmi, isolate, caplog):
    path, ways = lying(fmi)
    with caplog.at_level(logging.INFO, "bayesftc.fmu"):
        result = run(path, ways["LONG_LINE"], isolate, steps=8)
    assert len(result.time) == 9
    assert [len(text) for text in logged(caplog)] == [len("car: ") + _fmi_messages.LENGTH] * 3


@pytest.mark.slow
@pytest.mark.sampled(1)
@WHERE
def test_ten_megabytes_of_log_in_a_million_messages(lying, isolate, caplog):
    path, ways = lying(FMI[isolate])
    with caplog.at_level(logging.INFO, "bayesftc.fmu"):
        result = run(path, ways["MANY_LINES"], isolate, steps=8)
    np.testing.assert_allclose(result["car.v"], speeds(ways["MANY_LINES"], 8), rtol=1e-12)
    texts = logged(caplog)
    assert len(texts) == _fmi_messages.FORWARDED + 1
    assert set(texts[:-1]) == {"car: ten bytes."}
    assert texts[-1] == "car: This FMU has logged 10000 messages; later ones are not forwarded."


# --- what is none of their business -------------------------------------------------------------------------------------------


@ENGINES
def test_arithmetic_that_is_changed_is_put_back_and_told(lying, engine):
    path, ways = lying("2.0")
    with pytest.warns(RuntimeWarning, match="The FMU of 'car' has changed how this process rounds") as caught:
        run(path, ways["ROUNDS_UP"], False, engine, steps=8)
    assert len(caught) < 5
    one, small = np.ones(2), np.full(2, 1e-20)
    assert (one + small == one).all()
    assert (one - small == one).all()
    least, tiny = np.full(2, 2.0**-1022), np.full(2, 2.0**-1074)
    assert (0.5 * least != 0.0).all()
    assert (tiny * one != 0.0).all()
    run(path, ways["ROUNDS_UP"], True, engine, steps=8)  # in another process it harms nobody: no warning


@ENGINES
def test_the_working_directory_is_gone_back_to(lying, engine, tmp_path, monkeypatch):
    path, ways = lying("3.0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    run(path, ways["GOES_AWAY"], False, engine, steps=8)
    assert Path.cwd() == tmp_path


@ENGINES
def test_the_working_directory_stays_where_other_threads_may_have_changed_it(lying, engine, tmp_path, monkeypatch):
    path, ways = lying("3.0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(threading, "active_count", lambda: 2)
    run(path, ways["GOES_AWAY"], False, engine, steps=8)
    assert Path.cwd() != tmp_path


@ENGINES
def test_a_deleted_working_directory_stops_no_run(lying, engine, tmp_path, monkeypatch):
    path, ways = lying("3.0")
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    run(path, ways["GOES_AWAY"], False, engine, steps=8)


@ENGINES
def test_ctrl_c_is_given_back(lying, engine):
    path, ways = lying("2.0")
    before = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        run(path, ways["TAKES_CTRL_C"], False, engine, steps=8)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


@WHERE
def test_what_is_said_after_the_end_is_not_printed(lying, isolate, capfd):
    path, ways = lying("2.0")
    run(path, ways["SPEAKS_LATE"], isolate, steps=8)
    assert capfd.readouterr() == ("", "")


# --- value references ---------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@EVERYWHERE
def test_value_references_that_the_binary_does_not_know(tmp_path, fmi, isolate):
    output = rewritten(fmi, tmp_path / "output.fmu", ('valueReference="2"', 'valueReference="77"'))
    error = stopped(output, 5.0, isolate)
    get = "fmi2GetReal" if fmi == "2.0" else "fmi3GetFloat64"
    assert f"at t = 0 s (step 0): block 'car' failed. {get}" in str(error)
    assert "value reference 77" in str(error)
    assert len(error.result.time) == 0
    entry = rewritten(fmi, tmp_path / "input.fmu", ('valueReference="1"', 'valueReference="77"'))
    set_ = get.replace("Get", "Set")
    error = stopped(entry, 5.0, isolate, error=FMUError)
    assert f"could not be initialized as 'car': {set_} of 'disturbance' returned Error." in str(error)


@pytest.mark.parametrize("validate", [True, False])
def test_numbers_that_stand_for_no_variable(tmp_path, validate):
    for number in (0, 99):
        path = rewritten("2.0", tmp_path / f"{number}.fmu", ('<Unknown index="3"', f'<Unknown index="{number}"'))
        with pytest.raises(
            FMUError, match=rf"refers to variable number {number}, but variables are numbered from 1 to \d+"
        ):
            describe(path, validate=validate)
    path = rewritten("2.0", tmp_path / "input.fmu", ('<Unknown index="3" dep', '<Unknown index="1" dep'))
    listed = rewritten("3.0", tmp_path / "output.fmu", ('<Output valueReference="2"', '<Output valueReference="0"'))
    for target in (path, listed):
        if validate:
            with pytest.raises(FMUError, match="lists 'force' as an output, but its causality is input"):
                describe(target)
        else:
            assert describe(target, validate=False).variables
    wide = rewritten("2.0", tmp_path / "wide.fmu", ('valueReference="2"', 'valueReference="4294967296"'))
    with pytest.raises(FMUError, match="4294967296"):
        describe(wide, validate=validate)
    with zipfile.ZipFile(fmus.path("CruiseControl", fmi="3.0")) as old:
        text = old.read("modelDescription.xml").decode()
    start = text.index('<Float64 name="v"')
    element = text[start : text.index("/>", start)]
    many = element + ">" + '<Dimension start="1"/>' * 70 + "</Float64>"
    deep = rewritten("3.0", tmp_path / "deep.fmu", (element + "/>", many))
    with pytest.raises(FMUError, match="'v' has 70 dimensions, but an array can have at most 32"):
        describe(deep, validate=validate)


def test_a_start_value_that_is_no_number_is_not_taken_for_zero(tmp_path):
    with zipfile.ZipFile(fmus.path("CruiseControl")) as old:
        text = old.read("modelDescription.xml").decode()
    start = text.index('name="force"')
    element = text[start : text.index("start=", start) + len('start="0.0"')]
    for word in ("NaN", "INF"):
        path = rewritten("2.0", tmp_path / f"{word}.fmu", (element, element.replace('start="0.0"', f'start="{word}"')))
        diagram = cosim.Diagram(dt=0.02)
        diagram.add(cosim.FMU(path), "car")
        with pytest.raises(cosim.UnconnectedInputError, match=r"car\.force"):
            diagram.build()
    diagram = cosim.Diagram(dt=0.02)
    car = diagram.add(cosim.FMU(path), "car")
    diagram.connect(diagram.add(cosim.Constant(100.0), "push")["y"], car["force"])
    assert diagram.simulate(0.02, engine="interpreted")["car.v"][-1] == 0.02


def test_values_beyond_the_bounds_that_an_fmu_declares(tmp_path):
    with zipfile.ZipFile(fmus.path("CruiseControl")) as old:
        text = old.read("modelDescription.xml").decode()
    start = text.index("<Real", text.index('name="m"'))
    element = text[start : start + 60]
    bounded = element.replace("<Real", '<Real min="1" max="500"')
    path = rewritten(
        "2.0", tmp_path / "m.fmu", (text[start - 80 : start] + element, text[start - 80 : start] + bounded)
    )
    assert cosim.FMU(path, parameters={"m": 500}).start_value("m") == 500.0
    for value in (0.5, 501):
        with pytest.raises(
            FMUError,
            match=r"'m' of the FMU m\.fmu is set to .* but its declaration allows only values from 1 to 500 kg",
        ):
            cosim.FMU(path, parameters={"m": value})
        assert cosim.FMU(path, parameters={"m": value}, validate=False).start_value("m") == value


def test_a_size_of_steps_that_is_none(tmp_path):
    path = rewritten("3.0", tmp_path / "step.fmu", ("<CoSimulation ", '<CoSimulation fixedInternalStepSize="1e-320" '))
    assert len(run(path, 5.0, False, steps=2).time) == 3


def test_value_references_that_two_variables_share(tmp_path):
    two = ('valueReference="1"', 'valueReference="0"')
    with pytest.raises(
        FMUError, match=r"gives 'force' and 'disturbance' one value reference, 0, so that setting one would"
    ) as e:
        cosim.FMU(rewritten("2.0", tmp_path / "two.fmu", two))
    assert str(e.value).endswith("try it all the same with validate=False (bayesftc inspect: --no-validate).")
    assert [port.name for port in cosim.FMU(tmp_path / "two.fmu", validate=False).inputs] == ["force", "disturbance"]
    with pytest.raises(
        FMUError, match=r"\"disturbance\" \(line \d+\) has the same value reference as variable \"force\""
    ):
        cosim.FMU(rewritten("3.0", tmp_path / "three.fmu", two))
    with pytest.raises(FMUError, match="gives 'b' and 'm' one value reference, 3"):
        cosim.FMU(rewritten("2.0", tmp_path / "b.fmu", ('valueReference="4"', 'valueReference="3"')))
    # An output may show an input: that is what sharing is for.
    shown = rewritten("2.0", tmp_path / "shown.fmu", ('valueReference="2"', 'valueReference="0"'))
    assert {v.name for v in describe(shown).variables if v.reference == 0} == {"force", "v"}
    assert run(shown, 5.0, False, steps=2)["car.v"].tolist() == [100.0] * 3


# --- promises -----------------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(2)
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
@WHERE
@pytest.mark.parametrize("fmi", FMI)
def test_steps_are_not_taken_for_repetitions(lying, fmi, isolate, engine):
    """An FMU may keep its state for a step that is repeated, unless it is promised that nobody goes back."""
    path, ways = lying(fmi)
    result = run(path, ways["REPEATS"], isolate, engine=engine)
    np.testing.assert_allclose(result["car.v"], speeds(ways["REPEATS"], 50), rtol=1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("fmi", FMI)
def test_no_promise_is_made_that_is_broken(lying, fmi, isolate):
    """After a state was saved, to which one may go back, steps come without the promise."""
    path, ways = lying(fmi)
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(cosim.FMU(path, parameters={"b": ways["REPEATS"], "force": 100.0}, isolate=isolate), "car")
    with diagram.start() as session:
        session.advance(0.04)
        session.save_state()
        with pytest.raises(SimulationError, match=r"is not the time .* at which this instance stands"):
            session.advance(0.1)  # the first step after that is taken for one that will be repeated


# --- what it prints, and how long it may take ---------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
@pytest.mark.parametrize("fmi", FMI)
def test_what_an_isolated_fmu_prints_is_logged(lying, fmi, capfd, caplog, engine):
    path, ways = lying(fmi)
    with caplog.at_level(logging.INFO, "bayesftc.fmu"):
        result = run(path, ways["PRINTS"], isolate=True, engine=engine)
    assert len(result.time) == 51
    assert {"car: the pump starts", "car: a bearing is hot", "car: the pump is to stop"} <= set(caplog.messages)
    assert capfd.readouterr() == ("", "")


def test_time_without_a_processor_does_not_count(monkeypatch):
    """A process that others keep from running is waited for as much longer, and no more."""
    from bayesftc.cosim.isolation import process

    class Busy:
        """Is ready at 0.3 s; was kept from running for half of the time up to then."""

        began = time.monotonic()

        def wait(self, end):
            time.sleep(max(0.0, min(end, self.began + 0.3) - time.monotonic()))
            return ["answer"] if time.monotonic() >= self.began + 0.3 else []

        def queued(self):
            return 0.5 * min(time.monotonic() - self.began, 0.3)

    assert process.Patience(Busy(), 0.2).wait() == ["answer"]
    idle = Busy()
    idle.began, idle.queued = time.monotonic(), lambda: 1.0
    assert process.Patience(idle, 0.2).wait() == []
    assert time.monotonic() - idle.began < 0.29
    worker = process.WorkerProcess(1, 1, 1.0)
    try:
        worker.wait(time.monotonic() + 60)
        assert 0.0 <= worker.queued() < 60.0
    finally:
        worker.end()
    assert worker.queued() == 0.0  # nobody says
