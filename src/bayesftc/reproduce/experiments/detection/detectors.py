"""The residuals of the detection experiment as detectors with thresholds: delays, missed faults and false alarms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from operator import add
from typing import Any, TypeVar

from bayesftc import cosim
from bayesftc.cosim.judging.alarms import Alarms, alarm_threshold, judge_alarms
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import SIGNALS, Residual
from bayesftc.reproduce.shared.streams import KINDS, Faults, Stream, Streams

R = TypeVar("R")
GROUP = 4
"""Streams of one task."""
EVEN = "probability .5"
"""The threshold at fault probability .5, for residuals that are log odds of a fault probability."""


@dataclass(frozen=True)
class Detectors:
    """Evaluation of residuals with one feature by their alarms."""

    streams: Streams
    ensemble: Ensemble  # seed, threads and progress
    residuals: Mapping[str, Residual]  # by name; one with several features has no threshold and is left out

    def report(self, headline: Faults) -> dict[str, Any]:
        """Return thresholds, their false alarms on other fault-free streams, and delays and misses by kind and size of fault.

        The sizes are the headline's and then those of the settings.
        """
        s = self.streams.settings
        thresholds = self.thresholds()
        healthy = self._alarms("False alarms", None, "detection/fault-free", s.healthy_streams, thresholds)
        cells = [headline, *(Faults(injection, drift) for injection, drift in s.alarm_sizes)]
        found = [
            self._alarms("Delays", c, f"detection/alarms/{i}", s.alarm_streams, thresholds) for i, c in enumerate(cells)
        ]
        return {
            "fault_free": {
                name: {rule: {"threshold": level, **_rates(healthy[name][rule]["all"])} for rule, level in mine.items()}
                for name, mine in thresholds.items()
            },
            "cells": [
                {
                    **asdict(cell),
                    "residuals": {
                        name: {rule: {kind: a.to_dict() for kind, a in kinds.items()} for rule, kinds in mine.items()}
                        for name, mine in of.items()
                    },
                }
                for cell, of in zip(cells, found, strict=True)
            ],
        }

    def thresholds(self) -> dict[str, dict[str, float]]:
        """Return for each residual its thresholds by rule, determined on separate fault-free streams."""
        s = self.streams.settings
        scores = self._scores("Thresholds", None, "detection/thresholds", s.healthy_streams, lambda _, score, __: score)
        step = self.streams.car.step
        found = {
            name: {rule_of(rate): alarm_threshold(mine, step=step, per_hour=rate) for rate in s.false_alarm_rates}
            for name, mine in scores
        }
        for name, mine in found.items():
            if self.residuals[name].probability is not None:
                mine[EVEN] = 0.0
        return found

    def _alarms(
        self, what: str, faults: Faults | None, purpose: str, count: int, thresholds: Mapping[str, Mapping[str, float]]
    ) -> dict[str, dict[str, dict[str, Alarms]]]:
        """Return the alarms of each residual by rule and by kind of fault, including ``all``."""

        def judge(name: str, score: Floats, stream: Stream) -> dict[str, dict[str, Alarms]]:
            kind, step = stream.kind[self.streams.settings.skipped :], self.streams.car.step
            masks = {"all": kind >= 0, **({} if faults is None else {k: kind == i for i, k in enumerate(KINDS)})}
            return {
                rule: {
                    k: judge_alarms(score, mask, threshold=level, step=step, left_out=(kind >= 0) & ~mask)
                    for k, mask in masks.items()
                }
                for rule, level in thresholds[name].items()
            }

        return {
            name: {
                rule: {k: reduce(add, [part[rule][k] for part in parts]) for k in kinds}
                for rule, kinds in parts[0].items()
            }
            for name, parts in self._scores(what, faults, purpose, count, judge)
        }

    def _scores(
        self, what: str, faults: Faults | None, purpose: str, count: int, function: Callable[[str, Floats, Stream], R]
    ) -> list[tuple[str, list[R]]]:
        """Return for each residual the results of a function of its name, its scores and the stream, one per stream."""
        seeds = self.ensemble.seeds(purpose, count)
        learners = dict.fromkeys(r.learners for r in self.residuals.values() if len(r.columns) == 1)
        found: dict[str, list[R]] = {}
        for learner in learners:
            names = [name for name, r in self.residuals.items() if r.learners == learner]

            def each(loop: cosim.Diagram, few: Sequence[int], names: list[str] = names) -> list[list[R]]:
                return [
                    [function(name, self._score(name, stream), stream) for name in names]
                    for stream in self.streams.run(loop, few, SIGNALS)
                ]

            groups = self.ensemble.one(what, Batch(self.streams.loop(faults, learner[0]), seeds, each), GROUP)
            streams = [stream for group in groups for stream in group]
            found |= {name: [of[i] for of in streams] for i, name in enumerate(names)}
        return [(name, found[name]) for name in self.residuals if name in found]

    def _score(self, name: str, stream: Stream) -> Floats:
        return self.residuals[name].features([stream])[self.streams.settings.skipped :, :, 0]


def rule_of(rate: float) -> str:
    """Return the name of the threshold for a rate of false alarms."""
    return f"{rate:g} per hour"


def _rates(alarms: Alarms) -> dict[str, Any]:
    """Return the figures that exist without faults."""
    all_figures = alarms.to_dict()
    return {n: all_figures[n] for n in all_figures if not n.startswith(("fault", "missed", "delay"))} | {
        "fault_free_hours": alarms.hours
    }
