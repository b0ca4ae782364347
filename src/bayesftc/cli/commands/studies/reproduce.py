"""``bayesftc reproduce``: run the paper's experiments, and further ones, and write tables, figures and files."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc.cli import output
from bayesftc.cli.options import Json, Quiet
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.random import check_seed
from bayesftc.reproduce.registry import EXPERIMENTS
from bayesftc.reproduce.shared.ensemble import Progress, check_jobs

if TYPE_CHECKING:
    from bayesftc.reproduce.registry import Experiment
    from bayesftc.reproduce.shared.runner import Report

ALL = "all"
BREATH = 0.1
"""Least seconds between two moves of the progress bar."""
QUICK = {"compress_level": 3}
"""PNG compression that takes three quarters of the time; the files are one twentieth larger."""


def reproduce(
    experiment: Annotated[str, typer.Argument(help="An experiment of the list above, or all.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write a JSON file and figures for each experiment there."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all noise and faults.")] = 0,
    jobs: Annotated[int | None, typer.Option(help="Number of threads; by default one for each core.")] = None,
    runs: Annotated[int | None, typer.Option(help="Runs of each case; a small number gives a quick look.")] = None,
    cases: Annotated[
        list[str] | None, typer.Option("--case", metavar="PATTERN", help="For family: cases, as 'freeze*'; repeatable.")
    ] = None,
    learners: Annotated[
        list[str] | None,
        typer.Option("--learner", metavar="PATTERN", help="For family: learners, as '*Precision'; repeatable."),
    ] = None,
    unseen: Annotated[
        int | None,
        typer.Option(metavar="N", help="For family: N random cases, which were not used for tuning."),
    ] = None,
    paper_only: Annotated[
        bool,
        typer.Option(
            "--paper-only",
            help="Leave out further techniques and faults, which are not in the paper; with 'all', also bound and the "
            "experiments after it in the list.",
        ),
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run one experiment or all, print their tables and write their files.

    Each experiment's files are written when it is complete. They replace those of an earlier run.
    """
    name = experiment
    if name != ALL and name not in EXPERIMENTS:
        raise UnknownNameError(f"There is no experiment {name!r}; {did_you_mean(name, [*EXPERIMENTS, ALL])}")
    of_paper = name == ALL and paper_only
    chosen = [e for e in EXPERIMENTS.values() if name in {e.name, ALL} and not (of_paper and e.beyond)]
    filters = {"cases": cases, "learners": learners, "unseen": unseen}
    given: dict[str, Any] = {what: value for what, value in filters.items() if value not in (None, [])}
    if given and not all(e.filtered for e in chosen):
        able = ", ".join(e.name for e in EXPERIMENTS.values() if e.filtered)
        raise ModelError(f"{name} has no choice of {' and '.join(given)}. Leave it out, or use it with: {able}.")
    given |= {"seed": check_seed(seed), "jobs": check_jobs(_cores() if jobs is None else jobs)}
    if out is not None:
        output.check_folder(out, [name for e in chosen for name in _names(e)], silent=quiet or json)
    reports = {}
    for each in chosen:
        with _progress(each.name, shown=not quiet and not json) as progress:
            report = each.run(**given, runs=runs, beyond=not paper_only, progress=progress)
        reports[each.name] = report
        written = [] if out is None else _write(out, each, report)
        if not (json or quiet):
            _print(each, report, out, written)
    if json:
        typer.echo(output.as_json(reports))


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _names(experiment: Experiment) -> list[str]:
    """Return the names of all files that an experiment can write."""
    return [f"{experiment.name}.json", *(f"{name}.png" for name in experiment.figures)]


def _write(folder: Path, experiment: Experiment, report: Report) -> list[str]:
    """Write the report and the figures, all or none, remove an earlier run's other figures, and return the names."""
    files = {f"{experiment.name}.json": (output.as_json(report) + "\n").encode()}
    for name, draw in experiment.figures.items():
        if (figure := draw(report)) is not None:
            picture = io.BytesIO()
            figure.savefig(picture, dpi=output.DOTS_PER_INCH, format="png", pil_kwargs=QUICK)
            files[f"{name}.png"] = picture.getvalue()
    with output.staged(folder) as stage:
        for name, content in files.items():
            (stage / name).write_bytes(content)
        for name in set(_names(experiment)) - set(files):  # here all new files are complete
            (folder / name).unlink(missing_ok=True)
    return list(files)


def _print(experiment: Experiment, report: Report, folder: Path | None, written: list[str]) -> None:
    from rich.rule import Rule
    from rich.text import Text

    console = output.terminal()
    console.print(Rule(f"{experiment.name}, seed {report['settings']['seed']}", align="left"))
    for part in experiment.show(report):
        console.print(Text(part) if isinstance(part, str) else part)
        console.print()
    if folder is not None:
        console.print(Text(f"Written to {folder}: {', '.join(written)}"), soft_wrap=True)


@contextmanager
def _progress(name: str, *, shown: bool) -> Iterator[Progress | None]:
    """Give a function that shows the progress on stderr, as a bar or, without a terminal, as lines; None if not shown."""
    if shown and not sys.stderr.isatty():
        with output.progress_lines(name) as move:
            yield lambda what, done, of: move(done, of, what=what)
        return
    with output.progress_bar(name, "count", "elapsed", shown=shown, breath=BREATH) as move:
        yield move and (lambda what, done, of: move(done, of, description=f"{name}: {what}"))
