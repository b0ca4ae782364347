"""What a campaign can say: which factor is compared, which metric counts, which signals are errors, what tells of detection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from bayesftc.cosim._campaign.reading import StoredCampaign
from bayesftc.cosim.errors import StoreError, UnknownNameError, did_you_mean

if TYPE_CHECKING:
    import pandas as pd

MOST_LEVELS = 6
"""Levels of a factor that are told apart by colours."""


@dataclass(frozen=True)
class ErrorSignal:
    """A signal less a reference, both recorded, as a metric has them."""

    signal: str
    reference: str
    shift: int


class Contents:
    """A stored campaign, as its report sees it.

    Parameters
    ----------
    store : StoredCampaign
        What is reported.
    metric, compare : str, optional
        The metric that counts, by default the first; the factor whose levels are compared, by default the first of names rather
        than numbers.

    Raises
    ------
    StoreError
        If no run is done yet.
    UnknownNameError
        If there is no such metric or factor.
    """

    def __init__(self, store: StoredCampaign, metric: str | None = None, compare: str | None = None):
        self.store, self.table = store, store.table()
        if not len(self.table):
            raise StoreError(f"The campaign in {store.path} has no run yet; run it first.")
        self.metrics = list(store.metadata.metrics)
        if metric is not None and metric not in self.metrics:
            raise UnknownNameError(f"The campaign has no metric {metric!r}; {did_you_mean(metric, self.metrics)}")
        self.metric = metric or next((m for m in self.metrics if self.table[m].notna().any()), None)
        if compare is not None and compare not in self.factors:
            raise UnknownNameError(f"The campaign has no factor {compare!r}; {did_you_mean(compare, self.factors)}")
        self.compared = compare or self._chosen()

    @cached_property
    def factors(self) -> list[str]:
        """Columns of the table that are factors."""
        names = list(self.store.plan.points[0])
        return [name if name in self.table else f"factor:{name}" for name in names]

    @cached_property
    def varied(self) -> list[str]:
        """Factors that have more than one value."""
        return [name for name in self.factors if self.table[name].nunique() > 1]

    @property
    def others(self) -> list[str]:
        """Factors that are varied, but not compared."""
        return [name for name in self.varied if name != self.compared]

    def levels(self) -> list[Any]:
        """Return the levels of the factor that is compared, in the order of the design; [None] without one."""
        return [None] if self.compared is None else list(self.table[self.compared].drop_duplicates())

    def runs_of(self, level: Any) -> pd.DataFrame:
        """Return the rows of the table at a level of the factor that is compared."""
        return self.table if self.compared is None else self.table[self.table[self.compared] == level]

    @property
    def description(self) -> Mapping[str, Any]:
        """What the campaign says of itself."""
        return self.store.metadata.description

    def errors(self) -> list[ErrorSignal]:
        """Return the signals that metrics compare with a reference, where both were recorded whole."""
        found: dict[ErrorSignal, None] = {}
        known = {name for name, (shape, _) in self.store.metadata.signals.items() if not shape}
        for metric in self.description.get("metrics", []):
            signal, reference = metric.get("signal"), metric.get("reference")
            if {signal, reference} <= known:
                found[ErrorSignal(signal, reference, int(metric.get("shift", 0)))] = None
        return list(found)

    def scalars(self) -> list[str]:
        """Return the recorded signals that are one number at each time."""
        return [name for name, (shape, _) in self.store.metadata.signals.items() if not shape]

    def unit(self, signal: str) -> str:
        """Return the unit of a signal in brackets, or nothing."""
        unit = self.store.metadata.signals[signal][1]
        return f" ({unit})" if unit else ""

    def _chosen(self) -> str | None:
        named = [n for n in self.varied if not _is_number(self.table[n]) and self.table[n].nunique() <= MOST_LEVELS]
        few = [name for name in self.varied if self.table[name].nunique() <= MOST_LEVELS]
        return next(iter([*named, *few]), None)


def _is_number(column: pd.Series[Any]) -> bool:
    return column.dtype.kind in "if"


__all__ = ["Contents", "ErrorSignal"]
