"""The sentence about compiling: said once, where nobody listens on stderr, and not for what comes from the disk."""

import logging
import re
import sys
import time
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.base import announcing
from bayesftc.cosim.run import running
from bayesftc.cosim.stepping import compiler
from bayesftc.cosim.stepping.machine import steps
from bayesftc.examples.fitted_car.recordings import CAR, NAMES, recording


@pytest.fixture
def fresh(monkeypatch):
    """A process that has compiled nothing yet and is not patient."""
    monkeypatch.setattr(announcing, "announcement", announcing._Announcement())
    monkeypatch.setattr(announcing, "PATIENCE", 0.05)
    logger = logging.getLogger("bayesftc")
    level, handlers = logger.level, list(logger.handlers)
    logger.setLevel(logging.NOTSET)
    yield logger
    logger.setLevel(level)
    logger.handlers[:] = handlers


def test_it_is_said_once_and_only_if_compiling_takes_long(fresh, caplog):
    with announcing.announced(True):
        pass
    assert not caplog.messages
    for _ in range(2):
        with announcing.announced(True):
            time.sleep(0.2)
    with announcing.announced(False):
        time.sleep(0.1)
    assert caplog.messages == [announcing.SENTENCE]


def test_a_slow_call_reports_itself_each_time_and_a_quick_one_does_not(fresh, caplog):
    for seconds in (0.0, 0.2, 0.2):
        with announcing.reported("Compiling limit.fmu."):
            time.sleep(seconds)
    assert caplog.messages == ["Compiling limit.fmu."] * 2


def test_export_design_calibrate_and_campaigns_report_themselves(fresh, caplog, tmp_path, monkeypatch):
    monkeypatch.setattr(announcing, "PATIENCE", 0.0)
    monkeypatch.setattr(announcing.announcement, "said", lambda: True)
    servo = cosim.FMU(fmus.path("PositionServo"))
    controller = controllers.design(servo, measured="angle", actuated="voltage")
    controllers.calibrate(controller.model, steps=5000)
    loop = cosim.closed_loop(servo, controller, control="voltage", measured="angle", reference=1.0)
    cosim.Campaign(loop, duration=2.0, seeds=4).run()
    cosim.export_fmu(cosim.Saturation(-1.0, 1.0), tmp_path / "limit.fmu", dt=0.01)
    words = (
        "Linearizing",
        "Comparing the linear model",
        "Simulating 5000 steps",
        "Making 4 runs",
        "Translating the blocks to C",
        "Compiling limit.fmu",
    )
    assert [message for message in caplog.messages if message.startswith(words)] == caplog.messages
    assert len(caplog.messages) == len(words)


@pytest.mark.slow
def test_verify_and_fit_report_themselves(fresh, caplog, tmp_path, monkeypatch):
    diagram = cosim.Diagram(dt=0.1)
    noise, limit = diagram.add(cosim.Gaussian(std=1.0)), diagram.add(cosim.Saturation(-1.0, 1.0), "limit")
    diagram.connect(noise["y"], limit["u"])
    fmu = cosim.export_fmu(diagram, tmp_path / "limit.fmu", blocks="limit")
    monkeypatch.setattr(announcing, "PATIENCE", 0.0)
    monkeypatch.setattr(announcing.announcement, "said", lambda: True)
    caplog.clear()
    cosim.verify_fmu(fmu, diagram, duration=10.0)
    cosim.fit(CAR, recording(0, 100), {"m": (80.0, 120.0)}, **NAMES)
    assert caplog.messages == [
        "Comparing limit.fmu with limit, for some seconds.",
        "Fitting m to 100 steps, for seconds to minutes.",
    ]


def test_the_check_of_a_model_against_a_recording_reports_itself(fresh, caplog, monkeypatch):
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    u, y = np.random.default_rng(0).standard_normal((2, 200, 2))
    monkeypatch.setattr(announcing, "PATIENCE", 0.0)
    for _ in range(2):
        controllers.diagnose_recording(model, y, u[:, :1])
    assert caplog.messages == ["Comparing the samples with the model, for seconds to a minute."] * 2


def test_the_time_left_does_not_count_the_compiler(caplog, monkeypatch):
    """As in an interpreted run: the first step compiles for 20 s, a piece 1.5 s later for 15 s, and each step takes 0.01 s."""
    clock = [0.0]
    monkeypatch.setattr(announcing.announcement, "said", lambda: True)
    monkeypatch.setattr(running, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    late = [15.0]

    def steps(begin, end, *, first):
        clock[0] += 0.01 * (end - begin) + 20.0 * first + (late.pop() if clock[0] > 21.5 and late else 0.0)
        return end, None

    run = SimpleNamespace(k=-1, guard=SimpleNamespace(changed=False), schedule=SimpleNamespace(step=Fraction(1, 10)))
    assert running.advance(SimpleNamespace(advance=steps), 2000, run) is None
    assert run.k == 2000
    text = r"Simulating: (\d+)% \([\d.]+ of 200 s\) after (\d+) s, about (\d+) s left\."
    said = [[int(number) for number in re.fullmatch(text, message).groups()] for message in caplog.messages]
    assert [after for _, after, _ in said] == [39, 49]
    assert all(abs(left - (100 - share) / 5) <= 0.7 for share, _, left in said)  # 5 % of the run in a second


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_long_run_says_how_far_it_is_and_has_the_same_bits(engine, fresh, caplog, monkeypatch):
    diagram = cosim.Diagram(dt=0.1)
    noise, integrator = diagram.add(cosim.Gaussian(std=1.0)), diagram.add(cosim.Integrator())
    diagram.connect(noise["y"], integrator["u"])
    monkeypatch.setattr(announcing.announcement, "said", lambda: True)
    silent = diagram.simulate(500.0, seed=1, engine=engine)
    assert not caplog.messages
    monkeypatch.setattr(running, "SILENCE", 0.0)
    diagram.simulate(50_000.0 if engine == "compiled" else 500.0, seed=1, engine=engine)
    assert len(caplog.messages) == 1  # the next one is due in ten seconds
    monkeypatch.setattr(running, "PERIOD", 0.0)
    told = diagram.simulate(500.0, seed=1, engine=engine)
    assert re.fullmatch(r"Simulating: \d+% \([\d.]+ of 500 s\) after \d s, about \d+ s left\.", caplog.messages[1])
    assert told["integrator.y"].tobytes() == silent["integrator.y"].tobytes()
    caplog.clear()
    diagram.simulate(500.0, engine=engine, progress=lambda step, steps: None)
    diagram.simulate(0.1, engine=engine, pace=10.0)
    assert not caplog.messages


def test_many_short_compilations_add_up(fresh, caplog):
    for _ in range(5):
        with announcing.announced(True):
            time.sleep(0.03)
    time.sleep(0.05)
    assert caplog.messages == [announcing.SENTENCE]


def test_without_logging_it_is_on_stderr_and_quiet_turns_it_off(fresh, monkeypatch, capsys):
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with announcing.announced(True):
        time.sleep(0.2)
    assert capsys.readouterr().err == f"{announcing.SENTENCE}\n"
    monkeypatch.setattr(announcing, "announcement", announcing._Announcement())
    fresh.setLevel(logging.WARNING)
    with announcing.announced(True):
        time.sleep(0.2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("module", [compiler, steps])
def test_what_comes_from_the_disk_is_not_announced(module, monkeypatch, tmp_path):
    """By numba, and from the C of exports; a second process is one without the names of the first."""
    asked = []
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path))
    monkeypatch.setattr(module, "announced", lambda needed: asked.append(needed) or announcing.announced(False))

    def doubled_for_announcing(u, y):
        y[0] = 2.0 * u[0]

    sections = {"u": ("inputs", 0, (1,)), "y": ("outputs", 0, (1,))}
    for _ in range(2):
        if module is steps:
            steps._address(doubled_for_announcing, sections, "doubled_for_announcing")
        else:
            compiler.compile_function(_service, "float64(float64)")
            for name in [name for name in compiler._modules if "_service" in name]:
                sys.modules.pop(compiler._modules.pop(name).__name__)
    assert [needed for needed in asked if needed] == [True]


def _service(x):
    return 2.0 * x + 0.125
