"""The content of a report: the compared factor, the main metric, the error signals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import behind, with_unit
from bayesftc.cosim.campaign.designs.plan import OK
from bayesftc.cosim.campaign.runs.columns import factor_columns
from bayesftc.cosim.campaign.store.reading import StoredCampaign
from bayesftc.cosim.errors import StoreError, UnknownNameError, did_you_mean
from bayesftc.report.svg import Style, styles

if TYPE_CHECKING:
    import pandas as pd

MOST_LEVELS = 6
"""Largest number of levels with distinct colours."""


@dataclass(frozen=True)
class ErrorSignal:
    """A signal minus a reference, both recorded, from a metric."""

    signal: str
    reference: str
    shift: int


class Contents:
    """A stored campaign with the choices of its report.

    Parameters
    ----------
    store : StoredCampaign
        The campaign.
    metric, compare : str, optional
        The main metric, by default the first; the factor whose levels are compared, by default the first whose values are names
        and not numbers. The controller or its precision learner comes before other factors with names.

    Raises
    ------
    StoreError
        If there is no run yet.
    UnknownNameError
        If there is no such metric or factor.
    """

    def __init__(self, store: StoredCampaign, metric: str | None = None, compare: str | None = None):
        self.store, self.table = store, store.table()
        if not len(self.table):
            raise StoreError(f"The campaign in {store.path} has no run yet. Run it first.")
        self.metrics = list(store.metadata.metrics)
        if metric is not None and metric not in self.metrics:
            raise UnknownNameError(f"The campaign has no metric {metric!r}; {did_you_mean(metric, self.metrics)}")
        self.candidates = self.metrics if metric is None else [metric]
        self.metric = next((m for m in self.candidates if self.table[m].notna().any()), None)
        if compare is not None and compare not in self.factors:
            raise UnknownNameError(f"The campaign has no factor {compare!r}; {did_you_mean(compare, self.factors)}")
        self.compared = compare or self._chosen()

    @cached_property
    def factors(self) -> list[str]:
        """Columns of the table that are factors."""
        metadata = self.store.metadata
        return list(factor_columns(self.store.plan.points, (*metadata.metrics, *metadata.signals)))

    @cached_property
    def varied(self) -> list[str]:
        """Factors with more than one value."""
        return [name for name in self.factors if self.values(name) > 1]

    @property
    def others(self) -> list[str]:
        """Varied factors, except the compared one."""
        return [name for name in self.varied if name != self.compared]

    def values(self, factor: str) -> int:
        """Return the number of values of a factor in the table."""
        return int(self.table[factor].nunique(dropna=False))

    def positive(self, metric: str | None) -> bool:
        """Return whether a metric, as an RMSE, has no negative value in any run, so that its intervals are cut at zero."""
        return metric is not None and bool((self.table[metric].dropna() >= 0).all())

    @cached_property
    def combinations(self) -> Any:
        """Index, for each run, of the combination of the factors that are not compared."""
        others = [name for name in self.factors if name != self.compared]
        if not others:
            return self.table["run"].to_numpy() * 0
        return self.table.groupby(others, sort=False, dropna=False).ngroup().to_numpy()

    @cached_property
    def seed_lists(self) -> Any:
        """Index, for each point, of its list of seeds: points with different lists have independent noise."""
        place: dict[tuple[int, ...], int] = {}
        return np.array([place.setdefault(seeds, len(place)) for seeds in self.store.plan.seeds])

    def levels(self) -> list[Any]:
        """Return the levels of the compared factor in the order of the design; [None] without one."""
        return [None] if self.compared is None else list(self.table[self.compared].drop_duplicates())

    def runs_of(self, level: Any) -> pd.DataFrame:
        """Return the rows of the table at a level of the compared factor."""
        if self.compared is None:
            return self.table
        column = self.table[self.compared]
        return self.table[column.isna() if level is None or level != level else column == level]

    def drawn(self) -> dict[Any, Style]:
        """Return the levels in figures, with the style of each."""
        return dict(zip(self.levels(), styles(), strict=False))

    def name(self, level: Any) -> str | None:
        """Return the name of a level in a figure: its text, or factor and number."""
        if level is None or self.compared is None:
            return None
        number = _is_number(self.table[self.compared])
        return f"{self.compared} = {level:.4g}{self.behind(self.compared)}" if number else str(level)

    def heading(self, column: str) -> str:
        """Return the name of a column of the table, with its unit."""
        return with_unit(column, self.store.metadata.units.get(column))

    def behind(self, column: str) -> str:
        """Return the unit of a column as it stands behind a number."""
        return behind(self.store.metadata.units.get(column))

    @property
    def undrawn(self) -> str:
        """A sentence on levels that figures do not show, or nothing."""
        every, drawn = len(self.levels()), len(self.drawn())
        return f" Only the first {drawn} of {every} levels are drawn." if every > drawn else ""

    @property
    def failed(self) -> int:
        """Number of failed runs."""
        return int((self.table["status"] != OK).sum())

    @property
    def description(self) -> Mapping[str, Any]:
        """The campaign's description from its metadata."""
        return self.store.metadata.description

    @property
    def controller(self) -> str | None:
        """Name of the controller; None if the diagram is no closed loop."""
        name: str | None = self.description.get("roles", {}).get("controller")
        return name

    def errors(self) -> list[ErrorSignal]:
        """Return the signals that metrics compare with a reference, if both are recorded scalars."""
        errors: dict[ErrorSignal, None] = {}
        recorded = {name for name, (shape, _) in self.store.metadata.signals.items() if not shape}
        for metric in self.description.get("metrics", []):
            signal, reference = metric.get("signal"), metric.get("reference")
            if {signal, reference} <= recorded:
                errors[ErrorSignal(signal, reference, int(metric.get("shift", 0)))] = None
        return list(errors)

    def scalars(self) -> list[str]:
        """Return the recorded scalar signals, except the flags of active faults."""
        faults = {f"{fault}.active" for chain in self._chains for fault in chain}
        return [name for name, (shape, _) in self.store.metadata.signals.items() if not shape and name not in faults]

    def faults_of(self, sensor: int) -> list[str]:
        """Return the names of a sensor's faults."""
        return list(self._chains[sensor]) if sensor < len(self._chains) else []

    @property
    def _chains(self) -> list[list[str]]:
        chains: list[list[str]] = self.description.get("roles", {}).get("faults_of_sensors", [])
        return chains

    def unit(self, signal: str) -> str:
        """Return the unit of a signal in brackets, or nothing."""
        unit = self.store.metadata.signals[signal][1]
        return f" ({unit})" if unit else ""

    def _chosen(self) -> str | None:
        few = [name for name in self.varied if self.values(name) <= MOST_LEVELS]
        named = [name for name in few if not _is_number(self.table[name])]
        # A loop that is a function has factors with the names of its arguments.
        learners = {self.controller, f"{self.controller}.precision", "controller", "precision", "learner"}
        return next(iter([*(name for name in named if name in learners), *named, *few]), None)


def _is_number(column: pd.Series[Any]) -> bool:
    return column.dtype.kind in "if"
