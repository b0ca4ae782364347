"""Comparison of the residuals of the detection experiment with the exact posterior, the best possible detector."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bayesftc import cosim
from bayesftc.cosim.judging.metrics import auc as area
from bayesftc.cosim.judging.probabilities import reliability
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.statistics import interval, mean_reliability
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.bound.filter import PosteriorFilter
from bayesftc.reproduce.experiments.detection.run import GROUP, Bench
from bayesftc.reproduce.settings import Bound, Car, Detection
from bayesftc.reproduce.shared import residuals as _residuals
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import Residual
from bayesftc.reproduce.shared.runner import Report, experiment
from bayesftc.reproduce.shared.streams import Faults

BOUND = "bound"
CERTAIN = 700.0
"""Log odds at which a fault counts as certain: their exponential is still finite."""


class Record(NamedTuple):
    """The filter's inputs from a stream, and the truth."""

    y: Floats
    u: Floats
    faulty: Flags


@experiment(Bound, detection=Detection, car=Car)
def run(ensemble: Ensemble, settings: Bound, detection: Detection, car: Car, *, beyond: bool) -> Report:
    """Compare residuals with the exact posterior, on streams with the settings of `detection`.

    The learners of fault modes are beyond the paper. There are at most three sensors. It is an error if the AUC still changes at
    the largest number of particles.
    """
    bench = Bench(detection, car, ensemble)
    cells = [Faults(injection, drift, settings.reference) for injection, drift in settings.cells]
    records, betas, areas = [], [], []
    for i, faults in enumerate(cells):
        beta, _ = bench.choose(faults, bench.ensemble.seeds(f"bound/choice/{i}", settings.choice_streams))
        residuals = {**_residuals.papers(detection, beta), **(_residuals.posteriors(detection) if beyond else {})}
        seeds = bench.ensemble.seeds(f"bound/streams/{i}", settings.streams)
        records.append(_records(bench, faults, seeds))
        areas.append(_areas(bench, faults, seeds, residuals))
        betas.append({name: getattr(beta, name) for name in ("forgetting", "prior_shape")})
    found = _converged(bench, settings, cells, records)
    return {
        "particles": found[-1].particles,
        "moved": _moved(*found[-2:]),
        "doublings": [{"particles": f.particles, "auc": f.areas.mean(axis=1).tolist()} for f in found],
        "cells": [
            {
                **asdict(faults),
                "beta": betas[i],
                **_compared(areas[i], found[-1].areas[i]),
                "calibration": _calibration(bench, records[i], found[-1].odds[i]),
            }
            for i, faults in enumerate(cells)
        ],
    }


def _records(bench: Bench, faults: Faults, seeds: Sequence[int]) -> list[Record]:
    """Return the filter's inputs from the loop of the plain Kalman controller; the posterior is the same in any loop."""
    loop = bench.loop(faults, _residuals.PLAIN)
    samples = f"fault_{bench.car.sensors - 1}.y"

    def each(loop: cosim.Diagram, few: Sequence[int]) -> list[Record]:
        streams = bench.source.run(loop, few, [samples, "controller.u"])
        return [Record(s.result[samples], s.result["controller.u"].ravel(), s.faulty) for s in streams]

    return [record for group in bench.ensemble.one("Streams", Batch(loop, seeds, each), GROUP) for record in group]


def _areas(bench: Bench, faults: Faults, seeds: Sequence[int], residuals: Mapping[str, Residual]) -> dict[str, Floats]:
    """Return the AUC of each residual on each whole stream."""
    return dict(zip(residuals, bench.areas("Residuals", [(faults, r) for r in residuals.values()], seeds), strict=True))


class Posterior(NamedTuple):
    """The filter's results with a number of particles."""

    particles: int
    odds: list[list[Floats]]  # log odds of each stream of each cell
    areas: Floats  # the AUC, of shape (cells, streams)


def _converged(
    bench: Bench, settings: Bound, cells: Sequence[Faults], records: Sequence[Sequence[Record]]
) -> list[Posterior]:
    """Double the particles until no stream's AUC changes; return the results with each number."""
    found = [_posterior(bench, settings, cells, records, settings.particles)]
    while len(found) < 2 or _moved(*found[-2:]) >= settings.moves:
        particles = 2 * found[-1].particles
        if particles > settings.most_particles:
            raise cosim.ModelError(
                f"With {found[-1].particles} particles the AUC of a stream still changes by {settings.moves:g} or more. Raise "
                "most_particles."
            )
        found.append(_posterior(bench, settings, cells, records, particles))
    return found


def _posterior(
    bench: Bench, settings: Bound, cells: Sequence[Faults], records: Sequence[Sequence[Record]], particles: int
) -> Posterior:
    filters = [PosteriorFilter(bench.settings, bench.car, faults, particles, settings.tolerance) for faults in cells]
    tasks: list[Callable[[], Floats]] = [
        partial(each.log_odds, r.y, r.u) for each, mine in zip(filters, records, strict=True) for r in mine
    ]
    done = iter(bench.ensemble.run(tasks, f"Bound, {particles} particles"))
    odds = [[next(done) for _ in mine] for mine in records]
    skipped = bench.settings.skipped
    areas = [
        [area(r.faulty[skipped:], o[skipped:]) for r, o in zip(mine, of, strict=True)]
        for mine, of in zip(records, odds, strict=True)
    ]
    return Posterior(particles, odds, np.array(areas))


def _moved(before: Posterior, after: Posterior) -> float:
    """Return the largest change of a stream's AUC."""
    return float(np.abs(after.areas - before.areas).max())


def _compared(residuals: Mapping[str, Floats], bound: Floats) -> dict[str, Any]:
    """Return mean and interval of each AUC, and of its ratio to the bound's, stream by stream."""
    every = {**residuals, BOUND: bound}
    return {
        "auc": {name: {"mean": float(v.mean()), "ci": interval(v)} for name, v in every.items()},
        "ratio": {n: {"mean": float((v / bound).mean()), "ci": interval(v / bound)} for n, v in residuals.items()},
        "streams": {name: v.tolist() for name, v in every.items()},
    }


def _calibration(bench: Bench, records: Sequence[Record], odds: Sequence[Floats]) -> dict[str, Any]:
    """Return the calibration of the filter's probabilities; those of the exact posterior are calibrated."""
    skipped = bench.settings.skipped
    found = [
        reliability(
            1.0 / (1.0 + np.exp(-np.clip(o[skipped:], -CERTAIN, CERTAIN))), r.faulty[skipped:], bins=bench.settings.bins
        )
        for r, o in zip(records, odds, strict=True)
    ]
    means = mean_reliability(found)
    return {name: means[name] for name in ("ece", "brier")}
