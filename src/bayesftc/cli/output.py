"""What a run leaves behind: tables on the terminal, and files that appear under their names only when they are whole."""

from __future__ import annotations

import json
import secrets
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import ResultFileError

if TYPE_CHECKING:
    from rich.table import Table

    from bayesftc.cosim.result import Result
    from bayesftc.cosim.roles import LoopSignals

RESULT, FIGURE, NUMBERS = "result.npz", "figure.png", "figures.json"
DASH = "–"
DOTS_PER_INCH = 150

SENSOR_ROWS = (
    ("share of time in fault", "fault_share", "{:.1%}"),
    ("faults", "faults", "{:.0f}"),
    ("faults missed", "missed", "{:.0f}"),
    ("mean detection delay (s)", "delay", "{:.2f}"),
    ("false alarms (share of fault-free time)", "false_alarm_rate", "{:.2%}"),
    ("AUC", "auc", "{:.3f}"),
    ("mean precision without fault", "precision_healthy", "{:.3g}"),
    ("mean precision in fault", "precision_faulty", "{:.3g}"),
)
PHASES = (("overall", "whole run"), ("before", "before faults"), ("during", "during"), ("after", "after"))


def prepare_folder(folder: Path) -> Path:
    """Make the folder, before the run rather than after it.

    Raises
    ------
    ResultFileError
        If it cannot be made or written to.
    """
    if folder.exists() and not folder.is_dir():
        raise ResultFileError(
            f"Nothing can be written into {folder}: it is a file, and must be a folder; choose another name."
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ResultFileError(
            f"Nothing can be written to the folder {folder} ({error.strerror}); choose another."
        ) from None
    return folder


def write_files(folder: Path, result: Result, numbers: Mapping[str, Any], signals: LoopSignals) -> None:
    """Write ``result.npz``, ``figures.json`` and ``figure.png``, each in one piece.

    Raises
    ------
    ResultFileError
        If one of them cannot be written.
    """
    from bayesftc.cosim.plotting import plot_run

    result.save(folder / RESULT)
    write_whole(folder / NUMBERS, lambda path: path.write_text(as_json(numbers) + "\n", encoding="utf-8"))
    title = f"{Path(numbers['scenario']).stem}, seed {numbers['seed']}" + (" (stopped early)" if result.stopped else "")
    figure = plot_run(signals, title)
    write_whole(folder / FIGURE, lambda path: figure.savefig(path, dpi=DOTS_PER_INCH, format="png"))


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a file beside `path`, then move it there in one step; a failure leaves nothing behind."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        write(temporary)
        temporary.replace(path)
    except OSError as error:
        raise ResultFileError(f"{path} cannot be written ({error.strerror or error}); choose another folder.") from None
    finally:
        with suppress(OSError):  # it is there only where the write has failed
            temporary.unlink(missing_ok=True)


def as_json(numbers: Mapping[str, Any]) -> str:
    """Return the text of a JSON file, which has null where a number is not defined."""
    return json.dumps(numbers, indent=2, allow_nan=False, ensure_ascii=False)


def print_report(numbers: Mapping[str, Any], folder: Path | None) -> None:
    """Print the figures of a run as tables."""
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    title = f"{numbers['scenario']}: {numbers['duration']:g} s, {numbers['steps']} steps, seed {numbers['seed']}"
    console.print(Text(title), soft_wrap=True)
    tables = [_sensors(numbers["sensors"])]
    if numbers["tracking"]:
        tables.insert(0, _errors(numbers))
    if "kalman" in numbers:
        tables.append(_kalman(numbers["kalman"]))
    for heading, table in tables:
        console.print()
        console.print(Text(heading, style="bold"))
        console.print(table)
    for note in numbers["notes"]:
        console.print()
        console.print(Text(note))
    if folder is not None:
        console.print()
        console.print(Text(f"Written to {folder}: {RESULT}, {FIGURE}, {NUMBERS}"), soft_wrap=True)


def _errors(numbers: Mapping[str, Any]) -> tuple[str, Table]:
    table = _table(*(label for _, label in PHASES))
    for what in ("tracking", "belief"):
        for name, errors in numbers[what].items():
            unit = numbers["units"].get(name)
            row = [_number(errors[phase], "{:.4g}") for phase, _ in PHASES]
            table.add_row(f"{what} of {name}{f' ({unit})' if unit else ''}", *row)
    heading = "Root-mean-square errors (tracking: true value - reference; belief: estimate - true value)"
    return heading, table


def _sensors(sensors: list[dict[str, Any]]) -> tuple[str, Table]:
    table = _table(*(f"sensor {s['sensor']}" for s in sensors))
    for label, key, form in SENSOR_ROWS:
        of_beta = key == "auc" and any(s["ranked_by"] == "beta" for s in sensors)
        table.add_row("AUC of beta" if of_beta else label, *(_number(s[key], form) for s in sensors))
    return "Faults and their detection", table


def _kalman(check: Mapping[str, Any]) -> tuple[str, Table]:
    table = _table("relative", "absolute")
    table.add_row("mean", f"{check['mean_difference']:.2e}", f"{check['mean_absolute']:.2e}")
    table.add_row("covariance", f"{check['covariance_difference']:.2e}", f"{check['covariance_absolute']:.2e}")
    return f"Largest differences from filterpy's Kalman filter over {check['steps']} samples", table


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for column in columns:
        table.add_column(Text(column), justify="right", overflow="fold")
    return table


def _number(value: float | None, form: str) -> str:
    return DASH if value is None else form.format(value)
