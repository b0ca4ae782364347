"""Beyond the paper: whether learners detect faults of healthy sensors if the model is wrong.

These are the paper's 'ageing and other non-fault phenomena'. Each technique tracks with a car, a road or sensors that differ from
the controller's model, with healthy sensors and with one that fails. The controller's model is unchanged, or also has an unknown
force that is estimated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.judging.alarms import Alarms, alarm_threshold, judge_alarms
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.statistics import ratio
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.models.car import RIGHT, Condition, believed, conditions, disturbed, loop
from bayesftc.reproduce.experiments.tracking.bench import (
    CHUNK,
    HEALTHY,
    ORACLE,
    PAPERS,
    RECORD,
    all_alarms,
    techniques,
    tracking_errors,
)
from bayesftc.reproduce.settings import Car, Models, Tracking
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import SWITCHING
from bayesftc.reproduce.shared.runner import Report, experiment

FIXED = "No FT"
"""Fixed precision, with which all techniques are compared if the sensors are healthy."""


class Detector(NamedTuple):
    """The signal and the threshold of a learner's alarms."""

    # A signal of the controller: ``fault_probability``, ``detected``, or ``precision`` (a low one indicates a fault).
    signal: str
    threshold: float = ALARM  # the least score of an alarm: of the signal, or of the negative precision

    @property
    def record(self) -> str:
        """Name of the signal in a result."""
        return f"controller.{self.signal}"

    def score(self, result: cosim.Result) -> Floats:
        """Return the score, which is higher for more suspicious samples."""
        return -result[self.record] if self.signal == "precision" else result[self.record]


ACTUATOR = Detector("actuator_fault_probability")
"""The detector of actuator faults, for learners with actuator modes."""


Detectors = tuple[Detector | None, Detector | None]
"""The detectors of sensor faults and of actuator faults."""
NOTHING: Detectors = (None, None)


class Runs(NamedTuple):
    """The runs of one cell."""

    rmse: Floats  # of shape (runs,): root-mean-square tracking error of each run, in m/s
    # All alarms for sensors and for the actuator, if there is a detector.
    alarms: Alarms | None
    actuator_alarms: Alarms | None


@dataclass(frozen=True)
class Cell:
    """A loop: its model, condition, fault and technique."""

    model: str
    condition: str
    case: str
    technique: str

    def over(self, technique: str) -> Cell:
        """Return the same cell with another technique."""
        return replace(self, technique=technique)


@experiment(Models, car=Car)
def run(ensemble: Ensemble, settings: Models, car: Car, *, beyond: bool) -> Report:
    """Run every technique in every condition; further techniques and disturbances (``grid``) are beyond the paper."""
    named_learners = learners(beyond)
    bench = _Bench(settings, car, ensemble, conditions(settings, car), believed(settings, car))
    detectors = bench.detectors(named_learners)
    found = bench.measure(
        "Wrong models", bench.cells(bench.models, (HEALTHY, *bench.faults), named_learners), named_learners, detectors
    )
    table: dict[str, Any] = {m: {c: {} for c in bench.conditions} for m in bench.models}
    for cell, runs in found.items():
        if cell.technique != ORACLE:
            entry = _errors(runs, found[cell.over(FIXED if cell.case == HEALTHY else ORACLE)])
            if cell.case == HEALTHY:
                for kind in ("alarms", "actuator_alarms"):
                    entry[kind] = None if (alarms := getattr(runs, kind)) is None else alarms.to_dict()
            table[cell.model][cell.condition].setdefault(cell.technique, {})[cell.case] = entry
    return {
        "settings": {
            "techniques": {name: repr(learner) for name, learner in named_learners.items()},
            "conditions": {name: condition.text for name, condition in bench.conditions.items()},
            "labels": {name: condition.label for name, condition in bench.conditions.items()},
        },
        "errors": table,
        "oracle": {
            m: {
                c: {case: float(found[Cell(m, c, case, ORACLE)].rmse.mean()) for case in bench.faults}
                for c in bench.conditions
            }
            for m in bench.models
        },
        "detectors": {m: {n: d._asdict() for n in named_learners if (d := detectors[m, n])} for m in bench.models},
        "above_the_bar": _above(table, settings.bar),
        "grid": _grid(bench, named_learners) if beyond else None,
    }


def learners(beyond: bool) -> dict[str, controllers.PrecisionLearner]:
    """Return the tracking experiment's techniques, and learners with modes only of sensors, or also of actuators."""
    named_learners = techniques(Tracking())
    if not beyond:
        return {name: named_learners[name] for name in PAPERS}
    modes = [controllers.InputOffset(), controllers.LostEffect(), controllers.StuckActuator()]
    given = {"input offset": modes[:1], "actuator modes": modes}
    return named_learners | {
        f"{SWITCHING}, sensors only": controllers.SwitchingPrecision(process_modes=()),
        **{f"{SWITCHING}, {name}": controllers.SwitchingPrecision(actuator_modes=of) for name, of in given.items()},
    }


@dataclass(frozen=True)
class _Bench:
    """Runs of techniques in all conditions."""

    settings: Models
    car: Car
    ensemble: Ensemble
    conditions: Mapping[str, Condition]
    models: Mapping[str, controllers.LinearModel]

    @property
    def faults(self) -> dict[str, cosim.Fault]:
        s = self.settings
        when: dict[str, Any] = {"sensor": s.faulty_sensor, "start": s.fault_start, "stop": s.fault_stop}
        return {
            "freeze": cosim.Freeze(**when),
            "injection": cosim.Injection(magnitude=s.injection, **when),
            "drift": cosim.Drift(slope=s.drift, **when),
        }

    def loop(
        self,
        model: str,
        condition: str,
        learner: controllers.PrecisionLearner,
        case: str = HEALTHY,
        *,
        drop_faulty: bool = False,
    ) -> cosim.Diagram:
        """Return a loop; with `drop_faulty`, the faulty sensor's samples are missing."""
        faults = [] if case == HEALTHY else [self.faults[case]]
        if drop_faulty:
            faults += [cosim.Dropout(sensor=f.sensor, start=f.start, stop=f.stop) for f in faults]
        return loop(self.settings, self.car, self.conditions[condition], self.models[model], learner, faults)

    def detectors(
        self, named_learners: Mapping[str, controllers.PrecisionLearner]
    ) -> dict[tuple[str, str], Detector | None]:
        """Return the detector by model and technique; None if there is none.

        It uses the learner's probability or detection. For a learner without these it uses the precision, with a threshold that
        is set with the right model and healthy sensors.
        """
        s = self.settings
        found = {
            (m, n): _own_detector(named_learners[n], self.models[m]) for m, n in product(self.models, named_learners)
        }
        own = self.ensemble.seeds("models/thresholds", s.threshold_runs)
        for (m, n), detector in found.items():
            if detector is not None and detector.signal == "precision":
                loop = self.loop(m, RIGHT, named_learners[n])
                batch = Batch(loop, own, partial(_scores, s.duration, detector))
                scores = [score for part in self.ensemble.one("Thresholds", batch, CHUNK) for score in part]
                level = alarm_threshold(scores, step=self.car.step, per_hour=s.alarms_per_hour)
                found[m, n] = detector._replace(threshold=level)
        return found

    def cells(self, models: Iterable[str], cases: Iterable[str], named_learners: Iterable[str]) -> list[Cell]:
        """Return the cells of every technique in every condition, and of the oracle if there is a fault."""
        cells = [Cell(*of) for of in product(models, self.conditions, cases, [*named_learners, ORACLE])]
        return [cell for cell in cells if cell.technique != ORACLE or cell.case != HEALTHY]

    def measure(
        self,
        what: str,
        cells: Sequence[Cell],
        named_learners: Mapping[str, controllers.PrecisionLearner],
        detectors: Mapping[tuple[str, str], Detector | None],
    ) -> dict[Cell, Runs]:
        """Return all runs of cells; all models, conditions and techniques of a case have the same noise."""
        s = self.settings
        learners = {**named_learners, ORACLE: controllers.FixedPrecision()}
        runs = {case: s.runs * (s.healthy_factor if case == HEALTHY else 1) for case in (HEALTHY, *self.faults)}
        seeds = {case: self.ensemble.seeds(f"models/{case}", runs[case]) for case in runs}
        batches = {}
        for c in cells:
            learner, watched = learners[c.technique], NOTHING
            if c.case == HEALTHY:
                blames = ACTUATOR.signal in {port.name for port in learner.learner(self.models[c.model]).ports}
                watched = (detectors.get((c.model, c.technique)), ACTUATOR if blames else None)
            loop = self.loop(c.model, c.condition, learner, c.case, drop_faulty=c.technique == ORACLE)
            batches[c] = Batch(loop, seeds[c.case], partial(_run, s.duration, watched))
        every, _ = self.ensemble.each(what, batches, CHUNK)
        return {cell: _pooled(parts) for cell, parts in every.items()}


def _grid(bench: _Bench, named_learners: Mapping[str, controllers.PrecisionLearner]) -> dict[str, Any]:
    """Return the errors with healthy sensors if the estimated disturbance changes faster or slower."""
    s = bench.settings
    models = {f"{time:g}": disturbed(s, bench.car, time) for time in s.unmodelled_times}
    fewer = replace(bench, settings=replace(s, healthy_factor=1), models=models)
    found = fewer.measure("Other disturbances", fewer.cells(models, [HEALTHY], named_learners), named_learners, {})
    return {
        time: {
            c: {n: _errors(found[cell := Cell(time, c, HEALTHY, n)], found[cell.over(FIXED)]) for n in named_learners}
            for c in fewer.conditions
        }
        for time in models
    }


def _own_detector(learner: controllers.PrecisionLearner, model: controllers.LinearModel) -> Detector | None:
    """Return a learner's own detector, or its precision with a threshold that is not yet set."""
    if learner.why_no_probability is None:
        return Detector("fault_probability")
    if "detected" in {port.name for port in learner.learner(model).ports}:
        return Detector("detected")
    return None if isinstance(learner, controllers.FixedPrecision) else Detector("precision")


def _scores(duration: float, detector: Detector, loop: cosim.Diagram, own_seeds: Sequence[int]) -> list[Floats]:
    return [detector.score(r) for r in repeat(loop, duration, own_seeds, (detector.record,))]


def _run(duration: float, detectors: Detectors, loop: cosim.Diagram, own_seeds: Sequence[int]) -> Runs:
    """Make runs of one cell."""
    results = list(repeat(loop, duration, own_seeds, (*RECORD, *(d.record for d in detectors if d))))
    return Runs(np.sqrt(np.mean(tracking_errors(results) ** 2, axis=1)), *(_judged(results, d) for d in detectors))


def _judged(results: Sequence[cosim.Result], detector: Detector | None) -> Alarms | None:
    """Return all alarms of fault-free runs."""
    if detector is None:
        return None
    scores, step = [detector.score(r) for r in results], float(results[0].step)
    level = detector.threshold
    return all_alarms(judge_alarms(x, np.zeros(x.shape, bool), threshold=level, step=step) for x in scores)


def _pooled(parts: Sequence[Runs]) -> Runs:
    rmse, alarms, actuator = zip(*parts, strict=True)
    return Runs(np.concatenate(rmse), all_alarms(alarms), all_alarms(actuator))


def _errors(runs: Runs, over: Runs) -> dict[str, Any]:
    value, bounds = ratio(runs.rmse, over.rmse)
    return {"rmse_mean": float(runs.rmse.mean()), "n": len(runs.rmse), "ratio": value, "ratio_ci": bounds}


def _above(table: Mapping[str, Any], bar: float) -> dict[str, dict[str, list[str]]]:
    """Return for each model and technique the conditions in which its error with healthy sensors is above the bar."""
    found: dict[str, dict[str, list[str]]] = {m: {} for m in table}
    for m, of in table.items():
        for condition, cells in of.items():
            for technique, cell in cells.items():
                if cell[HEALTHY]["ratio"] > bar:
                    found[m].setdefault(technique, []).append(condition)
    return found
