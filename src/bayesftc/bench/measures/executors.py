"""Campaigns in other processes: isolated FMUs on a local Dask cluster and in one process, and the overhead of processes."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from bayesftc.bench._figures import Figure, Section, ratios
from bayesftc.bench.measures.full_loop import EXPERIMENT, SETTING, full_diagram
from bayesftc.cosim.base.extras import why_missing

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.campaign import Campaign
    from bayesftc.cosim.campaign.executors.base import Executor

STARTING = 0.25
"""Share of the runs before the rate is measured: then all workers are active."""


def measure(quick: bool = False) -> Section:
    """Measure executors in turns: the rate once all workers are active, and the time until the first runs are done."""
    from bayesftc import cosim

    few, many, rounds = (16, 200, 1) if quick else (1_600, 60_000, 5)
    isolated, inside = _campaign(few, few // 80, isolate=True), _campaign(many, many // 40)
    measured: dict[str, tuple[Executor, Campaign]] = {
        "process": (cosim.Processes(1), isolated),
        "in_process": (cosim.Processes(1), inside),
        "thread": (cosim.Threads(1), inside),
    }
    missing = why_missing("distributed", purpose="A campaign on a cluster")
    if missing is None:
        measured["dask"] = cosim.DaskCluster(workers=2), isolated
    rates: dict[str, list[float]] = {name: [] for name in (*measured, "dask")}
    starts: dict[str, list[float]] = {name: [] for name in (*measured, "dask")}
    for _ in range(rounds):
        for name, (executor, campaign) in measured.items():
            start, rate = _rate(campaign, executor)
            starts[name].append(start)
            rates[name].append(rate)
    unit = "steps/s"
    two, first = "isolated FMU, Dask with two workers", "first runs of"
    over = ratios(rates["dask"], rates["process"]) if missing is None else ()
    return Section(
        "executors",
        f"Campaigns in other processes, runs of {EXPERIMENT} steps",
        (
            Figure("process", "isolated FMU, one process", unit, rates["process"]),
            Figure("dask", f"{two} here", unit, rates["dask"], reason=missing),
            Figure("dask_over_process", f"{two} / one process", "", over, at_least=1.5, reason=missing),
            Figure("dask_start", f"{first} a Dask cluster here are done after", "s", starts["dask"], reason=missing),
            Figure("process_start", f"{first} one process are done after", "s", starts["process"]),
            Figure("in_process", "FMU in process, one process", unit, rates["in_process"]),
            Figure("overhead", "one thread / one process", "", ratios(rates["thread"], rates["in_process"])),
        ),
    )


def _campaign(runs: int, piece: int, *, isolate: bool = False) -> Campaign:
    from bayesftc import cosim

    error = cosim.RMSE("plant.v", "reference.y", shift=1)
    return cosim.Campaign(
        full_diagram(isolate=isolate),
        duration=EXPERIMENT * SETTING.step,
        seeds=runs,
        metrics=[error],
        piece=max(piece, 1),
    )


def _rate(campaign: Campaign, executor: Executor) -> tuple[float, float]:
    """Return the seconds until the first runs are done, and the steps per second from `STARTING` on."""
    began, log = time.perf_counter(), list[tuple[int, float]]()
    campaign.run(executor=executor, progress=lambda done, of, failed: log.append((done, time.perf_counter())))
    first = next(at for done, at in log if done) - began
    ready, since = next((done, at) for done, at in log if done >= STARTING * campaign.runs)
    return first, (campaign.runs - ready) * EXPERIMENT / (log[-1][1] - since)
