"""Faults on a condition: a signal that is compared with a number opens and closes the window of a fault."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.blocks.faults.kernels import HALF
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import maximum, minimum, select
from bayesftc.cosim.types import Floats, Kernel

RELATIONS: Mapping[str, tuple[float, float, float]] = {
    "<": (1.0, 0.0, 0.0),
    "<=": (1.0, 1.0, 0.0),
    "==": (0.0, 1.0, 0.0),
    "!=": (1.0, 0.0, 1.0),
    ">=": (0.0, 1.0, 1.0),
    ">": (0.0, 0.0, 1.0),
}
"""For each relation, whether it holds for a signal below, at and above the value."""


@dataclass(frozen=True)
class When:
    """A condition on a signal, for the start and the stop of a fault; `when` makes it. A missing sample does not fulfil it.

    Parameters
    ----------
    signal : str
        Name of one number among the signals of the diagram: ``"plant.v"``, ``"sensors.y[1]"``, ``"freeze_0.active"``.
    relation : {"<", "<=", "==", "!=", ">=", ">"}
        How the signal must compare to the value.
    value : float
        The value, in the unit of the signal.
    delayed : bool
        Whether the signal of the step before is compared. A fault needs this if the signal depends on the fault at the same
        step, as the control depends on a sensor. At the first step a delayed condition is not fulfilled.
    after : float
        Time in seconds before which the start is not fulfilled. A stop has no such time.

    Raises
    ------
    ModelError
        If a setting is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> begin = cosim.When("controller.u", ">", 400.0, delayed=True)
    >>> begin == cosim.when("controller.u > 400", delayed=True)
    True
    >>> fault = cosim.GainFault(factor=0.5, start=begin, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u, start_signal=u).y[0]) for u in (300.0, 500.0, 500.0)]
    [300.0, 500.0, 250.0]
    """

    signal: str
    relation: str
    value: float = field(metadata={"unit": "{*_signal}"})
    delayed: bool = False
    after: float = field(default=0.0, metadata={"unit": "s"})

    def __post_init__(self) -> None:
        if self.signal == "":  # an input of the fault, which somebody sets
            return
        if not isinstance(self.signal, str) or not all(self.signal.partition(".")):
            raise ModelError(
                f"A condition has signal={brief(self.signal)}; it must be the name of a signal with its block, such as 'plant.v'."
            )
        if self.relation not in tuple(RELATIONS):
            raise ModelError(
                f"The condition on {self.signal} has relation={brief(self.relation)}; it must be one of {' '.join(RELATIONS)}."
            )
        if not isfinite(real(self.value)):
            raise ModelError(
                f"The condition on {self.signal} has value={brief(self.value)}; it must be a finite number."
            )
        if not isinstance(self.delayed, bool):
            raise ModelError(
                f"The condition on {self.signal} has delayed={brief(self.delayed)}; it must be True or False."
            )
        if not isfinite(real(self.after)):
            raise ModelError(
                f"The condition on {self.signal} has after={brief(self.after)}; it must be a finite number of seconds."
            )

    def __str__(self) -> str:
        return HAND if not self.signal else f"{self.signal} {self.relation} {self.value:g}"

    @classmethod
    def read(cls, text: str, *, delayed: bool = False) -> When | None:
        """Return the condition of a text such as ``"plant.v > 22"``; None if it is none.

        Parameters
        ----------
        text : str
            Signal, relation and number.
        delayed : bool
            Whether the signal of the step before is compared.
        """
        if text == HAND:
            return BY_HAND
        parts = re.fullmatch(r"\s*([^\s<>=!]+)\s*([<>=!]=|[<>])\s*([^\s<>=!]+)\s*", text)
        try:
            value = float(parts[3]) if parts else None
        except ValueError:
            return None
        return None if parts is None or value is None else cls(parts[1], parts[2], value, delayed)


HAND = "by hand"
"""The start of a fault that is present while its input ``start_signal`` is above one half."""
BY_HAND = When("", ">", 0.5)


def when(signal: str, relation: str | None = None, value: float | None = None, *, delayed: bool = False) -> When:
    """Return a condition for the ``start`` or ``stop`` of a fault.

    Parameters
    ----------
    signal : str
        Name of one number among the signals of the diagram: ``"plant.v"``, ``"sensors.y[1]"``. Or the whole condition:
        ``"plant.v > 22"``.
    relation : {"<", "<=", "==", "!=", ">=", ">"}, optional
        How the signal must compare to the value.
    value : float, optional
        The value, in the unit of the signal.
    delayed : bool
        Whether the signal of the step before is compared: see `When`.

    Returns
    -------
    When
        The condition.

    Raises
    ------
    ModelError
        If a setting is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Freeze(sensor=0, start=cosim.when("plant.v", ">", 22.0), duration=2.0)
    >>> print(fault.start)
    plant.v > 22
    >>> fault.start == cosim.when("plant.v > 22")
    True
    """
    condition = When.read(signal, delayed=delayed) if isinstance(signal, str) else None
    if condition is not None:
        if relation is None and value is None:
            return condition
        raise ModelError(
            f"{brief(signal)} is a whole condition, but there is also relation={brief(relation)} or value={brief(value)}. Leave "
            "both out, or give only the name of the signal first."
        )
    if relation is None or value is None or not signal:
        raise ModelError(
            f"{brief(signal)} is no condition; write signal, relation and number, such as cosim.when('plant.v > 22') or "
            "cosim.when('plant.v', '>', 22.0)."
        )
    return When(signal, relation, value, delayed)


# --- Step functions --------------------------------------------------------------------------------------------------


class Condition(NamedTuple):
    """A signal, the value that it is compared with, and its row of `RELATIONS`."""

    signal: Floats
    value: Floats
    relation: Floats


class Occasion(NamedTuple):
    """Conditions and times of a fault, and state: whether it is inside its window, since how many steps, and whether it may.

    ``times`` are the earliest start and the latest stop in seconds.
    """

    start: Condition
    stop: Condition
    times: Floats
    duration: Floats
    latching: Floats
    step: Floats
    inside: Floats
    since: Floats
    armed: Floats


def holds(condition):
    """Return 1 if a condition is fulfilled, else 0; a missing sample fulfils none."""
    signal, value, relation = condition
    now = signal[0]
    beyond = select(now > value[0], relation[2], 0.0)
    return select(now < value[0], relation[0], select(now == value[0], relation[1], beyond))


def triggered(t, window):
    """Return 1 while the window of a fault on a condition is open, else 0.

    It opens when the start is fulfilled and the stop is not. It closes after its duration, when the stop is fulfilled, and
    unless it is latching when the start is not. Then it can open again, once the start has not been fulfilled for a step.
    """
    start, stop, times, duration, latching, step, inside, since, armed = window
    begins = select(t >= times[0], holds(start), 0.0)
    ends = select(t >= times[1], 1.0, holds(stop))
    steps = select(inside[0] > HALF, since[0] + 1.0, 0.0)
    stays = select((steps + HALF) * step[0] < duration[0], maximum(begins, latching[0]), 0.0)
    now = select(ends > HALF, 0.0, select(inside[0] > HALF, stays, minimum(begins, armed[0])))
    armed[0] = select(now > HALF, 0.0, select(begins > HALF, armed[0], 1.0))
    inside[0] = now
    since[0] = steps
    return now


def remember(start_signal, stop_signal, start_before, stop_before):
    """Keep the signals of conditions for the next step."""
    start_before[0] = start_signal[0]
    stop_before[0] = stop_signal[0]


# --- Definition ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Window:
    """The part of a fault's `Definition` for its window; ``inside(t, window)`` states whether it is open."""

    inside: Kernel
    parameters: Mapping[str, ArrayLike]
    state: Mapping[str, ArrayLike] = field(default_factory=dict)
    records: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    update: Kernel | None = None


def conditional(conditions: Mapping[str, When], times: tuple[float, float], duration: float, latching: bool) -> Window:
    """Return the window of a fault that starts or stops on a condition, or has a duration.

    Parameters
    ----------
    conditions : mapping of str to When
        For ``"start"`` and ``"stop"``; one that is missing does not matter.
    times : tuple of float
        Earliest start and latest stop in seconds.
    duration : float
        Seconds.
    latching : bool
        Whether the window stays open when the condition of the start is not fulfilled any more.
    """
    parameters: dict[str, ArrayLike] = {"times": times, "duration": duration, "latching": float(latching)}
    state: dict[str, ArrayLike] = {"inside": 0.0, "since": 0.0, "armed": 1.0}
    delayed = any(condition.delayed for condition in conditions.values())
    names: dict[str, Any] = {name: name for name in Occasion._fields}
    for name, fulfilled in (("start", 1.0), ("stop", 0.0)):
        condition, signal = conditions.get(name), f"{name}_signal"
        names[name] = Condition(signal, f"{name}_value", f"{name}_relation")  # type: ignore[arg-type]
        if condition is None:
            parameters |= {signal: 0.0, f"{name}_value": 0.0, f"{name}_relation": (fulfilled,) * 3}
        else:
            parameters |= {f"{name}_value": condition.value, f"{name}_relation": RELATIONS[condition.relation]}
            if condition.delayed:
                names[name] = names[name]._replace(signal=f"{name}_before")
        if delayed:
            state[f"{name}_before"] = nan
    return Window(triggered, parameters, state, {"window": Occasion(**names)}, remember if delayed else None)


__all__ = ["RELATIONS", "When", "Window", "conditional", "when"]
