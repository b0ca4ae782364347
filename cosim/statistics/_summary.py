"""Means of metrics with confidence intervals, cell by cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.statistics._intervals import Method, bootstrap_interval, check_level, interval
from bayesftc.cosim.statistics._table import Names, cells, check_columns, names_of, numbers
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

NAN = float("nan")


def summary(
    table: pd.DataFrame,
    metric: Names,
    by: Names = None,
    *,
    level: float = 0.95,
    bootstrap: Method | None = None,
    resamples: int = 9_999,
    seed: int = 0,
) -> pd.DataFrame:
    """Return number, mean, standard deviation, confidence interval of the mean and median of metrics in each cell.

    Runs of a cell count as independent, which they are if each has a different seed. If a cell contains several points with the
    same seeds, name their factors in `by`.

    Parameters
    ----------
    table : DataFrame
        A row for each run.
    metric : str or sequence of str
        Columns to summarize.
    by : str or sequence of str, optional
        Factors: each combination of their values is a cell. Without factors, all runs are one cell.
    level : float
        Probability that an interval contains the mean.
    bootstrap : str, optional
        ``"BCa"``, ``"percentile"`` or ``"basic"``: the interval by the bootstrap (`scipy.stats.bootstrap`) instead of Student's
        t, for metrics that are far from a normal distribution. The time of BCa grows with the square of the number of runs.
    resamples, seed : int
        Number of samples and seed of the bootstrap.

    Returns
    -------
    DataFrame
        A row for each cell and metric: the columns of `by`, ``metric``, ``n``, ``left_out`` (runs with a metric that is NaN
        or infinite, such as failed runs; they count nowhere else), ``mean``, ``sd`` (with n - 1), ``low``, ``high``
        (the interval), ``median``. NaN if there are too few runs.

    Raises
    ------
    UnknownNameError
        If the table has no such column.
    ModelError
        If a metric is not a number, or level or method is wrong.

    Examples
    --------
    >>> import pandas as pd
    >>> from bayesftc.cosim import statistics
    >>> table = pd.DataFrame({"gain": [1, 1, 1, 2, 2, 2], "rmse": [0.4, 0.5, 0.6, 0.8, 1.0, None]})
    >>> statistics.summary(table, "rmse", "gain")[["gain", "n", "left_out", "mean"]]
       gain  n  left_out  mean
    0     1  3         0   0.5
    1     2  2         1   0.9
    """
    import pandas as pd

    metrics, factors = names_of(metric), names_of(by)
    check_columns(table, (*metrics, *factors))
    check_level(level)
    options = {"method": bootstrap, "resamples": resamples, "seed": seed}
    rows = [
        {**cell, "metric": name, **_row(numbers(of, name), level, options)}
        for name in metrics
        for cell, of in cells(table, factors)
    ]
    names = ("metric", "n", "left_out", "mean", "sd", "low", "high", "median")
    return pd.DataFrame(rows, columns=[*factors, *names])


def _row(values: Floats, level: float, options: dict[str, Any]) -> dict[str, Any]:
    finite = values[~np.isnan(values)]
    n, enough = len(finite), len(finite) > 1
    low, high = [NAN, NAN]
    if enough:
        low, high = (
            interval(finite, level) if options["method"] is None else bootstrap_interval(finite, level, **options)
        )
    return {
        "n": n,
        "left_out": len(values) - n,
        "mean": float(finite.mean()) if n else NAN,
        "sd": float(finite.std(ddof=1)) if enough else NAN,
        "low": low,
        "high": high,
        "median": float(np.median(finite)) if n else NAN,
    }


__all__ = ["summary"]
