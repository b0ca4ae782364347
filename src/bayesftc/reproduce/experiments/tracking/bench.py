"""Runs of the tracking experiment: every technique in every scenario, on the same noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from itertools import product
from operator import add
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.judging.alarms import Alarms
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.types import Floats
from bayesftc.reproduce import paper
from bayesftc.reproduce.settings import Car, Tracking
from bayesftc.reproduce.shared.car import closed_loop
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import PER_SENSOR, SWITCHING

Errors = dict[str, Floats]
"""The error of each run, by technique."""

REFERENCES = ("constant", "ramp", "sine")
PAPERS = tuple(paper.TOTAL_MERIT)
"""The techniques of the paper's table, in its order."""
ORACLE = "oracle"
HEALTHY = "healthy"
"""The name for a scenario without a fault."""
CHUNK = 25
"""Runs of one task: some milliseconds, after which it can be stopped."""
RECORD = ("plant.v", "reference.y")


@dataclass(frozen=True)
class Scenario:
    """A fault, its size (None if it has none), and a reference."""

    fault: str
    reference: str
    size: float | None = None

    @property
    def kind(self) -> str:
        """Name without the size; all techniques and all sizes of the fault have the noise of this name."""
        return f"{self.fault}/{self.reference}"

    @property
    def name(self) -> str:
        """Name with the size."""
        return self.kind if self.size is None else f"{self.fault} {self.size:g}/{self.reference}"


class Runs(NamedTuple):
    """The runs of one technique in one scenario."""

    rmse: Floats  # of shape (runs,): root-mean-square tracking error of each run, in m/s
    absolute: Floats  # of shape (steps,): mean over the runs of the absolute tracking error at each step, in m/s


class Measured(NamedTuple):
    """Runs by scenario and technique, their number of closed-loop steps, and the time."""

    runs: dict[Scenario, dict[str, Runs]]
    steps: int
    seconds: float

    def errors(self) -> dict[Scenario, Errors]:
        """Return the error of each run by scenario and technique."""
        return {s: {name: runs.rmse for name, runs in of.items()} for s, of in self.runs.items()}


def techniques(settings: Tracking) -> dict[str, controllers.PrecisionLearner]:
    """Return the paper's four techniques, and every other learner of the package by its class name."""
    four = {
        "EF-FDI": effdi(settings, settings.effdi_duration),
        "No FT": controllers.FixedPrecision(),
        "PL": controllers.GammaPrecision(forgetting=settings.forgetting, prior_shape=settings.prior_shape),
        "SER FT": controllers.SERFDI(threshold=settings.ser_threshold),
    }
    named = {type(learner) for learner in four.values()}
    others: dict[str, controllers.PrecisionLearner] = {
        cls.__name__: cls() for cls in controllers.LEARNERS if cls not in named
    }
    if SWITCHING in others:
        others[PER_SENSOR] = controllers.SwitchingPrecision(joint=False)
    return four | others


@dataclass(frozen=True)
class Bench:
    """Runs of techniques in scenarios."""

    settings: Tracking
    car: Car
    ensemble: Ensemble

    def measure(
        self,
        what: str,
        scenarios: Sequence[Scenario],
        learners: Mapping[str, controllers.PrecisionLearner],
        *,
        drop_faulty: bool = False,
    ) -> Measured:
        """Return all runs of every technique in every scenario; with `drop_faulty`, the faulty sensor's samples are missing."""
        s = self.settings
        batches = {
            (scenario, name): Batch(
                self.loop(scenario, learner, drop_faulty=drop_faulty),
                self.ensemble.seeds(scenario.kind, s.runs),
                partial(_run, s.duration),
            )
            for scenario, (name, learner) in product(scenarios, learners.items())
        }
        every, seconds = self.ensemble.each(what, batches, CHUNK)
        runs: dict[Scenario, dict[str, Runs]] = {scenario: {} for scenario in scenarios}
        for (scenario, name), parts in every.items():
            mean = np.divide(sum(absolute for _, absolute in parts), s.runs)
            runs[scenario][name] = Runs(np.concatenate([rmse for rmse, _ in parts]), mean)
        return Measured(runs, len(every) * s.runs * round(s.duration / self.car.step), seconds)

    def loop(self, scenario: Scenario, learner: controllers.PrecisionLearner, *, drop_faulty: bool) -> cosim.Diagram:
        """Return the car in a scenario with a technique; with `drop_faulty`, the faulty sensor's samples are missing."""
        s = self.settings
        when: dict[str, Any] = {"sensor": s.faulty_sensor, "start": s.fault_start, "stop": s.fault_stop}
        size = 0.0 if scenario.size is None else scenario.size
        kinds: dict[str, list[cosim.Fault]] = {
            HEALTHY: [],
            "freeze": [cosim.Freeze(**when)],
            "injection": [cosim.Injection(magnitude=size, **when)],
            "drift": [cosim.Drift(slope=size, **when)],
        }
        faults = kinds[scenario.fault]
        reference: cosim.Source = {
            "constant": cosim.Constant(s.constant),
            "ramp": cosim.Ramp(s.ramp),
            "sine": cosim.Sine(s.sine_amplitude, s.sine_period, offset=s.constant),
        }[scenario.reference]
        start = 0.0 if scenario.reference == "ramp" else s.constant
        if drop_faulty and faults:
            faults.append(cosim.Dropout(**when))
        return closed_loop(self.car, learner, faults, reference, start)


def _run(duration: float, loop: cosim.Diagram, own_seeds: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the root-mean-square tracking error of each run, and the sum over runs of the absolute error over time."""
    errors = tracking_errors(repeat(loop, duration, own_seeds, RECORD))
    return np.sqrt(np.mean(errors**2, axis=1)), np.abs(errors).sum(axis=0)


def tracking_errors(results: Iterable[cosim.Result]) -> Floats:
    """Return the errors of runs over time: the controller steers the state at t_k+1 to the goal at t_k."""
    return np.array([r["plant.v"][1:] - r["reference.y"][:-1] for r in results])


def all_alarms(parts: Iterable[Alarms | None]) -> Alarms | None:
    """Return the alarms of all parts together; None if none has any."""
    present = [each for each in parts if each is not None]
    return reduce(add, present) if present else None


def summary(errors: Floats) -> dict[str, float]:
    """Return the report's entry for the runs of one technique in one scenario."""
    return {"rmse_mean": float(errors.mean()), "rmse_sd": float(errors.std(ddof=1)), "n": len(errors)}


def effdi(settings: Tracking, duration: float) -> controllers.EFFDI:
    """Return the paper's EF-FDI, which ignores a sensor for a duration in seconds."""
    return controllers.EFFDI(threshold=settings.effdi_threshold, duration=duration)
