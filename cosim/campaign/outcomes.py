"""The results of a campaign: a table with a row for each run, and the signals over time."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.campaign.designs.plan import Outcome
from bayesftc.cosim.campaign.runs.columns import factor_columns, run_columns, unit_attributes
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from bayesftc.cosim.campaign.runs.job import Job


class CampaignResult:
    """The results of a campaign, from memory or from a store.

    Attributes
    ----------
    table : pandas.DataFrame
        A row for each run: ``run``, ``point``, ``seed``, a column for each factor, ``status``, ``reason``, ``steps``, and a
        column for each metric.
    dataset : xarray.Dataset
        The recorded signals over ``run`` and ``time`` (seconds), with point, seed and factors as coordinates of the runs.
    units : dict of str to str
        The unit of each column of `table` that has one, such as ``"m/s"``.
    metadata : dict of str to object
        How the runs were made: ``executor`` has the name of the executor, and the reason for it.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> one, gain = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Gain(1.0), "gain")
    >>> diagram.connect(one["y"], gain["u"])
    >>> campaign = cosim.Campaign(diagram, duration=1.0, grid={"gain.gain": [2.0, 3.0]}, metrics=[cosim.Final("gain.y")])
    >>> result = campaign.run()
    >>> result.table[["run", "gain.gain", "status", "final(gain.y)"]]
       run  gain.gain status  final(gain.y)
    0    0        2.0     ok            2.0
    1    1        3.0     ok            3.0
    >>> result.metadata["executor"]
    'Threads: all blocks are compiled, and no FMU needs a separate process.'
    """

    def __init__(
        self,
        table: Callable[[], pd.DataFrame],
        dataset: Callable[[], xr.Dataset],
        units: Mapping[str, str] | None = None,
    ):
        self._make_table, self._make_dataset = table, dataset
        self.units = dict(units or {})
        self.metadata: dict[str, Any] = {}
        self._table: pd.DataFrame | None = None

    @property
    def table(self) -> pd.DataFrame:
        """See the class."""
        if self._table is None:
            self._table = self._make_table()
        return self._table

    @property
    def dataset(self) -> xr.Dataset:
        """See the class."""
        return self._make_dataset()

    def __repr__(self) -> str:
        table = self.table
        failed = int((table["status"] != "ok").sum())
        return f"<CampaignResult: {len(table)} runs{f', {failed} failed' if failed else ''}>"

    def _repr_html_(self) -> str:
        """Return the first and the last runs as a table with units, for notebooks."""
        headings = {name: with_unit(name, unit) for name, unit in self.units.items()}
        shown: str = self.table.rename(columns=headings)._repr_html_()  # type: ignore[operator]
        return f"<p><b>{escape(repr(self)[1:-1])}</b></p>\n{shown}"


class InMemory:
    """Keeps the outcomes of a campaign in memory."""

    def __init__(self, job: Job, labels: Sequence[Mapping[str, Any]]):
        self._job, self._labels, self._units = job, labels, job.units_of_columns(labels)
        n = job.plan.runs
        numbers = sum(len(job.time) * int(np.prod(s.shape)) for s in job.signals.values())
        if 8 * n * numbers > memory():
            raise ModelError(
                f"The recorded signals of {n} runs take {8e-9 * n * numbers:.3g} GB, more than this machine has; give run() the "
                "folder of a store, or record fewer signals, or every n-th step with decimation=n."
            )
        self._signals = {name: np.full((n, len(job.time), *s.shape), np.nan) for name, s in job.signals.items()}
        self._metrics = {name: np.full(n, np.nan) for name in job.columns}
        self._steps = np.full(n, -1, dtype=np.int64)
        self._status, self._reasons = np.full(n, "", dtype=object), np.full(n, "", dtype=object)

    def write(self, outcome: Outcome) -> None:
        """Keep an outcome."""
        where = slice(outcome.piece.begin, outcome.piece.end)
        for name, values in outcome.signals.items():
            self._signals[name][where] = values
        for name, numbers in outcome.metrics.items():
            self._metrics[name][where] = numbers
        self._steps[where] = outcome.steps
        self._status[where], self._reasons[where] = outcome.status, outcome.reasons

    def result(self) -> CampaignResult:
        """Return the kept outcomes."""
        return CampaignResult(self._table, self._dataset, self._units)

    @cached_property
    def _runs(self) -> dict[str, Any]:
        """Return the columns that identify the run of each row."""
        factors = factor_columns(self._labels, [*self._metrics, *self._signals])
        return run_columns(self._job.plan, factors)

    def _table(self) -> pd.DataFrame:
        import pandas as pd

        ends = {"status": self._status, "reason": self._reasons, "steps": self._steps}
        return pd.DataFrame({**self._runs, **ends, **self._metrics})

    def _dataset(self) -> xr.Dataset:
        import xarray as xr

        job = self._job
        signals = {
            name: (
                ("run", "time", *(f"{name}_{d}" for d in range(values.ndim - 2))),
                values,
                unit_attributes(job.signals[name].unit),
            )
            for name, values in self._signals.items()
        }
        of_runs = {name: ("run", values, unit_attributes(self._units.get(name))) for name, values in self._runs.items()}
        return xr.Dataset(
            signals, {**of_runs, "status": ("run", self._status), "time": ("time", job.time, {"units": "s"})}
        )


def memory() -> float:
    """Return the bytes of memory of this machine; infinity if the system has no such information."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return float("inf")


__all__ = ["CampaignResult", "InMemory"]
