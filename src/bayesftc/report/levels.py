"""Are the levels of the compared factor different, over all points together? Differences run by run, where seeds are the same."""

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
"""Levels of which each two are compared."""
SURE = 0.95


@dataclass(frozen=True)
class Pair:
    """Two levels, and the difference of their means over the points that both have."""

    # The levels.
    first: Any
    second: Any
    difference: Estimate  # first minus second
    paired: bool  # whether runs of the same seed were compared
    points: int  # at how many combinations of the other factors both have runs
    pairs: int  # how many pairs of levels there are: intervals and p hold for all of them together (Bonferroni)

    @property
    def half(self) -> float:
        """Half of the interval that holds for all pairs together."""
        return self.difference.half(1.0 - (1.0 - SURE) / self.pairs)

    @property
    def p(self) -> float:
        """The probability that says whether there is a difference, corrected for the number of pairs."""
        p = self.difference.p
        return min(1.0, p * self.pairs) if p == p else p

    @property
    def certain(self) -> bool:
        """Whether the interval leaves zero out."""
        return abs(self.difference.value) > self.half


def compared_levels(contents: Contents) -> list[Pair]:
    """Return each two levels; of very many levels the two with the lowest means only."""
    assert contents.metric is not None
    order = contents.levels()
    every = len(order) * (len(order) - 1) // 2
    if len(order) > MOST_COMPARED:
        order = [level for level, _ in ranked(contents)][:2]
    return [pair(contents, a, b, every) for a, b in combinations(order, 2)]


def ranked(contents: Contents) -> list[tuple[Any, Estimate]]:
    """Return the levels that have a value of the metric, with their means, from the lowest to the highest."""
    found = [(level, estimate(contents, contents.runs_of(level))) for level in contents.levels()]
    return sorted((each for each in found if each[1].runs), key=lambda each: each[1].value)


def estimate(contents: Contents, runs: pd.DataFrame, metric: str | None = None) -> Estimate:
    """Return the mean of a metric over some runs."""
    values = runs[metric or contents.metric].to_numpy(dtype=np.float64)
    points = runs["point"].to_numpy()
    return pooled(values, points, runs["seed"].to_numpy(), contents.seed_lists[points])


def pair(contents: Contents, first: Any, second: Any, pairs: int = 1) -> Pair:
    """Return two levels beside each other."""
    a, b = (_known(contents, level) for level in (first, second))
    common = np.intersect1d(a["combination"], b["combination"])
    a, b = (runs[runs["combination"].isin(common)] for runs in (a, b))
    both = a.merge(b, on=["combination", "seed"], suffixes=("", "_other"))
    if len(both):
        values = (both["value"] - both["value_other"]).to_numpy()
        lists = contents.seed_lists[both["point"].to_numpy()]
        found = pooled(values, both["combination"].to_numpy(), both["seed"].to_numpy(), lists)
        return Pair(first, second, found, True, int(both["combination"].nunique()), pairs)
    means = [
        pooled(r["value"].to_numpy(), r["point"].to_numpy(), r["seed"].to_numpy(), contents.seed_lists[r["point"]])
        for r in (a, b)
    ]
    return Pair(first, second, apart(*means), False, len(common), pairs)


def _known(contents: Contents, level: Any) -> pd.DataFrame:
    """Return combination, point, seed and value of the runs of a level that have one; a point that is there twice counts once."""
    runs = contents.runs_of(level)
    values = runs[contents.metric].to_numpy(dtype=np.float64)
    found = runs[["point", "seed"]].assign(combination=contents.combinations[runs.index], value=values)
    known: pd.DataFrame = found[np.isfinite(values)].drop_duplicates(["combination", "seed"])
    return known
