"""The influence of factors on a metric: first-order and total Sobol indices, from a campaign with a `SaltelliDesign`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.designs.samples import SaltelliDesign
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.statistics._intervals import check_level
from bayesftc.cosim.statistics._table import Names, cells, check_columns, names_of, numbers, where
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    "factor",
    "other",
    "first",
    "first_low",
    "first_high",
    "total",
    "total_low",
    "total_high",
    "second",
    "second_low",
    "second_high",
    "n",
    "left_out",
)


def sensitivity(
    table: pd.DataFrame,
    metric: str,
    design: SaltelliDesign,
    by: Names = None,
    *,
    level: float = 0.95,
    resamples: int = 1_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the share of each factor in the variance of a metric: first-order and total Sobol indices.

    The first-order index is the share of the variance that vanishes if the factor is fixed. The total index is the share that
    remains if all other factors are fixed. A factor with a total index near zero has no influence. A total index above the
    first-order index means interactions.

    The metric at a point is its mean over the point's runs. If all points have the same seeds (the default), their noise adds
    little to the variance. By SALib (`SALib.analyze.sobol`, Saltelli et al. 2010), with intervals by its bootstrap over base
    points.

    Parameters
    ----------
    table : DataFrame
        A row for each run, with the columns ``point`` and those of the factors of the design.
    metric : str
        Column whose variance is divided.
    design : SaltelliDesign
        The design of the campaign, by itself or multiplied by others.
    by : str or sequence of str, optional
        Factors of the other designs: there are separate indices for each combination of their values.
    level : float
        Probability that an interval contains the index.
    resamples, seed : int
        Number of samples and seed of the bootstrap.

    Returns
    -------
    DataFrame
        A row for each cell and factor: the columns of `by`, ``factor``, ``first``, ``first_low``, ``first_high``, ``total``,
        ``total_low``, ``total_high``; ``n``: base points that count; ``left_out``: base points that do not count, because no
        run at one of their points has a finite metric. Estimates may be slightly below 0 or above 1. NaN if the metric does not
        vary. With ``second_order=True`` in the design there is also a row for each pair of factors, with ``other`` and its
        index ``second``, ``second_low``, ``second_high``.

    Raises
    ------
    UnknownNameError
        If the table has no such column.
    ModelError
        If the table's points are not those of the design, or less than two base points are left.
    BayesFTCError
        If SALib is not installed.

    Examples
    --------
    >>> import pandas as pd
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import statistics
    >>> design = cosim.SaltelliDesign({"a": (0.0, 1.0), "b": (0.0, 1.0)}, count=256)
    >>> table = pd.DataFrame(design.points()).assign(point=range(len(design)))
    >>> table["metric"] = 3.0 * table["a"] + table["b"]  # variances 9 : 1
    >>> statistics.sensitivity(table, "metric", design)[["factor", "first", "total"]].round(1)
      factor  first  total
    0      a    0.9    0.9
    1      b    0.1    0.1
    """
    import pandas as pd

    if not isinstance(design, SaltelliDesign):
        raise ModelError(f"sensitivity has design={brief(design)}; give the SaltelliDesign of the campaign.")
    check_level(level)
    others = names_of(by)
    check_columns(table, (metric, "point", *design.factors, *others))
    analyze = extra("SALib.analyze.sobol", "sensitivity").analyze
    rows = []
    for cell, of in cells(table, others):
        values = _at_points(of, metric, design, cell)
        whole: Any = np.isfinite(values).all(axis=1)
        n = int(whole.sum())
        if n < 2:
            raise ModelError(
                f"sensitivity has {n} base points{where(cell)} at which {metric!r} is known; it needs at least two."
            )
        counts = {"n": n, "left_out": len(whole) - n}
        indices = _indices(analyze, values[whole].ravel(), design, level, resamples, seed)
        rows += [{**cell, **row, **counts} for row in indices]
    names = [name for name in COLUMNS if design.second_order or name not in COLUMNS[1:2] + COLUMNS[8:11]]
    return pd.DataFrame(rows, columns=[*others, *names])


def _at_points(table: pd.DataFrame, metric: str, design: SaltelliDesign, cell: dict[str, Any]) -> Floats:
    """Return the mean of the metric at each point, a row for each base point."""
    runs = table[["point", *design.factors]].assign(value=numbers(table, metric)).groupby("point", sort=True)
    settings, points = runs[list(design.factors)].first().to_numpy(dtype=np.float64), design.points()
    if len(settings) != len(points):
        raise ModelError(
            f"The table has {len(settings)} points{where(cell)} and the design {len(points)}; give the table of the whole "
            "campaign, and name in by= the factors that the design was multiplied by."
        )
    for name, column in zip(design.factors, settings.T, strict=True):
        if not np.allclose(column, [point[name] for point in points], rtol=1e-12, atol=0.0):
            raise ModelError(
                f"The factor {name!r} has other values in the table than in the design{where(cell)}; give the design of the "
                "campaign, with its seed and ranges."
            )
    return np.asarray(runs["value"].mean().to_numpy()).reshape(design.count, design.block)


def _indices(
    analyze: Any, values: Floats, design: SaltelliDesign, level: float, resamples: int, seed: int
) -> list[dict[str, Any]]:
    """Return a row for each factor, and for each pair of them."""
    names = design.factors
    if np.ptp(values) == 0:  # without variance there are no indices
        return [{"factor": name} for name in names]
    indices = analyze(
        design.problem(),
        values,
        calc_second_order=design.second_order,
        num_resamples=resamples,
        conf_level=level,
        seed=np.random.default_rng(seed),
    )
    rows = [
        {
            "factor": name,
            **_bounds("first", indices["S1"][i], indices["S1_conf"][i]),
            **_bounds("total", indices["ST"][i], indices["ST_conf"][i]),
        }
        for i, name in enumerate(names)
    ]
    if design.second_order:
        rows += [
            {"factor": names[i], "other": names[j], **_bounds("second", indices["S2"][i, j], indices["S2_conf"][i, j])}
            for i in range(len(names))
            for j in range(i + 1, len(names))
        ]
    return rows


def _bounds(name: str, value: float, half: float) -> dict[str, float]:
    return {name: float(value), f"{name}_low": float(value - half), f"{name}_high": float(value + half)}


__all__ = ["sensitivity"]
