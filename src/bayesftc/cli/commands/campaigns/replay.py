"""``bayesftc replay``: one run of a stored campaign once more, with everything recorded."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.cli.findings import add_findings, notes_on
from bayesftc.cli.options import Json, Quiet, RunFolder, Store
from bayesftc.cli.page import HOST, PORT, Host, OpenPage, PagePort, need_console, serve_page
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.campaign.designs.plan import FAILED
from bayesftc.cosim.errors import BayesFTCError, ModelError, SimulationError

if TYPE_CHECKING:
    from bayesftc.console.desk.desk import Served
    from bayesftc.cosim.campaign.runs.job import Job
    from bayesftc.cosim.campaign.store.reading import StoredCampaign
    from bayesftc.cosim.run.result import Result


def replay(
    store: Store,
    run: Annotated[int, typer.Argument(help="Number of the run in the campaign's table.")],
    out: RunFolder = None,
    json: Json = False,
    quiet: Quiet = False,
    serve: Annotated[bool, typer.Option("--serve", help="Then show the run on a page, as bayesftc serve.")] = False,
    host: Host = HOST,
    port: PagePort = PORT,
    open_page: OpenPage = False,
) -> None:
    """Repeat a run of a campaign, compare it with the store, print its figures and write its files.

    A run that stopped in the campaign may stop again, which is no error. There is no time limit here.
    """
    if serve:
        need_console("bayesftc replay --serve")
    stored = _StoredRun.of(store, run)
    served = stored.served() if serve else None
    if out is not None:
        output.check_folder(out, silent=quiet or json)
    _repeat(stored, out, json, quiet)
    if served is not None:
        serve_page(served, host, port, open_page)


@dataclass(frozen=True)
class _StoredRun:
    store: StoredCampaign
    job: Job
    number: int

    @classmethod
    def of(cls, folder: Path, number: int) -> _StoredRun:
        from bayesftc.cosim.campaign.store.folder import CampaignStore
        from bayesftc.cosim.campaign.store.repeating import kept_job

        store = CampaignStore.open(folder)
        job = kept_job(store)
        count = len(job.plan.of_runs()[0])
        if not 0 <= number < count:
            raise ModelError(f"There is no run {number}. The campaign in {folder} has the runs 0 to {count - 1}.")
        return cls(store, job, number)

    @property
    def point(self) -> int:
        return int(self.job.plan.of_runs()[0][self.number])

    @property
    def seed(self) -> int:
        return int(self.job.plan.of_runs()[1][self.number])

    @property
    def name(self) -> str:
        return f"{self.store.path.name} run {self.number}"

    def served(self) -> Served:
        """Return the run as a scenario that has run to its end.

        Raises
        ------
        ModelError
            If the campaign is not one of a scenario file.
        """
        from bayesftc.console.desk.desk import Served
        from bayesftc.scenario.campaigns import ScenarioLoop

        loop, duration = self.job.loop, self.job.step * self.job.steps
        if not isinstance(loop, ScenarioLoop):
            raise ModelError(
                f"The page shows runs of a scenario file, but the loop of the campaign in {self.store.path} is made in Python. "
                "Leave --serve out; --out writes the signals and a figure."
            )
        content = loop.changed(self.job.plan.points[self.point])
        content["simulation"] = {**content["simulation"], "seed": self.seed}
        return Served(Path(loop.path), content, self.name, duration)


def _repeat(stored: _StoredRun, out: Path | None, json: bool, quiet: bool) -> None:
    """Repeat the run, print its figures, and write its files."""
    from bayesftc import __version__
    from bayesftc.cosim.judging.findings import numbers_of
    from bayesftc.cosim.judging.roles import loop_signals

    kept, job = stored.store, stored.job
    diagram, seed = job.diagram(stored.point), stored.seed
    try:
        with reported(f"Repeating run {stored.number}."):
            result = diagram.simulate(job.duration, seed=seed)
    except SimulationError as error:
        if error.result is None:
            raise
        result = error.result
    steps = max(len(result.time) - 1, 0)
    numbers: dict[str, Any] = {
        "scenario": stored.name,
        "bayesftc": __version__,
        "seed": seed,
        "engine": result.metadata.get("engine"),
        "factors": dict(kept.plan.points[stored.point]),
        "duration": float(steps * job.step),
        "steps": steps,
        "stopped": result.stopped,
        "notes": [_same(kept, job.decimation, stored.number, result)],
    }
    try:
        signals = loop_signals(diagram, result)
    except BayesFTCError as error:  # a diagram that is no closed loop has signals, but no figures of a loop
        numbers["notes"].append(f"There are no figures of this run: {error}")
        if out is not None:
            _write_signals(out, result, numbers)
        if not quiet:
            written = [f"Written to {out}: {', '.join(sorted(p.name for p in out.iterdir()))}"] if out else []
            typer.echo(output.as_json(numbers) if json else "\n\n".join([*numbers["notes"], *written]))
        return
    numbers |= numbers_of(signals)
    numbers["notes"] += notes_on(diagram, result, signals)
    failed = add_findings(numbers, diagram, result, signals)
    if not json and not quiet:
        output.print_report(numbers)
    undrawn = None if out is None else output.write_files(out, result, numbers, signals)
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        if out is not None:
            output.say_written(out, undrawn)
    elif result.stopped:
        sys.stderr.write(f"{result.stopped}\n")
    if failed := failed or undrawn:
        raise failed


def _write_signals(folder: Path, result: Result, numbers: Mapping[str, Any]) -> None:
    """Write the signals of a diagram that is no closed loop, and the numbers of the run."""
    from bayesftc.cosim.judging.figures.plotting import plot_signals

    with output.staged(folder) as stage:
        result.save(stage / output.RESULT)
        (stage / output.NUMBERS).write_text(output.as_json(numbers) + "\n", encoding="utf-8")
        with suppress(BayesFTCError):  # the run has no signal that can be drawn
            plot_signals(result).savefig(stage / output.FIGURE, dpi=output.DOTS_PER_INCH, format="png")


def _same(kept: Any, decimation: int, run: int, result: Any) -> str:
    """Return a sentence that compares the run with the store: its bits, and whether it failed there."""
    table = kept.table().set_index("run")
    if run not in table.index:
        return "The store does not have this run yet."
    row = table.loc[run]
    outcome = ""
    if row["status"] == FAILED:
        outcome = f"In the store this run failed: {row['reason']} "
        outcome += f"Now it stopped as well: {result.stopped} " if result.stopped else "Now it is complete. "
    elif result.stopped:
        outcome = f"In the store this run is complete. Now it stopped: {result.stopped} "
    names = [name for name in kept.metadata.signals if name in result]
    rows = min(int(row["steps"]), len(result.time) - 1) // decimation + 1  # as far as both have come
    if not names or rows < 1:
        return f"{outcome}The store has no signals of this run to compare with."
    data = kept.dataset()
    different = [
        name
        for name in names
        if not np.array_equal(data[name][run].to_numpy()[:rows], result[name][::decimation][:rows], equal_nan=True)
    ]
    if different:
        return f"{outcome}It differs from the run in the store in {', '.join(different)}. The machine or the versions differ."
    return f"{outcome}It has the same bits as the run in the store{', as far as both have run' if outcome else ''}."
