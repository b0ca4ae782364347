"""``bayesftc live``: a scenario's controller between wires, paced by the clock."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from bayesftc.cli import output
from bayesftc.cli.live_report import (
    Alarms,
    all_of,
    as_numbers,
    print_alarms,
    print_summary,
    run_between,
)
from bayesftc.cli.options import Json, LiveDuration, Quiet, RecordFolder, check_numbers
from bayesftc.cli.page import HOST, PORT, Beside, Drops, Host, OpenPage, PageBeside, PagePort, page_beside
from bayesftc.cosim.live.run import LiveSettings
from bayesftc.monitoring.watching import ActuatorWatch, AlarmWatch
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
    serve: Beside = False,
    drops: Drops = False,
    host: Host = HOST,
    port: PagePort = PORT,
    open_page: OpenPage = False,
) -> None:
    """Run a controller against a real plant, or one in another process, and print deadlines, missing samples and alarms.

    Ctrl-C and SIGTERM end the run: the safe values are sent, and the recording is completed.
    """
    page = PageBeside(serve, drops, host, port, open_page)
    page.check("bayesftc live")
    check_numbers(duration=duration, pace=pace)
    wires = load_wires(bridge)
    received = [name for wire in wires.wires.values() if wire.is_input for name in wire.names]
    loaded = live_controller(controller, received)
    with loaded.stepper() as stepper, ExitStack() as stack:
        stepper.prepare()
        watches = [
            AlarmWatch(loaded.sensors, loaded.modes, stepper.step),
            ActuatorWatch(loaded.actuators, loaded.actuator_modes, stepper.step),
        ]
        alarms = Alarms(watches, "controller.", shown=not quiet)
        watchers, opened = [alarms.watcher(stepper)], None
        if serve:
            from bayesftc.console.desk.live import LiveRun, controller_lane

            lane, recording = controller_lane(loaded, stepper), wires.recording(record)
            shown = LiveRun(Path(controller).stem, lane, wires.wires, recording, drops=drops)
            stack.enter_context(page_beside(shown, page))
            watchers.append(shown.feed)
            opened = shown.opened
        settings = LiveSettings(duration, pace, wires.watchdog, wires.recording(record), all_of(watchers), opened)
        settings.steps(stepper.step)  # errors of the options are not those of the wires
        summary = run_between(stepper, wires, settings)
    numbers = as_numbers(summary, alarms.close())
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        print_summary(numbers)
        if numbers["alarms"]:
            print_alarms(numbers)
