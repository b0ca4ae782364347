"""Values that devices send for a missing sample, such as -9999 or 65535."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    import pandas as pd

Invalid = float | Sequence[float] | Sequence[Sequence[float]]
"""A value, several for all sensors, or several for each sensor."""


def invalid_values(who: str, given: Any, sensors: int) -> NDArray[np.float64]:
    """Return each sensor's values that mark missing samples.

    Parameters
    ----------
    who : str
        The owner of the setting, for the error.
    given : number, sequence of number, or sequence of these
        See `Invalid`; several lists are one for each sensor.
    sensors : int
        Their number m.

    Returns
    -------
    ndarray, shape (m, k)
        Rows are filled up with NaN, which equals no sample; k is at least 1.

    Raises
    ------
    ModelError
        If a value is no finite number, or there are lists for some sensors only.
    """
    values = _listed(given)
    each = [_listed(value) for value in values] if values and all(map(_is_list, values)) else [values] * sensors
    if len(each) != sensors:
        raise ModelError(
            f"{who} has invalid={given!r}, a list for each of {len(each)} sensors, but there are {sensors}. Give one list of "
            "numbers for all sensors, or a list for each."
        )
    for value in (value for row in each for value in row):
        if not np.isfinite(real(value)):
            raise ModelError(
                f"{who} has invalid={given!r}, but its values must be finite numbers (NaN and infinities are missing samples "
                "anyway). Give numbers such as [-9999, 65535] for all sensors, or a list of them for each sensor."
            )
    table = np.full((sensors, max(1, *map(len, each))), np.nan)
    for row, sensor_values in zip(table, each, strict=True):
        row[: len(sensor_values)] = sensor_values
    return table


def without_texts(cells: pd.Series[Any], invalid: Sequence[float | str]) -> pd.Series[Any]:
    """Return a column of a file without the texts that stand for missing samples."""
    texts = [value.strip() for value in invalid if isinstance(value, str)]
    return cells.mask(cells.astype(str).str.strip().isin(texts)) if texts else cells


def numbers_of(invalid: Sequence[float | str]) -> list[float]:
    """Return the numbers among values of a file that stand for missing samples; the others are texts."""
    return [value for value in invalid if not isinstance(value, str)]


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)


def _listed(value: Any) -> list[Any]:
    return list(value) if _is_list(value) else [value]
