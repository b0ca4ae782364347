"""Physical units: read from text by pint, or given by an FMU's own definitions; compared and converted.

A value ``x`` in a unit is ``factor * x + offset`` in SI. The radian counts as a base unit, but where units are compared it is 1,
as in the SI, except against the hertz: 1 Hz is 2 pi rad/s, and whoever mixes the two must say so.
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
"""Relative difference up to which two factors are one: definitions are printed with ten digits or so."""

_LONGEST = 200
"""Characters of a unit, with its number or without; to search longer texts for one may take for ever."""

_SPELLINGS = {"Nm": "N.m", "Ohm": "ohm", "rev": "revolution", "-": "1", "1": "1"}
_TOKEN = re.compile(
    r"\s*(?:(?P<name>[^\W\d_]+(?:_[^\W\d_]+)*|[°µμΩ%]+[^\W\d_]*)(?:\^|\*\*)?(?P<power>[+-]?\d{1,2})?(?!\d)"
    r"|(?P<one>1(?![\d.]))|(?P<sign>[*.·/() ]))"
)
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?=.*[^\W\d_]|.*[%°])(\S.*)\Z", re.DOTALL)


@dataclass(frozen=True)
class Unit:
    """What a unit's name means.

    Attributes
    ----------
    powers : mapping of str to int
        Powers of the base units that are not zero, by pint's names.
    factor, offset : float
        A value ``x`` in this unit is ``factor * x + offset`` in SI.
    cycles : bool
        Whether it counts cycles (Hz), which are no radians.
    """

    powers: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    factor: float = 1.0
    offset: float = 0.0
    cycles: bool = False

    def fits(self, other: Unit) -> bool:
        """Return whether values of the two can be converted: their dimensions are the same."""
        ours, theirs = ({n: p for n, p in u.powers.items() if n != "radian"} for u in (self, other))
        if ours != theirs:
            return False
        return self.powers.get("radian") == other.powers.get("radian") or not (self.cycles or other.cycles)

    def to(self, other: Unit) -> tuple[float, float]:
        """Return gain and offset that bring a value from this unit to another that fits."""
        gain, offset = self.factor / other.factor, (self.offset - other.offset) / other.factor
        return 1.0 if isclose(gain, 1.0, rel_tol=_SAME) else gain, offset


@dataclass(frozen=True)
class UnitDefinition:
    """What an FMU says of one of its units.

    Attributes
    ----------
    unit : Unit or None
        Its meaning in SI; None where the FMU does not say.
    displays : mapping of str to (float, float)
        Factor and offset of each unit in which values may be shown: ``shown = factor * value + offset``.
    """

    unit: Unit | None = None
    displays: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def parse(text: str) -> Unit | None:
    """Return what a unit means to pint, in FMI's spelling (``kg.m2/s2``) or pint's (``kg * m**2 / s**2``).

    Parameters
    ----------
    text : str
        Products and quotients of names with whole powers; ``/`` divides by the one factor, or bracket, that follows it.

    Returns
    -------
    Unit or None
        None where it cannot be read, or is no fixed multiple of SI units (as dB).
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
        return _named(tokens[0][1])  # alone, a unit may have an offset (degC); among factors it is a difference
    powers: dict[str, int] = {}
    factor, cycles = 1.0, False
    sign, signs, started = 1, [1], False  # of the next factor; of what is in each open bracket
    for kind, name, power in tokens:
        if kind == "name":
            unit = _named(name)
            if unit is None:
                return None
            exponent = sign * signs[-1] * power
            factor *= unit.factor**exponent
            cycles = cycles or unit.cycles
            for base, own in unit.powers.items():
                powers[base] = powers.get(base, 0) + exponent * own
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
    """Return names with their powers, and signs; nothing where something else stands in the text.

    A grammar of our own, without numbers and arithmetic: the text may come from a file that means harm.
    """
    tokens: list[tuple[str, str, int]] = []
    position = 0
    while position < len(text):
        found = _TOKEN.match(text, position)
        if found is None:
            return []
        position = found.end()
        if found["name"]:
            tokens.append(("name", _SPELLINGS.get(found["name"], found["name"]), int(found["power"] or 1)))
        elif found["one"]:
            tokens.append(("one", "1", 1))
        elif found["sign"] not in {" ", "*", ".", "·"}:
            tokens.append(("sign", found["sign"], 1))
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
    except Exception:  # noqa: BLE001 - pint raises a dozen classes for names that it does not know or cannot convert
        return None
    powers = {base: int(power) for base, power in one.unit_items()}
    whole = all(power == int(power) for _, power in one.unit_items())
    if not whole or factor == 0.0 or not isclose(two.magnitude, 2.0 * factor + offset, rel_tol=_SAME):
        return None
    return Unit(MappingProxyType(powers), factor, offset, cycles=str(exact).endswith("hertz"))


def gain(source: Unit, target: Unit) -> tuple[float, float] | str:
    """Return gain and offset that bring a value from one unit to another, or why there are none, as the end of a sentence."""
    if source.fits(target):
        return source.to(target)
    if source.cycles != target.cycles and replace(source, cycles=False).fits(replace(target, cycles=False)):
        return "1 Hz is 2 pi rad/s"
    return "their dimensions differ"


def difference(source: str, target: str, *meanings: Unit | None) -> str | None:
    """Return what stands between an output in one unit and an input in another, as the end of a sentence, or None.

    Parameters
    ----------
    source, target : str
        The two units. Those that pint does not know are compared by their spelling.
    *meanings : Unit or None
        What the two mean, where someone said so (an FMU of its own units).
    """
    if _spelt(source) == _spelt(target):
        return None
    first, second = (
        known or parse(text) for known, text in zip(meanings or (None, None), (source, target), strict=True)
    )
    if first is None or second is None:
        return "; put a Gain between them that converts."
    found = gain(first, second)
    if isinstance(found, str):
        return f": {found}; put a block between them that computes one from the other."
    factor, offset = found
    if found == (1.0, 0.0):
        return None
    more = f", offset={offset:.12g}" if offset else ""
    return f"; put Gain({factor:.12g}{more}) between them."


def conversion(given: str, wanted: str, own: Mapping[str, UnitDefinition]) -> tuple[float, float] | str:
    """Return how a number that a user gives in some unit becomes one in a variable's unit.

    Parameters
    ----------
    given, wanted : str
        The user's unit, and the variable's.
    own : mapping of str to UnitDefinition
        What the FMU says of its units: it counts first, before what pint knows.

    Returns
    -------
    tuple of float, or str
        Gain and offset; or why there are none, as the end of a sentence.
    """
    if _spelt(given) == _spelt(wanted):
        return 1.0, 0.0
    if wanted in own and given in own[wanted].displays:
        factor, offset = own[wanted].displays[given]
        return 1.0 / factor, -offset / factor
    units = [_defined(name, own) or parse(name) for name in (given, wanted)]
    for unit, name in zip(units, (given, wanted), strict=True):
        if unit is None:
            return f"what {name!r} means is not known"
    assert units[0] is not None
    assert units[1] is not None
    return gain(units[0], units[1])


def _defined(name: str, own: Mapping[str, UnitDefinition]) -> Unit | None:
    if name in own:
        return own[name].unit
    for definition in own.values():
        if name in definition.displays and definition.unit is not None:
            base, (factor, offset) = definition.unit, definition.displays[name]
            return replace(base, factor=base.factor / factor, offset=base.offset - base.factor * offset / factor)
    return None


def _spelt(unit: str) -> str:
    return unit.replace(" ", "").replace(".", "*").replace("·", "*")


def split(text: str) -> tuple[float, str] | None:
    """Return number and unit of a text such as ``"3.6 km/h"``, or None where it is none."""
    found = _NUMBER.match(text) if len(text) <= _LONGEST else None
    return (float(found[1]), found[2].strip()) if found else None
