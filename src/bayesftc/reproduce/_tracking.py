"""Experiment 2: nine scenarios of fault and reference, every technique on the same noise (paper, section 5.2)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim._repeat import repeat
from bayesftc.cosim.block import Floats
from bayesftc.reproduce import paper
from bayesftc.reproduce._car import closed_loop
from bayesftc.reproduce._ensemble import Progress, check_jobs, chunks, in_parallel, prepare, seeds
from bayesftc.reproduce._merit import merit, outcomes, total
from bayesftc.reproduce.settings import Car, Tracking

Errors = dict[str, Floats]
"""For each technique the error of each run."""

REFERENCES = ("constant", "ramp", "sine")
FAULTS = ("freeze", "injection", "drift")
PAPERS = tuple(paper.TOTAL_MERIT)
"""The techniques of the paper's table, in its order."""
ORACLE = "oracle"
CURVES = "injection/sine"
"""The scenario of which the paper shows the mean absolute error over time."""
CHUNK = 25
"""Runs that one task makes: some milliseconds, after which it can be stopped."""
USER_STEPS = 5_000
"""Steps for which the loop with fmpy and filterpy is timed."""
RECORD = ("plant.v", "reference.y")


@dataclass(frozen=True)
class Scenario:
    """A fault of some size (None for a freeze) on a reference."""

    fault: str
    reference: str
    size: float | None = None

    @property
    def kind(self) -> str:
        """Name without the size; all techniques, and all sizes of the fault, share the noise of this name."""
        return f"{self.fault}/{self.reference}"

    @property
    def name(self) -> str:
        """Name with the size."""
        return self.kind if self.size is None else f"{self.fault} {self.size:g}/{self.reference}"


def techniques(settings: Tracking) -> dict[str, controllers.PrecisionLearner]:
    """Return the paper's four techniques, and every other learner of the package by its class name."""
    four = {
        "EF-FDI": _effdi(settings, settings.effdi_duration),
        "No FT": controllers.FixedPrecision(),
        "PL": controllers.GammaPrecision(forgetting=settings.forgetting, prior_shape=settings.prior_shape),
        "SER FT": controllers.SERFDI(threshold=settings.ser_threshold),
    }
    named = {type(learner) for learner in four.values()}
    return four | {cls.__name__: cls() for cls in controllers.LEARNERS if cls not in named}


def run(
    *,
    seed: int = 0,
    jobs: int = 1,
    runs: int | None = None,
    beyond: bool = True,
    settings: Tracking | None = None,
    car: Car | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and return what ``tracking.json`` holds.

    Parameters
    ----------
    seed : int
        Seed of all noise.
    jobs : int
        Number of threads; all but ``speed`` is the same to the last bit for any.
    runs : int, optional
        Runs of each technique in each scenario, instead of the settings'.
    beyond : bool
        Whether what is not in the paper is run as well: further techniques, and faults of other sizes.
    settings, car : Tracking, Car, optional
        Other settings than those of `bayesftc.reproduce.settings`.
    progress : callable, optional
        Called as ``progress(what, done, of)``.

    Raises
    ------
    ModelError
        If a number of jobs or runs cannot be.
    """
    settings, car = settings or Tracking(), car or Car()
    settings = settings if runs is None else replace(settings, runs=runs)
    bench = _Bench(settings, car, seed, check_jobs(jobs), progress)
    known = techniques(settings)
    papers = {name: known[name] for name in PAPERS}
    known = known if beyond else papers
    headline = [Scenario(fault, r, size) for (fault, size), r in product(_headline(settings).items(), REFERENCES)]
    cells = bench.errors("The paper's table", headline, papers)
    speed = bench.speed()
    further = bench.errors("Further techniques", headline, {n: known[n] for n in known if n not in papers})
    oracle = bench.errors("The oracle", headline, {ORACLE: controllers.FixedPrecision()})
    everything = {s: cells[s] | further[s] for s in headline}
    of_papers, of_all = (
        merit(list(errors.values()), names, settings.significance)
        for errors, names in ((cells, PAPERS), (everything, tuple(known)))
    )
    return {
        "settings": {
            "seed": seed,
            **settings.to_dict(),
            "car": car.to_dict(),
            "techniques": {name: repr(learner) for name, learner in known.items()},
        },
        "scenarios": {s.kind: {name: _summary(e) for name, e in everything[s].items()} for s in headline},
        "merit": of_papers,
        "total_merit": total(of_papers),
        "oracle": {s.kind: _summary(oracle[s][ORACLE]) for s in headline},
        "paper": {"merit": paper.MERIT, "total_merit": paper.TOTAL_MERIT},
        "merit_of_all": of_all,
        "total_merit_of_all": total(of_all),
        "lost": _lost(headline, everything, settings.significance),
        "mean_absolute_error": bench.curves,
        "grid": _grid(bench, cells, papers) if beyond else None,
        "speed": speed,
    }


class _Bench:
    """Runs techniques on scenarios; remembers how long that took, and the mean error over time of one scenario."""

    def __init__(self, settings: Tracking, car: Car, seed: int, jobs: int, progress: Progress | None):
        self.settings, self.car, self.seed, self.jobs, self.progress = settings, car, seed, jobs, progress
        self.curves: dict[str, list[float]] = {}
        self._steps, self._seconds = 0, 1.0

    def errors(
        self,
        what: str,
        scenarios: Sequence[Scenario],
        learners: Mapping[str, controllers.PrecisionLearner],
        *,
        beside: bool = False,
    ) -> dict[Scenario, Errors]:
        """Return the tracking error of every run of every technique on every scenario; `beside`: for the grid alone."""
        s = self.settings
        cells = list(product(scenarios, learners))
        loops = [self._loop(scenario, learners[name], told=name == ORACLE) for scenario, name in cells]
        prepare(loops, self.progress)
        groups = [chunks(seeds(self.seed, scenario.kind, s.runs), CHUNK) for scenario, _ in cells]
        tasks = [partial(_run, loop, s.duration, g) for loop, mine in zip(loops, groups, strict=True) for g in mine]
        began = time.perf_counter()
        done = iter(in_parallel(tasks, self.jobs, self.progress, what))
        self._seconds = time.perf_counter() - began
        self._steps = len(cells) * s.runs * round(s.duration / self.car.step)
        errors: dict[Scenario, Errors] = {scenario: {} for scenario in scenarios}
        for (scenario, name), mine in zip(cells, groups, strict=True):
            parts = [next(done) for _ in mine]
            errors[scenario][name] = np.concatenate([rmse for rmse, _ in parts])
            if (scenario.kind, scenario.size) == (CURVES, s.injection) and not beside:
                self.curves[name] = np.divide(sum(a for _, a in parts), s.runs).tolist()
        return errors

    def speed(self) -> dict[str, float]:
        """Return the closed-loop steps per second of the last errors, and those of a loop with fmpy and filterpy."""
        from bayesftc.bench.full_loop import user_rate

        ours, users = self._steps / self._seconds, user_rate(USER_STEPS)
        return {
            "steps": self._steps,
            "seconds": self._seconds,
            "jobs": self.jobs,
            "steps_per_second": ours,
            "user_loop_steps_per_second": users,
            "ratio": ours / users,
        }

    def _loop(self, scenario: Scenario, learner: controllers.PrecisionLearner, *, told: bool) -> cosim.Diagram:
        s = self.settings
        when: dict[str, Any] = {"sensor": s.faulty_sensor, "start": s.fault_start, "stop": s.fault_stop}
        size = 0.0 if scenario.size is None else scenario.size
        fault: cosim.Fault = {
            "freeze": cosim.Freeze(**when),
            "injection": cosim.Injection(magnitude=size, **when),
            "drift": cosim.Drift(slope=size, **when),
        }[scenario.fault]
        reference: cosim.Source = {
            "constant": cosim.Constant(s.constant),
            "ramp": cosim.Ramp(s.ramp),
            "sine": cosim.Sine(s.sine_amplitude, s.sine_period, offset=s.constant),
        }[scenario.reference]
        start = 0.0 if scenario.reference == "ramp" else s.constant
        faults = [fault, cosim.Dropout(**when)] if told else [fault]
        return closed_loop(self.car, learner, faults, reference, start)


def _run(loop: cosim.Diagram, duration: float, own_seeds: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the root-mean-square tracking error of each run, and the sum over runs of the absolute error over time.

    The controller aims at the goal of t_k with the state of t_k+1.
    """
    results = repeat(loop, duration, own_seeds, RECORD)
    errors = np.array([r["plant.v"][1:] - r["reference.y"][:-1] for r in results])
    return np.sqrt(np.mean(errors**2, axis=1)), np.abs(errors).sum(axis=0)


def _headline(settings: Tracking) -> dict[str, float | None]:
    return {"freeze": None, "injection": settings.injection, "drift": settings.drift}


def _summary(errors: Floats) -> dict[str, float]:
    sd = float(errors.std(ddof=1)) if len(errors) > 1 else float("nan")
    return {"rmse_mean": float(errors.mean()), "rmse_sd": sd, "n": len(errors)}


def _lost(
    scenarios: Sequence[Scenario], errors: Mapping[Scenario, Errors], significance: float
) -> dict[str, list[str]]:
    """Return the scenarios in which precision learning is significantly worse than some technique, and than which."""
    worse = {}
    for s in scenarios:
        rivals = [name for name in errors[s] if name != "PL"]
        lost = outcomes([errors[s]["PL"]] * len(rivals), [errors[s][name] for name in rivals], significance) < 0
        worse[s.kind] = [name for name, worst in zip(rivals, lost, strict=True) if worst]
    return {kind: names for kind, names in worse.items() if names}


def _grid(
    bench: _Bench, known: Mapping[Scenario, Errors], papers: Mapping[str, controllers.PrecisionLearner]
) -> dict[str, Any]:
    """Return the errors for faults of other sizes, and the merit table for each pair of sizes and duration of EF-FDI."""
    s = bench.settings
    injections, drifts = sorted({s.injection, *s.injections}), sorted({s.drift, *s.drifts})
    sizes = [("injection", size) for size in injections] + [("drift", size) for size in drifts]
    scenarios = [Scenario(fault, r, size) for (fault, size), r in product([("freeze", None), *sizes], REFERENCES)]
    others = {f"EF-FDI {d:g} s": _effdi(s, d) for d in s.effdi_durations}
    errors = bench.errors("Faults of other sizes", [c for c in scenarios if c not in known], papers) | dict(known)
    longer = bench.errors("EF-FDI of other durations", scenarios, others, beside=True)
    tables = []
    for injection, drift, column in product(injections, drifts, ("EF-FDI", *others)):
        chosen = [c for c in scenarios if c.size in {None, injection if c.fault == "injection" else drift}]
        cells = [errors[c] | {"EF-FDI": (errors[c] | longer[c])[column]} for c in chosen]
        table = merit(cells, PAPERS, s.significance)
        duration = s.effdi_duration if column == "EF-FDI" else others[column].duration
        tables.append(
            {
                "injection": injection,
                "drift": drift,
                "effdi_duration": duration,
                "merit": table,
                "total_merit": total(table),
            }
        )
    cells_of = {c.name: {n: _summary(e) for n, e in (errors[c] | longer[c]).items()} for c in scenarios}
    return {"scenarios": cells_of, "tables": tables}


def _effdi(settings: Tracking, duration: float) -> controllers.EFFDI:
    return controllers.EFFDI(threshold=settings.effdi_threshold, duration=duration)
