"""The paper's merit: in how many scenarios one technique tracks better than another, by Welch's t-tests (table 2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import ttest_ind

from bayesftc.cosim.block import Floats

Table = dict[str, dict[str, int]]
"""Row -> column -> tests that the column won against the row, minus those that it lost."""


def outcomes(ours: ArrayLike, theirs: ArrayLike, significance: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return 1 where our mean error is significantly smaller, -1 where it is significantly larger, else 0.

    Welch's test takes both samples for independent. Ours share their noise run by run, which makes the difference of the
    means more certain than the test believes: it errs towards 0.

    Parameters
    ----------
    ours, theirs : array_like, ... x runs
        Errors of each run.
    significance : float
        Level of the two-sided tests.
    """
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    p = ttest_ind(ours, theirs, axis=-1, equal_var=False).pvalue
    decided = p < significance  # not where neither varies, and p is NaN
    return np.where(decided, np.sign(theirs.mean(axis=-1) - ours.mean(axis=-1)), 0).astype(np.int64)


def merit(errors: Sequence[Mapping[str, Floats]], techniques: Sequence[str], significance: float) -> Table:
    """Count the outcomes over scenarios.

    Parameters
    ----------
    errors : sequence of mapping
        For each scenario the errors of each technique, one for each run.
    techniques : sequence of str
        Which techniques are compared.
    significance : float
        Level of the two-sided tests.
    """
    pairs = [(row, column) for row, column in product(techniques, techniques) if row != column]
    ours, theirs = ([[e[pair[i]] for e in errors] for pair in pairs] for i in (1, 0))
    counts = dict(zip(pairs, outcomes(ours, theirs, significance).sum(axis=-1).tolist(), strict=True))
    return {row: {column: counts.get((row, column), 0) for column in techniques} for row in techniques}


def total(table: Table) -> dict[str, int]:
    """Return the sums of a table's columns."""
    return {column: sum(table[row][column] for row in table) for column in table}
