"""Experiment 1: active inference on a robot arm whose first encoder freezes (paper, section 5.1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.statistics import interval
from bayesftc.cosim.types import Floats
from bayesftc.reproduce import paper
from bayesftc.reproduce.experiments.arm.loop import FAULTY, HEALTHY, Case, closed_loop, explicit, learning, switching
from bayesftc.reproduce.settings import Arm
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.runner import Report, experiment

CHUNK = 5
"""Runs of one task: about a fifth of a second."""
BELIEF = ("plant.q1", "plant.q2", "controller.x_hat")
NAMES = ("none", "implicit", "explicit", "deterministic")
SWITCHING = "switching"
SIGNALS = {"explicit": "detected", SWITCHING: "fault_probability"}
"""The signal of each detecting technique: a probability for each sensor, or 0 or 1."""


@experiment(Arm)
def run(ensemble: Ensemble, settings: Arm, *, beyond: bool) -> Report:
    """Run active inference on the arm, with thresholds that are learned with separate seeds.

    `SwitchingPrecision` and other values of the unpublished settings (``grid``) are beyond the paper.
    """
    thresholds = learn_thresholds(settings, ensemble)
    cases = {
        "none": Case(controllers.FixedPrecision()),
        "implicit": Case(learning(settings)),
        "explicit": Case(explicit(settings, thresholds)),
        "deterministic": Case(controllers.FixedPrecision(), drop_faulty=True),
    }
    if beyond:
        cases[SWITCHING] = Case(switching(settings.fault_modes))
    loops = {name: closed_loop(settings, case) for name, case in cases.items()}
    chosen = ensemble.seeds("arm", settings.runs)
    errors = squared_errors(settings, loops, chosen, ensemble, "The paper's table")
    detection = {
        name: detections(settings, cases[name], SIGNALS[name], chosen, ensemble) for name in SIGNALS if name in cases
    }
    return {
        "settings": {"techniques": {n: repr(c.precision) for n, c in cases.items()}},
        "mse": {name: _summary(values) for name, values in errors.items()},
        "paper": paper.ARM,
        "detection": detection,
        "trajectories": {name: _trajectory(settings, loop, chosen[0]) for name, loop in loops.items()},
        "grid": _grid(settings, ensemble) if beyond else None,
    }


def learn_thresholds(settings: Arm, ensemble: Ensemble) -> tuple[controllers.FittedThreshold, ...]:
    """Return a Chebyshev threshold for each modality, learned from the innovations of healthy runs with other seeds."""
    loop = closed_loop(settings, Case(controllers.FixedPrecision(), fault=False))
    seeds = ensemble.seeds("arm thresholds", settings.threshold_runs)
    innovations = np.concatenate(ensemble.one("Healthy runs", Batch(loop, seeds, partial(_innovations, settings)), 1))
    rule = controllers.ChebyshevThreshold(settings.alpha)
    return tuple(rule.fit(innovations[:, list(group)]) for group in settings.detection_groups)


def squared_errors(
    settings: Arm,
    loops: Mapping[Any, cosim.Diagram],
    of: Sequence[int],
    ensemble: Ensemble,
    what: str,
) -> dict[Any, Floats]:
    """Return for each loop the mean squared error of the belief about both joints in each run (runs x 2)."""
    batches = {name: Batch(loop, of, partial(_errors, settings)) for name, loop in loops.items()}
    every, _ = ensemble.each(what, batches, CHUNK)
    return {name: np.concatenate(parts) for name, parts in every.items()}


def detections(settings: Arm, case: Case, signal: str, of: Sequence[int], ensemble: Ensemble) -> dict[str, float]:
    """Return a technique's detection delay by one of its signals, its missed faults, and its false alarms."""
    loops = {fault: closed_loop(settings, replace(case, fault=fault)) for fault in (True, False)}
    judge = partial(_detected, settings, signal)
    every, _ = ensemble.each("Detection", {fault: Batch(loops[fault], of, judge) for fault in loops}, CHUNK)
    delays, healthy = np.concatenate(every[True])[:, 0], np.concatenate(every[False])[:, 1]
    return {
        "delay_mean": float(np.mean(delays[np.isfinite(delays)])) if np.isfinite(delays).any() else float("nan"),
        "missed": int(np.isnan(delays).sum()),
        "healthy_share": float(healthy.mean()),
        "n": len(of),
    }


def _innovations(settings: Arm, loop: cosim.Diagram, of: Sequence[int]) -> Floats:
    name = "controller.innovation"
    return np.concatenate([result[name] for result in repeat(loop, settings.duration, of, [name])])


def _errors(settings: Arm, loop: cosim.Diagram, of: Sequence[int]) -> Floats:
    first, last = (round(t / settings.step) for t in settings.judged)
    rows = []
    for result in repeat(loop, settings.duration, of, BELIEF):
        truth = np.column_stack([result["plant.q1"], result["plant.q2"]])
        errors = (result["controller.x_hat"][:, :2] - truth)[first : last + 1]
        rows.append(np.mean(errors * errors, axis=0))
    return np.array(rows)


def _detected(settings: Arm, signal: str, loop: cosim.Diagram, of: Sequence[int]) -> Floats:
    """Return for each run the delay of the faulty encoder's detection in seconds, and the share of time with a detection."""
    start, rows = round(settings.fault_start / settings.step), []
    for result in repeat(loop, settings.duration, of, [f"controller.{signal}"]):
        flags = result[f"controller.{signal}"] >= ALARM
        hits = np.flatnonzero(flags[start:, FAULTY])
        rows.append([hits[0] * settings.step if len(hits) else np.nan, flags.any(axis=1).mean()])
    return np.array(rows)


def _summary(errors: Floats) -> dict[str, dict[str, Any]]:
    """Return the mean over runs for each joint, with its 95 % confidence interval (Student's t)."""
    summary = {}
    for name, joint in (("faulty", FAULTY), ("healthy", HEALTHY)):
        values = errors[:, joint]
        summary[name] = {"mean": float(values.mean()), "ci": interval(values), "n": len(values)}
    return summary


def _trajectory(settings: Arm, loop: cosim.Diagram, seed: int) -> dict[str, Any]:
    """Return angles, belief and goal of one run."""
    names = (*BELIEF, "reference_0.y", "reference_1.y")
    result = loop.simulate(settings.duration, seed=seed, record=names, decimation=settings.every)
    return {
        "time": result.time.tolist(),
        "angle": np.column_stack([result["plant.q1"], result["plant.q2"]]).tolist(),
        "belief": result["controller.x_hat"][:, :2].tolist(),
        "goal": np.column_stack([result["reference_0.y"], result["reference_1.y"]]).tolist(),
    }


def _grid(settings: Arm, ensemble: Ensemble) -> dict[str, list[dict[str, Any]]]:
    """Return the errors for other values of unpublished settings, and for other fault modes."""
    learned = ("learning_rate", "lower_bound")
    make: dict[str, Callable[[Arm], controllers.PrecisionLearner]] = {
        "none": lambda _: controllers.FixedPrecision(),
        "implicit": learning,
        SWITCHING: lambda varied: switching(varied.fault_modes),
    }
    cells: dict[str, list[dict[str, Any]]] = {
        "none": [
            {"switch": s, "camera_precision": c} for s, c in product(settings.switches, settings.camera_precisions)
        ],
        "implicit": [
            dict(zip(learned, pair, strict=True)) for pair in product(settings.learning_rates, settings.lower_bounds)
        ],
        SWITCHING: [{"fault_modes": modes} for modes in settings.further_modes],
    }
    loops: dict[Any, cosim.Diagram] = {}
    for kind, values in cells.items():
        for i, changes in enumerate(values):
            varied = replace(settings, **changes)
            loops[kind, i] = closed_loop(varied, Case(make[kind](varied)))
    seeds = ensemble.seeds("arm grid", settings.grid_runs)
    errors = squared_errors(settings, loops, seeds, ensemble, "Unpublished settings")
    return {
        kind: [
            {**changes, "faulty": float(e[FAULTY]), "healthy": float(e[HEALTHY])}
            for i, changes in enumerate(values)
            for e in [errors[kind, i].mean(axis=0)]
        ]
        for kind, values in cells.items()
    }
