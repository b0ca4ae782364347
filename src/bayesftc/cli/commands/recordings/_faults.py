"""The table of faults that `bayesftc monitor` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from bayesftc.cli import output
from bayesftc.controllers.switching.fault_modes import FAULT_MODES
from bayesftc.cosim.base.recordings.dates import span_text, time_text
from bayesftc.cosim.run.summary import pauses
from bayesftc.monitoring import ActuatorEvent, Disagreement, FaultEvent, Monitored, Recording

IN_NOISE = tuple(mode.__name__ for mode in FAULT_MODES if mode.size_in_noise)
"""Modes whose sizes are multiples of the sensor's noise."""

DAY = len("2026-01-01")


def print_faults(
    events: Sequence[FaultEvent | ActuatorEvent],
    units: Mapping[str, str],
    recording: Recording | None = None,
    doubtful: Sequence[FaultEvent] = (),
    hold: float | None = None,
    open_: bool = False,
) -> None:
    """Print the table of alarms, with the unit of each sensor and input by its name, and dates if the recording has any.

    The kinds of doubtful ones are in brackets. Pauses of at most `hold` seconds do not end an alarm. `open_`: sentences on times
    in which it is open which sensor is faulty follow.
    """
    console, say = output.sayer()
    if not events:
        say("A fault was found, but not in which sensor:" if open_ else "No fault was found.")
        return
    clock = Clock(recording)
    table = output.empty_table("kind", *clock.titles("onset", "alarm"), "size")
    for event in sorted(events, key=lambda event: isinstance(event, ActuatorEvent)):
        kind, span = event.kind or output.DASH, clock.span(event.start, event.end)
        if isinstance(event, FaultEvent):
            shown = f"({kind})" if event in doubtful else kind
            onset = output.DASH if event.onset is None else clock.time(event.onset)
            table.add_row(event.sensor, shown, onset, span, _size(event, units[event.sensor]))
        else:
            unit = "" if kind == "LostEffect" else units.get(event.actuator, "")
            table.add_row(f"actuator {event.actuator}", kind, output.DASH, span, _size(event, unit))
    say(f"\nFaults{clock.day}", "bold")
    console.print(table)
    if doubtful:
        say(
            f"In brackets: {len(doubtful)} of {len(events)}, which are probably no faults of sensors. Sensors that agree have "
            "alarms at the same time: the model is probably wrong."
        )
    if any(event.continued for event in events):
        say("Where the kind of an alarm changes, each kind that lasts has a row.")
    say(f"{pauses(hold)} Size: at the end of the alarm. With x: the deviations as a multiple of the expected noise.")
    if any(isinstance(event, ActuatorEvent) for event in events):
        say("For an actuator: in the unit of its input. For LostEffect: the lost share of the effect.")


class Clock:
    """The texts of times in a table: seconds, dates, or the times of a single day, which stands above the table.

    Parameters
    ----------
    recording : Recording, optional
        Its origin says whether there are dates.
    """

    def __init__(self, recording: Recording | None):
        self._origin = None if recording is None else recording.origin
        self._digits, self._dropped, self.day = 2, "", ""
        if recording is None:
            return
        exponent = int(f"{float(recording.dt):.0e}".partition("e")[2])
        self._digits = max(2, -exponent)  # neighbouring samples have other times
        if self._origin is None:
            return
        self._digits = 0 if recording.dt >= 1 else min(self._digits, 6)  # of dates
        first, last = (time_text(float(t), self._origin, 0)[:DAY] for t in recording.time[[0, -1]])
        if first == last:
            self.day, self._dropped = f" on {first}", f"{first} "

    def titles(self, *names: str) -> Iterator[str]:
        """Give the titles of columns with times."""
        return (name if self._origin else f"{name} (s)" for name in names)

    def time(self, seconds: float) -> str:
        """Return a time without a unit."""
        return time_text(seconds, self._origin, self._digits).removeprefix(self._dropped).removesuffix(" s")

    def span(self, start: float, end: float) -> str:
        """Return two times without a unit."""
        return self.whole_span(start, end).removeprefix(self._dropped).removesuffix(" s")

    def whole_span(self, start: float, end: float) -> str:
        """Return two times with a unit, or with their day."""
        return span_text(start, end, self._origin, self._digits)


def print_disagreements(monitored: Monitored, open_: Sequence[Disagreement], doubtful: Sequence[FaultEvent]) -> None:
    """Print when one of several sensors is faulty, but it is open which one: a sentence for all pairs with the same times.

    Those that begin with a doubtful alarm, or soon after it, are left out: then the model is probably wrong.
    """
    recording, hold = monitored.recording, monitored.alarm.hold
    say, clock = output.sayer()[1], Clock(monitored.recording)
    together: dict[tuple[float, float], list[Disagreement]] = {}
    for each in open_:
        if not any(event.start <= each.start <= event.end + hold for event in doubtful):
            together.setdefault((each.start, each.end), []).append(each)
    for (start, end), pairs in together.items():
        *names, last = (name for name in recording.sensors if any(name in each.sensors for each in pairs))
        several = len(recording.sensors) > 2
        model = ", or whether the model is wrong" if several and len(names) + 1 == len(recording.sensors) else ""
        say(
            f"From {clock.whole_span(start, end)} it is open which of {', '.join(names)} and {last} is faulty{model} (the sum "
            f"of two fault probabilities reaches {max(each.probability for each in pairs):.3g})"
            f"{'' if several else ': a third sensor would tell'}."
        )


def _size(event: FaultEvent | ActuatorEvent, unit: str) -> str:
    if event.size is None:
        return output.DASH
    return f"x {event.size:.3g}" if event.kind in IN_NOISE else f"{event.size:.3g} {unit}".rstrip()
