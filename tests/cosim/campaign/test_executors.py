"""Executors: wherever the runs of a campaign are made, they have the same bits; what kills a process fails one run, no other."""

import importlib.util
import os
import resource
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import DaskCluster, Processes, Threads
from bayesftc.cosim.campaign.executors.choice import EXECUTORS, choose_executor
from bayesftc.cosim.campaign.runs import pickling
from bayesftc.cosim.errors import ModelError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
DISTRIBUTED = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="needs the package distributed"
)
IN_OTHER_PROCESSES = [Processes(2), DaskCluster(workers=2)]
"""Those that outlive the death of a run."""
EXAMPLES = [Threads(2), *IN_OTHER_PROCESSES]
"""Each way to make the runs; a new one is tested by being added here, or to those above."""


def test_every_executor_is_tested_and_can_be_chosen_on_the_command_line():
    from bayesftc.cli.commands.campaigns.campaign import Executor

    lacking = set(EXECUTORS) - {type(each) for each in EXAMPLES}
    assert not lacking, f"add {', '.join(cls.__name__ for cls in lacking)} to EXAMPLES of this file"
    assert len(Executor) == len(EXECUTORS), "Executor of src/bayesftc/cli/commands/campaigns/campaign.py lacks one"


def case(executor, *more, slow=False):
    marks = [DISTRIBUTED, *([pytest.mark.slow] if slow else [])] if isinstance(executor, DaskCluster) else []
    return pytest.param(executor, *more, marks=marks, id="-".join([type(executor).__name__, *more]))


@pytest.fixture(scope="module")
def campaign(lying, car):
    """Return a function that returns a campaign of a kind; all but one have runs that fail among those that do not."""

    def spread(result):  # a metric that other processes cannot import
        return float(np.ptp(result["plant.v"]))

    def looped(mass):
        return car(parameters={"m": mass})

    def campaign(kind):
        path, ways = lying("2.0")
        metrics = [cosim.RMSE("plant.v", name="size"), spread]
        common = {"duration": 0.6, "seeds": 3, "metrics": metrics, "record": ["plant.v", "sensors.y"], "piece": 4}
        if kind == "in process":
            values = {
                "well": 50.0,
                "infinite": -1e30,
                "error": ways["ERROR"],
                "refused": np.nan,
                "heavy": 60.0,
            }
            return cosim.Campaign(car(path), grid={"plant.b": values, "freeze.start": [0.2, 0.4]}, **common)
        if kind == "isolated":
            values = {"well": 50.0, "crash": ways["SEGFAULT"], "endless": ways["ENDLESS"]}
            loop = car(path, isolate=True, time_limit=0.5)
            return cosim.Campaign(loop, grid={"plant.b": values}, **common | {"seeds": 1, "piece": 2})
        if kind == "drawn":
            return cosim.Campaign(looped, grid=cosim.LatinHypercube({"mass": (80.0, 120.0)}, 7), **common)
        values = {"quick": 50.0, "slow": ways["SLEEPS"]}  # 0.3 s a step
        return cosim.Campaign(
            car(path, dt=0.1), grid={"plant.b": values}, **common | {"seeds": 1, "duration": 0.8, "time_limit": 0.4}
        )

    return campaign


KINDS = ("in process", "isolated", "drawn", "time limit")


@pytest.fixture(scope="module")
def alone(campaign):
    """Return a function that returns what a campaign comes to if all its runs are made in one thread."""
    return cache(lambda kind: campaign(kind).run(executor=Threads(1)))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("executor", "kind"), [case(e, kind, slow=kind != "in process") for e in EXAMPLES for kind in KINDS]
)
def test_the_same_bits_everywhere(executor, kind, alone, campaign, living, same_bits):
    told, before = [], living()
    result = campaign(kind).run(executor=executor, progress=lambda *counts: told.append(counts))
    table, expected = result.table, alone(kind).table
    assert table["status"].tolist() == expected["status"].tolist(), table["reason"].tolist()
    assert set(table["status"]) == ({"ok"} if kind == "drawn" else {"ok", "failed"})
    compared = slice(None)
    if kind == "time limit":  # at which step is a matter of the clock
        compared = slice(0, 1)
        assert table["reason"][1].startswith("The run reached its time limit of 0.4 s of computing at t = ")
    else:
        assert table["reason"].tolist() == expected["reason"].tolist()
        assert table["steps"].tolist() == expected["steps"].tolist()
    for name in ("size", "spread"):
        same_bits(table[name].to_numpy(), expected[name].to_numpy(), name)
    for name in ("plant.v", "sensors.y"):
        same_bits(result.dataset[name].values[compared], alone(kind).dataset[name].values[compared], name)
    assert told[0] == (0, len(table), 0)
    assert told[-1] == (len(table), len(table), int((table["status"] == "failed").sum()))
    assert living() <= before


def crashing(car, lying, **options):
    path, ways = lying("2.0")
    values = {"well": 50.0, "segfault": ways["SEGFAULT"], "exit": ways["EXIT"], "heavy": 60.0}
    metrics = [cosim.RMSE("plant.v", name="size")]
    return cosim.Campaign(
        car(path),
        duration=0.6,
        grid={"plant.b": values},
        seeds=2,
        record=["plant.v"],
        metrics=metrics,
        piece=3,
        **options,
    )


@pytest.mark.slow
@pytest.mark.parametrize("executor", [case(e, slow=True) for e in IN_OTHER_PROCESSES])
def test_a_run_that_ends_its_process_fails_alone(executor, car, lying, living, same_bits):
    before, crashes = living(), lying("2.0")[1]["SEGFAULT"]
    result = crashing(car, lying).run(executor=executor)
    table, good = result.table, [0, 1, 6, 7]
    assert table["status"].tolist() == ["ok", "ok", "failed", "failed", "failed", "failed", "ok", "ok"]
    assert (table["reason"][good] == "").all()
    for run in (2, 3):
        where = f"seed {table['seed'][run]}, plant.b = {crashes}"
        assert (
            table["reason"][run] == f"The process of this run ({where}) was killed by a segmentation fault (SIGSEGV)."
        )
    assert table["reason"][4].endswith("ended itself with exit code 3.")
    path, _ = lying("2.0")
    points = {"plant.b": [50.0, 60.0]}
    metrics = [cosim.RMSE("plant.v", name="size")]
    alone = cosim.Campaign(car(path), duration=0.6, grid=points, seeds=2, record=["plant.v"], metrics=metrics).run()
    same_bits(result.dataset["plant.v"].values[good], alone.dataset["plant.v"].values)
    same_bits(table["size"].to_numpy()[good], alone.table["size"].to_numpy())
    assert np.isnan(result.dataset["plant.v"].values[2:6]).all()
    assert living() <= before


@pytest.mark.slow
@pytest.mark.parametrize("executor", [Processes(1)], ids=str)
def test_a_worker_out_of_memory_stops_the_campaign_which_goes_on_later(executor, tmp_path, living, same_bits):
    """It is no property of a run: the campaign stops, and goes on from its store where there is more memory."""
    pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
    scarce, before = tmp_path / "scarce", living()
    scarce.touch()

    def greedy(result):
        if result["law.y"][-1] > 50.0 and scarce.exists():
            limits = resource.getrlimit(resource.RLIMIT_AS)
            resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, limits[1]))
            try:
                np.ones(2**31)
            finally:
                resource.setrlimit(resource.RLIMIT_AS, limits)
        return float(result["law.y"][-1])

    diagram = cosim.Diagram(0.1)
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], diagram.add(cosim.Gain(1.0), "law")["u"])
    points = {"law.offset": [0.0, 1.0, 100.0, 2.0]}
    campaign = cosim.Campaign(diagram, duration=0.5, grid=points, seeds=2, metrics=[greedy], piece=2)
    with pytest.raises(MemoryError):
        campaign.run(executor=executor, store=tmp_path / "store")
    assert living() <= before
    scarce.unlink()
    again = campaign.run(executor=executor, store=tmp_path / "store").table
    assert set(again["status"]) == {"ok"}
    same_bits(again["greedy"].to_numpy(), campaign.run(executor=Threads(1)).table["greedy"].to_numpy())


@pytest.mark.slow
@pytest.mark.parametrize("executor", [case(e, slow=True) for e in IN_OTHER_PROCESSES])
def test_a_worker_that_the_system_kills_for_its_memory_fails_alone(executor, living):
    """The system sends SIGKILL; of a cluster it hits the process of the runs, which is the largest one."""

    def killed(result):
        if result["law.y"][-1] > 50.0:
            os.kill(os.getpid(), signal.SIGKILL)
        return 1.0

    before = living()
    diagram = cosim.Diagram(0.1)
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], diagram.add(cosim.Gain(1.0), "law")["u"])
    points = {"law.offset": [0.0, 100.0, 2.0]}
    table = cosim.Campaign(diagram, duration=0.5, grid=points, metrics=[killed], piece=2).run(executor=executor).table
    assert table["status"].tolist() == ["ok", "failed", "ok"]
    assert table["reason"][1].endswith("was killed by the system or a user (SIGKILL).")
    assert living() <= before


@pytest.mark.slow
def test_a_step_that_does_not_end_reaches_the_time_limit(car, lying, living):
    path, ways = lying("2.0")
    before, points = living(), {"plant.b": [ways["ENDLESS"], 50.0]}
    campaign = cosim.Campaign(car(path), duration=0.6, grid=points, record=["plant.v"], time_limit=0.5)
    table = campaign.run(executor=Processes(1)).table
    assert table["status"].tolist() == ["failed", "ok"]
    assert "was ended, because it reached its time limit of 0.5 s of computing within a step." in table["reason"][0]
    assert living() <= before


@pytest.mark.slow
def test_a_process_that_someone_kills_is_replaced(car, living, same_bits):
    campaign = cosim.Campaign(car(), duration=20.0, seeds=60, record=["plant.v"], piece=4)
    killed, before = set(), living()

    def kill(done, of, failed):
        if done == 12 and not killed:
            killed.update(living() - before)
            for pid in killed:
                os.kill(pid, signal.SIGKILL)

    result = campaign.run(executor=Processes(2), progress=kill)
    assert killed
    assert set(result.table["status"]) == {"ok"}
    same_bits(result.dataset["plant.v"].values, campaign.run(executor=Threads(1)).dataset["plant.v"].values)
    assert living() <= before


INTERRUPTED = """
import os, signal, sys, threading
from bayesftc import cosim
diagram = cosim.Diagram(dt="1/1000")
diagram.add(cosim.Gaussian(std=1.0), "noise")
def told(done, of, failed):
    if done:
        threading.Timer(0.2, os.kill, (os.getpid(), signal.{name})).start()
executor = eval("cosim." + sys.argv[1])
try:
    cosim.Campaign(diagram, duration=2000.0, seeds=10_000, metrics=[cosim.Mean("noise.y")], piece=1).run(
        executor=executor, progress=told)
except KeyboardInterrupt:
    print("stopped")
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
@pytest.mark.parametrize("executor", [case(e) for e in IN_OTHER_PROCESSES])
def test_what_ends_the_client_ends_all(executor, name, living):
    before = living()
    shown = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED.replace("{name}", name), repr(executor)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    seen = set()
    while shown.poll() is None:
        seen |= living() - before - {shown.pid}
        time.sleep(0.02)
    out, err = shown.communicate(timeout=60)
    assert (out, shown.returncode) == (("stopped\n", 0) if name == "SIGINT" else ("", -signal.SIGKILL)), err
    assert len(seen) >= 2
    end = time.monotonic() + 10
    while left := [pid for pid in seen if Path(f"/proc/{pid}").exists() and _state(pid) != "Z"]:
        assert time.monotonic() < end, left
        time.sleep(0.05)


def _state(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


SCRIPT = """
import dataclasses
from bayesftc import cosim
from bayesftc.cosim import ops

LEVEL = 3.0

@dataclasses.dataclass(frozen=True)
class Root(cosim.Block):
    gain: float = 2.0
    inputs = (cosim.Port("u"),)
    outputs = (cosim.Port("y"),)
    def define(self, step):
        def output(u, y, gain):
            y[0] = gain[0] * ops.sqrt(ops.square(u[0]) + LEVEL)
        return cosim.Definition(output=output, parameters={"gain": self.gain})

def loop(gain):
    diagram = cosim.Diagram(dt=0.1)
    noise, root = diagram.add(cosim.Gaussian(std=1.0), "noise"), diagram.add(Root(gain), "root")
    diagram.connect(noise["y"], root["u"])
    return diagram

def last(result):
    return float(result["root.y"][-1])

campaign = cosim.Campaign(loop, duration=1.0, grid={"gain": [1.0, 2.0]}, seeds=2, metrics=[last])
a, b = (campaign.run(executor=e).table["last"].tolist() for e in (cosim.Processes(1), cosim.Threads(1)))
print(int(a == b and len(set(a)) == 4))
"""


@pytest.mark.slow
def test_scripts_need_no_guard(python):
    assert python(SCRIPT) == 1


def test_without_cloudpickle_it_is_said_what_is_not_found(monkeypatch, car):
    monkeypatch.setattr(pickling, "_cloudpickle", lambda: None)

    def loop(start):
        return car()

    campaign = cosim.Campaign(loop, duration=0.1, grid={"start": [1.0]})
    with pytest.raises(
        ModelError, match=r"loop is defined in another function, .*; define it at the top of a separate module"
    ):
        campaign.run(executor=Processes(1))
    assert "run" in cosim.Campaign(car(), duration=0.1, record=["plant.v"]).run(executor=Processes(1)).table


def test_what_cannot_be_pickled_is_named(car):
    import threading

    lock = threading.Lock()
    campaign = cosim.Campaign(car(), duration=0.1, metrics=[lambda result: 0.0 if lock else 1.0])
    with pytest.raises(ModelError, match=r"the metric .* cannot be pickled \(.*lock.*executor=Threads"):
        campaign.run(executor=Processes(1))


@pytest.mark.parametrize("executor", ["threads", Threads, 4], ids=str)
def test_what_is_no_executor_is_refused(executor, car):
    with pytest.raises(
        ModelError, match=r"executor is .*; it must be one of Threads\(\), Processes\(\), DaskCluster\(\)"
    ):
        cosim.Campaign(car(), duration=0.1).run(executor=executor)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("executor", [Threads(1), Processes(1)], ids=str)
def test_what_a_function_raises_fails_the_runs_that_it_raises_for(executor, car, same_bits):
    def rarely(result):
        if result["plant.v"][-1] > bound:
            raise ZeroDivisionError("by nothing")
        return 1.0

    def loop(weight):
        return car(parameters={"m": {"light": 90.0, "heavy": 120.0}[weight]})

    grid, common = {"weight": ["light", "no such", "heavy"]}, {"duration": 0.2, "seeds": 6, "record": ["plant.v"]}
    metrics = [cosim.Final("plant.v", name="end"), rarely]
    free = cosim.Campaign(loop, grid=grid, metrics=metrics[:1], **common).run(executor=Threads(1))
    ends = free.table["end"].to_numpy()
    bound = float(np.nanmedian(ends))
    result = cosim.Campaign(loop, grid=grid, metrics=metrics, **common).run(executor=executor)
    table, raised = result.table, ends > bound
    assert raised.any()
    assert (table["status"] == np.where(raised | (table["point"] == 1), "failed", "ok")).all()
    told = r"The metric 'rarely' could not be computed: ZeroDivisionError: by nothing \(test_executors.py, line \d+, in rarely\)"
    assert table["reason"][raised].str.fullmatch(told).all()
    unbuilt = r"The loop of this point could not be built: KeyError: 'no such' .*"
    assert table["reason"][table["point"] == 1].str.fullmatch(unbuilt).all()
    assert (table["steps"][table["point"] != 1] == 10).all()
    same_bits(table["end"].to_numpy(), np.where(raised, np.nan, ends))
    same_bits(result.dataset["plant.v"].values, free.dataset["plant.v"].values)


@pytest.mark.parametrize("executor", [Threads(1), Processes(1)], ids=str)
def test_what_a_block_raises_fails_its_run(executor, make_block):
    def output(u, y):
        if u[0] > 2.0:
            raise ValueError("too much")
        y[0] = u[0]

    block = make_block(inputs=(cosim.Port("u"),), outputs=(cosim.Port("y"),), output=output, compiled=False)
    diagram = cosim.Diagram(0.1)
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], diagram.add(block, "picky")["u"])
    table = (
        cosim.Campaign(diagram, duration=2.0, seeds=10, metrics=[cosim.Final("picky.y")]).run(executor=executor).table
    )
    for seed, reason in zip(table["seed"], table["reason"], strict=True):
        try:
            diagram.simulate(2.0, seed=int(seed))
            assert not reason
        except ValueError:
            assert reason.startswith("The run could not be made: ValueError: too much (test_executors.py, line ")
    assert set(table["status"]) == {"ok", "failed"}


def test_the_default_is_threads_where_they_use_all_cores(monkeypatch, car, make_block):
    monkeypatch.setattr("bayesftc.cosim.campaign.executors.choice.cores", lambda: 4)

    def chosen(diagram, **options):
        return choose_executor(cosim.Campaign(diagram, duration=0.1, **options).job)

    assert chosen(car()) == (Threads(), "Threads: all blocks are compiled, and no FMU needs a separate process.")
    assert chosen(car(isolate=True))[0] == Threads()
    once = car()
    monkeypatch.setitem(once["plant"].block.description.capabilities, "canBeInstantiatedOnlyOncePerProcess", True)
    executor, why = chosen(once)
    assert executor == Processes()
    assert why == "Processes: the FMU 'plant' allows only one instance per process."
    monkeypatch.setattr("bayesftc.cosim.campaign.executors.choice.cores", lambda: 1)
    assert chosen(once)[0] == Threads()
    assert cosim.Campaign(car(), duration=0.1).run().metadata["executor"].startswith("Threads: ")
    assert (
        cosim.Campaign(car(), duration=0.1)
        .run(executor=Threads(1))
        .metadata["executor"]
        .startswith("Threads(jobs=1), ")
    )


def test_what_python_computes_goes_to_processes(monkeypatch, make_block):
    monkeypatch.setattr("bayesftc.cosim.campaign.executors.choice.cores", lambda: 4)

    def output(y, t):
        y[0] = float(str(t[0])) if hasattr(t, "__len__") else float(str(t))

    diagram = cosim.Diagram(dt=0.1)
    diagram.add(make_block(outputs=(cosim.Port("y"),), output=output, compiled=False), "clock")
    campaign = cosim.Campaign(diagram, duration=1.0, record=["clock.y"])
    executor, why = choose_executor(campaign.job)
    assert "the block 'clock' computes in Python" in why
    assert isinstance(executor, Processes)
    ticks, alone = campaign.run(executor=executor).dataset, campaign.run(executor=Threads(1)).dataset
    np.testing.assert_array_equal(ticks["clock.y"].values, alone["clock.y"].values)
    np.testing.assert_array_equal(ticks["clock.y"].values.ravel(), ticks["time"].values)
