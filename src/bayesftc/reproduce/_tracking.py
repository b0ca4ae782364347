"""Experiment 2: nine scenarios of fault and reference, every technique on the same noise (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim._repeat import repeat
from bayesftc.cosim.block import Floats
from bayesftc.reproduce import paper
from bayesftc.reproduce._car import closed_loop
from bayesftc.reproduce._ensemble import Ensemble, Progress
from bayesftc.reproduce._merit import merit, total
from bayesftc.reproduce._statistics import outcomes
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


class Runs(NamedTuple):
    """The runs of one technique in one scenario.

    Attributes
    ----------
    rmse : ndarray of shape (runs,)
        Root-mean-square tracking error of each run, in m/s.
    absolute : ndarray of shape (steps,)
        Mean over the runs of the absolute tracking error at each step, in m/s.
    """

    rmse: Floats
    absolute: Floats


class Measured(NamedTuple):
    """Runs by scenario and technique, and how many closed-loop steps they took in how many seconds."""

    runs: dict[Scenario, dict[str, Runs]]
    steps: int
    seconds: float

    def errors(self) -> dict[Scenario, Errors]:
        """Return the error of each run by scenario and technique."""
        return {s: {name: runs.rmse for name, runs in of.items()} for s, of in self.runs.items()}


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
        If a seed, a number of jobs or a number of runs cannot be one.
    """
    settings, car = Tracking.of(settings, runs), car or Car()
    bench = _Bench(settings, car, Ensemble(seed, jobs, progress))
    known = techniques(settings)
    papers = {name: known[name] for name in PAPERS}
    known = known if beyond else papers
    headline = [Scenario(fault, r, size) for (fault, size), r in product(_headline(settings).items(), REFERENCES)]
    table = bench.measure("The paper's table", headline, papers)
    speed = _speed(table, jobs)
    others = bench.measure("Further techniques", headline, {n: known[n] for n in known if n not in papers})
    told = bench.measure("The oracle", headline, {ORACLE: controllers.FixedPrecision()}, told=True)
    cells, further, oracle = table.errors(), others.errors(), told.errors()
    everything = {s: cells[s] | further[s] for s in headline}
    of_papers, of_all = (
        merit(list(errors.values()), names, settings.significance)
        for errors, names in ((cells, PAPERS), (everything, tuple(known)))
    )
    curves = [part.runs[s] for part in (table, others, told) for s in headline if s.kind == CURVES]
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
        "mean_absolute_error": {name: r.absolute.tolist() for runs in curves for name, r in runs.items()},
        "grid": _grid(bench, cells, papers) if beyond else None,
        "speed": speed,
    }


@dataclass(frozen=True)
class _Bench:
    """Runs techniques on scenarios."""

    settings: Tracking
    car: Car
    ensemble: Ensemble

    def measure(
        self,
        what: str,
        scenarios: Sequence[Scenario],
        learners: Mapping[str, controllers.PrecisionLearner],
        *,
        told: bool = False,
    ) -> Measured:
        """Return all runs of every technique on every scenario; if `told`, the faulty sensor's samples are missing."""
        s = self.settings
        cells = list(product(scenarios, learners))
        loops = [self.loop(scenario, learners[name], told=told) for scenario, name in cells]
        own = [self.ensemble.seeds(scenario.kind, s.runs) for scenario, _ in cells]
        every, seconds = self.ensemble.each(what, loops, own, CHUNK, partial(_run, s.duration))
        runs: dict[Scenario, dict[str, Runs]] = {scenario: {} for scenario in scenarios}
        for (scenario, name), parts in zip(cells, every, strict=True):
            mean = np.divide(sum(absolute for _, absolute in parts), s.runs)
            runs[scenario][name] = Runs(np.concatenate([rmse for rmse, _ in parts]), mean)
        return Measured(runs, len(cells) * s.runs * round(s.duration / self.car.step), seconds)

    def loop(self, scenario: Scenario, learner: controllers.PrecisionLearner, *, told: bool) -> cosim.Diagram:
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


def _run(duration: float, loop: cosim.Diagram, own_seeds: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the root-mean-square tracking error of each run, and the sum over runs of the absolute error over time.

    The controller aims at the goal of t_k with the state of t_k+1.
    """
    results = repeat(loop, duration, own_seeds, RECORD)
    errors = np.array([r["plant.v"][1:] - r["reference.y"][:-1] for r in results])
    return np.sqrt(np.mean(errors**2, axis=1)), np.abs(errors).sum(axis=0)


def _speed(measured: Measured, jobs: int) -> dict[str, float]:
    """Return the closed-loop steps per second of our runs, and those of a loop with fmpy and filterpy."""
    from bayesftc.bench.full_loop import user_rate

    ours, users = measured.steps / measured.seconds, user_rate(USER_STEPS)
    return {
        "steps": measured.steps,
        "seconds": measured.seconds,
        "jobs": jobs,
        "steps_per_second": ours,
        "user_loop_steps_per_second": users,
        "ratio": ours / users,
    }


def _headline(settings: Tracking) -> dict[str, float | None]:
    return {"freeze": None, "injection": settings.injection, "drift": settings.drift}


def _summary(errors: Floats) -> dict[str, float]:
    return {"rmse_mean": float(errors.mean()), "rmse_sd": float(errors.std(ddof=1)), "n": len(errors)}


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
    sized = bench.measure("Faults of other sizes", [c for c in scenarios if c not in known], papers)
    errors = sized.errors() | dict(known)
    longer = bench.measure("EF-FDI of other durations", scenarios, others).errors()
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
