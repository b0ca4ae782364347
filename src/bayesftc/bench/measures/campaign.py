"""Campaigns: the rate on all cores, compared with one core, the bare engine, and a process pool of fmpy and filterpy."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.bench._child import repeated
from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import unpacked_fmu
from bayesftc.bench._user_loop import user_loop
from bayesftc.bench.measures.full_loop import EXPERIMENT, SETTING, full_diagram

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.campaign import Campaign
    from bayesftc.cosim.diagram.diagram import Diagram

MANY = 100_000
"""Runs of the large campaign."""
CHILD = """
import json, time
from bayesftc.bench.measures.campaign import speed_campaign
from bayesftc.bench.measures.memory import peak

speed_campaign(2).run()  # loads the compiled code
began = time.perf_counter()
table = speed_campaign({runs}).run().table
seconds = time.perf_counter() - began
assert len(table) == {runs} and (table["status"] == "ok").all()
print(json.dumps([seconds, peak()]))
"""


def speed_campaign(runs: int) -> Campaign:
    """Return the loop of `full_loop` with this number of seeds, which keeps only the tracking error."""
    from bayesftc import cosim

    error = cosim.RMSE("plant.v", "reference.y", shift=1)
    return cosim.Campaign(full_diagram(), duration=EXPERIMENT * SETTING.step, seeds=runs, metrics=[error])


def measure(quick: bool = False) -> Section:
    """Measure everything in turns, after a first run that compiles."""
    from bayesftc.cosim.campaign.executors.base import cores

    runs, few, rounds = (200, 4, 2) if quick else (32_000, 40, 7)
    campaign, diagram = speed_campaign(runs), full_diagram()
    on_cores = {"one": 1, "all": cores()}
    measured = {name: partial(_rate, campaign, n) for name, n in on_cores.items()}
    measured["bare"] = partial(_bare_rate, diagram, runs * EXPERIMENT // 4)
    with _pool(on_cores["all"]) as pool:
        measured["user"] = partial(_user_rate, pool, few, on_cores["all"])
        _rate(speed_campaign(2), 1)
        rates = in_turns(measured, rounds)
    large = 1_000 if quick else MANY  # the time of fewer runs is scaled
    results, reason = repeated(CHILD.format(runs=large), 1 if quick else 3)
    seconds, memory = [took * MANY / large for took, _ in results], [peak / 1e6 for _, peak in results]
    rate = "steps/s"
    n, overhead = on_cores["all"], ratios(rates["bare"], rates["one"])
    scaling, over_user = ratios(rates["all"], rates["one"]), ratios(rates["all"], rates["user"])
    return Section(
        "campaign",
        f"Campaigns: runs of {EXPERIMENT} steps of the car with gamma learning, metrics only",
        (
            Figure("threads", f"threads on {n} cores", rate, rates["all"], at_least=8e6),
            Figure("one_thread", "one thread", rate, rates["one"]),
            Figure("scaling", f"{n} cores / one", "", scaling, at_least=1.8),
            Figure("bare", "bare engine, one long run that records the same", rate, rates["bare"]),
            Figure("overhead", "bare engine / campaign on one thread", "", overhead, at_most=1.1),
            Figure("user", f"fmpy, NumPy and filterpy in a pool of {n} processes", rate, rates["user"]),
            Figure("over_user", "campaign / user's pool", "", over_user, at_least=50.0),
            Figure("large", f"{MANY} runs", "s", seconds, at_most=30.0, reason=reason),
            Figure(
                "large_memory", f"{MANY} runs: peak memory of the process", "MB", memory, at_most=1e3, reason=reason
            ),
        ),
    )


def _rate(campaign: Campaign, threads: int) -> float:
    from bayesftc import cosim

    began = time.perf_counter()
    campaign.run(executor=cosim.Threads(threads))
    return campaign.runs * EXPERIMENT / (time.perf_counter() - began)


def _bare_rate(diagram: Diagram, steps: int) -> float:
    began = time.perf_counter()
    diagram.simulate(steps * diagram.step, seed=1, record=("plant.v", "reference.y"))
    return steps / (time.perf_counter() - began)


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def _user_rate(pool: ProcessPoolExecutor, runs: int, workers: int) -> float:
    list(pool.map(_user_runs, [[0]] * workers))  # so that each worker has imported and unpacked everything
    seeds = np.array_split(np.arange(runs), workers)
    began = time.perf_counter()
    errors = list(pool.map(_user_runs, [part.tolist() for part in seeds]))
    assert sum(map(len, errors)) == runs
    return runs * EXPERIMENT / (time.perf_counter() - began)


def _user_runs(seeds: Sequence[int]) -> list[float]:
    """Return the tracking error of each run of the user's loop."""
    errors = []
    with unpacked_fmu() as car:
        for seed in seeds:
            noise = np.random.default_rng(seed).standard_normal((EXPERIMENT + 1, 3))
            recording = user_loop(car, EXPERIMENT, noise, SETTING)
            errors.append(float(np.sqrt(np.mean((recording[1:, 0] - recording[:-1, -1]) ** 2))))
    return errors
