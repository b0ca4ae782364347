"""Compare the levels of a factor: tests between each two of them, in each cell of the other factors."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.statistics._differences import (
    CORRECTIONS,
    Correction,
    corrected,
    paired as paired_difference,
    rank_sum,
    signed_ranks,
    welch,
)
from bayesftc.cosim.statistics._intervals import check_level
from bayesftc.cosim.statistics._table import Names, cells, check_columns, names_of, numbers, where
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

NAN = float("nan")
COLUMNS = (
    "first",
    "second",
    "n_first",
    "n_second",
    "left_out",
    "mean_first",
    "mean_second",
    "difference",
    "low",
    "high",
    "effect",
    "statistic",
    "freedom",
    "p",
    "p_corrected",
)


def compare(
    table: pd.DataFrame,
    metric: str,
    factor: str,
    by: Names = None,
    *,
    paired: bool = True,
    test: Literal["t", "wilcoxon"] = "t",
    correction: Correction | None = None,
    against: Any = None,
    level: float = 0.95,
) -> pd.DataFrame:
    """Return the difference of a metric's means between each two levels of a factor, with a test.

    Parameters
    ----------
    table : DataFrame
        A row for each run, with a column ``seed`` if runs are paired.
    metric : str
        Column whose means are compared.
    factor : str
        Column whose levels are compared.
    by : str or sequence of str, optional
        Other factors: the levels are compared in each combination of their values (a cell). For paired runs, name all factors
        that vary.
    paired : bool
        True: runs of the same seed belong together, and their differences are tested. They have the same noise, so that a few
        runs show small differences. False: the samples are independent.
    test : str
        ``"t"``: the paired t-test, or Welch's test (1947) of means with unequal variances. ``"wilcoxon"``: the signed-rank test,
        or the rank-sum test (Mann and Whitney's U), which do not assume normal distributions; difference and interval are still
        those of the means.
    correction : str, optional
        ``"bonferroni"``, ``"holm"`` or ``"benjamini-hochberg"``: correction for the number of all tests in the result.
    against : object, optional
        A level: only pairs with it are compared, as the second level.
    level : float
        Probability that an interval contains the difference (each interval by itself, without correction).

    Returns
    -------
    DataFrame
        A row for each cell and pair, with NaN if there are too few runs, or no scatter. Its columns are

        - the columns of `by`; ``first``, ``second`` (levels); ``n_first``, ``n_second`` (runs);
        - ``left_out``: runs, or pairs of runs, with a metric that is not finite, such as failed runs;
        - ``mean_first``, ``mean_second``; ``difference`` (first minus second) with its interval ``low``, ``high``;
        - ``effect``: Cohen's d, the difference over the standard deviation (paired: of the differences, d_z; else the root of
          the mean of both variances); for "wilcoxon" the rank-biserial correlation, positive if the first is larger;
        - ``statistic``: t, the smaller sum of signed ranks, or U; ``freedom``: degrees of freedom of t;
        - ``p``, two-sided, and ``p_corrected``, the same as ``p`` without correction.

    Raises
    ------
    UnknownNameError
        If the table has no such column, or the factor no such level.
    ModelError
        If the factor has only one level, a choice is unknown, or runs cannot be paired because of different seeds, or several
        runs of a seed.

    Examples
    --------
    >>> import pandas as pd
    >>> from bayesftc.cosim import statistics
    >>> table = pd.DataFrame({"gain": [1, 1, 1, 2, 2, 2], "seed": [0, 1, 2] * 2, "rmse": [0.4, 0.5, 0.7, 0.5, 0.7, 0.8]})
    >>> statistics.compare(table, "rmse", "gain")[["first", "second", "difference", "low", "high", "p"]].round(4)
       first  second  difference     low    high       p
    0      1       2     -0.1333 -0.2768  0.0101  0.0572
    """
    import pandas as pd

    others = names_of(by)
    check_columns(table, (metric, factor, *others, *(["seed"] if paired else [])))
    check_level(level)
    if test not in ("t", "wilcoxon"):
        raise ModelError(f"compare has test={test!r}; it must be 't' or 'wilcoxon'.")
    if correction is not None and correction not in CORRECTIONS:
        raise ModelError(
            f"compare has correction={correction!r}; it must be None, {', '.join(map(repr, CORRECTIONS))}."
        )
    rows = []
    for cell, of in cells(table, others):
        levels = {each[factor]: rows for each, rows in cells(of, [factor])}
        for first, second in _pairs(levels, factor, against, cell):
            place = f"{factor} {first!r} and {second!r}{where(cell)}"
            a, b = levels[first], levels[second]
            x, y = _by_seed(a, b, metric, place) if paired else (numbers(a, metric), numbers(b, metric))
            rows.append({**cell, "first": first, "second": second, **_row(x, y, paired, test, level)})
    tests = pd.DataFrame(rows, columns=[*others, *COLUMNS])
    tests["p_corrected"] = corrected(tests["p"].to_numpy(dtype=np.float64), correction)
    return tests


def _pairs(levels: dict[Any, Any], factor: str, against: Any, cell: dict[str, Any]) -> list[tuple[Any, Any]]:
    if len(levels) < 2:
        raise ModelError(
            f"The factor {factor!r} has only {', '.join(map(repr, levels)) or 'no level'}{where(cell)}; compare needs two levels."
        )
    if against is None:
        return list(combinations(levels, 2))
    if against not in levels:
        raise UnknownNameError(
            f"The factor {factor!r} has no level {against!r}{where(cell)}; {did_you_mean(against, map(str, levels))}"
        )
    return [(each, against) for each in levels if each != against]


def _by_seed(a: pd.DataFrame, b: pd.DataFrame, metric: str, place: str) -> tuple[Floats, Floats]:
    """Return the metric of the runs of two levels, ordered so that runs of the same seed have the same place."""
    for rows in (a, b):
        twice = rows["seed"][rows["seed"].duplicated()]
        if len(twice):
            raise ModelError(
                f"Runs of {place} cannot be paired: several have the seed {twice.iloc[0]}. Name the other factors that vary in "
                "by=, or set paired=False."
            )
    a, b = a.sort_values("seed"), b.sort_values("seed")
    if not np.array_equal(a["seed"], b["seed"]):
        only = sorted(set(a["seed"]) ^ set(b["seed"]))
        raise ModelError(
            f"Runs of {place} cannot be paired: {len(only)} seeds have a run of only one of them (the first is {only[0]}). Run "
            "the campaign with the same seeds for both (the default, without independent=), or set paired=False."
        )
    return numbers(a, metric), numbers(b, metric)


def _row(x: Floats, y: Floats, paired: bool, test: str, level: float) -> dict[str, Any]:
    every = len(x) if paired else len(x) + len(y)
    if paired:
        valid = ~np.isnan(x) & ~np.isnan(y)
        x, y = x[valid], y[valid]
    else:
        x, y = x[~np.isnan(x)], y[~np.isnan(y)]
    row: dict[str, Any] = {
        "n_first": len(x),
        "n_second": len(y),
        "left_out": every - (len(x) if paired else len(x) + len(y)),
        "mean_first": float(x.mean()) if len(x) else NAN,
        "mean_second": float(y.mean()) if len(y) else NAN,
    }
    if min(len(x), len(y)) < 2:
        return {**row, **dict.fromkeys(COLUMNS[7:], NAN)}
    difference = paired_difference(x, y) if paired else welch(x, y)
    low, high = difference.interval(level)
    row |= {"difference": float(difference.mean), "low": low, "high": high, "p_corrected": NAN}
    if test == "wilcoxon":
        ranks = signed_ranks(x, y) if paired else rank_sum(x, y)
        return row | {"effect": ranks.effect, "statistic": ranks.statistic, "freedom": NAN, "p": ranks.p}
    scatter = (x - y).std(ddof=1) if paired else np.sqrt((x.var(ddof=1) + y.var(ddof=1)) / 2)
    constant = scatter <= 0.0
    return row | {
        "effect": NAN if constant else float(difference.mean / scatter),
        "statistic": NAN if constant else float(difference.mean / difference.error),
        "freedom": float(difference.freedom),
        "p": float(difference.p),
    }


__all__ = ["compare"]
