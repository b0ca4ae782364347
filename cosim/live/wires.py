"""Wires: which message is which input, and which output goes where."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import Bridge
from bayesftc.cosim.live.inbox import Inbox, Limits
from bayesftc.cosim.live.steppers import Stepper
from bayesftc.cosim.types import Floats

CONTROL = "u"
"""The output of controllers that drives actuators, which need a safe value."""

Names = str | Sequence[str]


@dataclass(frozen=True, eq=False)
class Wire:
    """A bridge and the inputs that its messages set, or the outputs that it sends.

    Parameters
    ----------
    bridge : Bridge
        The connection.
    to : str or sequence of str, optional
        Inputs, in the order of the numbers in a message: ``"controller.y[0]"``, or all elements of ``"controller.y"``.
    source : str or sequence of str, optional
        Outputs, ``from`` in files. A wire has either `to` or `source`.
    stale_after, scale, offset, low, high : optional
        Of a wire with `to`: see `Limits`. Of one with `source`, ``scale * value + offset`` is sent, clipped to the range.
    hold : bool, optional
        Whether a sample is used in each step until the next one. By default, an input that bears missing samples (the samples
        ``y`` of a controller) gets each sample once; every other input keeps the last one.
    start : float, optional
        Value of an input that keeps the last sample, before the first one. Without it, no control is sent until then.
    safe : float or "last", optional
        What is sent when there is no control: at the end of the run, after an error, if a step takes too long (the watchdog), if
        a control is not a number, and before all inputs have their first samples. ``"last"`` sends nothing then, so that the
        actuator keeps the last control. Required for outputs named ``u``.

    Raises
    ------
    ModelError
        If these do not fit together.

    Examples
    --------
    >>> from bayesftc.cosim import live
    >>> speed = live.Wire(live.UDP(port=5001), to="controller.y[0]", stale_after=0.06, scale=0.2778)
    >>> force = live.Wire(live.UDP(port=5002), source="controller.u", safe=0.0)
    >>> force.is_input
    False
    """

    bridge: Bridge
    to: Names = ()
    source: Names = ()
    stale_after: float | None = None
    hold: bool | None = None
    scale: float = 1.0
    offset: float = 0.0
    low: float = -inf
    high: float = inf
    start: float | None = None
    safe: float | Literal["last"] | None = None

    def __post_init__(self) -> None:
        if bool(self.to) == bool(self.source):
            raise ModelError("A wire has either to = ... (an input) or from = ... (an output). Give one of them.")
        unused = {"stale_after", "hold", "start"} if self.source else {"safe"}
        for name in sorted(unused):
            if getattr(self, name) is not None:
                raise ModelError(
                    f"{name} has no effect on a wire with {'from' if self.source else 'to'} = ... Leave it out."
                )
        outputs = self.names if self.source else ()
        controls = [name for name in outputs if name.split(".")[-1].split("[")[0] == CONTROL]
        if controls and self.safe is None:
            raise ModelError(
                f"{controls[0]} drives an actuator and needs a safe value. Add safe = ... (sent when there is no control), or "
                "safe = 'last' for an actuator that may keep its last control."
            )
        if isinstance(self.safe, str) and self.safe != "last":
            raise ModelError(f"safe is {self.safe!r}; it must be a number or 'last'.")
        if isinstance(self.safe, int | float) and not isfinite(self.safe):
            raise ModelError(f"safe is {self.safe!r}; it must be a finite number or 'last'.")
        if isinstance(self.safe, int | float) and not self.low <= self.safe <= self.high:
            raise ModelError(
                f"safe is {self.safe!r}; it must not be below low = {self.low:g} or above high = {self.high:g}."
            )
        self.limits(hold=False)

    @property
    def is_input(self) -> bool:
        """Whether it brings samples in."""
        return bool(self.to)

    @property
    def names(self) -> tuple[str, ...]:
        """The inputs or outputs."""
        given = self.to or self.source
        return (given,) if isinstance(given, str) else tuple(given)

    def limits(self, hold: bool) -> Limits:
        """Return the limits of its samples, with a default of `hold`."""
        return Limits(
            self.stale_after, hold if self.hold is None else self.hold, self.scale, self.offset, self.low, self.high
        )


@dataclass(eq=False)
class Incoming:
    """A wire that brings samples to some elements of the inputs."""

    name: str
    wire: Wire
    places: list[int]
    inbox: Inbox
    bears_missing: bool
    waiting: bool = field(init=False)

    def __post_init__(self) -> None:
        self.waiting = not self.bears_missing and self.wire.start is None

    def numbers(self, steps: int) -> dict[str, Any]:
        """Return the numbers of its messages and missing samples after so many steps."""
        return self.inbox.numbers(steps)

    def read(self, inputs: Floats, late: float, behind: int) -> None:
        """Write the sample into the vector of inputs; an input that bears no missing sample keeps its last one."""
        bridge = self.wire.bridge
        try:
            bridge.collect()
        except Exception as error:  # noqa: BLE001 - a bridge of one's own may raise anything; its samples are missing then
            bridge.problem = f"{type(error).__name__}: {error}"
        values = self.inbox.take(late, behind)
        if self.bears_missing:
            inputs[self.places] = values
            return
        present = np.isfinite(values)
        if present.any():
            inputs[np.array(self.places)[present]] = values[present]
            if present.all():
                self.waiting = False


class Outgoing:
    """A wire that sends some elements of the outputs, or the safe value.

    Parameters
    ----------
    name : str
        Of the wire.
    wire : Wire
        Its settings.
    places : list of int
        The elements of the outputs.
    """

    def __init__(self, name: str, wire: Wire, places: list[int]):
        self.name, self.wire, self.places = name, wire, places
        self.sent = self.safes = self.clipped = self.not_finite = 0
        self._lock = threading.Lock()
        self._time = 0.0
        wire.bridge.safe = [float(wire.safe)] * len(places) if isinstance(wire.safe, int | float) else None

    def numbers(self, steps: int) -> dict[str, Any]:
        """Return the numbers of its controls and safe values."""
        return {
            "sent": self.sent,
            "lost": self.wire.bridge.lost,
            "safe": self.safes,
            "clipped": self.clipped,
            "not_finite": self.not_finite,
        }

    def send(self, outputs: Floats, time: float) -> None:
        """Send the values of a step, or the safe value if one of them is not a finite number."""
        wire = self.wire
        values = [wire.scale * float(outputs[place]) + wire.offset for place in self.places]
        if not all(map(isfinite, values)):
            self.not_finite += 1
            if wire.safe is not None:
                self.make_safe(time)
                return
        clipped = [value if value != value else min(max(value, float(wire.low)), float(wire.high)) for value in values]
        self.clipped += any(value < wire.low or value > wire.high for value in values)
        with self._lock:
            self._time = time
            self.sent += 1
            wire.bridge.send(clipped, time)

    def make_safe(self, time: float | None = None, timeout: float = 2.0) -> None:
        """Send the safe value, if it has one; give up after `timeout` seconds in which another thread sends.

        An error of the bridge is noted and not raised, because other wires have safe values to send too.
        """
        if not isinstance(self.wire.safe, int | float) or not self._lock.acquire(timeout=timeout):
            return
        try:
            self.safes += 1
            self._time = self._time if time is None else time
            self.wire.bridge.send([float(self.wire.safe)] * len(self.places), self._time)
        except Exception as error:  # noqa: BLE001 - a bridge of one's own may raise anything
            self.wire.bridge.lost += 1
            self.wire.bridge.problem = f"{type(error).__name__}: {error}"
        finally:
            self._lock.release()


def incoming(name: str, wire: Wire, stepper: Stepper) -> Incoming:
    """Return a wire with the places of its inputs.

    Raises
    ------
    UnknownNameError, ModelError
        If it does not fit to the stepper.
    """
    places = [place for each in wire.names for place in stepper.input_places(each)]
    # A name may itself end in brackets, as that of a column with its unit.
    inputs = [each if each in stepper.inputs else each.rpartition("[")[0] for each in wire.names]
    bears = {stepper.bears_missing(each) for each in inputs}
    if len(bears) > 1:
        raise ModelError("It mixes inputs that may be missing with others. Make a wire for each.")
    return Incoming(name, wire, places, Inbox(len(places), wire.limits(hold=not all(bears))), all(bears))


def outgoing(name: str, wire: Wire, stepper: Stepper) -> Outgoing:
    """Return a wire with the places of its outputs.

    Raises
    ------
    UnknownNameError
        If it does not fit to the stepper.
    """
    return Outgoing(name, wire, [place for each in wire.names for place in stepper.output_places(each)])
