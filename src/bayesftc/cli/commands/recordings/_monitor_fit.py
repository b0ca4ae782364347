"""``bayesftc monitor --fit``: from a recording to a model file, and a printed summary."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cli import output
from bayesftc.cosim.errors import ResultFileError
from bayesftc.monitoring import (
    FittedModel,
    RandomWalk,
    Recording,
    as_model_file,
    fit_model,
    recorded,
    redundant_signals,
    stretch_of,
)
from bayesftc.monitoring.fit.doubtful import doubtful_sensors, lasting_errors

MODEL = "model.toml"
LONG = 10
"""Steps without a sample of any sensor beyond which they are a gap of the recording."""


@dataclass(frozen=True)
class Fit:
    """The part of a recording that a model is fitted to: times in seconds and columns, by default everything."""

    start: float | None = None
    stop: float | None = None
    sensors: tuple[str, ...] = ()


def fit_files(recording: Sequence[Path], part: Fit, model: Path, *, overwrite: bool) -> tuple[FittedModel, Recording]:
    """Fit a model to CSV files or folders, write it, and return it with the recording.

    A file that has exactly this model stays as it is, so that a command can be repeated.

    Raises
    ------
    ResultFileError
        If the model file exists with another content and `overwrite` is not set, or if it cannot be written.
    """
    places, signals = redundant_signals(recording, part.sensors)
    output.check_folder(model.parent, (model.name,), silent=True)
    samples = recorded(signals)
    stretch = stretch_of(samples, part.start, part.stop)
    fitted = fit_model(samples, stretch)
    text = as_model_file(fitted, samples, places, stretch)
    if os.path.lexists(model) and not overwrite and not _has(model, text):
        raise ResultFileError(
            f"{model} exists already, with another content. Add --overwrite to replace it, name another file with --model, or "
            f"give --model {model} without --fit to use it."
        )
    with output.staged(model.parent) as stage:
        (stage / model.name).write_text(text, encoding="utf-8")
    return fitted, samples


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
    }


def fit_notes(fitted: FittedModel) -> list[str]:
    """Return a note for each sensor that may have failed in the stretch of the fit."""
    return [
        f"The errors of {name} last, and are {ratio:.0f} times its noise and far above those of the other sensors. If {name} has "
        "failed in this recording, the model expects the fault: its alarm ends too early, or there is none. Name a stretch "
        "without faults with --from and --to, in seconds, or fit a file that has only that stretch."
        for name, ratio in doubtful_sensors(fitted).items()
    ]


def print_fit(fitted: FittedModel, recording: Recording, part: Fit, model: Path) -> None:
    """Print the fitted model."""
    console, say = output.sayer()
    say("Fitted model", "bold")
    say(_motion(fitted))
    table = output.empty_table("noise", "lasting errors", "bias", "resolution", "repeats", "missing")
    errors = lasting_errors(fitted)
    for name, sensor in fitted.sensors.items():
        lasting = f"{errors[name]:.3g}" if errors[name] else output.DASH
        resolution = f"{sensor.resolution:.3g}" if sensor.resolution else "fine"
        shares = f"{sensor.repeats:.0%}", f"{sensor.missing:.0%}"
        table.add_row(name, f"{sensor.std:.3g}", lasting, f"{sensor.bias:.3g}", resolution, *shares)
    console.print(table)
    for each in fitted.errors:
        if each.common:
            say(f"{' and '.join(each.sensors or ())} have common errors of std {float(np.max(each.std)):.3g}.")
    say(
        "Noise: standard deviation from sample to sample. Lasting errors: standard deviation of errors that persist over many "
        "samples. Bias: difference from the typical sensor."
    )
    say(
        "Resolution: least difference of two samples; fine: too small to matter. Repeats: share of samples that equal the one "
        "before. Missing: share of the steps without a sample, in a typical part of the fitted steps."
    )
    if part.start is not None or part.stop is not None:
        say(
            "Biases, repeats and missing are those of the stretch between --from and --to. Motion, noise up to twice as large, "
            "and biases that change are those of the whole recording, because a calm stretch does not show them. To leave the "
            "rest out, fit a file without it."
        )
    if gaps := _gaps(recording):
        say(gaps)
    say(f"Written to {model}\n")


def _gaps(recording: Recording) -> str:
    """Return a sentence about the gaps in which all sensors lack samples, which no typical part has; empty without them."""
    sampled = np.flatnonzero(np.isfinite(recording.y).any(axis=1))
    usual = max(LONG, *(3 * int(np.median(np.diff(np.flatnonzero(np.isfinite(y))))) for y in recording.y.T))
    lengths, dt = np.diff(sampled) - 1, float(recording.dt)
    gaps = lengths[lengths > usual]
    if not len(gaps):
        return ""
    longest = int(np.argmax(lengths))
    first, last = recording.time[sampled[longest]], recording.time[sampled[longest + 1]]
    share = gaps.sum() / len(recording.y)
    return (
        f"Gaps are not counted as missing: no sensor has a sample in {100 * share:.0f} % of the steps, {gaps.sum() * dt:.4g} s "
        f"in all, the longest time from {first:.10g} to {last:.10g} s."
    )


def _motion(fitted: FittedModel) -> str:
    std = f"{fitted.plant.std:.3g}"
    if not fitted.moves:
        return f"No motion is visible above the noise. The level may change by {std} in one second (RandomWalk)."
    what = "level changes" if type(fitted.plant) is RandomWalk else "rate of the level changes"
    return f"The {what} by {std} in one second ({type(fitted.plant).__name__})."
