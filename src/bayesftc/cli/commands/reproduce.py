"""``bayesftc reproduce``: the paper's experiments, and ours beyond it, to tables, figures and files."""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayesftc.cli import output
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.random import check_seed
from bayesftc.reproduce.registry import EXPERIMENTS
from bayesftc.reproduce.shared.ensemble import Progress, check_jobs

if TYPE_CHECKING:
    from bayesftc.reproduce.registry import Experiment
    from bayesftc.reproduce.shared.runner import Report

ALL = "all"
BREATH = 0.1
"""Seconds between two moves of the progress bar."""
QUICK = {"compress_level": 3}
"""Figures are written in three quarters of the time, and are one twentieth larger."""


def reproduce_experiments(
    name: str,
    out: Path | None,
    options: Mapping[str, Any],
    filters: Mapping[str, Sequence[str] | int | None],
    *,
    json: bool,
    quiet: bool,
) -> None:
    """Run one experiment or all, print their tables and write their files.

    Parameters
    ----------
    name : str
        Of the experiment, or ``all``.
    out : pathlib.Path or None
        Folder for ``<experiment>.json`` and the figures; each experiment's are written when it is done, in place of those
        of an earlier run.
    options : mapping
        ``seed``, ``jobs`` (None: one for each core), ``runs``, ``beyond``, as the experiments take them.
    filters : mapping
        Names or patterns of the ``cases`` and ``learners`` that are to run, and how many ``unseen`` cases instead; None or
        nothing for all.
    json, quiet : bool
        How the numbers are printed: as one JSON object with a key for each experiment, or not at all.
    """
    if name != ALL and name not in EXPERIMENTS:
        raise UnknownNameError(f"There is no experiment {name!r}; {did_you_mean(name, [*EXPERIMENTS, ALL])}")
    paper_only = name == ALL and not options["beyond"]
    chosen = [e for e in EXPERIMENTS.values() if name in {e.name, ALL} and not (paper_only and e.beyond)]
    given: dict[str, Any] = {what: wanted for what, wanted in filters.items() if wanted not in (None, [])}
    if given and not all(e.filtered for e in chosen):
        able = ", ".join(e.name for e in EXPERIMENTS.values() if e.filtered)
        raise ModelError(f"{name} has no choice of {' and '.join(given)}; leave it out, or take one that has: {able}.")
    jobs = options["jobs"]
    options = {**options, "seed": check_seed(options["seed"]), "jobs": check_jobs(_cores() if jobs is None else jobs)}
    if out is not None:
        output.check_folder(out, [name for e in chosen for name in _names(e)])
    reports = {}
    for experiment in chosen:
        with _progress(experiment.name, shown=sys.stderr.isatty() and not quiet and not json) as progress:
            report = experiment.run(**options, **given, progress=progress)
        reports[experiment.name] = report
        written = [] if out is None else _write(out, experiment, report)
        if not (json or quiet):
            _print(experiment, report, out, written)
    if json:
        typer.echo(output.as_json(reports))


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _names(experiment: Experiment) -> list[str]:
    """Return the names of all files that an experiment may write."""
    return [f"{experiment.name}.json", *(f"{name}.png" for name in experiment.figures)]


def _write(folder: Path, experiment: Experiment, report: Report) -> list[str]:
    """Write the report and the figures, all or none, remove what an earlier run drew and this one did not; return their names."""
    files = {f"{experiment.name}.json": (output.as_json(report) + "\n").encode()}
    for name, draw in experiment.figures.items():
        if (figure := draw(report)) is not None:
            picture = io.BytesIO()
            figure.savefig(picture, dpi=output.DOTS_PER_INCH, format="png", pil_kwargs=QUICK)
            files[f"{name}.png"] = picture.getvalue()
    with output.staged(folder) as stage:
        for name, content in files.items():
            (stage / name).write_bytes(content)
        for name in set(_names(experiment)) - set(files):  # all else is whole by now, and about to move into place
            (folder / name).unlink(missing_ok=True)
    return list(files)


def _print(experiment: Experiment, report: Report, folder: Path | None, written: list[str]) -> None:
    from rich.console import Console
    from rich.rule import Rule
    from rich.text import Text

    console = Console(highlight=False)
    console.print(Rule(f"{experiment.name}, seed {report['settings']['seed']}", align="left"))
    for part in experiment.show(report):
        console.print(Text(part) if isinstance(part, str) else part)
        console.print()
    if folder is not None:
        console.print(Text(f"Written to {folder}: {', '.join(written)}"), soft_wrap=True)


@contextmanager
def _progress(name: str, *, shown: bool) -> Iterator[Progress | None]:
    """Give a function that moves a progress bar on stderr, or None."""
    if not shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress as Bar, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None)
        last = 0.0

        def move(what: str, done: int, of: int) -> None:
            nonlocal last
            if (now := time.monotonic()) - last > BREATH or done == of:
                last = now
                bar.update(task, description=f"{name}: {what}", completed=done, total=of)

        yield move
