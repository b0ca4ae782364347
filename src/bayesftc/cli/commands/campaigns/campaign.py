"""``bayesftc campaign``: run a campaign file, keep its results in a store and print a table of them."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc._interrupt import Interrupted
from bayesftc.cli import output
from bayesftc.cli.options import Json, Quiet
from bayesftc.cosim.base.numbers import with_half
from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from rich.table import Table

    from bayesftc.cosim.campaign.executors.base import Executor as Runner
    from bayesftc.cosim.campaign.outcomes import CampaignResult
    from bayesftc.cosim.campaign.working import Progress

POINTS = 40
"""Rows of the printed table; the store has all points."""
METRICS = 4
"""Metrics in the printed table."""
BREATH = 0.2
"""Least seconds between two moves of the progress bar."""


Executor = StrEnum("Executor", ["threads", "processes", "dask"])


def campaign(
    file: Annotated[Path, typer.Argument(help="A campaign file (TOML): a scenario, what is varied, how many runs.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="STORE",
            help="Folder of the results; by default named after the file. Results in it are kept.",
        ),
    ] = None,
    executor: Annotated[
        Executor | None,
        typer.Option(help="What executes the runs; by default threads if they can use all cores, else processes."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Number of workers; by default one for each core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.1:8786.")
    ] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Repeat the runs that failed.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a campaign, or its missing runs, and print the mean of each metric with its unit."""
    from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
    from bayesftc.scenario._unused import unused_of_campaign
    from bayesftc.scenario.campaigns import described, load_campaign

    with noted_elsewhere():
        loaded = load_campaign(file)
    if not json and not quiet:
        output.say_notes(unused_of_campaign(loaded, str(file)))
    chosen = _executor(executor, jobs, scheduler)
    folder = Path(file.stem) if out is None else out
    began, before = time.perf_counter(), _runs_in(folder, loaded.job.plan.runs)
    again = ["bayesftc", "campaign", str(file)] + (["-o", str(out)] if out else [])
    first = _beginning(loaded.job.plan.runs, before, folder)
    with _kept(folder, again), _progress(file.stem, first, shown=not quiet and not json) as progress:
        result = loaded.run(
            folder, executor=chosen, progress=progress, retry_failed=retry_failed, description=described(file, loaded)
        )
    seconds = time.perf_counter() - began
    numbers = _numbers(result, list(loaded.labels[0]), list(loaded.job.columns))
    numbers |= {"store": str(folder), "seconds": seconds, "executor": result.metadata.get("executor")}
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        _print(numbers, 0 if retry_failed else before)


@contextmanager
def _kept(store: Path, again: list[str]) -> Iterator[None]:
    """Give a Ctrl-C inside the number of runs that are kept, and the command that goes on, as its message."""
    try:
        yield
    except (Interrupted, KeyboardInterrupt) as stop:
        from bayesftc.cosim.campaign.working import kept_runs

        if kept := kept_runs(store):
            runs, of = kept
            stop.args = (f"Stopped by Ctrl-C. {runs} of {of} runs are kept in {store}. To go on: {shlex.join(again)}",)
        raise


def _runs_in(store: Path, runs: int) -> int:
    """Return how many of a campaign's runs a folder has already; 0 if it is no store, or one of another number of runs."""
    from bayesftc.cosim.campaign.working import kept_runs

    kept = kept_runs(store) if store.is_dir() else None
    return kept[0] if kept and kept[1] == runs else 0


def _executor(name: str | None, jobs: int | None, scheduler: str | None) -> Runner | None:
    from bayesftc import cosim

    if scheduler is not None:
        if name not in {None, "dask"} or jobs is not None:
            raise ModelError(
                "--scheduler is for a Dask cluster, which has its own workers. Leave out --executor and --jobs."
            )
        return cosim.DaskCluster(scheduler)
    if name == "dask":
        return cosim.DaskCluster(workers=jobs)
    if name == "processes":
        return cosim.Processes(jobs)
    if name == "threads" or jobs is not None:
        return cosim.Threads(jobs)
    return None


def _numbers(result: CampaignResult, factors: list[str], metrics: list[str]) -> dict[str, Any]:
    """Return what is printed: units, and for each point its factors, and the mean of each metric with its confidence interval."""
    from bayesftc.cosim.campaign.runs.columns import OWN
    from bayesftc.cosim.statistics import summary

    table = result.table
    # A factor with the name of a fixed column, such as seed, has the prefix "factor:" in the table.
    names = [name if name in table and name not in OWN else f"factor:{name}" for name in factors]
    columns = dict(zip(factors, names, strict=True)) | {name: name for name in metrics}
    points: list[dict[str, Any]] = [
        {
            "point": int(rows["point"].iloc[0]),
            "factors": {f: _plain(rows[n].iloc[0]) for f, n in zip(factors, names, strict=True)},
            "runs": len(rows),
            "failed": int((rows["status"] == "failed").sum()),
            "metrics": {},
        }
        for _, rows in table.groupby("point", sort=True)
    ]
    for metric in metrics:
        cells = summary(table, metric, by=["point"]).set_index("point")
        for row in points:
            if row["point"] in cells.index:
                cell = cells.loc[row["point"]]
                row["metrics"][metric] = {k: float(cell[k]) for k in ("mean", "low", "high", "sd", "n") if k in cell}
    reasons = table["reason"][table["status"] == "failed"].value_counts().head(3)
    return {
        "runs": len(table),
        "failed": int((table["status"] == "failed").sum()),
        "points": points,
        "units": {name: result.units[column] for name, column in columns.items() if column in result.units},
        "reasons": {str(reason): int(count) for reason, count in reasons.items()},
    }


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


def _print(numbers: Mapping[str, Any], before: int) -> None:
    from rich.text import Text

    console = output.terminal(None if sys.stdout.isatty() else 110)
    if numbers["points"] and numbers["points"][0]["metrics"]:
        defined = _defined_metrics(numbers["points"])
        metrics = defined[:METRICS]
        console.print(_table(numbers["points"], metrics, numbers["units"]))
        hidden = [f"{len(numbers['points']) - POINTS} more points"] if len(numbers["points"]) > POINTS else []
        more = len(defined) - len(metrics)
        hidden += [f"{more} more metrics"] if more > 0 else []
        if hidden:
            console.print(Text(f"{' and '.join(hidden)} are in the store."))
    done = f"{numbers['runs']} runs" + (f", of which {numbers['failed']} failed" if numbers["failed"] else "")
    if before:
        done += ", all of them from earlier" if before == numbers["runs"] else f", {before} of them from earlier"
    console.print(Text(f"{done}, in {numbers['store']} ({numbers['seconds']:.1f} s)."))
    for reason, count in numbers["reasons"].items():
        console.print(Text(f"{count} of them: {reason}"))
    store = shlex.quote(numbers["store"])
    console.print(Text(f"bayesftc report {store} draws them; bayesftc replay {store} RUN repeats one."))


def _defined_metrics(points: list[dict[str, Any]]) -> list[str]:
    """Return the metrics that are defined at some point, as the tracking error of a quantity with a goal; all if none is."""

    def defined(name: str) -> bool:
        means = (point["metrics"].get(name, {}).get("mean", float("nan")) for point in points)
        return any(mean == mean for mean in means)

    names = list(points[0]["metrics"])
    return [name for name in names if defined(name)] or names


def _table(points: list[dict[str, Any]], metrics: list[str], units: Mapping[str, str]) -> Table:
    from rich.table import Table

    table = Table(title="Mean of each metric ± half of its 95 % confidence interval", title_justify="left")
    for name in points[0]["factors"]:
        table.add_column(with_unit(name, units.get(name)), overflow="fold")
    table.add_column("runs", justify="right")
    for name in metrics:
        table.add_column(with_unit(name, units.get(name)), justify="right", overflow="fold")
    for point in points[:POINTS]:
        cells = [point["metrics"].get(name) for name in metrics]
        runs = f"{point['runs']}" + (f" ({point['failed']} failed)" if point["failed"] else "")
        table.add_row(*(_shown(value) for value in point["factors"].values()), runs, *map(_interval, cells))
    return table


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _interval(cell: Mapping[str, float] | None) -> str:
    if cell is None or cell["mean"] != cell["mean"]:
        return output.DASH
    return with_half(cell["mean"], cell["high"] - cell["mean"])


def _beginning(runs: int, before: int, store: Path) -> str:
    """Return the first line of the progress: how many runs there are, and how many of them the store has already."""
    return f"{runs} run{'s' * (runs != 1)}" + (f", {before} of them in {store} already" if before else "")


@contextmanager
def _progress(name: str, first: str, *, shown: bool) -> Iterator[Progress | None]:
    """Give a function that shows the progress on stderr, as a bar or, without a terminal, as lines; None if not shown."""
    if shown and not sys.stderr.isatty():
        with output.progress_lines(name, first) as move:
            yield _mover(move)
        return
    columns = "count", "{task.fields[rate]}", "remaining", "{task.fields[failed]}"
    with output.progress_bar(name, *columns, shown=shown, breath=BREATH, rate="", failed="") as move:
        yield move and _mover(move)


def _mover(move: Callable[..., None]) -> Progress:
    """Return a function that moves a bar, with the rate since its first call."""
    first: list[tuple[float, int]] = []

    def update(done: int, of: int, failed: int) -> None:
        now = time.monotonic()
        if not first:
            first.append((now, done))
        began, before = first[0]
        rate = _rate((done - before) / (now - began)) if now > began and done > before else ""
        move(done, of, rate=rate, failed=f"{failed} failed" if failed else "")

    return update


def _rate(runs: float) -> str:
    return f"{runs:.3g} runs/s" if runs < 100 else f"{runs:,.0f} runs/s"
