"""What `bayesftc live` and `bayesftc monitor --live` print: alarms while they run, and tables at the end."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any

from bayesftc.cli import output
from bayesftc.cosim.errors import ResultFileError
from bayesftc.cosim.live.run import LiveSettings, LiveSummary, Watcher, run_live
from bayesftc.cosim.live.steppers import Stepper
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import ActuatorEvent, FaultEvent
from bayesftc.monitoring.watching import AlarmWatch
from bayesftc.scenario.live.wires import WireFile

Event = FaultEvent | ActuatorEvent

MOST = 1000
"""Largest number of alarms that the summary lists."""


@dataclass(eq=False)
class Alarms:
    """The alarms of a live run, printed as they begin and end.

    Parameters
    ----------
    watches : sequence of AlarmWatch
        They find the alarms.
    prefix : str
        Beginning of the names of the outputs: ``"controller."``.
    shown : bool
        Whether to print them on stderr.
    """

    watches: Sequence[AlarmWatch]
    prefix: str = ""
    shown: bool = True
    ended: list[Event] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def watcher(self, stepper: Stepper) -> Callable[[float, Floats, Floats], None] | None:
        """Return the watcher for a live run; None if there are no fault probabilities. The stepper is prepared by then."""
        places: dict[str, slice] = {}
        first = 0
        for name, port in stepper.outputs.items():
            if name.startswith(self.prefix):
                places[name.removeprefix(self.prefix)] = slice(first, first + port.size)
            first += port.size
        self.watches = [watch for watch in self.watches if watch.signals[0] in places]
        if not self.watches:
            return None
        wanted = {name: places[name] for watch in self.watches for name in watch.signals if name in places}

        def watch_all(time: float, inputs: Floats, outputs: Floats) -> None:
            signals = {name: outputs[place] for name, place in wanted.items()}
            for watch in self.watches:
                for event, ended in watch.feed(time, signals):
                    self._note(event, ended, time)

        return watch_all

    def close(self) -> list[Event]:
        """Return the last alarms, also those that have not ended, in the order of their start."""
        for watch in self.watches:
            for event in watch.close():
                self._add(event)
        return sorted(self.ended, key=lambda event: event.start)

    def _note(self, event: Event, ended: bool, time: float) -> None:
        if ended:
            self._add(event)
            del self.ended[:-MOST]
        if self.shown:
            kind = f", {event.kind}" if event.kind else ""
            if ended and event.continued:
                text = f"its kind was {event.kind} from {event.start:.2f} s on"
            elif ended:
                text = f"the alarm has ended (since {event.start:.2f} s{kind})"
            else:
                text = f"alarm, fault probability {event.probability:.3f}{kind}"
            note_at(time, f"{name_of(event)}: {text}")

    def _add(self, event: Event) -> None:
        self.ended.append(event)
        self.counts[name_of(event)] += not event.continued


def all_of(watchers: Sequence[Watcher | None]) -> Watcher | None:
    """Return a watcher that calls those that there are."""
    present = [each for each in watchers if each is not None]
    if len(present) < 2:
        return present[0] if present else None

    def watch(time: float, inputs: Floats, outputs: Floats) -> None:
        for each in present:
            each(time, inputs, outputs)

    return watch


def run_between(stepper: Stepper, wires: WireFile, settings: LiveSettings) -> LiveSummary:
    """Run between the wires of a file; its name stands before errors of wires, not before those of the recording's folder."""
    try:
        with wires.named():
            return run_live(stepper, wires.wires, settings)
    except ResultFileError as error:
        raise error.__cause__ or error from None


def note(text: str) -> None:
    """Print a line on stderr at once."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def note_at(time: float, text: str) -> None:
    """Print a line on stderr at once, after the date and the time in seconds of the run."""
    note(f"{datetime.now():%Y-%m-%d %H:%M:%S}, {time:.2f} s: {text}")


def name_of(event: Event) -> str:
    """Return the name of the sensor or actuator, as in tables."""
    return event.sensor if isinstance(event, FaultEvent) else f"actuator {event.actuator}"


def as_numbers(summary: LiveSummary, alarms: Sequence[Event]) -> dict[str, Any]:
    """Return a summary as plain data."""
    return {**asdict(summary), "alarms": [asdict(event) for event in alarms]}


def print_summary(numbers: Mapping[str, Any]) -> None:
    """Print the tables of a live run, without its alarms."""
    console, say = output.sayer()
    deadlines = numbers["deadlines"]
    say(f"{numbers['stopped']} {numbers['steps']} steps of {_time(deadlines['period'])}.\n")
    say("Deadlines", "bold")
    table = output.empty_table("all steps")
    for label, text in (
        ("delay of a step, half of them", _time(deadlines["delay_0.5"])),
        ("99 %", _time(deadlines["delay_0.99"])),
        ("99.9 %", _time(deadlines["delay_0.999"])),
        ("worst", _time(deadlines["worst_delay"])),
        ("longest computation", _time(deadlines["longest_step"])),
        ("overruns", _share(deadlines["overruns"], numbers["steps"])),
        ("left out after a long stop", str(deadlines["skipped"])),
        ("safe values by the watchdog", str(numbers["watchdog_trips"])),
    ):
        table.add_row(label, text)
    console.print(table)
    if numbers["wires_in"]:
        say("\nSamples", "bold")
        samples = output.empty_table("messages", "replaced", "missing", "why missing", "connection")
        for name, row in numbers["wires_in"].items():
            why = ", ".join(f"{reason} {count}" for reason, count in row["missing"].items()) or output.DASH
            samples.add_row(
                name, str(row["received"]), str(row["replaced"]), f"{row['missing_share']:.1%}", why, _connection(row)
            )
        console.print(samples)
    if numbers["wires_out"]:
        say("\nOutputs", "bold")
        sent = output.empty_table("sent", "lost", "safe values", "clipped", "not a number", "connection")
        for name, row in numbers["wires_out"].items():
            counts = [str(row[key]) for key in ("sent", "lost", "safe", "clipped", "not_finite")]
            sent.add_row(name, *counts, _connection(row))
        console.print(sent)
    if numbers["recorded"]:
        say(f"\nRecorded in {numbers['recorded']}")
    if numbers["lost_rows"]:
        say(f"{numbers['lost_rows']} steps are not recorded ({numbers['problem'] or 'the disk was too slow'}).")


def print_alarms(numbers: Mapping[str, Any]) -> None:
    """Print the table of the alarms."""
    console, say = output.sayer()
    say("\nAlarms", "bold")
    alarms = output.empty_table("kind", "onset (s)", "alarm (s)", "probability")
    for event in numbers["alarms"]:
        onset = output.DASH if event.get("onset") is None else f"{event['onset']:.2f}"
        span = f"{event['start']:.2f} to {event['end']:.2f}"
        device = event["sensor"] if "sensor" in event else f"actuator {event['actuator']}"
        alarms.add_row(device, event["kind"] or output.DASH, onset, span, f"{event['probability']:.3f}")
    console.print(alarms)


def _connection(row: Mapping[str, Any]) -> str:
    return "at the end" if row["connected"] else row["problem"] or "none at the end"


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _share(count: int, of: int) -> str:
    return f"{count} ({count / of:.2%})" if of else str(count)
