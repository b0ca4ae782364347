"""The streams of the detection experiment: a car whose sensors repeatedly fail at random and recover."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.run.repeat import repeat
from bayesftc.reproduce.settings import Car, Detection
from bayesftc.reproduce.shared.car import closed_loop

HEADLINE = "fast"
KINDS = ("freeze", "injection", "drift")
"""The kinds of faults by their numbers."""
NEVER = 1e12
"""Seconds until the first fault of a stream without any."""


@dataclass(frozen=True)
class Faults:
    """The sizes of the faults, in m/s and m/s per second, and the reference."""

    injection: float
    drift: float
    reference: str = HEADLINE


class Stream(NamedTuple):
    """A run and its ground truth: the number of the kind of fault for each step (rows) and sensor (columns), -1 for none."""

    result: cosim.Result
    kind: np.ndarray[Any, np.dtype[np.float64]]

    @property
    def faulty(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether there is a fault."""
        return self.kind >= 0


@dataclass(frozen=True)
class Streams:
    """Makes streams: closed loops with random faults, and their runs."""

    settings: Detection
    car: Car

    def loop(self, faults: Faults | None, learner: controllers.PrecisionLearner) -> cosim.Diagram:
        """Return the loop with a learner; with None there are no faults, on the headline's reference."""
        s = self.settings
        sizes = faults or Faults(s.injection, s.drift)
        kinds = (cosim.Freeze(), cosim.Injection(magnitude=sizes.injection), cosim.Drift(slope=sizes.drift))
        chain = [
            cosim.RandomFaults(
                kinds=kinds,
                sensor=i,
                start=NEVER if faults is None else 0.0,
                mean_time_to_fault=s.mean_time_to_fault,
                mean_time_to_recovery=s.mean_time_to_recovery,
                name=f"fault_{i}",
            )
            for i in range(self.car.sensors)
        ]
        reference: cosim.Source = cosim.Constant(s.offset)
        if sizes.reference != "constant":
            amplitude, period = getattr(s, sizes.reference)
            reference = cosim.Sine(amplitude, period, offset=s.offset)
        return closed_loop(self.car, learner, chain, reference, s.offset)

    def run(self, loop: cosim.Diagram, seeds: Sequence[int], signals: Iterable[str]) -> Iterator[Stream]:
        """Yield a stream with the named signals for each seed."""
        kinds = [f"fault_{i}.kind" for i in range(self.car.sensors)]
        for result in repeat(loop, self.settings.steps * self.car.step, seeds, [*signals, *kinds]):
            yield Stream(result, np.column_stack([result[name] for name in kinds]))
