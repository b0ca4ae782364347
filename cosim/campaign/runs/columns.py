"""The columns that identify the run of a row: its number, point, seed and the value of each factor."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import Plan
from bayesftc.cosim.errors import ModelError, brief

OWN = ("run", "point", "seed", "status", "reason", "steps", "time")
"""Names of columns in the tables and datasets of every campaign."""

Array = np.ndarray[Any, np.dtype[Any]]


def factor_columns(labels: Sequence[Mapping[str, Any]], taken: Iterable[str] = ()) -> dict[str, Array]:
    """Return for each factor the values at all points, as a column of one type.

    Parameters
    ----------
    labels : sequence of mapping of str to object
        The label of each factor, for each point: a number, a text, True, False or None.
    taken : iterable of str
        Names of metrics and signals. The column of a factor with one of these names, or a name in `OWN`, is called
        ``"factor:NAME"``.

    Returns
    -------
    dict of str to ndarray of shape (points,)
        Columns of bool, int64 or float64 if all values are; NaN for a missing number. Else texts, None for a missing one.

    Raises
    ------
    ModelError
        If a table cannot hold a value.
    """
    names = dict.fromkeys(name for point in labels for name in point)
    reserved = {*OWN, *taken}
    return {column_of(name, reserved): _column(name, [point.get(name) for point in labels]) for name in names}


def column_of(factor: str, reserved: Container[str]) -> str:
    """Return the name of the column of a factor."""
    return f"factor:{factor}" if factor in reserved else factor


def unit_attributes(unit: str | None) -> dict[str, str]:
    """Return the attributes of a variable of a dataset."""
    return {"units": unit} if unit else {}


def run_columns(plan: Plan, factors: Mapping[str, Array], begin: int = 0, end: int | None = None) -> dict[str, Array]:
    """Return the columns run, point, seed and factors of the runs from `begin` to before `end`, by name."""
    points, seeds = plan.of_runs()
    points, seeds = points[begin:end], seeds[begin:end]
    runs = np.arange(begin, begin + len(points))
    return {"run": runs, "point": points, "seed": seeds, **{name: column[points] for name, column in factors.items()}}


def _column(name: str, values: list[Any]) -> Array:
    values = [value.item() if isinstance(value, np.generic) else value for value in values]
    for value in values:
        if not isinstance(value, bool | int | float | str | None):
            raise ModelError(
                f"The factor {name!r} has the value {brief(value)}, which a table cannot hold; give it a label: "
                f"{{label: value}}."
            )
    kinds = {type(value) for value in values}
    if kinds == {bool}:
        return np.array(values)
    if kinds == {int} and all(abs(value) < 2**63 for value in values):
        return np.array(values, dtype=np.int64)
    if kinds <= {int, float, type(None)} and kinds != {type(None)}:
        return np.array([np.nan if value is None else float(value) for value in values])
    texts = np.empty(len(values), dtype=object)
    texts[:] = [None if value is None else str(value) for value in values]
    return texts


__all__ = ["OWN", "column_of", "factor_columns", "run_columns", "unit_attributes"]
