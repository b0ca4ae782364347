"""Convert scores and truth of many runs, given as arrays of one shape or run by run, into one form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats


def by_run(
    what: str, score: ArrayLike | Sequence[ArrayLike], faulty: ArrayLike | Sequence[ArrayLike]
) -> list[tuple[Floats, Flags]]:
    """Return score and truth of each run, of shape (steps, sensors).

    Parameters
    ----------
    what : str
        Name of the scores in error messages.
    score : array_like of shape (runs, steps) or (runs, steps, sensors), or a sequence of a smaller array for each run
        The scores.
    faulty : array_like of bool, or a sequence of such
        The truth, of the same shapes.

    Raises
    ------
    ModelError
        If the shapes do not agree, or there is no run.
    """
    if len(score) != len(faulty):  # type: ignore[arg-type]
        raise ModelError(f"There are {len(score)} runs of {what} and {len(faulty)} of faulty; give one for each run.")  # type: ignore[arg-type]
    if not len(score):  # type: ignore[arg-type]
        raise ModelError(f"There is no run of {what}; give at least one.")
    runs: list[tuple[Floats, Flags]] = []
    for i, (run_score, run_faulty) in enumerate(zip(score, faulty, strict=True)):  # type: ignore[arg-type]
        try:
            values, truth = np.asarray(run_score, dtype=np.float64), np.asarray(run_faulty)
        except (TypeError, ValueError):
            raise ModelError(f"The {what} of run {i} is no array of numbers; give one.") from None
        if values.ndim not in (1, 2) or values.shape != truth.shape:
            raise ModelError(
                f"Run {i} has {what} of shape {values.shape} and faulty of shape {truth.shape}; both must be (steps,) or (steps, "
                "sensors). Give a single run as a list of one."
            )
        columns = (len(values), -1 if values.size else 1)
        if truth.dtype != np.bool_:  # a recorded signal: above one half if faulty, NaN after the failure of a run
            flags = np.asarray(truth, dtype=np.float64)
            values, truth = np.where(np.isnan(flags), np.nan, values), flags > 0.5
        runs.append((values.reshape(columns), np.asarray(truth.reshape(columns))))
    return runs


def pooled(runs: Sequence[tuple[Floats, Flags]]) -> tuple[Floats, Flags, Any]:
    """Return score, truth and run number of each sample with a score, of all runs together.

    Parameters
    ----------
    runs : sequence of (score, faulty)
        The result of `by_run`.
    """
    valid = [~np.isnan(score) for score, _ in runs]
    counts = [int(v.sum()) for v in valid]
    scores = np.concatenate([score[v] for (score, _), v in zip(runs, valid, strict=True)])
    truth = np.concatenate([faulty[v] for (_, faulty), v in zip(runs, valid, strict=True)])
    return scores, truth, np.repeat(np.arange(len(runs)), counts)


__all__ = ["by_run", "pooled"]
