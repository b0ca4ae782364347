"""``bayesftc live``: a scenario's controller between wires, paced by the clock."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesftc.cli import output
from bayesftc.cli.commands.loops._live_report import Alarms, as_numbers, print_alarms, print_summary
from bayesftc.cli.options import Json, LiveDuration, Quiet, RecordFolder
from bayesftc.cosim.live.run import LiveSettings, run_live
from bayesftc.monitoring.watching import AlarmWatch
from bayesftc.scenario.live import live_controller, load_wires

Bridges = Annotated[
    Path, typer.Option("--bridge", metavar="TOML", help="File of wires: where samples come from, and where outputs go.")
]


def live(
    controller: Annotated[
        str,
        typer.Argument(
            metavar="CONTROLLER",
            help="A scenario file, or the name of a shipped one: its controller and reference run, its plant does not.",
        ),
    ],
    bridge: Bridges,
    duration: LiveDuration = None,
    record: RecordFolder = None,
    pace: Annotated[
        float, typer.Option(metavar="FACTOR", help="Seconds of the controller for each second of the clock.")
    ] = 1.0,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a controller against a real plant, or one in another process, and print deadlines, missing samples and alarms.

    Ctrl-C and SIGTERM end the run: the safe values are sent, and the recording is completed.
    """
    wires = load_wires(bridge)
    received = [name for wire in wires.wires.values() if wire.is_input for name in wire.names]
    loaded = live_controller(controller, received)
    with loaded.stepper() as stepper:
        stepper.prepare()
        alarms = Alarms([AlarmWatch(loaded.sensors, loaded.modes, stepper.step)], "controller.", shown=not quiet)
        settings = LiveSettings(duration, pace, wires.watchdog, wires.recording(record), alarms.watcher(stepper))
        settings.steps(stepper.step)  # errors of the options are not those of the wires
        with wires.named():
            summary = run_live(stepper, wires.wires, settings)
    numbers = as_numbers(summary, alarms.close())
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        print_summary(numbers)
        if numbers["alarms"]:
            print_alarms(numbers)
