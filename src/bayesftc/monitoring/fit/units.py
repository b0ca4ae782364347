"""Units at the end of names of columns, as in ``T_1 [degC]``: samples of sensors of one quantity are converted to one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.recordings.columns import column_unit
from bayesftc.cosim.base.units import gain, parse
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats

_LAST_WORD = re.compile(r"_([A-Za-z]{2,})\Z")
"""Two letters or more: names like ``T_a`` and ``T_b`` count sensors."""


def in_unit(values: ArrayLike, column: str, unit: str) -> Floats:
    """Return the samples of a column in a unit; as they are, if its name has no unit in brackets that can be converted to it."""
    numbers, given = np.asarray(values, dtype=np.float64), parse(column_unit(column))
    target = parse(unit)
    factors = "unknown" if given is None or target is None else gain(given, target)
    if isinstance(factors, str) or factors == (1.0, 0.0):
        return numbers
    return np.asarray(numbers * factors[0] + factors[1])


def check_one_unit(names: Iterable[str]) -> None:
    """Refuse columns of different units, unless both units stand in brackets and can be converted.

    A last word such as ``T_1_degF`` counts only beside a unit of the same dimension, since many words happen to be units.

    Raises
    ------
    RecordingError
        If two columns differ in their units.
    """
    for first, second in combinations(names, 2):
        units = [column_unit(name) for name in (first, second)]
        certain = all(units)
        if not certain:
            words = (_LAST_WORD.search(name) for name in (first, second))
            units = [unit or (word[1] if word else "") for unit, word in zip(units, words, strict=True)]
        one, other = map(parse, units)
        if one is None or other is None:
            continue
        factors = gain(one, other)
        if factors == (1.0, 0.0) or isinstance(factors, str) != certain:
            continue
        remedy = (
            "Name" if certain else "Write the units in brackets, as in 'h [cm]', so that they are converted, or name"
        )
        raise RecordingError(
            f"The columns {first!r} and {second!r} have different units. All columns must be sensors of one quantity. "
            f"{remedy} the sensors of one quantity with --sensor."
        )
