"""Tables of runs: one row for each run, with its point, its seed, its factors and its metrics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.numbers import with_article
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

Names = str | Sequence[str] | None


def names_of(given: Names) -> tuple[str, ...]:
    """Return a tuple of names from one name, several, or None."""
    return () if given is None else (given,) if isinstance(given, str) else tuple(given)


def check_columns(table: pd.DataFrame, names: Sequence[str]) -> None:
    """Raise an error if a table lacks a column, or a column is named twice.

    Parameters
    ----------
    table : DataFrame
        A row for each run.
    names : sequence of str
        The columns.
    """
    if not hasattr(table, "columns"):
        raise ModelError(
            f"The table is {with_article(type(table).__name__)}; give a pandas table with a row for each run."
        )
    for i, name in enumerate(names):
        if name not in table.columns:
            raise UnknownNameError(f"The table has no column {name!r}; {did_you_mean(name, map(str, table.columns))}")
        if name in names[:i]:
            raise ModelError(f"The column {name!r} is named twice; use it for one purpose only.")


def numbers(table: pd.DataFrame, metric: str) -> Floats:
    """Return the metric of each run; numbers that are not finite become NaN.

    Parameters
    ----------
    table : DataFrame
        A row for each run.
    metric : str
        The column.
    """
    try:
        values = table[metric].to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError):
        raise ModelError(
            f"The column {metric!r} has no numbers and cannot be a metric; choose another column."
        ) from None
    return np.where(np.isfinite(values), values, np.nan)


def cells(table: pd.DataFrame, by: Sequence[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Yield each combination of values of some columns with its rows, in the order of their first rows.

    Parameters
    ----------
    table : DataFrame
        A row for each run.
    by : sequence of str
        The columns; without columns, all rows are one cell.
    """
    if not by:
        yield {}, table
        return
    for labels, rows in table.groupby(list(by), sort=False, dropna=False, observed=True):
        yield dict(zip(by, labels if isinstance(labels, tuple) else (labels,), strict=True)), rows


def where(cell: dict[str, Any]) -> str:
    """Return the values of a cell as part of a message."""
    return f" where {', '.join(f'{name} is {value!r}' for name, value in cell.items())}" if cell else ""


__all__ = ["Names", "cells", "check_columns", "names_of", "numbers", "where"]
