"""``bayesftc fit``: parameters of an FMU from a recording, a figure and the numbers."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.cli.commands.fmus.inspect import find_fmu
from bayesftc.cli.options import Json, Quiet, as_invalid, by_options
from bayesftc.cosim.base.invalid import numbers_of, without_texts
from bayesftc.cosim.base.recordings.columns import column_called
from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.cosim.errors import UnknownNameError, did_you_mean
from bayesftc.cosim.judging.metrics import without_nan

if TYPE_CHECKING:
    import pandas as pd

FITTED, FIGURE = "fit.json", "figure.png"

OPTIONS = {"time": "--time", "dt": "--dt", "held_out": "--held-out", "inputs": "--input"}
"""Arguments of `bayesftc.cosim.fit` that its errors name, and their options."""


def fit(
    fmu: Annotated[str, typer.Argument(help="An FMU file, or the name of a shipped FMU, as CruiseControl.")],
    recording: Annotated[Path, typer.Argument(help="A CSV or Parquet file with the recording.")],
    parameters: Annotated[
        list[str],
        typer.Option("--parameter", metavar="NAME=LOW:HIGH", help="A parameter and its range; repeat for more."),
    ],
    outputs: Annotated[
        list[str],
        typer.Option(
            "--output",
            metavar="NAME=COLUMN,...",
            help="An output of the FMU and the columns of its sensors; repeat for more.",
        ),
    ],
    inputs: Annotated[
        list[str] | None,
        typer.Option("--input", metavar="NAME=COLUMN", help="An input of the FMU and its column; repeat for more."),
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="The column of times; by default the one called t, time, timestamp or t_ms, or one with dates."
        ),
    ] = None,
    dt: Annotated[
        float | None, typer.Option(help="Seconds between two steps, if the times are not evenly spaced.")
    ] = None,
    held_out: Annotated[
        float, typer.Option(help="Share of the recording, at its end, that the fit does not use.")
    ] = 0.2,
    all_samples: Annotated[
        bool, typer.Option("--all-samples", help="Count all samples, also those that are probably faulty.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write fit.json and figure.png there.")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    *,
    invalid: Annotated[
        list[str] | None,
        typer.Option(
            "--invalid",
            metavar="VALUE",
            help="A value or text that stands for no sample, in all inputs and outputs (0, or 'Bad Input') or in one column "
            "(lidar=0); repeat it for more.",
        ),
    ] = None,
) -> None:
    """Fit parameters of an FMU to a recording, print them and write the files."""
    from bayesftc import cosim

    if out is not None:
        output.check_folder(out, (FITTED, FIGURE), silent=quiet or json)
    read = _pairs("--input", inputs or (), "NAME=COLUMN", alone=True)
    sensed = {
        name: text.split(",") for name, text in _pairs("--output", outputs, "NAME=COLUMN,...", alone=True).items()
    }
    named = [*read.values(), *(column for columns in sensed.values() for column in columns)]
    with by_options(**OPTIONS):
        fitted = cosim.fit(
            find_fmu(fmu),
            _without(as_invalid(invalid), recording, named) if invalid else recording,
            {name: _range(name, text) for name, text in _pairs("--parameter", parameters, "NAME=LOW:HIGH").items()},
            inputs=read,
            outputs=sensed,
            time=time,
            dt=dt,
            held_out=held_out,
            weigh=None if all_samples else "learner",
        )
    numbers = summary(fitted)
    if out is not None:
        from bayesftc.cosim.fitting.figure import plot_fit

        picture = io.BytesIO()
        plot_fit(fitted).savefig(picture, dpi=output.DOTS_PER_INCH, format="png")
        with output.staged(out) as stage:
            (stage / FITTED).write_text(output.as_json(numbers) + "\n", encoding="utf-8")
            (stage / FIGURE).write_bytes(picture.getbuffer())
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        _print(numbers, out)


def summary(fitted: Any) -> dict[str, Any]:
    """Return a fit as plain data."""
    names, units = list(fitted.parameters), fitted.units
    return dict(
        without_nan(
            {
                "parameters": {
                    name: {
                        "value": fitted.parameters[name],
                        "std": fitted.std[name],
                        "determined": name not in fitted.undetermined,
                        "unit": units[name],
                    }
                    for name in names
                },
                "correlation": dict(
                    zip(names, (dict(zip(names, row, strict=True)) for row in fitted.correlation.tolist()), strict=True)
                ),
                "profile": [asdict(combination) for combination in fitted.profile],
                "sensors": {
                    column: {
                        "offset": fitted.offsets[column],
                        "rms": fitted.rms[column],
                        "held_out": fitted.held_out[column],
                        "samples": int(np.isfinite(fitted.measured[:, i]).sum()),
                        "counted": float(fitted.weights[:, i].sum()),
                    }
                    for i, column in enumerate(fitted.rms)
                },
                "sentences": list(fitted.sentences),
            }
        )
    )


def _without(invalid: Mapping[str, Sequence[float | str]], recording: Path, named: Sequence[str]) -> pd.DataFrame:
    """Return the recording without values that stand for no sample: by column, and those of ``""`` in all named columns."""
    import pandas as pd

    table = read_table_file(recording)
    columns = list(map(str, table.columns))
    values: dict[str, list[float | str]] = {}
    for name, given in invalid.items():
        for each in [name] if name else named:
            column = column_called(each, columns)
            if column is not None:
                values.setdefault(column, []).extend(given)
            elif name:
                raise UnknownNameError(
                    f"The recording has no column {name!r} for --invalid; {did_you_mean(name, columns)}"
                )
    for column, absent in values.items():
        cells = table[column]
        if cells.dtype.kind not in "fiub":
            with suppress(ValueError):  # of other texts, which the fit refuses
                cells = pd.to_numeric(without_texts(cells, absent))
        table[column] = cells.mask(cells.isin(numbers_of(absent)))
    return table


def _pairs(option: str, given: Sequence[str], form: str, *, alone: bool = False) -> dict[str, str]:
    """Return the name and the text of each option, of the given form; with `alone`, a name alone stands for ``NAME=NAME``."""
    pairs: dict[str, str] = {}
    for text in given:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not name or not (value or (alone and not sign)):
            raise typer.BadParameter(f"{option} {text} has no name or no value. Write {form}.")
        if name in pairs:
            raise typer.BadParameter(f"{option} names {name!r} twice. Give each name once.")
        pairs[name] = value or name
    return pairs


def _range(name: str, text: str) -> tuple[float, float]:
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise typer.BadParameter(
            f"--parameter {name}={text} has no range. Write {name}=LOW:HIGH, as m=80:120."
        ) from None
    return low, high


def _print(numbers: dict[str, Any], folder: Path | None) -> None:
    console, say = output.sayer()
    table = output.empty_table("value", "standard error", "unit")
    for name, row in numbers["parameters"].items():
        std = output.DASH if row["std"] is None else f"{row['std']:.2g}" if row["determined"] else "not determined"
        table.add_row(name, f"{row['value']:.6g}", std, row["unit"])
    console.print(table)
    sensors = output.empty_table("samples", "counted", "rms error", "rms error held out")
    for column, row in numbers["sensors"].items():
        errors = [output.DASH if row[key] is None else f"{row[key]:.4g}" for key in ("rms", "held_out")]
        sensors.add_row(column, str(row["samples"]), f"{row['counted']:.0f}", *errors)
    console.print(sensors)
    for sentence in numbers["sentences"]:
        say(sentence)
    if folder is not None:
        say(f"\nWritten to {folder}: {FITTED}, {FIGURE}")
