"""Differences between levels of the compared factor over all points, paired by run where the seeds are the same."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.report.pooling import Estimate, apart, pooled

if TYPE_CHECKING:
    import pandas as pd

    from bayesftc.report.contents import Contents

MOST_COMPARED = 12
"""Largest number of levels for which all pairs are compared."""
SURE = 0.95


@dataclass(frozen=True)
class Pair:
    """Two levels, and the difference of their means over their common points."""

    first: Any
    second: Any
    difference: Estimate  # first minus second
    paired: bool  # whether runs of the same seed were compared
    points: int  # number of combinations of the other factors with runs of both
    pairs: int  # number of pairs of levels: intervals and p hold for all of them together (Bonferroni)

    @property
    def half(self) -> float:
        """Half of the interval that holds for all pairs together."""
        return self.difference.half(1.0 - (1.0 - SURE) / self.pairs)

    @property
    def p(self) -> float:
        """The p-value of the difference, corrected for the number of pairs."""
        p = self.difference.p
        return min(1.0, p * self.pairs) if p == p else p

    @property
    def certain(self) -> bool:
        """Whether zero is outside the interval."""
        return abs(self.difference.value) > self.half


def compared_levels(contents: Contents) -> list[Pair]:
    """Return all pairs of levels; with very many levels only the two with the lowest means."""
    assert contents.metric is not None
    order = contents.levels()
    every = len(order) * (len(order) - 1) // 2
    if len(order) > MOST_COMPARED:
        order = [level for level, _ in ranked(contents)][:2]
    return [pair(contents, a, b, every) for a, b in combinations(order, 2)]


def ranked(contents: Contents) -> list[tuple[Any, Estimate]]:
    """Return the levels that have a value of the metric, with their means, from the lowest to the highest."""
    means = [(level, estimate(contents, contents.runs_of(level))) for level in contents.levels()]
    return sorted((each for each in means if each[1].runs), key=lambda each: each[1].value)


def estimate(contents: Contents, runs: pd.DataFrame, metric: str | None = None) -> Estimate:
    """Return the mean of a metric over some runs."""
    values = runs[metric or contents.metric].to_numpy(dtype=np.float64)
    points = runs["point"].to_numpy()
    return pooled(values, points, runs["seed"].to_numpy(), contents.seed_lists[points])


def pair(contents: Contents, first: Any, second: Any, pairs: int = 1) -> Pair:
    """Return the comparison of two levels."""
    a, b = (_values_of(contents, level) for level in (first, second))
    common = np.intersect1d(a["combination"], b["combination"])
    a, b = (runs[runs["combination"].isin(common)] for runs in (a, b))
    both = a.merge(b, on=["combination", "seed"], suffixes=("", "_other"))
    if len(both):
        values = (both["value"] - both["value_other"]).to_numpy()
        lists = contents.seed_lists[both["point"].to_numpy()]
        difference = pooled(values, both["combination"].to_numpy(), both["seed"].to_numpy(), lists)
        return Pair(first, second, difference, True, int(both["combination"].nunique()), pairs)
    means = [
        pooled(r["value"].to_numpy(), r["point"].to_numpy(), r["seed"].to_numpy(), contents.seed_lists[r["point"]])
        for r in (a, b)
    ]
    return Pair(first, second, apart(*means), False, len(common), pairs)


def _values_of(contents: Contents, level: Any) -> pd.DataFrame:
    """Return combination, point, seed and value of a level's runs with a finite value; a repeated point counts once."""
    runs = contents.runs_of(level)
    values = runs[contents.metric].to_numpy(dtype=np.float64)
    table = runs[["point", "seed"]].assign(combination=contents.combinations[runs.index], value=values)
    finite: pd.DataFrame = table[np.isfinite(values)].drop_duplicates(["combination", "seed"])
    return finite
