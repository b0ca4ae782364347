"""``bayesftc monitor``: recorded samples to fault probabilities, a figure and a list of faults."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.cli.commands.recordings._faults import Clock, print_disagreements, print_faults
from bayesftc.cli.commands.recordings._monitor_fit import (
    MODEL,
    Fit,
    FittedFiles,
    as_moment,
    fit_files,
    fitted_summary,
    print_fit,
    turns_note,
)
from bayesftc.cli.options import Json, LiveDuration, Quiet, RecordFolder, as_invalid, check_numbers
from bayesftc.cli.page import HOST, PORT, Beside, Drops, Host, OpenPage, PageBeside, PagePort
from bayesftc.controllers import ModelMismatchWarning
from bayesftc.controllers.switching.default_time import time_at
from bayesftc.cosim.base.recordings.dates import date_at, span_text
from bayesftc.cosim.base.recordings.silences import held_notes
from bayesftc.cosim.judging.metrics import without_nan
from bayesftc.monitoring import (
    ActuatorEvent,
    Disagreement,
    FaultEvent,
    Gap,
    ModelSuspicion,
    Monitor,
    Monitored,
    Recording,
    doubtful_alarms,
    load_monitor,
    suspect_model,
)
from bayesftc.monitoring.csv import Tables
from bayesftc.monitoring.fit.doubtful import lasting_errors
from bayesftc.monitoring.fit.suspect import both_blamed, failed_before, moved

if TYPE_CHECKING:
    from bayesftc.controllers import ModelFinding

NAMED = 5
"""Largest number of gaps that are printed with their times."""
DATES = "%Y-%m-%dT%H:%M:%S.%f%z"
FILES = PROBABILITIES, FAULTS, FIGURE = "probabilities.csv", "faults.json", "figure.png"


def monitor(
    recording: Annotated[
        list[Path] | None, typer.Argument(help="CSV files with recorded samples, or a folder of them.")
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="TOML",
            help="Model file: the columns and the sensors' properties. With --fit it is written, by default model.toml.",
        ),
    ] = None,
    fit: Annotated[
        bool,
        typer.Option(
            "--fit", help="First fit the model to the recording. All columns must be sensors of one quantity."
        ),
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="TIME",
            help="With --fit: all sensors are healthy from this time on; seconds, or a date such as 2026-05-01T10:00.",
        ),
    ] = None,
    stop: Annotated[
        str | None, typer.Option("--to", metavar="TIME", help="With --fit: all sensors are healthy up to this time.")
    ] = None,
    sensors: Annotated[
        list[str] | None,
        typer.Option(
            "--sensor",
            help="Fit only this column, with or without the unit in brackets; repeat the option for more columns.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write probabilities.csv, faults.json and figure.png there."),
    ] = None,
    live: Annotated[
        Path | None,
        typer.Option(
            "--live", metavar="TOML", help="File of wires with the samples that arrive now, instead of a recording."
        ),
    ] = None,
    duration: LiveDuration = None,
    record: RecordFolder = None,
    json: Json = False,
    quiet: Quiet = False,
    *,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="With --fit: replace the model file if it exists.")
    ] = False,
    invalid: Annotated[
        list[str] | None,
        typer.Option(
            "--invalid",
            metavar="VALUE",
            help="With --fit: a value or text that stands for no sample, in all columns (0, or 'Bad Input') or in one (lidar=0); "
            "repeat it for more.",
        ),
    ] = None,
    serve: Beside = False,
    drops: Drops = False,
    host: Host = HOST,
    port: PagePort = PORT,
    open_page: OpenPage = False,
) -> None:
    """Find faults in a recording, print them and write the files.

    The model, driven by the recorded inputs, is also compared with the recording. A `ModelMismatchWarning` states differences.

    With --live, samples come from wires. Alarms are printed as they begin and end, until Ctrl-C, SIGTERM or --duration.
    """
    if live is not None:
        if model is None or recording or fit or out is not None:
            raise typer.BadParameter(
                "--live needs --model, and no recording, --fit or --out. Fit the model to a recording first; --record keeps the "
                "signals of a live run."
            )
        from bayesftc.cli.commands.recordings._monitor_live import LiveOptions, monitor_live

        check_numbers(duration=duration)
        page = PageBeside(serve, drops, host, port, open_page)
        monitor_live(model, live, LiveOptions(duration, record, json, quiet, page))
        return
    if duration is not None or record is not None or serve or drops:
        raise typer.BadParameter(
            "--duration, --record, --serve and --drops are for samples that arrive now: add --live."
        )
    if not recording:
        raise typer.BadParameter("there is no recording: give CSV files, or a file of wires with --live.")
    if model is None and not fit:
        Tables(recording)  # says first if a file does not exist
        raise typer.BadParameter("there is no model: give a file with --model, or fit one to the recording with --fit.")
    if overwrite and not fit:
        raise typer.BadParameter("--overwrite replaces the model file that --fit writes: add --fit, or leave it out.")
    if not fit and (sensors or start is not None or stop is not None):
        raise typer.BadParameter("--from, --to and --sensor choose what to fit: add --fit.")
    if not fit and invalid:
        raise typer.BadParameter("--invalid is for a fit: add --fit, or write invalid = [...] in the model file.")
    part = Fit(as_moment("--from", start), as_moment("--to", stop), tuple(sensors or ()), as_invalid(invalid or ()))
    if out is not None:
        output.check_folder(out, FILES, silent=True)
    model = model or (out or Path()) / MODEL
    fitted = None
    if fit:
        fitted = fit_files(recording, part, model, overwrite=overwrite)
        if not (json or quiet):
            print_fit(fitted.model, fitted.recording, part, model)
    loaded = load_monitor(model)
    samples = loaded.read(recording)
    if out is not None and not (quiet or json):
        output.note_replaced(out / name for name in FILES)
    monitored = loaded.run(samples)
    mismatch = loaded.compare(samples, monitored)
    faults = mismatch is not None and mismatch.kind == "sensors"  # which the tables show
    if mismatch is not None and not faults:
        warnings.warn(mismatch.sentence, ModelMismatchWarning, stacklevel=2)
    suspicion = None if mismatch and not faults and loaded.inputs else suspect_model(loaded, monitored)
    if fitted and suspicion and fitted.model.strangers.keys() & set(suspicion.sensors):
        suspicion = None  # a sensor that does not follow the others agrees with everything within its noise
    doubtful = doubtful_alarms(loaded, monitored) if (mismatch and not faults) or suspicion else ()
    both = both_blamed(loaded, monitored)
    open_ = [each for each in monitored.disagreements if each not in both]
    numbers = summary(monitored, open_, mismatch, doubtful) | (
        {} if fitted is None else {"fitted": fitted_summary(fitted.model, model)}
    )
    notes = [] if suspicion is None else [f"{suspicion.sentence} {_remedy(loaded, fitted, suspicion, model)}".rstrip()]
    notes += [] if suspicion or (mismatch and not faults) else failed_before(loaded, monitored)
    if not suspicion:
        change = "" if fitted is None else f" {_change(model)}"
        notes += [f"{sentence}{change}" for sentence in moved(loaded, monitored, both)]
    notes += [mismatch.sentence] if mismatch is not None and faults else []
    alarms: list[FaultEvent | ActuatorEvent | Disagreement] = [*monitored.events, *monitored.actuator_events, *open_]
    notes += held_notes(
        samples.silences,
        lambda silence: any(silence.start <= each.start <= silence.end for each in alarms),
        samples.origin,
    )
    more = turns_note(loaded, samples, model) if fitted is None else fitted.notes
    numbers["notes"] = [*notes, *more]
    if out is not None:
        _write(out, monitored, numbers)
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        _print(monitored, numbers, notes, out, open_, doubtful)
    if not quiet:
        output.say_notes(more)


def _remedy(monitor: Monitor, fitted: FittedFiles | None, suspicion: ModelSuspicion, model: Path) -> str:
    """Return sentences about the fit of a better model; empty for a model with inputs, which is not fitted."""
    if fitted is not None:
        errors = lasting_errors(fitted.model)
        lasting = [name for name in suspicion.sensors if errors[name]]
        healthy = "a stretch in which the sensors are healthy, with --from and --to"
        if suspicion.setting != "motion":
            return f"Fit {healthy}."
        change = _change(model)
        if not 0 < len(lasting) < len(suspicion.sensors):  # errors of all, or of two, are no fault of one
            return change
        failed = f"If {' and '.join(lasting)} failed in this recording, which the model now expects as lasting errors"
        return f"{change} {failed}, fit {healthy}, instead."
    return "" if monitor.inputs else "bayesftc monitor --fit finds such numbers in a recording."


def _change(model: Path) -> str:
    return f"Change it in {model} and give --model {model} without --fit."


def summary(
    monitored: Monitored,
    open_: Sequence[Disagreement],
    mismatch: ModelFinding | None,
    doubtful: Sequence[FaultEvent] = (),
) -> dict[str, Any]:
    """Return the faults, also those of an open sensor, which are due to a wrong model, and how it is wrong, as plain data."""
    recording = monitored.recording
    sensors = {}
    for i, name in enumerate(recording.sensors):
        count = int(np.isfinite(recording.y[:, i]).sum())
        sensors[name] = {
            "samples": count,
            "rate": 1.0 / recording.interval[i],
            "replaced": recording.replaced[i],
            "mean_probability": float(monitored.fault_probability[:, i].mean()),
            "alarms": sum(event.sensor == name and not event.continued for event in monitored.events),
            "bursts": monitored.bursts.get(name),
        }
    return {
        "start": float(monitored.time[0]),
        "end": float(monitored.time[-1]),
        **_dates(recording, start=monitored.time[0], end=monitored.time[-1]),
        "sensors": sensors,
        "faults": [_with_dates(event, recording) | {"doubtful": event in doubtful} for event in monitored.events],
        "disagreements": [_with_dates(each, recording) for each in open_],
        "actuators": {
            name: {
                "mean_probability": float(monitored.actuator_fault_probability[:, j].mean()),
                "alarms": sum(event.actuator == name and not event.continued for event in monitored.actuator_events),
            }
            for j, name in enumerate(monitored.actuators)
        },
        "actuator_faults": [_with_dates(event, recording) for event in monitored.actuator_events],
        "why_no_probability": monitored.why_no_probability,
        "gaps": [_with_dates(gap, recording) for gap in recording.gaps],
        "rest": float(monitored.rest.sum() * float(monitored.recording.dt)),
        "model": None if mismatch is None else dict(without_nan(asdict(mismatch))),
    }


def _dates(recording: Recording, **times: float | None) -> dict[str, str | None]:
    """Return the date of each time, with ``_date`` after its name; nothing for a recording without dates."""
    origin = recording.origin
    if origin is None:
        return {}
    return {
        f"{name}_date": None if time is None else date_at(origin, float(time)).isoformat(timespec="milliseconds")
        for name, time in times.items()
    }


def _with_dates(stretch: FaultEvent | ActuatorEvent | Disagreement | Gap, recording: Recording) -> dict[str, Any]:
    """Return an alarm or a gap as plain data."""
    numbers = asdict(stretch)
    times = {name: numbers[name] for name in ("start", "end", "onset") if name in numbers}
    return numbers | _dates(recording, **times)


def _write(folder: Path, monitored: Monitored, numbers: dict[str, Any]) -> None:
    from bayesftc.monitoring.figure import plot_monitored

    picture = io.BytesIO()
    plot_monitored(monitored).savefig(picture, dpi=output.DOTS_PER_INCH, format="png")
    table, text = monitored.to_pandas(), output.as_json(numbers) + "\n"
    table["t"] = [f"{t:.13g}" for t in monitored.time]  # seconds since 1970 have ten digits before the point
    with output.staged(folder) as stage:
        table.to_csv(stage / PROBABILITIES, index=False, float_format="%.9g", date_format=DATES)
        (stage / FAULTS).write_text(text, encoding="utf-8")
        (stage / FIGURE).write_bytes(picture.getbuffer())


def _gaps(recording: Recording) -> str:
    """Return a sentence about the gaps of a recording: the longest ones, in the order of time."""
    gaps = recording.gaps
    longest = sorted(sorted(gaps, key=lambda gap: gap.samples)[-NAMED:], key=lambda gap: gap.start)
    clock = Clock(recording)
    named = [f"from {clock.whole_span(gap.start, gap.end)} ({gap.samples} samples)" for gap in longest]
    begin = "The recording has a gap" if len(gaps) == 1 else f"The recording has {len(gaps)} gaps"
    lead = ". The longest:" if len(gaps) > NAMED else ":"
    return (
        f"{begin}, in which no sensor has a sample{lead} {', '.join(named)}. A gap is no fault. The fault "
        "probabilities keep their values in it."
    )


def _left_out(recording: Recording) -> str:
    """Return what is left out, and the step with which fewer samples are, if there is one."""
    text = "Left out: of several samples of a sensor in one step, only the last one is used."
    if recording.better is None:
        return text
    how = f"{recording.left_out} are" if recording.left_out else "none is"
    return f"{text} With dt = {float(recording.better):.10g} in the model file, {how} left out."


def _sampling(rate: float) -> str:
    """Return the samples per second, or the seconds between two samples if they are more than one, in three digits."""
    if not rate:
        return output.DASH  # of a single sample
    number = float(f"{1 / rate if rate < 1 else rate:.3g}")
    return f"every {number:g} s" if rate < 1 else f"{number:g} per second"


def _zone(recording: Recording) -> str:
    """Return the time zone of a recording's dates, in brackets; empty without one."""
    zone = None if recording.origin is None else recording.origin.tzname()
    return f" ({zone})" if zone else ""


def _print(
    monitored: Monitored,
    numbers: dict[str, Any],
    notes: Sequence[str],
    folder: Path | None,
    open_: Sequence[Disagreement],
    doubtful: Sequence[FaultEvent],
) -> None:
    console, say = output.sayer()
    recording = monitored.recording
    say(
        f"{span_text(numbers['start'], numbers['end'], recording.origin)}{_zone(recording)}, {len(monitored.time)} steps of "
        f"{float(recording.dt):g} s\n"
    )
    sensors = output.empty_table("samples", "sampling", "left out", "mean probability", "alarms")
    for name, row in numbers["sensors"].items():
        mean = "{:.4f}".format(row["mean_probability"])
        sensors.add_row(
            name, str(row["samples"]), _sampling(row["rate"]), str(row["replaced"]), mean, str(row["alarms"])
        )
    console.print(sensors)
    if any(recording.replaced):
        say(_left_out(recording))
    if monitored.actuators:
        actuators = output.empty_table("mean probability", "alarms")
        for name, row in numbers["actuators"].items():
            actuators.add_row(name, "{:.4f}".format(row["mean_probability"]), str(row["alarms"]))
        say("\nActuators", "bold")
        console.print(actuators)
    if numbers["rest"]:
        say(
            f"For {numbers['rest']:g} s in total, all sensors repeat their values: the quantity or the logger is at rest. "
            "The fault probabilities keep their values in this time."
        )
    if recording.gaps:
        say(_gaps(recording))
    if monitored.why_no_probability:
        say(f"There is no fault probability: {monitored.why_no_probability}")
    else:
        units = zip((*recording.sensors, *recording.inputs), (*recording.units, *recording.input_units), strict=False)
        hold = time_at(monitored.alarm.hold, float(recording.dt))
        events: list[FaultEvent | ActuatorEvent] = [*monitored.events, *monitored.actuator_events]
        print_faults(events, dict(units), recording, doubtful, hold, open_=bool(open_))
        print_disagreements(monitored, open_, doubtful)
    for note in monitored.burst_notes():
        say(note)
    for note in notes:
        say(f"\n{note}")
    if folder is not None:
        say(f"\nWritten to {folder}: {PROBABILITIES}, {FAULTS}, {FIGURE}")
