"""What a campaign has come to: a table with a row for each run, and the signals over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim._campaign.plan import Outcome
from bayesftc.cosim.block import Floats

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from bayesftc.cosim._campaign.job import Job


class CampaignResult:
    """The results of a campaign; what they are read from, memory or a store, makes no difference.

    Attributes
    ----------
    table : pandas.DataFrame
        A row for each run: ``run``, ``point``, ``seed``, a column for each factor, ``status``, ``reason``, ``steps``, and a
        column for each metric.
    dataset : xarray.Dataset
        The recorded signals over ``run`` and ``time`` (seconds), with point, seed and factors as coordinates of the runs.
    """

    def __init__(self, table: Callable[[], pd.DataFrame], dataset: Callable[[], xr.Dataset]):
        self._make_table, self._make_dataset = table, dataset
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


class InMemory:
    """Keeps the outcomes of a campaign in memory."""

    def __init__(self, job: Job, labels: Sequence[Mapping[str, Any]]):
        self._job, self._labels = job, labels
        n = job.plan.runs
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
        """Return what was kept."""
        return CampaignResult(self._table, self._dataset)

    def _table(self) -> pd.DataFrame:
        return runs_table(self._job, self._labels, slice(None), self._status, self._reasons, self._steps, self._metrics)

    def _dataset(self) -> xr.Dataset:
        import xarray as xr

        job, table = self._job, self._table()
        signals = {
            name: (("run", "time", *(f"{name}_{d}" for d in range(values.ndim - 2))), values, _attributes(job, name))
            for name, values in self._signals.items()
        }
        of_runs = {name: ("run", table[name].to_numpy()) for name in ("point", "seed", *self._labels[0], "status")}
        return xr.Dataset(
            signals, {"run": table["run"].to_numpy(), "time": ("time", job.time, {"units": "s"}), **of_runs}
        )


def runs_table(
    job: Job,
    labels: Sequence[Mapping[str, Any]],
    where: slice,
    status: ArrayLike,
    reasons: ArrayLike,
    steps: np.ndarray[Any, np.dtype[np.int64]],
    metrics: Mapping[str, Floats],
) -> pd.DataFrame:
    """Return the rows of a campaign's table for the runs `where`, in the order of its columns."""
    import pandas as pd

    points, seeds = (values[where] for values in job.plan.of_runs())
    factors = {name: [point[name] for point in labels] for name in labels[0]}
    return pd.DataFrame(
        {
            "run": np.arange(job.plan.runs)[where],
            "point": points,
            "seed": seeds,
            **{name: pd.Series(values).take(points).to_numpy() for name, values in factors.items()},
            "status": np.asarray(status, dtype=object),
            "reason": np.asarray(reasons, dtype=object),
            "steps": steps,
            **metrics,
        }
    )


def _attributes(job: Job, name: str) -> dict[str, str]:
    unit = job.signals[name].unit
    return {"units": unit} if unit else {}


__all__ = ["CampaignResult", "InMemory", "runs_table"]
