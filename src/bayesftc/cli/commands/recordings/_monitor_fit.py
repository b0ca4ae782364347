"""``bayesftc monitor --fit``: from a recording to a model file, and a printed summary."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.controllers.switching.fault_modes import HEALTHY_REPEATS
from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.numbers import with_and
from bayesftc.cosim.base.recordings.columns import bare_name, column_called, column_unit
from bayesftc.cosim.base.recordings.dates import date_at, time_text
from bayesftc.cosim.base.recordings.local_dates import day_first_date
from bayesftc.cosim.base.recordings.turns import find_period
from bayesftc.cosim.base.timebase import spoken
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.errors import RecordingError, ResultFileError
from bayesftc.monitoring import (
    FittedModel,
    Monitor,
    Place,
    Recording,
    Signal,
    as_model_file,
    fit_model,
    recorded,
    stretch_of,
)
from bayesftc.monitoring.csv import Tables
from bayesftc.monitoring.fit.bias import gains
from bayesftc.monitoring.fit.codes import Code, codes, codes_of_angles
from bayesftc.monitoring.fit.columns import signals_of, without_numbers
from bayesftc.monitoring.fit.doubtful import doubtful_sensors, lasting_errors
from bayesftc.monitoring.fit.units import in_unit
from bayesftc.monitoring.gaps import in_gaps

MODEL = "model.toml"

OPPOSITE = (-1.2, -0.8)
"""Range of the motion of a sensor that measures the same the other way, while the others move by 1."""
FAHRENHEIT = 0.03
"""Relative error of a factor from which it is not the one between degC and degF."""


@dataclass(frozen=True)
class Fit:
    """The part of a recording that a model is fitted to: times (seconds or dates) and columns, by default everything.

    `invalid` has the values that stand for no sample, by column, as in `redundant_signals`.
    """

    start: float | datetime | None = None
    stop: float | datetime | None = None
    sensors: tuple[str, ...] = ()
    invalid: Mapping[str, Sequence[float | str]] = field(default_factory=dict)


class FittedFiles(NamedTuple):
    """A fitted model, its recording, and notes for the user."""

    model: FittedModel
    recording: Recording
    notes: list[str]


def as_moment(option: str, text: str | None) -> float | datetime | None:
    """Return the time of an option, in seconds or as a date."""
    if text is None:
        return None
    for read in (float, datetime.fromisoformat):
        with suppress(ValueError):
            return read(text.strip())
    if date := day_first_date(text):
        with suppress(ValueError):  # no such day
            moment = datetime.fromisoformat(date)
            inform(f"{option} {text.strip()} has the day first: it is read as {date}.")
            return moment
    raise typer.BadParameter(
        f"{text!r} is neither a number of seconds nor a date. Write {option} 12.5, or {option} 2026-05-01T10:00:12 if the times "
        "of the recording are dates.",
        param_hint=option,
    )


def _check_invalid(invalid: Mapping[str, Sequence[float | str]], tables: Tables) -> None:
    """Refuse a column without a value in the option --invalid."""
    columns = [name for file in tables.files() for name in tables.numeric(file)]
    for text in invalid.get("", ()):
        if isinstance(text, str) and column_called(text, columns):
            raise typer.BadParameter(
                f"{text!r} has no number. Write --invalid 0 for all columns, or --invalid {text}=0 for the column {text}.",
                param_hint="--invalid",
            )


def fit_files(recording: Sequence[Path], part: Fit, model: Path, *, overwrite: bool) -> FittedFiles:
    """Fit a model to CSV files or folders, write it, and return it with the recording and notes.

    A file that has exactly this model stays as it is, so that a command can be repeated.

    Raises
    ------
    ResultFileError
        If the model file exists with another content and `overwrite` is not set, or if it cannot be written.
    """
    tables = Tables(recording)
    _check_invalid(part.invalid, tables)
    places, signals = signals_of(tables, part.sensors, part.invalid)
    output.check_folder(model.parent, (model.name,), silent=True)
    turned = codes_of_angles(signals)
    for name, code in turned.items():
        signals[name] = replace(signals[name], invalid=(*signals[name].invalid, code.value))
    samples = recorded(signals)
    stretch = stretch_of(samples, part.start, part.stop)
    slow = _held(places, signals)
    try:
        fitted = fit_model(samples, stretch, gains=not any(place.period for place in places.values()))
    except RecordingError as error:  # with what the user does not see in the file
        reasons = [f"{note.partition('. ')[0]}." for name, note in slow.items() if repr(name) in str(error)]
        raise RecordingError(" ".join([str(error), *reasons])) from None
    text = as_model_file(fitted, samples, places, stretch)
    if os.path.lexists(model) and not overwrite and not _has(model, text):
        raise ResultFileError(
            f"{model} exists already, with another content. Add --overwrite to replace it, name another file with --model, or "
            f"give --model {model} without --fit to use it."
        )
    found = codes(samples)
    with output.staged(model.parent) as stage:
        (stage / model.name).write_text(text, encoding="utf-8")
    return FittedFiles(
        fitted,
        samples,
        [
            *_without_numbers(tables, part),
            *_angles(places),
            *slow.values(),
            *_codes({**found, **turned}, samples, tables, places),
            *_strangers(fitted, samples),
            *_without_unit(fitted, places),
            *_one_by_one(fitted, [*found]),
            *_changes(fitted, samples, stretch),
            *_parted(fitted, samples, stretch),
            *_gains(fitted, samples, stretch, model),
            *fit_notes(fitted, part, samples.units),
        ],
    )


def _without_numbers(tables: Tables, part: Fit) -> Iterator[str]:
    """Give a note on columns that no one has left out, but that nobody sees in the results."""
    names = [] if part.sensors else list(map(repr, without_numbers(tables)))
    if len(names) == 1:
        yield f"The column {names[0]} has no numbers; it is not monitored."
    elif names:
        yield f"The columns {', '.join(names[:-1])} and {names[-1]} have no numbers; they are not monitored."


def _angles(places: Mapping[str, Place]) -> Iterator[str]:
    """Give a note that the columns are angles, whose samples count on after a full turn."""
    period = next(iter(places.values())).period
    if period:
        yield (
            f"The samples jump by about {period:.4g} up and down, as an angle does after a full turn. The fit and the monitor "
            f"count on instead: each sensor has period = {period:.10g} in the model file. If the columns are no angles, delete "
            "these lines there and give --model without --fit."
        )


def _held(places: Mapping[str, Place], signals: Mapping[str, Signal]) -> dict[str, str]:
    """Return a note for each sensor whose last value the log repeats until the next one."""
    intervals = {name: float(np.median(np.diff(signals[name].corrected[0]))) for name in places if places[name].held}
    return {
        name: f"{name} has a new value about every {interval:.2g} s, and repeats it in the rows between. The fit and the monitor "
        f"take repeated values for no samples: {name} has held = true in the model file. If {name} freezes, it then counts as "
        "dropped out (DroppedOut). If repeated values are samples, delete this line there and give --model without --fit."
        for name, interval in intervals.items()
    }


def turns_note(monitor: Monitor, recording: Recording, model: Path) -> list[str]:
    """Return a note if samples look like those of an angle, but the model file does not say so."""
    period = 0.0 if any(sensor.period for sensor in monitor.sensors.values()) else find_period(recording.y.T)
    if not period:
        return []
    return [
        f"The samples jump by about {period:.4g} up and down, as an angle does after a full turn. If they are angles, add "
        f"period = {period:.10g} below each of their sensors in {model}: the monitor then counts on instead."
    ]


def _codes(
    found: Mapping[str, Code], recording: Recording, tables: Tables, places: Mapping[str, Place]
) -> Iterator[str]:
    """Give a note for each sensor that seems to record a value in place of a sample."""
    for name, code in found.items():
        others = "the other sensors of its quantity are" if len(recording.sensors) > 2 else "the other sensor is"
        place = places[name]
        files = tables.having(place.file or None, place.column, name)
        logged = np.unique(np.concatenate([tables.column(file, place.column, name, place.invalid) for file in files]))
        converted = in_unit(logged, places[name].column, recording.units[recording.sensors.index(name)])
        value = f"{logged[np.nanargmin(np.abs(converted - code.value))]:.10g}"
        option = f"--invalid {shlex.quote(f'{places[name].column}={value}')}"
        yield (
            f"{name} is exactly {value} in {100 * code.share:.2g}% of its samples, while {others} not near {value}. The noise of "
            f"{name} is fitted without these samples. If {value} means 'no measurement', add {option}: otherwise the monitor "
            "takes them for samples."
        )


def _strangers(fitted: FittedModel, recording: Recording) -> Iterator[str]:
    """Give a note for each sensor that does not follow the others, or for two that do not agree."""
    places = dict(zip(recording.sensors, np.nanmedian(recording.y, axis=0), strict=True))
    if len(fitted.sensors) == 2 and fitted.strangers:
        (one, slope), (other, _) = fitted.strangers.items()
        how = f"while one of them moves by 1, the other moves by {_slope(slope)}"
        if np.isnan(slope):
            at = [_beside(place, places[one] - places[other]) for place in places.values()]
            how = f"they lie at {at[0]} and {at[1]}, and no common motion is visible"
        yield (
            f"{one} and {other} do not agree: {how}. At least one of them is wrong, or measures another quantity, but two "
            f"sensors do not show which one. The monitor needs sensors of one quantity.{_fahrenheit(slope, one, other)}"
        )
        return
    others = next((name for name in fitted.sensors if name not in fitted.strangers), "")
    typical = np.median([place for name, place in places.items() if name not in fitted.strangers])
    for name, slope in fitted.strangers.items():
        how = f"does not follow the other sensors: while they move by 1, it moves by {_slope(slope)}"
        if np.isnan(slope):
            here, there = (_beside(place, places[name] - typical) for place in (places[name], typical))
            how = (
                f"does not seem to measure the same quantity as the other sensors: it lies at {here}, they lie at about {there}, "
                "and it does not visibly move with them"
            )
        yield (
            f"{name} {how}. Motion and the noise "
            f"of the others are fitted without {name}, and its whole distance from them counts as noise. If {name} measures "
            "another quantity, leave it out: name the others with --sensor. If it has failed in most of this recording, fit to a "
            f"stretch without the fault: --from and --to.{_fahrenheit(slope, name, others)}{_opposite(fitted, name, slope)}"
        )


def _beside(place: float, distance: float) -> str:
    """Return a place with as many digits as its distance from another one needs."""
    return f"{round(place, 2 - int(np.floor(np.log10(abs(distance))))) + 0.0:.6g}"


def _without_unit(fitted: FittedModel, places: Mapping[str, Place]) -> Iterator[str]:
    """Give a note that some columns have a unit in brackets but others have none, and no motion shows whether they follow."""
    units = {name: column_unit(place.column) for name, place in places.items() if name not in fitted.strangers}
    named, bare = [name for name, unit in units.items() if unit], [name for name, unit in units.items() if not unit]
    if named and bare and not fitted.moves:
        has = "has no unit" if len(bare) == 1 else "have no unit"
        yield (
            f"{with_and(bare)} {has} in brackets, but {named[0]} has. The fit takes all for samples in {units[named[0]]}. If a "
            "column measures another quantity, leave it out: name the others with --sensor."
        )


def _one_by_one(fitted: FittedModel, coded: Sequence[str]) -> Iterator[str]:
    """Give a note that sensors are not judged together, and what to do."""
    if fitted.joint:
        return
    names, how = (
        (coded, "with --invalid") if fitted.coded else (fitted.strangers, "other columns (--sensor) or another stretch")
    )
    yield (
        f"The model file has no joint = true, because of {with_and([*names])}: sensors are judged one by one, and healthy ones "
        f"are blamed more often than if they are judged together. For that, fit {how} as said above."
    )


def _opposite(fitted: FittedModel, name: str, slope: float) -> str:
    """Return a sentence if a sensor moves by about -1 while the others move by 1."""
    if not OPPOSITE[0] < slope < OPPOSITE[1]:
        return ""
    bias = fitted.sensors[name].bias + 2.0 * fitted.level
    return (
        f" If it measures the same the other way, as an altitude beside a depth, write gain = -1.0 and bias = {bias:.4g} below "
        f"[sensors.{name}] in the model file, and the std of its noise."
    )


def _fahrenheit(slope: float, name: str, other: str) -> str:
    """Return a sentence if a sensor moves by the factor from degC to degF while another moves by 1, or by its inverse."""
    for factor, units in ((1.8, ("degF", "degC")), (1 / 1.8, ("degC", "degF"))):
        if abs(slope / factor - 1) < FAHRENHEIT:
            renamed = [f"{bare_name(column)} [{unit}]" for column, unit in zip((name, other), units, strict=True)]
            return (
                f" A factor of {slope:.3g} is that from {units[1]} to {units[0]}. If these are the units, name the columns "
                f"{renamed[0]!r} and {renamed[1]!r}: then they are converted."
            )
    return ""


def _changes(fitted: FittedModel, recording: Recording, stretch: slice) -> Iterator[str]:
    """Give a note for each sensor that has moved away from the others in the stretch, and not returned."""
    first, last, _ = stretch.indices(len(recording.time))
    for name, change in fitted.changes.items():
        if not first < change.begin < last - 1:  # --to includes its own step
            continue  # the user knows when it was healthy
        size = f"{abs(change.size):.3g} {recording.units[recording.sensors.index(name)]}".rstrip()
        place = f"{size} {'above' if change.size > 0 else 'below'} its place among the other sensors"
        since = float(recording.time[change.begin])
        begin, end = (time_text(t, recording.origin) for t in (since, recording.time[-1]))
        moment, reached = (_moment(recording, step) for step in (change.begin, change.reached or change.begin))
        course = (
            f"is {place}, until the end ({end})"
            if change.sudden
            else f"moves away from the other sensors. At the end ({end}) it is {place}"
        )
        if change.reached is not None:
            grown = time_text(float(recording.time[change.reached]), recording.origin)
            course = f"moves away from the other sensors. From about {grown} until the end ({end}) it is {place}"
        then = "since then" if change.reached is None else "since it has stayed there"
        since_then = f" If it has been healthy {then}, fit with --from {reached}." if change.sudden else ""
        yield (
            f"From about {begin} on, {name} {course}. The fit takes this for a fault: {name} has the bias and the lasting errors "
            f"of the time before. If it was healthy until then, fit with --to {moment}.{since_then} If it measures another "
            "quantity, leave it out: name the others with --sensor."
        )


def _parted(fitted: FittedModel, recording: Recording, stretch: slice) -> Iterator[str]:
    """Give a note if two sensors have moved apart in the stretch, and not returned."""
    change, (first, last, _) = fitted.parted, stretch.indices(len(recording.time))
    if change is None or not first < change.begin < last - 1:
        return
    one, other = recording.sensors
    size = f"{abs(change.size):.3g} {recording.units[0]}".rstrip()
    begin, end = (time_text(float(recording.time[k]), recording.origin) for k in (change.begin, -1))
    place = f"{size} {'above' if change.size > 0 else 'below'} its place beside {other}"
    how = f"{one} is {place}" if change.sudden else f"{one} and {other} move apart. At the end ({end}) {one} is {place}"
    yield (
        f"From about {begin} on, {how}. The fit takes this for a fault of one of them, and uses the time before for biases and "
        "lasting errors. Two sensors do not show which one has moved: where the monitor names one, only the motion speaks for it."
    )


def _gains(fitted: FittedModel, recording: Recording, stretch: slice, model: Path) -> Iterator[str]:
    """Give a note for a sensor whose difference from the others is proportional to the quantity."""
    if fitted.strangers or fitted.changes or fitted.coded:
        return
    first, two = recording.sensors[0], len(recording.sensors) == 2
    others = f"{first} moves" if two else "the other sensors move"
    error = "a gain error"
    if two:
        error = f"one of the two has a gain error. Which one is not known: the belief has the scale of {first}"
    divided = {name: sensor for name, sensor in fitted.sensors.items() if sensor.gain != 1.0}
    for name, sensor in divided.items():
        bias = sensor.bias + (sensor.gain - 1) * fitted.level
        yield (
            f"While {others} by 1, {name} moves by {sensor.gain:.4g}, in both halves of the recording: {error}. The model file "
            f"has this gain, and the samples of {name}, less the bias, are divided by it. To undo this, write gain = 1 and "
            f"bias = {bias:.3g} below [sensors.{name}] in {model}, and give --model without --fit."
        )
    if divided:
        return
    for i, gain in gains(recording.y[stretch], [sensor.std for sensor in fitted.sensors.values()]).items():
        name = recording.sensors[i]
        bias = fitted.sensors[name].bias - gain * fitted.level
        yield (
            f"While {others} by 1, {name} moves by {1 + gain:.4g}, but not in both halves of the recording. A fault may be the "
            "reason, or too little motion in one half. The model file has no gain. A gain error may cause false alarms, mostly "
            f"of the kind Drifting. If {name} has one, write gain = {1 + gain:.4g} and bias = {bias:.3g} below [sensors.{name}] "
            f"in {model}, and give --model without --fit."
        )


def _moment(recording: Recording, step: int) -> str:
    """Return the time of a step for --from or --to."""
    seconds = float(recording.time[step])
    return f"{seconds:.10g}" if recording.origin is None else date_at(recording.origin, seconds).isoformat()


def _slope(slope: float) -> str:
    """Return a slope with two decimals, and without the sign of a zero."""
    return f"{round(slope, 2) + 0.0:.2g}"


def _has(file: Path, text: str) -> bool:
    try:
        return file.read_text(encoding="utf-8") == text
    except (OSError, UnicodeDecodeError):
        return False


def fitted_summary(fitted: FittedModel, model: Path) -> dict[str, Any]:
    """Return the fitted model as plain data."""
    return {
        "file": str(model),
        "model": type(fitted.plant).__name__,
        "std": fitted.plant.std,
        "moves": fitted.moves,
        "sensors": {name: asdict(sensor) for name, sensor in fitted.sensors.items()},
        "errors": [asdict(errors) for errors in fitted.errors],
        "changes": {name: change._asdict() for name, change in fitted.changes.items()},
    }


def fit_notes(fitted: FittedModel, part: Fit, units: Sequence[str] = ()) -> list[str]:
    """Return a note for each sensor that may have failed in the stretch of the fit, or that measures another quantity."""
    return [
        f"The errors of {name} last, and are {ratio:.0f} times its noise and far above those of the other sensors. If {name} has "
        "failed in this recording, the model expects the fault: its alarm ends too early, or there is none. Name a stretch "
        "without faults with --from and --to, or fit a file that has only that stretch. If it measures another "
        "quantity, leave it out: name the others with --sensor."
        for name, ratio in doubtful_sensors(fitted).items()
        if name not in fitted.strangers
    ] + list(_outside(fitted, part, _one_unit(units)))


def _one_unit(units: Sequence[str]) -> str:
    """Return the unit that all have; none if they differ."""
    return units[0] if len(set(units)) == 1 else ""


def _outside(fitted: FittedModel, part: Fit, unit: str) -> Iterator[str]:
    """Give a note that the model expects slow errors which are rare, or which the stretch of healthy sensors does not show."""
    if fitted.outside:
        size, seconds = float(np.max(fitted.outside.std)), float(np.max(fitted.outside.time_constant))
        named = part.start is not None or part.stop is not None
        where, there = ("Outside of the stretch", "there") if named else ("In a small part of the recording", "then")
        yield (
            f"{where}, biases wander by {size:.2g}{behind(unit)} within {spoken(seconds)}, and the model expects that of healthy "
            f"sensors. If sensors failed {there}, slow drifts are not found: put rows with healthy sensors into a file of their "
            "own, and fit that."
        )


def print_fit(fitted: FittedModel, recording: Recording, part: Fit, model: Path) -> None:
    """Print the fitted model."""
    console, say = output.sayer()
    say("Fitted model", "bold")
    unit = _one_unit(recording.units)
    say(_motion(fitted, unit, float(recording.dt)))
    table = output.empty_table("noise", "lasting errors", "bias", "resolution", "repeats", "missing")
    errors = lasting_errors(fitted)
    for name, sensor in fitted.sensors.items():
        lasting = f"{errors[name]:.3g}" if errors[name] else output.DASH
        resolution = f"{sensor.resolution:.3g}" if sensor.resolution else "fine"
        shares = f"{sensor.repeats:.1%}", f"{sensor.missing:.1%}"
        table.add_row(name, f"{sensor.std:.3g}", lasting, f"{sensor.bias:.3g}", resolution, *shares)
    console.print(table)
    for each in fitted.errors:
        if each.common:
            say(f"{' and '.join(each.sensors or ())} have common errors of std {float(np.max(each.std)):.3g}.")
    if unit:
        say(f"Noise, lasting errors, bias and resolution are in {unit}.")
    say(
        "Noise: standard deviation from sample to sample. Lasting errors: standard deviation of errors that persist over many "
        "samples. Bias: difference from the typical sensor."
    )
    say(
        "Resolution: least difference of two samples; fine: too small to matter. Repeats: share of samples that equal the one "
        f"before, at least {HEALTHY_REPEATS:.1%}. Missing: share of the steps without a sample. Both leave out parts of the "
        "recording with far more than usual, such as a freeze."
    )
    if part.start is not None or part.stop is not None:
        say(
            "All but the motion, which is that of the whole recording, comes from the stretch between --from and --to."
            if not fitted.borrows
            else "Biases, repeats and missing come from the stretch between --from and --to. Motion and noise come from the "
            "whole recording, because the stretch is too short or too calm for them; the noise is at most twice that of the "
            "stretch. "
            "Lasting errors outside the stretch count if most sensors have them. To fit the stretch alone, put its rows into a "
            "file of their own."
        )
    if gaps := _gaps(recording):
        say(gaps)
    say(f"Written to {model}\n")


def _gaps(recording: Recording) -> str:
    """Return a sentence about the gaps in which all sensors lack samples, which are unusual parts; empty without them."""
    silent = int(in_gaps(recording.y).all(axis=1).sum())
    return f"The gaps ({silent / len(recording.y):.0%} of the steps) are not counted as missing." if silent else ""


def _motion(fitted: FittedModel, unit: str, dt: float) -> str:
    """Return a sentence about the motion in one second, as in the model file, and of a random walk also in a step."""
    what, plant = (
        ("The rate of the quantity", f" {unit}/s" if unit else " per second")
        if fitted.belief
        else ("The quantity", behind(unit))
    )
    step = "" if fitted.belief or dt == 1.0 else f" ({fitted.plant.std * dt**0.5:.2g}{plant} in a sample of {dt:g} s)"
    how = f"{fitted.plant.std:.2g}{plant} in one second{step}, at random ({type(fitted.plant).__name__})."
    if not fitted.moves:
        return f"From sample to sample no motion is visible above the noise. {what} may change by about {how}"
    return f"{what} changes by about {how} It often changes less: this is an upper quantile over the recording."
