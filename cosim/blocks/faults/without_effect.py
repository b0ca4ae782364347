"""Sentences on settings without effect: a mistake, or a short run of a long scenario. So they are no errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from fractions import Fraction
from itertools import count
from math import floor
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.base.warnings_shown import warn_user

_noted: ContextVar[bool] = ContextVar("noted", default=False)


@contextmanager
def noted_elsewhere() -> Iterator[None]:
    """Give no warnings in this context: a command notes the same, with the place in its file."""
    token = _noted.set(True)
    try:
        yield
    finally:
        _noted.reset(token)


def warn_without_effect(sentences: Iterable[str]) -> None:
    """Give each sentence as a warning, except where it is noted elsewhere."""
    if not _noted.get():
        for sentence in sentences:
            warn_user(sentence)


def late_faults(starts: Mapping[str, Iterable[object]], end: Fraction) -> Iterator[str]:
    """Yield a sentence for each fault whose earliest start is not before the end of the run.

    Parameters
    ----------
    starts : mapping of str to iterable
        The possible starts of each fault: seconds, or something else for a condition, which may be fulfilled at once.
    end : Fraction
        Seconds of the run.
    """
    for fault, given in starts.items():
        first = min(start if isinstance(start, Real) else 0.0 for start in given)
        if first >= end:
            yield f"{fault} starts at {first:g} s, but the run ends at {show(end)} s. The fault has no effect."


def short_faults(times: Mapping[str, tuple[float, float]], step: Fraction) -> Iterator[str]:
    """Yield a sentence for each fault between two steps.

    Parameters
    ----------
    times : mapping of str to (float, float)
        Start and stop of each fault in seconds; the stop may be infinite.
    step : Fraction
        The base step in seconds.
    """
    for fault, (start, stop) in times.items():
        k = max(floor(start / step) - 1, 0)
        if next(t for i in count(k) if (t := float(i * step)) >= start) >= stop:
            yield (
                f"{fault} lasts from {start:g} s to {stop:g} s, between two steps of {show(step)} s. The fault has no effect."
            )


def unread_variables(name: str, matrix: ArrayLike | None, measured: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each sensor that measures nothing, and for each variable that no sensor measures.

    Parameters
    ----------
    name : str
        The name of the sensors' matrix in the sentences.
    matrix : array of shape (sensors, variables) or None
        The matrix; None if each sensor measures one variable.
    measured : sequence of str
        The names of the variables, if each is a number.
    """
    if matrix is None:
        return
    matrix = np.asarray(matrix)
    for i in np.flatnonzero(~matrix.any(axis=1)):
        yield f"{name} has a row of zeros, so sensor {i} measures nothing of the plant."
    if len(measured) == matrix.shape[1]:
        for j in np.flatnonzero(~matrix.any(axis=0)):
            yield f"{name} has a column of zeros, so no sensor measures {measured[int(j)]!r}."


def unread_sensors(name: str, C: ArrayLike) -> Iterator[str]:
    """Yield a sentence for each sensor that a measurement matrix leaves out."""
    for i in np.flatnonzero(~np.asarray(C).any(axis=1)):
        yield f"{name} has a row of zeros, so the controller does not use sensor {i}."


def unconnected(name: str, remedy: str) -> str:
    """Return the sentence for a block that reads no signal, and that nothing reads."""
    return f"{name} is connected to nothing. It has no effect. {remedy}, or leave it out."


__all__ = [
    "late_faults",
    "noted_elsewhere",
    "unconnected",
    "unread_sensors",
    "unread_variables",
    "warn_without_effect",
]
