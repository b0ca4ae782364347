"""Stretches in which an input has no sample, so that its last value is held for longer than usual."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import datetime
from typing import NamedTuple

import numpy as np

from bayesftc.cosim.base.recordings.dates import span_text
from bayesftc.cosim.base.recordings.intervals import typical_interval
from bayesftc.cosim.types import Floats

LONG = 10.0
"""Least length of a silence, in typical intervals: over fewer, an input that keeps its value hardly matters."""

NEAR = 2.5
"""Multiple of the typical interval up to which an interval is about a typical one."""

REGULAR = 0.9
"""Least share of such intervals. An input that is logged when it changes has fewer: its silence says that it is constant."""

FEWEST = 20
"""Least number of intervals that show whether they are regular."""


class Silence(NamedTuple):
    """An input without a sample, from its last one before to the next one, in seconds."""

    name: str
    start: float
    end: float


def silences(inputs: Iterable[tuple[str, Floats]], sampled: Floats, end: float) -> tuple[Silence, ...]:
    """Return the silences of inputs that have samples at regular times, if a sensor has one in them.

    Parameters
    ----------
    inputs : iterable of (str, ndarray)
        Name and times of the samples of each input.
    sampled : ndarray
        The times at which any sensor has a sample.
    end : float
        The end of the recording.
    """
    found = []
    for name, time in inputs:
        intervals, typical = np.diff(time), typical_interval(time)
        if len(intervals) < FEWEST or np.mean(intervals <= NEAR * typical) < REGULAR:
            continue
        ends = np.append(time[1:], end)
        found += [Silence(name, float(time[k]), float(ends[k])) for k in np.flatnonzero(ends - time > LONG * typical)]
    return tuple(each for each in found if ((sampled > each.start) & (sampled < each.end)).any())


def held_notes(
    found: Sequence[Silence], matters: Callable[[Silence], bool], origin: datetime | None = None
) -> Iterator[str]:
    """Give a note for each input on its longest silence that matters."""
    for name in dict.fromkeys(silence.name for silence in found):
        own = [silence for silence in found if silence.name == name and matters(silence)]
        if own:
            longest = max(own, key=lambda silence: silence.end - silence.start)
            others = len(own) - 1
            more = f", and in {others} shorter time{'s' * (others > 1)}" if others else ""
            yield (
                f"The input {name} has no sample from {span_text(longest.start, longest.end, origin)}{more}; its last value is "
                "held. What looks like a fault of a sensor in this time may come from that."
            )


__all__ = ["Silence", "held_notes", "silences"]
