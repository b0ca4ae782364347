"""Beyond the paper: whether fault probabilities are correct.

Of the samples with a fault probability of .3, three in ten should be faulty. This is tested on runs with faults of random kinds
and sizes, most of which no learner models. With only one kind of fault and a short sequence, the probability can be computed
exactly, from all histories of faults. A further part compares `SwitchingPrecision` with these exact probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.elementary import logarithm
from bayesftc.cosim.judging.metrics import NAN, without_nan
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.statistics import calibration
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.probabilities import exact_cases as _exact_cases
from bayesftc.reproduce.experiments.probabilities.random_faults import RandomFault, random_fault
from bayesftc.reproduce.experiments.tracking.bench import CHUNK
from bayesftc.reproduce.settings import Car, Probabilities, Tracking
from bayesftc.reproduce.shared.car import closed_loop, model
from bayesftc.reproduce.shared.ensemble import Ensemble, chunks
from bayesftc.reproduce.shared.residuals import PER_SENSOR, SWITCHING
from bayesftc.reproduce.shared.runner import Report, experiment

TOLD, GAMMA = f"{SWITCHING}, told the times", "GammaPrecision, calibrated"
PROBABILITY = "controller.fault_probability"
RESAMPLES = 2_000
"""Number of bootstrap samples: the ends of an interval are then known to a few percent of its width."""

Learners = Mapping[str, controllers.PrecisionLearner]


class Run(NamedTuple):
    """Fault probabilities and true faults of a run, both of shape (steps, sensors)."""

    probability: Floats
    faulty: np.ndarray[Any, np.dtype[np.bool_]]


@experiment(
    Probabilities,
    car=Car,
    options="""
    learners : mapping of str to PrecisionLearner, optional
        The evaluated learners, by default those of `judged_learners`.""",
)
def run(ensemble: Ensemble, settings: Probabilities, car: Car, *, learners: Learners | None = None) -> Report:
    """Evaluate fault probabilities on random faults and against exact ones; `runs` also limits the sequences of each mode."""
    settings = replace(settings, sequences=min(settings.sequences, settings.runs))
    reliability, names = {}, {}
    for lengths in settings.lengths:
        known = learners or judged_learners(settings, lengths, car)
        title = f"{lengths[0]:g} to {lengths[1]:g} s"
        reliability[title] = _reliability(settings, lengths, car, ensemble, known, title)
        names[title] = {name: repr(learner) for name, learner in known.items()}
    report: dict[str, Any] = without_nan(
        {
            "settings": {**settings.to_dict(), "learners": names},
            "reliability": reliability,
            "exact": _exact_cases.distances(settings, model(car), Tracking.constant, ensemble),
        }
    )
    return report


def judged_learners(
    settings: Probabilities, lengths: tuple[float, float], car: Car
) -> dict[str, controllers.PrecisionLearner]:
    """Return the learners by name: with default settings, with better settings, and gamma with a fitted map."""
    to_fault, to_recovery = mean_times(settings, lengths, car)
    default = controllers.SwitchingPrecision()
    with_times = [
        replace(m, time_to_fault=len(default.modes) * to_fault, time_to_recovery=to_recovery) for m in default.modes
    ]
    larger = [replace(mode, jump=settings.jump) if type(mode) is controllers.Offset else mode for mode in default.modes]
    gamma = controllers.GammaPrecision()
    fitted = controllers.calibrate(model(car), controllers.Hazards(to_fault, to_recovery), precision=gamma)
    return {
        SWITCHING: default,
        PER_SENSOR: replace(default, joint=False),
        TOLD: replace(default, modes=with_times, duration_shape=inf),
        f"{SWITCHING}, jump {settings.jump:g}": replace(default, modes=larger),
        GAMMA: replace(gamma, calibration=fitted.calibration),
    }


def mean_times(settings: Probabilities, lengths: tuple[float, float], car: Car) -> tuple[float, float]:
    """Return the mean time to a fault of one sensor, and to its recovery, in seconds."""
    shortest, longest = lengths
    mean = shortest if shortest == longest else (longest - shortest) / logarithm(longest / shortest)
    return car.sensors * settings.duration - mean, mean


def _reliability(
    settings: Probabilities,
    lengths: tuple[float, float],
    car: Car,
    ensemble: Ensemble,
    known: Learners,
    title: str,
) -> dict[str, dict[str, Any]]:
    """Return the reliability of each learner's probabilities, on the same faults and the same noise."""
    seeds = ensemble.seeds(f"probabilities/faults/{title}", settings.runs)
    faults = [random_fault(settings, lengths, car.sensors, own) for own in seeds]
    kinds = [fault.kind for fault in faults]
    return {
        name: judged(settings, _runs(settings, car, ensemble, faults, learner), kinds)
        for name, learner in known.items()
    }


def _runs(
    settings: Probabilities,
    car: Car,
    ensemble: Ensemble,
    faults: Sequence[RandomFault],
    learner: controllers.PrecisionLearner,
) -> list[Run]:
    """Return the runs of a learner, one with each fault."""
    reference = cosim.Sine(Tracking.sine_amplitude, Tracking.sine_period, offset=Tracking.constant)
    loops = [closed_loop(car, learner, fault.faults, reference, Tracking.constant) for fault in faults]
    ensemble.prepare(list({fault.kind: loop for fault, loop in zip(faults, loops, strict=True)}.values()))
    seeds = ensemble.seeds("probabilities/noise", settings.runs)
    groups = chunks(range(settings.runs), CHUNK)
    done = ensemble.run(
        [partial(_simulated, settings, [(loops[k], faults[k], seeds[k]) for k in few]) for few in groups],
        "Random faults",
    )
    return [one for few in done for one in few]


def _simulated(settings: Probabilities, runs: Sequence[tuple[cosim.Diagram, RandomFault, int]]) -> list[Run]:
    found = []
    for loop, fault, seed in runs:
        (result,) = repeat(loop, settings.duration, [seed], [PROBABILITY])
        probability = result[PROBABILITY]
        found.append(Run(probability, fault.truth(result.time, probability.shape[1])))
    return found


def judged(settings: Probabilities, runs: Sequence[Run], kinds: Sequence[str]) -> dict[str, Any]:
    """Return the reliability of probabilities: diagram with intervals over runs, the worst bin, and the parts of each kind.

    The unit of the statistics is a run, because its samples are not independent; `kinds` has the kind of its fault.

    Returns
    -------
    dict
        ``bins``: for each ``samples``, ``runs`` with a sample in it, ``predicted``, ``observed`` with its ``ci``, ``gap``
        (predicted minus observed) and ``by_kind``, the contributions of the runs of each kind, whose sum is the gap.
        ``largest``: largest absolute gap of a bin that has enough samples, with its ``ci`` from the bootstrap over runs, and the
        number of that ``bin``. ``brier``, ``ece`` (calibration error) and their ``ci``.
    """
    probability, faulty = [r.probability for r in runs], [r.faulty for r in runs]
    found = calibration(probability, faulty, bins=settings.bins, equal="widths")
    samples, gaps = _gaps(settings, runs)
    each = {kind: np.array([k == kind for k in kinds]) for kind in dict.fromkeys(name for name, *_ in settings.kinds)}
    pooled, bins = found.pooled, []
    for b in range(settings.bins):
        total = max(samples[:, b].sum(), 1.0)
        bins.append(
            {
                "samples": int(samples[:, b].sum()),
                "runs": int((samples[:, b] > 0).sum()),
                "predicted": float(pooled.predicted[b]),
                "observed": float(pooled.observed[b]),
                "ci": [float(found.observed_low[b]), float(found.observed_high[b])],
                "gap": float(pooled.predicted[b] - pooled.observed[b]),
                "by_kind": {kind: float(gaps[own, b].sum() / total) for kind, own in each.items()},
            }
        )
    return {
        "bins": bins,
        "largest": _largest(samples, gaps, samples.sum(axis=0) >= settings.enough),
        "brier": pooled.brier,
        "brier_ci": list(found.brier_interval),
        "ece": pooled.calibration_error,
        "ece_ci": list(found.calibration_error_interval),
    }


def _gaps(settings: Probabilities, runs: Sequence[Run]) -> tuple[Floats, Floats]:
    """Return for each run and bin the number of samples, and the sum of the predicted minus the observed values."""
    counts, gaps = np.zeros((2, len(runs), settings.bins))
    for k, one in enumerate(runs):
        present = ~np.isnan(one.probability)
        p = one.probability[present]
        place = np.minimum((p * settings.bins).astype(int), settings.bins - 1)
        counts[k] = np.bincount(place, minlength=settings.bins)
        gaps[k] = np.bincount(place, p - one.faulty[present], settings.bins)
    return counts, gaps


def _distance(gaps: Floats, samples: Floats) -> Floats:
    distance: Floats = np.abs(gaps) / np.maximum(samples, 1.0)
    return distance


def _largest(samples: Floats, gaps: Floats, enough: np.ndarray[Any, np.dtype[np.bool_]]) -> dict[str, Any]:
    """Return the largest distance from the diagonal over bins with enough samples, its bin, and its bootstrap interval."""
    if not enough.any():
        return {"bin": None, "distance": NAN, "ci": [NAN, NAN]}
    rng, runs, drawn = np.random.default_rng(0), len(samples), []
    for _ in range(RESAMPLES):
        weights = np.bincount(rng.integers(runs, size=runs), minlength=runs).astype(np.float64)
        drawn.append(_distance(weights @ gaps, weights @ samples)[enough].max())
    distance = np.where(enough, _distance(gaps.sum(axis=0), samples.sum(axis=0)), -1.0)
    worst = int(np.argmax(distance))
    return {
        "bin": worst,
        "distance": float(distance[worst]),
        "ci": [float(v) for v in np.quantile(drawn, [0.025, 0.975])],
    }
