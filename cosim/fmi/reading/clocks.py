"""Clocks of FMI 3: what a model description says of them, and when those that time ticks are due."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any
from xml.etree import ElementTree

PERIODIC = ("constant", "fixed", "tunable")

UNKNOWN, UNCHANGED, CHANGED = range(3)
"""What an FMU says of an interval that it is asked for: fmi3IntervalQualifier."""


@dataclass(frozen=True)
class Clock:
    """What a model description says of a clock.

    Attributes
    ----------
    kind : str
        Its ``intervalVariability``: ``"constant"``, ``"fixed"``, ``"tunable"``, ``"changing"``, ``"countdown"`` or
        ``"triggered"``.
    interval : Fraction or None
        Seconds from tick to tick; None where the FMU is to be asked.
    shift : Fraction
        Seconds to the first tick.
    resolution : int or None
        Of a clock that counts in fractions of a second: how many make one second.
    fractions : bool
        Whether the FMU is asked for fractions, instead of decimal numbers.
    """

    kind: str
    interval: Fraction | None = None
    shift: Fraction = Fraction(0)
    resolution: int | None = None
    fractions: bool = False

    @property
    def is_timed(self) -> bool:
        """Whether time ticks it, so that it can be known when."""
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
        If an interval is no number, or none that a clock can have.
    """
    types = {t.get("name"): t.attrib for t in root.iterfind("TypeDefinitions/ClockType")}
    clocks = {}
    for element in root.iterfind("ModelVariables/Clock"):
        said = {**types.get(element.get("declaredType"), {}), **element.attrib}
        try:
            clocks[int(said["valueReference"])] = _clock(said)
        except (ValueError, ZeroDivisionError, KeyError, OverflowError):
            raise ValueError(f"the clock {said.get('name')!r} has an interval or shift that is none") from None
    return clocks


def _clock(said: dict[str, str]) -> Clock:
    kind = said["intervalVariability"]
    fractions = said.get("supportsFraction") in {"true", "1"}
    resolution = int(said["resolution"]) if "resolution" in said else None
    interval, shift = None, Fraction(0)
    if fractions and resolution and "intervalCounter" in said:
        interval = Fraction(int(said["intervalCounter"]), resolution)
        shift = Fraction(int(said.get("shiftCounter", "0")), resolution)
    elif "intervalDecimal" in said:
        interval, shift, resolution = Fraction(said["intervalDecimal"]), Fraction(said.get("shiftDecimal", "0")), None
    if (interval is not None and interval <= 0) or shift < 0 or (kind == "constant" and interval is None):
        raise ValueError
    return Clock(kind, interval, shift, resolution, fractions)


class Ticks:
    """When a clock is due in one run.

    Parameters
    ----------
    name : str
        Name of the clock.
    reference : int
        Its value reference.
    clock : Clock
        What is said of it.
    """

    def __init__(self, name: str, reference: int, clock: Clock):
        self.name, self.reference, self.clock = name, reference, clock
        self.begin, self.interval, self._count = clock.shift, clock.interval, 0
        self.due = math.inf
        if clock.is_periodic and clock.interval is not None:
            self.due = float(clock.shift)

    def start(self, shift: Fraction, interval: Fraction) -> None:
        """Take what the FMU says while it is initialized: of a periodic clock the first tick, of others the time to it."""
        self.begin, self.interval, self._count = shift, interval, 0
        self.due = float(shift if self.clock.is_periodic else interval)

    def tick(self) -> None:
        """Note that it has ticked: a periodic one is due again, the others when the FMU says so."""
        self._count += 1
        self.due = math.inf
        if self.clock.is_periodic and self.interval is not None:
            self.due = float(self.begin + self._count * self.interval)

    def change(self, now: float, interval: Fraction) -> None:
        """Take an interval that begins now."""
        self.begin, self.interval, self._count = Fraction(now) + interval, interval, 0
        self.due = float(self.begin)

    @property
    def state(self) -> tuple[Any, ...]:
        """What is to be remembered of it."""
        return self.begin, self.interval, self._count, self.due

    @state.setter
    def state(self, values: tuple[Any, ...]) -> None:
        self.begin, self.interval, self._count, self.due = values
