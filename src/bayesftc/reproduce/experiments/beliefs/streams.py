"""Fault probabilities on the detection experiment's streams, and modes learned from such streams without labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.judging.metrics import auc as area
from bayesftc.cosim.judging.probabilities import reliability
from bayesftc.cosim.statistics import interval
from bayesftc.reproduce.settings import Beliefs
from bayesftc.reproduce.shared.car import model
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.streams import Faults, Streams

PROBABILITY = "controller.fault_probability"
MEASURES = ("auc", "ece", "brier")
"""The measures of a stream: AUC, expected calibration error, Brier score."""
DEFAULTS, LEARNED, TOLD = "defaults", "learned", "told the times"
"""Rows: the initial settings of learning, the learned settings, and settings with the streams' mean times."""

Learners = Mapping[str, controllers.SwitchingPrecision]
"""Learners by name."""
Scores = dict[str, dict[str, Any]]
"""Scores by row and size of the faults."""


def sizes_of(settings: Beliefs) -> dict[str, Faults]:
    """Return the sizes of the faults by their names."""
    return {f"injection {i:g}, drift {d:g}": Faults(i, d) for i, d in settings.sizes}


def score(
    source: Streams, ensemble: Ensemble, settings: Beliefs, forms: Mapping[str, Mapping[str, Learners]]
) -> dict[str, Scores]:
    """Return mean and interval of each measure by form, row and size of the faults.

    `forms` has the learners by form, row and size.
    """
    sizes = sizes_of(settings)
    seeds = {size: ensemble.seeds(f"beliefs/{size}", settings.streams) for size in sizes}
    batches = {
        (form, row, size): Batch(source.loop(sizes[size], learners[size]), seeds[size], partial(_judged, source))
        for form, rows in forms.items()
        for (row, learners), size in product(rows.items(), sizes)
    }
    every, _ = ensemble.each("Streams", batches, 1)
    table: dict[str, Scores] = {form: {row: {} for row in rows} for form, rows in forms.items()}
    for (form, row, size), streams in every.items():
        columns = np.array([judged for few in streams for judged in few]).T
        table[form][row][size] = {
            name: {"mean": float(v.mean()), "ci": interval(v)} for name, v in zip(MEASURES, columns, strict=True)
        }
    return table


def _judged(source: Streams, loop: cosim.Diagram, seeds: Sequence[int]) -> list[tuple[float, ...]]:
    """Return the measures of the fault probabilities of each stream."""
    found: list[tuple[float, ...]] = []
    rows = slice(source.settings.skipped, None)
    for stream in source.run(loop, seeds, [PROBABILITY]):
        probability, faulty = stream.result[PROBABILITY][rows], stream.faulty[rows]
        honest = reliability(probability, faulty, bins=source.settings.bins)
        found.append((area(faulty, probability), honest.calibration_error, honest.brier))
    return found


def learn(
    source: Streams, ensemble: Ensemble, settings: Beliefs, starts: Learners
) -> dict[str, dict[str, controllers.LearnedModes]]:
    """Return the modes that each form learns for each size of the faults, from streams with separate seeds.

    The settings of `starts` are the initial settings of learning and the learner's settings in the recorded streams.
    """
    sizes = sizes_of(settings)
    seeds = {size: ensemble.seeds(f"beliefs/training/{size}", settings.training_streams) for size in sizes}
    batches = {
        (form, size): Batch(source.loop(sizes[size], starts[form]), seeds[size], partial(_recorded, source))
        for form, size in product(starts, sizes)
    }
    every, _ = ensemble.each("Recording", batches, 1)
    learned: dict[str, dict[str, controllers.LearnedModes]] = {form: {} for form in starts}
    # Without threads, which do not make it faster: learning steps through the samples in Python.
    for done, ((form, size), runs) in enumerate(every.items()):
        ensemble.tell("Learning", done, len(every))
        recordings = [run for few in runs for run in few]
        learned[form][size] = controllers.learn_modes(recordings, model(source.car), starts[form])
    return learned


def _recorded(source: Streams, loop: cosim.Diagram, seeds: Sequence[int]) -> list[controllers.RecordedRun]:
    """Return samples and controls of each stream."""
    samples, control = f"fault_{source.car.sensors - 1}.y", "controller.u"
    belief = {"initial_mean": source.settings.offset, "initial_covariance": source.car.initial_variance}
    return [
        controllers.RecordedRun(s.result[samples], s.result[control], **belief)
        for s in source.run(loop, seeds, [samples, control])
    ]


def account(learned: controllers.LearnedModes) -> dict[str, Any]:
    """Return the report of one learning: its iterations, and the settings of the learned modes."""
    modes = [
        {"mode": type(mode).__name__, **asdict(mode), "onsets": onsets}  # type: ignore[call-overload]
        for mode, onsets in zip(learned.precision.modes, learned.onsets, strict=True)
    ]
    return {
        "iterations": len(learned.log_likelihood),
        "settled": learned.settled,
        "log_likelihood": list(learned.log_likelihood),
        "modes": modes,
    }
