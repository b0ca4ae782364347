"""Physical units: parsed by pint, or defined by an FMU; comparison and conversion.

A value ``x`` in a unit is ``factor * x + offset`` in SI. The radian is a base unit. In comparisons it is 1, as in the SI, except
with the hertz: 1 Hz is 2 pi rad/s, so a conversion between them must be explicit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from math import isclose
from types import MappingProxyType
from typing import Any

BASE = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
"""The base units of FMI, in its order, by their names in pint."""

_SAME = 1e-9
"""Relative difference up to which two factors are equal: definitions have about ten digits."""

_LONGEST = 200
"""Most characters of a unit, with or without its number; matching longer texts may take for ever."""

_SPELLINGS = {"Nm": "N.m", "Ohm": "ohm", "rev": "revolution", "-": "1", "1": "1"}
_TOKEN = re.compile(
    r"\s*(?:(?P<name>[^\W\d_]+(?:_[^\W\d_]+)*|[°µμΩ%]+[^\W\d_]*)(?:\^|\*\*)?(?P<power>[+-]?\d{1,2})?(?!\d)"
    r"|(?P<one>1(?![\d.]))|(?P<sign>[*.·/() ]))"
)
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?=.*[^\W\d_]|.*[%°])(\S.*)\Z", re.DOTALL)


def shown(unit: str | None) -> str | None:
    """Return a unit to show: None for that of a plain number, 1."""
    return None if unit == "1" else unit


def with_unit(name: str, unit: str | None) -> str:
    """Return a name and its unit, if there is one, as a label."""
    return f"{name} ({unit})" if shown(unit) else name


def behind(unit: str | None) -> str:
    """Return a unit as it stands behind a number: nothing if there is none, or if it is that of a plain number, 1."""
    return f" {unit}" if shown(unit) else ""


@dataclass(frozen=True)
class Unit:
    """The meaning of a unit in SI.

    Attributes
    ----------
    powers : mapping of str to int
        Powers of the base units that are not zero, by pint's names.
    factor, offset : float
        A value ``x`` in this unit is ``factor * x + offset`` in SI.
    cycles : bool
        Whether it counts cycles (Hz) instead of radians.
    """

    powers: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    factor: float = 1.0
    offset: float = 0.0
    cycles: bool = False

    def fits(self, other: Unit) -> bool:
        """Return whether values of the two can be converted, because their dimensions are equal."""
        powers, other_powers = ({n: p for n, p in u.powers.items() if n != "radian"} for u in (self, other))
        if powers != other_powers:
            return False
        return self.powers.get("radian") == other.powers.get("radian") or not (self.cycles or other.cycles)

    def to(self, other: Unit) -> tuple[float, float]:
        """Return gain and offset of the conversion from this unit to another that fits."""
        gain, offset = self.factor / other.factor, (self.offset - other.offset) / other.factor
        return 1.0 if isclose(gain, 1.0, rel_tol=_SAME) else gain, offset


@dataclass(frozen=True)
class UnitDefinition:
    """The definition of a unit in an FMU.

    Attributes
    ----------
    unit : Unit or None
        Its meaning in SI; None if the FMU does not define it.
    displays : mapping of str to (float, float)
        Factor and offset of each display unit: ``shown = factor * value + offset``.
    """

    unit: Unit | None = None
    displays: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def parse(text: str) -> Unit | None:
    """Return pint's meaning of a unit, in FMI's spelling (``kg.m2/s2``) or pint's (``kg * m**2 / s**2``).

    Parameters
    ----------
    text : str
        Products and quotients of names with whole powers; ``/`` divides by the next factor or bracket only.

    Returns
    -------
    Unit or None
        None if it cannot be parsed, or is no fixed multiple of SI units (as dB).
    """
    return _parse(text.strip())


@cache
def _parse(text: str) -> Unit | None:
    if len(text) > _LONGEST:
        return None
    text = _SPELLINGS.get(text, text)
    tokens = _tokens(text.translate(_SUPERSCRIPTS))
    if not tokens:
        return None
    if len(tokens) == 1 and tokens[0][0] == "name" and tokens[0][2] == 1:
        return _named(tokens[0][1])  # a single unit may have an offset (degC); as a factor it is a difference
    powers: dict[str, int] = {}
    factor, cycles = 1.0, False
    sign, signs, started = 1, [1], False  # sign of the next factor; signs of the open brackets
    for kind, name, power in tokens:
        if kind == "name":
            unit = _named(name)
            if unit is None:
                return None
            exponent = sign * signs[-1] * power
            factor *= unit.factor**exponent
            cycles = cycles or unit.cycles
            for base, base_power in unit.powers.items():
                powers[base] = powers.get(base, 0) + exponent * base_power
        elif name == "/" and (sign < 0 or not started):
            return None
        elif name == "(":
            signs.append(sign * signs[-1])
        elif name == ")":
            if len(signs) == 1:
                return None
            signs.pop()
        sign, started = -1 if name == "/" else 1, True
    if len(signs) > 1 or tokens[-1][1] == "/":
        return None
    return Unit(MappingProxyType({n: p for n, p in powers.items() if p}), factor, 0.0, cycles)


def _tokens(text: str) -> list[tuple[str, str, int]]:
    """Return names with their powers, and signs; nothing if the text contains anything else.

    This is a separate grammar, without numbers and arithmetic, as the text may come from a hostile file.
    """
    tokens: list[tuple[str, str, int]] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            return []
        position = match.end()
        if match["name"]:
            tokens.append(("name", _SPELLINGS.get(match["name"], match["name"]), int(match["power"] or 1)))
        elif match["one"]:
            tokens.append(("one", "1", 1))
        elif match["sign"] not in {" ", "*", ".", "·"}:
            tokens.append(("sign", match["sign"], 1))
    return tokens


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


@cache
def _named(name: str) -> Unit | None:
    if "." in name:
        return _parse(name)
    registry = _registry()
    try:
        exact = registry.Unit(name)
        zero, one, two = (registry.Quantity(x, exact).to_base_units() for x in (0.0, 1.0, 2.0))
        offset = float(zero.magnitude)
        factor = float((registry.Quantity(1.0, f"delta_{exact}").to_base_units() if offset else one).magnitude)
    except Exception:  # noqa: BLE001 - pint raises a dozen classes for unknown or inconvertible names
        return None
    powers = {base: int(power) for base, power in one.unit_items()}
    whole = all(power == int(power) for _, power in one.unit_items())
    if not whole or factor == 0.0 or not isclose(two.magnitude, 2.0 * factor + offset, rel_tol=_SAME):
        return None
    return Unit(MappingProxyType(powers), factor, offset, cycles=str(exact).endswith("hertz"))


def gain(source: Unit, target: Unit) -> tuple[float, float] | str:
    """Return gain and offset of a conversion, or, as the end of a sentence, why there is none."""
    if source.fits(target):
        return source.to(target)
    if source.cycles != target.cycles and replace(source, cycles=False).fits(replace(target, cycles=False)):
        return "1 Hz is 2 pi rad/s"
    return "their dimensions differ"


def difference(source: str, target: str, *meanings: Unit | None) -> str | None:
    """Return, as the end of a sentence, how to connect an output and an input of different units; None if they are equal.

    Parameters
    ----------
    source, target : str
        The two units. Units that pint does not know are compared by their spelling.
    *meanings : Unit or None
        Definitions of the two, if there are any (from an FMU).
    """
    if _spelt(source) == _spelt(target):
        return None
    first, second = (
        defined or parse(text) for defined, text in zip(meanings or (None, None), (source, target), strict=True)
    )
    if first is None or second is None:
        return "; put a Gain between them that converts."
    factors = gain(first, second)
    if isinstance(factors, str):
        return f": {factors}; put a block between them that computes one from the other."
    factor, offset = factors
    if factors == (1.0, 0.0):
        return None
    more = f", offset={offset:.12g}" if offset else ""
    return f"; put Gain({factor:.12g}{more}) between them."


def conversion(given: str, target: str, definitions: Mapping[str, UnitDefinition]) -> tuple[float, float] | str:
    """Return the conversion of a user's number from its unit to a variable's unit.

    Parameters
    ----------
    given, target : str
        The user's unit, and the variable's.
    definitions : mapping of str to UnitDefinition
        The FMU's unit definitions; they override pint's.

    Returns
    -------
    tuple of float, or str
        Gain and offset; or why there are none, as the end of a sentence.
    """
    if _spelt(given) == _spelt(target):
        return 1.0, 0.0
    if target in definitions and given in definitions[target].displays:
        factor, offset = definitions[target].displays[given]
        return 1.0 / factor, -offset / factor
    units = [_defined(name, definitions) or parse(name) for name in (given, target)]
    for unit, name in zip(units, (given, target), strict=True):
        if unit is None:
            return f"the unit {name!r} is not known"
    assert units[0] is not None
    assert units[1] is not None
    return gain(units[0], units[1])


def _defined(name: str, definitions: Mapping[str, UnitDefinition]) -> Unit | None:
    if name in definitions:
        return definitions[name].unit
    for definition in definitions.values():
        if name in definition.displays and definition.unit is not None:
            base, (factor, offset) = definition.unit, definition.displays[name]
            return replace(base, factor=base.factor / factor, offset=base.offset - base.factor * offset / factor)
    return None


def _spelt(unit: str) -> str:
    return unit.replace(" ", "").replace(".", "*").replace("·", "*")


def split(text: str) -> tuple[float, str] | None:
    """Return number and unit of a text such as ``"3.6 km/h"``; None for any other text."""
    match = _NUMBER.match(text) if len(text) <= _LONGEST else None
    return (float(match[1]), match[2].strip()) if match else None
