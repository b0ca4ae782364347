"""Which factor drives a metric? First-order and total Sobol indices, of a campaign on a `SaltelliDesign`."""

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
    "factor", "other", "first", "first_low", "first_high", "total", "total_low", "total_high", "second", "second_low",
    "second_high", "n", "left_out",
)  # fmt: skip


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
    """Return the share that each factor has in the variance of a metric: first-order and total Sobol indices.

    The first-order index is the share of the variance that would go if the factor alone were known; the total index the share
    that would stay if all others were known. A factor with a total index near zero can be left as it is; a total index above the
    first-order one tells of interactions. The metric at a point is its mean over the point's runs; where all points have the same
    seeds (the default), their noise hardly adds to the variance. By SALib (`SALib.analyze.sobol`, Saltelli et al. 2010), with
    intervals by its bootstrap over base points.

    Parameters
    ----------
    table : DataFrame
        A row for each run, with the columns ``point`` and those of the factors of the design.
    metric : str
        Column whose variance is shared out.
    design : SaltelliDesign
        The design that the campaign has run, by itself or multiplied by others.
    by : str or sequence of str, optional
        Factors of the other designs: each combination of their values has indices of its own.
    level : float
        Probability that an interval covers an index.
    resamples, seed : int
        Of the bootstrap: how many samples are drawn, and with which random numbers.

    Returns
    -------
    DataFrame
        A row for each cell and factor: the columns of `by`, ``factor``, ``first``, ``first_low``, ``first_high``, ``total``,
        ``total_low``, ``total_high``; ``n``: base points that count; ``left_out``: base points that do not, since at one of the
        points that belong to them no run has a finite metric. Estimates may lie a little below 0 or above 1. NaN where the metric
        does not vary. With ``second_order=True`` in the design also a row for each pair of factors, with ``other`` and its
        index ``second``, ``second_low``, ``second_high``.

    Raises
    ------
    UnknownNameError
        If the table has no such column.
    ModelError
        If the table's points are not those of the design, or less than two base points are left.
    BayesFTCError
        If SALib is not installed.
    """
    import pandas as pd

    if not isinstance(design, SaltelliDesign):
        raise ModelError(
            f"sensitivity has design={brief(design)}; it takes the SaltelliDesign that the campaign has run."
        )
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
                f"sensitivity has {n} base points{where(cell)} at which {metric!r} is known; it takes at least two."
            )
        counted = {"n": n, "left_out": len(whole) - n}
        found = _indices(analyze, values[whole].ravel(), design, level, resamples, seed)
        rows += [{**cell, **row, **counted} for row in found]
    names = [name for name in COLUMNS if design.second_order or name not in COLUMNS[1:2] + COLUMNS[8:11]]
    return pd.DataFrame(rows, columns=[*others, *names])


def _at_points(table: pd.DataFrame, metric: str, design: SaltelliDesign, cell: dict[str, Any]) -> Floats:
    """Return the mean of the metric at each point, a row for each base point."""
    runs = table[["point", *design.factors]].assign(value=numbers(table, metric)).groupby("point", sort=True)
    settings, wanted = runs[list(design.factors)].first().to_numpy(dtype=np.float64), design.points()
    if len(settings) != len(wanted):
        raise ModelError(
            f"The table has {len(settings)} points{where(cell)} and the design {len(wanted)}; give the table of the whole "
            "campaign, and name in by= the factors that the design was multiplied by."
        )
    for name, column in zip(design.factors, settings.T, strict=True):
        if not np.allclose(column, [point[name] for point in wanted], rtol=1e-12, atol=0.0):
            raise ModelError(
                f"The factor {name!r} has other values in the table than in the design{where(cell)}; give the design that the "
                "campaign has run, with its seed and ranges."
            )
    return np.asarray(runs["value"].mean().to_numpy()).reshape(design.count, design.block)


def _indices(
    analyze: Any, values: Floats, design: SaltelliDesign, level: float, resamples: int, seed: int
) -> list[dict[str, Any]]:
    """Return a row for each factor, and for each pair of them."""
    names = design.factors
    if np.ptp(values) == 0:  # without any variance there are no shares in it
        return [{"factor": name} for name in names]
    found = analyze(
        design.problem(),
        values,
        calc_second_order=design.second_order,
        num_resamples=resamples,
        conf_level=level,
        seed=np.random.default_rng(seed),
    )
    rows = [
        {"factor": name, **_bounds("first", found["S1"][i], found["S1_conf"][i]),
         **_bounds("total", found["ST"][i], found["ST_conf"][i])}
        for i, name in enumerate(names)
    ]  # fmt: skip
    if design.second_order:
        rows += [
            {"factor": names[i], "other": names[j], **_bounds("second", found["S2"][i, j], found["S2_conf"][i, j])}
            for i in range(len(names))
            for j in range(i + 1, len(names))
        ]
    return rows


def _bounds(name: str, value: float, half: float) -> dict[str, float]:
    return {name: float(value), f"{name}_low": float(value - half), f"{name}_high": float(value + half)}


__all__ = ["sensitivity"]
