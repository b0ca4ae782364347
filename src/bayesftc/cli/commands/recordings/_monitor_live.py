"""``bayesftc monitor --live``: samples that arrive by wires, and alarms as they begin and end."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.cli.commands.recordings._faults import print_faults
from bayesftc.cli.live_report import MOST, Alarms, all_of, as_numbers, note_at, print_summary, run_between
from bayesftc.cli.page import PageBeside, page_beside
from bayesftc.cosim.live.run import LiveSettings
from bayesftc.cosim.types import Floats
from bayesftc.monitoring import ActuatorWatch, AlarmWatch, Monitor, MonitorStepper, load_monitor
from bayesftc.scenario.live import load_wires

PATIENCE = 5.0
"""Seconds after which the sensors are named that have not sent a sample yet."""


@dataclass(frozen=True)
class LiveOptions:
    """The options of a live monitor: see `monitor`."""

    duration: float | None
    record: Path | None
    json: bool
    quiet: bool
    page: PageBeside


def monitor_live(model: Path, bridges: Path, options: LiveOptions) -> None:
    """Monitor until the end of the duration, Ctrl-C or SIGTERM, and print what was found."""
    page = options.page
    page.check("bayesftc monitor --live")
    loaded, wires = load_monitor(model), load_wires(bridges)
    stepper = MonitorStepper(loaded)
    stepper.prepare()
    precision = stepper.estimator.precision
    conditions = stepper.step, loaded.alarm
    watches = [AlarmWatch(list(loaded.sensors), getattr(precision, "modes", ()), *conditions)]
    if precision.actuator_modes:
        watches.append(ActuatorWatch(list(loaded.inputs), precision.actuator_modes, *conditions))
    alarms = Alarms(watches, shown=not options.quiet)
    watcher = _Watcher(stepper, loaded, alarms)
    recording, watchers, opened = wires.recording(options.record), [watcher.watch], None
    with ExitStack() as stack:
        if page.serve:
            from bayesftc.console.desk.live import LiveRun
            from bayesftc.console.desk.monitored import monitor_lane

            shown = LiveRun(model.stem, monitor_lane(loaded, stepper), wires.wires, recording, drops=page.drops)
            stack.enter_context(page_beside(shown, page))
            watchers.append(shown.feed)
            opened = shown.opened
        settings = LiveSettings(
            options.duration,
            watchdog=wires.watchdog,
            recording=recording,
            watcher=all_of(watchers),
            opened=opened,
        )
        settings.steps(stepper.step)  # errors of the options are not those of the wires
        summary = run_between(stepper, wires, settings)
    events = alarms.close()
    numbers: dict[str, Any] = {
        **as_numbers(summary, events),
        "start_date": None if watcher.start is None else watcher.start.isoformat(timespec="milliseconds"),
        "began": stepper.began,
        "gaps": watcher.all_gaps,
        "sensors": watcher.numbers(),
        "why_no_probability": precision.why_no_probability,
    }
    if options.json:
        typer.echo(output.as_json(numbers))
    elif not options.quiet:
        if watcher.start is not None:
            output.sayer()[1](f"Time 0 is {watcher.start:%Y-%m-%d %H:%M:%S %Z}.")
        print_summary(numbers)
        _print_sensors(numbers)
        if stepper.began is not None and not precision.why_no_probability:
            units = {name: sensor.unit for name, sensor in loaded.sensors.items()}
            print_faults(events, units | {name: given.unit for name, given in loaded.inputs.items()})


@dataclass(eq=False)
class _Watcher:
    """Counts samples and fault probabilities, and says when monitoring begins."""

    stepper: MonitorStepper
    monitor: Monitor
    alarms: Alarms
    steps: int = 0
    judged: int = 0
    told: bool = False
    samples: Floats = field(init=False)
    probability: Floats = field(init=False)
    start: datetime | None = None
    gaps: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.samples, self.probability = np.zeros(len(self.monitor.sensors)), np.zeros(len(self.monitor.sensors))
        self._places = self.stepper.output_places("fault_probability")
        self._alarms = self.alarms.watcher(self.stepper)
        self._began = False
        self._gap_since: float | None = None

    def watch(self, time: float, inputs: Floats, outputs: Floats) -> None:
        """Note a step."""
        if self.start is None:
            self.start = datetime.now().astimezone() - timedelta(seconds=time)
        self.steps += 1
        self.samples += np.isfinite(inputs[: len(self.samples)])
        if self.stepper.began is None:
            if time >= PATIENCE and not self.told:
                self._say(time, f"monitoring has not begun; {self.stepper.waits_for}")
                self.told = True
            return
        if not self._began:
            self._began = True
            self._say(time, "monitoring has begun")
        self._note_gap(time)
        self.judged += 1
        self.probability += outputs[self._places]
        if self._alarms is not None:
            self._alarms(time, inputs, outputs)

    def numbers(self) -> dict[str, dict[str, Any]]:
        """Return the numbers of each sensor."""
        seconds = max(self.steps, 1) * float(self.stepper.step)
        return {
            name: {
                "samples": int(self.samples[i]),
                "rate": float(self.samples[i] / seconds),
                "mean_probability": float(self.probability[i] / self.judged) if self.judged else None,
                "alarms": self.alarms.counts[name],
            }
            for i, name in enumerate(self.monitor.sensors)
        }

    @property
    def all_gaps(self) -> list[dict[str, float]]:
        """The gaps, and the one that lasts to the end."""
        end = self.steps * float(self.stepper.step)
        return self.gaps + ([] if self._gap_since is None else [{"start": self._gap_since, "end": end}])

    def _note_gap(self, time: float) -> None:
        """Note the begin or the end of a gap."""
        since, begun = self.stepper.gap_since, self._gap_since
        self._gap_since = since
        if since is not None and begun is None:
            text = f"a gap: no sensor has sent a sample since {since:.2f} s; the fault probabilities keep their values"
            self._say(time, text)
        elif begun is not None and since is None:
            self.gaps.append({"start": begun, "end": time})
            del self.gaps[:-MOST]
            self._say(time, f"the gap has ended (since {begun:.2f} s)")

    def _say(self, time: float, text: str) -> None:
        if self.alarms.shown:
            note_at(time, text)


def _print_sensors(numbers: Mapping[str, Any]) -> None:
    console, say = output.sayer()
    say("\nSensors", "bold")
    table = output.empty_table("samples used", "per second", "mean probability", "alarms")
    for name, row in numbers["sensors"].items():
        mean = output.DASH if row["mean_probability"] is None else f"{row['mean_probability']:.4f}"
        table.add_row(name, str(row["samples"]), f"{row['rate']:.4g}", mean, str(row["alarms"]))
    console.print(table)
    for gap in numbers["gaps"]:
        say(f"From {gap['start']:.2f} to {gap['end']:.2f} s no sensor has sent a sample. This gap is no fault.")
    if numbers["began"] is None:
        say("Monitoring has not begun: not all sensors have sent enough samples.")
    elif numbers["why_no_probability"]:
        say(f"There is no fault probability: {numbers['why_no_probability']}")
