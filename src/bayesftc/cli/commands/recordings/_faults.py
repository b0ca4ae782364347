"""The table of faults that `bayesftc monitor` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayesftc.cli import output
from bayesftc.controllers.switching.fault_modes import FAULT_MODES
from bayesftc.monitoring import ActuatorEvent, FaultEvent

IN_NOISE = tuple(mode.__name__ for mode in FAULT_MODES if mode.size_in_noise)
"""Modes whose sizes are multiples of the sensor's noise."""


def print_faults(events: Sequence[FaultEvent | ActuatorEvent], units: Mapping[str, str]) -> None:
    """Print the table of alarms, with the unit of each sensor and input by its name."""
    console, say = output.sayer()
    if not events:
        say("No fault was found.")
        return
    table = output.empty_table("kind", "onset (s)", "alarm (s)", "size")
    for event in sorted(events, key=lambda event: isinstance(event, ActuatorEvent)):
        kind, span = event.kind or output.DASH, f"{event.start:.2f} to {event.end:.2f}"
        if isinstance(event, FaultEvent):
            onset = output.DASH if event.onset is None else f"{event.onset:.2f}"
            table.add_row(event.sensor, kind, onset, span, _size(event, units[event.sensor]))
        else:
            unit = "" if kind == "LostEffect" else units.get(event.actuator, "")
            table.add_row(f"actuator {event.actuator}", kind, output.DASH, span, _size(event, unit))
    say("\nFaults", "bold")
    console.print(table)
    say("Size: at the end of the alarm. With x: the deviations as a multiple of the expected noise.")
    if any(isinstance(event, ActuatorEvent) for event in events):
        say("For an actuator: in the unit of its input. For LostEffect: the lost share of the effect.")


def _size(event: FaultEvent | ActuatorEvent, unit: str) -> str:
    if event.size is None:
        return output.DASH
    return f"x {event.size:.3g}" if event.kind in IN_NOISE else f"{event.size:.3g} {unit}".rstrip()
