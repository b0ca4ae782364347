"""The paper's merit: the number of scenarios in which one technique is better than another, by t-tests (section 5.2, table 2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.statistics._compare import compare
from bayesftc.cosim.statistics._differences import Correction, decided, outcomes
from bayesftc.cosim.statistics._table import Names, cells, names_of, where
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

Merits = dict[str, dict[str, int]]
"""Row -> column -> number of tests that the column won against the row, minus the number that it lost."""
TOTAL = "total merit"


def merit(
    table: pd.DataFrame,
    metric: str,
    factor: str,
    by: Names,
    *,
    better: Literal["lower", "higher"] = "lower",
    significance: float = 0.05,
    paired: bool = False,
    test: Literal["t", "wilcoxon"] = "t",
    correction: Correction | None = None,
) -> pd.DataFrame:
    """Return the merit table: the number of scenarios in which each technique is significantly better than each other one.

    Each two techniques are compared in each scenario by a two-sided Welch's t-test. In the paper's section 5.2 the metric is
    the root mean square of the tracking error, and the scenarios are faults x references.

    Parameters
    ----------
    table : DataFrame
        A row for each run.
    metric : str
        Column of the errors.
    factor : str
        Column of the techniques.
    by : str or sequence of str
        Factors whose combinations are the scenarios.
    better : str
        ``"lower"`` for an error, ``"higher"`` for an AUC, for example.
    significance : float
        Level of the tests.
    paired : bool
        Whether runs of the same seed belong together.
    test : {"t", "wilcoxon"}
        The test.
    correction : str, optional
        Correction for the number of tests. See `compare` for these three. The paper's are ``False``, ``"t"`` and ``None``. If
        all techniques have the same noise, Welch's test is too conservative (towards 0); ``paired=True`` finds more
        differences.

    Returns
    -------
    DataFrame
        A row and a column for each technique: the number of tests that the column won against the row, minus the number that
        it lost. The last row, ``"total merit"``, has the sums of the columns.

    Raises
    ------
    UnknownNameError
        If the table has no such column.
    ModelError
        As in `compare`; or if a technique has no run in a scenario, or less than two with a finite metric.

    Examples
    --------
    >>> import pandas as pd
    >>> from bayesftc.cosim import statistics
    >>> runs = {("freeze", "LQG"): [0.9, 1.0, 1.1], ("freeze", "SER"): [0.4, 0.5, 0.6], ("bias", "LQG"): [0.8, 0.9, 1.0]}
    >>> runs["bias", "SER"] = [0.3, 0.5, 0.4]
    >>> rows = [(fault, name, error) for (fault, name), errors in runs.items() for error in errors]
    >>> table = pd.DataFrame(rows, columns=["fault", "controller", "rmse"])
    >>> statistics.merit(table, "rmse", "controller", by="fault").loc["total merit"].to_dict()
    {'LQG': -2, 'SER': 2}
    """
    import pandas as pd

    if better not in ("lower", "higher"):
        raise ModelError(f"merit has better={better!r}; it must be 'lower' or 'higher'.")
    if not 0 < significance < 1:
        raise ModelError(f"merit has significance={significance!r}; it must be a probability between 0 and 1.")
    tests = compare(table, metric, factor, by, paired=paired, test=test, correction=correction)
    scenarios = names_of(by)
    _check_whole(table, factor, scenarios)
    _check_runs(tests, factor, scenarios)
    gain = tests["difference"].to_numpy() * (-1 if better == "lower" else 1)
    techniques = list(dict.fromkeys(table[factor]))
    place = {technique: i for i, technique in enumerate(techniques)}
    counts = np.zeros((len(techniques),) * 2, dtype=np.int64)
    signs = decided(gain, tests["p_corrected"].to_numpy(), significance)
    for first, second, sign in zip(tests["first"], tests["second"], signs, strict=True):
        counts[place[second], place[first]] += sign
        counts[place[first], place[second]] -= sign
    labels: list[Any] = [*techniques, TOTAL]
    return pd.DataFrame(
        np.vstack([counts, counts.sum(axis=0)]), index=pd.Index(labels, name=factor), columns=pd.Index(techniques)
    )


def _check_whole(table: pd.DataFrame, factor: str, by: Sequence[str]) -> None:
    techniques = set(table[factor])
    for cell, of in cells(table, by):
        if missing := sorted(techniques - set(of[factor]), key=str):
            raise ModelError(
                f"merit has no run of {factor} {missing[0]!r}{where(cell)}. Run it there as well, or remove this scenario or "
                "the technique from the table."
            )


def _check_runs(tests: pd.DataFrame, factor: str, by: Sequence[str]) -> None:
    few = tests[(tests["n_first"] < 2) | (tests["n_second"] < 2)]
    if len(few):
        row = few.iloc[0]
        technique, n = (row["first"], row["n_first"]) if row["n_first"] < 2 else (row["second"], row["n_second"])
        raise ModelError(
            f"merit has {n} runs of {factor} {technique!r}{where({name: row[name] for name in by})} whose metric is a number; it "
            "needs at least two. Run it with more seeds, or remove this scenario from the table."
        )


def merit_counts(errors: Sequence[Mapping[str, Floats]], techniques: Sequence[str], significance: float) -> Merits:
    """Return the merit table of arrays of errors, by Welch's t-tests; for a table of runs use `merit`.

    Parameters
    ----------
    errors : sequence of mapping
        For each scenario technique -> its errors, an ndarray of shape (runs,) with at least two runs.
    techniques : sequence of str
        The techniques to compare.
    significance : float
        Level of the two-sided tests.

    Returns
    -------
    dict of str to dict of str to int
        Row -> column -> the number of tests that the column won against the row, minus the number that it lost.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> freeze = {"LQG": np.array([0.9, 1.0, 1.1]), "SER": np.array([0.4, 0.5, 0.6])}
    >>> bias = {"LQG": np.array([0.8, 0.9, 1.0]), "SER": np.array([0.7, 0.9, 0.8])}
    >>> statistics.merit_counts([freeze, bias], ["LQG", "SER"], significance=0.05)
    {'LQG': {'LQG': 0, 'SER': 1}, 'SER': {'LQG': -1, 'SER': 0}}
    """
    pairs = [(row, column) for row, column in product(techniques, techniques) if row != column]
    ours, theirs = ([[e[pair[i]] for e in errors] for pair in pairs] for i in (1, 0))
    counts = dict(zip(pairs, outcomes(ours, theirs, significance).sum(axis=-1).tolist(), strict=True))
    return {row: {column: counts.get((row, column), 0) for column in techniques} for row in techniques}


def total_merit(table: Merits) -> dict[str, int]:
    """Return the sums of a table's columns.

    Parameters
    ----------
    table : dict
        The result of `merit_counts`.

    Returns
    -------
    dict of str to int
        The total merit of each technique.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import statistics
    >>> errors = {"LQG": np.array([0.9, 1.0, 1.1]), "SER": np.array([0.4, 0.5, 0.6]), "none": np.array([1.9, 2.0, 2.1])}
    >>> statistics.total_merit(statistics.merit_counts([errors], list(errors), significance=0.05))
    {'LQG': 0, 'SER': 2, 'none': -2}
    """
    return {column: sum(table[row][column] for row in table) for column in table}


__all__ = ["Merits", "merit", "merit_counts", "total_merit"]
