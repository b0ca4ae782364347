"""The results of a campaign: a table with a row for each run, and the signals over time."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import Outcome
from bayesftc.cosim.campaign.runs.columns import factor_columns, run_columns
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

    def __init__(self, table: Callable[[], pd.DataFrame], dataset: Callable[[], xr.Dataset]):
        self._make_table, self._make_dataset = table, dataset
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
        """Return the first and the last runs as a table, for notebooks."""
        shown: str = self.table._repr_html_()  # type: ignore[operator]
        return f"<p><b>{escape(repr(self)[1:-1])}</b></p>\n{shown}"


class InMemory:
    """Keeps the outcomes of a campaign in memory."""

    def __init__(self, job: Job, labels: Sequence[Mapping[str, Any]]):
        self._job, self._labels = job, labels
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
        return CampaignResult(self._table, self._dataset)

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
            name: (("run", "time", *(f"{name}_{d}" for d in range(values.ndim - 2))), values, _attributes(job, name))
            for name, values in self._signals.items()
        }
        of_runs = {name: ("run", values) for name, values in self._runs.items()}
        return xr.Dataset(
            signals, {**of_runs, "status": ("run", self._status), "time": ("time", job.time, {"units": "s"})}
        )


def memory() -> float:
    """Return the bytes of memory of this machine; infinity if the system has no such information."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return float("inf")


def _attributes(job: Job, name: str) -> dict[str, str]:
    unit = job.signals[name].unit
    return {"units": unit} if unit else {}


__all__ = ["CampaignResult", "InMemory"]
