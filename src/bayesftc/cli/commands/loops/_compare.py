"""``bayesftc run --compare``: several scenario files with the same seeds, in one table and one figure."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import typer

from bayesftc.cli import output
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
from bayesftc.cosim.errors import ScenarioError
from bayesftc.cosim.judging.metrics import without_nan
from bayesftc.scenario import load_scenario
from bayesftc.scenario._unused import unused

if TYPE_CHECKING:
    from bayesftc.cosim.comparison.compare import Comparison

TABLE = "comparison.csv"
RUNS = "runs.csv"
FILES = (TABLE, RUNS, output.FIGURE)
PHASES = {"": "whole run", "_in_faults": "while a fault is present"}
SEEDS = 50

FAR_WORSE = 3.0
"""Error of a loop's worst run, relative to the median of its runs, from which on a sentence names the run: means hide it."""


def compare_scenarios(
    files: Sequence[str],
    *,
    seeds: int | None,
    seed: int | None,
    duration: float | None,
    out: Path | None,
    json: bool,
    quiet: bool,
) -> None:
    """Run scenario files with the same seeds, print the table, and write tables and figure.

    Raises
    ------
    ScenarioError
        If there is only one file, two have the same name, or their durations differ.
    """
    from bayesftc import cosim
    from bayesftc.cosim.comparison.figure import plot_comparison

    if len(files) < 2:
        raise ScenarioError(
            f"--compare has only one scenario, {files[0]}. Give at least two: bayesftc run a.toml b.toml --compare."
        )
    if out is not None:
        output.check_folder(out, FILES, silent=True)
    of_loop = {Path(file).stem: file for file in files}
    scenarios = {name: load_scenario(file) for name, file in of_loop.items()}
    if len(scenarios) < len(files):
        raise ScenarioError("Two of the files have the same name, which labels the table's rows. Rename one of them.")
    durations = {name: scenario.simulation.duration for name, scenario in scenarios.items()}
    (first, chosen), *others = durations.items()
    for name, other in others:
        if duration is None and rational_step(other) != rational_step(chosen):
            raise ScenarioError(
                f"The scenario {first!r} lasts {chosen} s and {name!r} lasts {other} s. Set the same duration in both, or use "
                "--duration."
            )
    lasts = chosen if duration is None else duration
    notes = [note for scenario in scenarios.values() for note in unused(scenario, lasts)]
    if not json and not quiet:
        output.say_notes(notes)
    with noted_elsewhere(), output.runs_progress("Comparing", shown=not quiet and not json) as progress:
        loops = {name: scenario.loop() for name, scenario in scenarios.items()}
        if out is not None and not json and not quiet:  # the scenarios are checked
            output.note_replaced(out / name for name in FILES)
        comparison = cosim.compare(
            loops,
            duration=lasts,
            seeds=SEEDS if seeds is None else seeds,
            seed=0 if seed is None else seed,
            progress=progress,
        )
    if out is not None:
        picture = io.BytesIO()
        signals = list(dict.fromkeys(comparison.table["signal"]))
        complete = {name: comparison.signals(name) for name in comparison.loops}
        figure = plot_comparison(complete, signals, failed=comparison.failed)
        figure.savefig(picture, dpi=output.DOTS_PER_INCH, format="png")
        with output.staged(out) as stage:
            comparison.table.to_csv(stage / TABLE, index=False)
            comparison.runs.to_csv(stage / RUNS, index=False)
            (stage / output.FIGURE).write_bytes(picture.getbuffer())
    rows: Any = comparison.table.astype(object).where(comparison.table.notna(), None).to_dict("records")
    worst = list(_far_worse(comparison, of_loop, duration))
    if json:
        typer.echo(output.as_json({"loops": without_nan(rows), "notes": [*notes, *worst]}))
    elif not quiet:
        _print(comparison, rows, worst, out)


def _far_worse(comparison: Comparison, files: Mapping[str, str], duration: float | None) -> Iterator[str]:
    """Give a sentence for each loop whose worst run has an error far above the median of its runs."""
    units = dict(zip(comparison.table["signal"], comparison.table["unit"], strict=True))
    lasts = "" if duration is None else f" --duration {duration}"
    for loop, runs in comparison.runs.groupby("loop", sort=False):
        for signal, unit in units.items():
            errors = runs.set_index("seed")[f"tracking.{signal}.overall"]
            if errors.max() > FAR_WORSE * errors.median():
                yield (
                    f"The worst run of {loop}, with the seed {errors.idxmax()}, has an error of {signal} of "
                    f"{errors.max():.4g}{behind(unit)}; the median of its runs is {errors.median():.4g}{behind(unit)}. To see "
                    f"it: bayesftc run {quote(files[str(loop)])} --seed {errors.idxmax()}{lasts}."
                )
                break


def _print(comparison: Comparison, rows: Sequence[dict[str, Any]], worst: Sequence[str], out: Path | None) -> None:
    console, say = output.sayer()
    first = rows[0]["loop"]
    for signal in dict.fromkeys(row["signal"] for row in rows):
        selected = [row for row in rows if row["signal"] == signal]
        unit = f" ({selected[0]['unit']})" if selected[0]["unit"] else ""
        for ending, phase in PHASES.items():
            if all(row[f"error{ending}"] is None for row in selected):
                continue
            say(f"Tracking error of {signal}{unit}, {phase}", "bold")
            columns = ("error", "difference", "95 % interval", "wins", "blamed*", "failed")
            table = output.plain_table("loop", *columns, right=columns, whole=("loop", *columns[:2]))
            for row in selected:
                table.add_row(row["loop"], *_cells(row, ending))
            console.print(table)
    say(
        f"Each loop has {rows[0]['runs']} runs with the same seeds. An error is the mean of the runs' root-mean-square "
        f"errors. Differences and wins are relative to {first}. * Blamed while healthy: the share of the fault-free steps with "
        "an alarm, mean of all sensors, over the whole run."
    )
    if comparison.remark:
        say(comparison.remark)
    for reason, count in (
        comparison.runs.loc[comparison.runs["status"] != "ok", "reason"].value_counts().head(3).items()
    ):
        say(f"{count} of them: {reason}")
    for sentence in worst:
        say(sentence)
    if out is not None:
        say(f"{TABLE}, {RUNS} and {output.FIGURE} are in {out}.")


def _cells(row: dict[str, Any], ending: str) -> list[str]:
    def shown(name: str, form: str = "{:.4g}") -> str:
        value = row[name]
        return output.DASH if value is None else form.format(value)

    interval = output.DASH
    if row[f"low{ending}"] is not None:
        interval = f"{shown(f'low{ending}')} to {shown(f'high{ending}')}"
    wins = output.DASH if row[f"pairs{ending}"] is None else f"{row[f'wins{ending}']} of {row[f'pairs{ending}']}"
    alarms = shown("false_alarm_rate", "{:.2%}")
    return [shown(f"error{ending}"), shown(f"difference{ending}"), interval, wins, alarms, str(row["failed"])]
