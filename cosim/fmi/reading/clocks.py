"""Clocks of FMI 3: their declarations in the model description, and when time-based clocks are due."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any
from xml.etree import ElementTree

PERIODIC = ("constant", "fixed", "tunable")

UNKNOWN, UNCHANGED, CHANGED = range(3)
"""The values of fmi3IntervalQualifier."""


@dataclass(frozen=True)
class Clock:
    """The declaration of a clock in a model description.

    Attributes
    ----------
    kind : str
        Its ``intervalVariability``: ``"constant"``, ``"fixed"``, ``"tunable"``, ``"changing"``, ``"countdown"`` or
        ``"triggered"``.
    interval : Fraction or None
        Seconds from tick to tick; None if the FMU gives it at run time.
    shift : Fraction
        Seconds to the first tick.
    resolution : int or None
        Of a clock that counts in fractions of a second: the number of fractions in one second.
    fractions : bool
        Whether the FMU gives intervals as fractions instead of decimal numbers.
    """

    kind: str
    interval: Fraction | None = None
    shift: Fraction = Fraction(0)
    resolution: int | None = None
    fractions: bool = False

    @property
    def is_timed(self) -> bool:
        """Whether the clock is time-based: its tick times are known in advance."""
        return self.kind != "triggered"

    @property
    def is_periodic(self) -> bool:
        """Whether it ticks at equal intervals."""
        return self.kind in PERIODIC


def read_clocks(root: ElementTree.Element) -> dict[int, Clock]:
    """Return the clocks of a model description by value reference.

    Raises
    ------
    ValueError
        If an interval is no number, or not valid for a clock.
    """
    types = {t.get("name"): t.attrib for t in root.iterfind("TypeDefinitions/ClockType")}
    clocks = {}
    for element in root.iterfind("ModelVariables/Clock"):
        attributes = {**types.get(element.get("declaredType"), {}), **element.attrib}
        try:
            clocks[int(attributes["valueReference"])] = _clock(attributes)
        except (ValueError, ZeroDivisionError, KeyError, OverflowError):
            raise ValueError(
                f"the clock {attributes.get('name')!r} has an interval or shift that is not valid"
            ) from None
    return clocks


def _clock(attributes: dict[str, str]) -> Clock:
    kind = attributes["intervalVariability"]
    fractions = attributes.get("supportsFraction") in {"true", "1"}
    resolution = int(attributes["resolution"]) if "resolution" in attributes else None
    interval, shift = None, Fraction(0)
    if fractions and resolution and "intervalCounter" in attributes:
        interval = Fraction(int(attributes["intervalCounter"]), resolution)
        shift = Fraction(int(attributes.get("shiftCounter", "0")), resolution)
    elif "intervalDecimal" in attributes:
        interval, shift, resolution = (
            Fraction(attributes["intervalDecimal"]),
            Fraction(attributes.get("shiftDecimal", "0")),
            None,
        )
    if (interval is not None and interval <= 0) or shift < 0 or (kind == "constant" and interval is None):
        raise ValueError
    return Clock(kind, interval, shift, resolution, fractions)


class Ticks:
    """The tick times of a clock in one run.

    Parameters
    ----------
    name : str
        Name of the clock.
    reference : int
        Its value reference.
    clock : Clock
        Its declaration.
    """

    def __init__(self, name: str, reference: int, clock: Clock):
        self.name, self.reference, self.clock = name, reference, clock
        self.begin, self.interval, self._count = clock.shift, clock.interval, 0
        self.due = math.inf
        if clock.is_periodic and clock.interval is not None:
            self.due = float(clock.shift)

    def start(self, shift: Fraction, interval: Fraction) -> None:
        """Set the first tick from initialization: at `shift` for a periodic clock, after `interval` for others."""
        self.begin, self.interval, self._count = shift, interval, 0
        self.due = float(shift if self.clock.is_periodic else interval)

    def tick(self) -> None:
        """Advance by one tick: a periodic clock is due again, others when the FMU gives a new interval."""
        self._count += 1
        self.due = math.inf
        if self.clock.is_periodic and self.interval is not None:
            self.due = float(self.begin + self._count * self.interval)

    def change(self, now: float, interval: Fraction) -> None:
        """Set a new interval that begins now."""
        self.begin, self.interval, self._count = Fraction(now) + interval, interval, 0
        self.due = float(self.begin)

    @property
    def state(self) -> tuple[Any, ...]:
        """The state to save and restore."""
        return self.begin, self.interval, self._count, self.due

    @state.setter
    def state(self, values: tuple[Any, ...]) -> None:
        self.begin, self.interval, self._count, self.due = values
