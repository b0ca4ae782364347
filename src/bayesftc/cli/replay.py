"""``bayesftc replay``: one run of a stored campaign once more, with everything recorded."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import typer

from bayesftc.cli import output
from bayesftc.cosim._campaign.plan import FAILED
from bayesftc.cosim.errors import BayesFTCError, ModelError, SimulationError


def replay_run(store: Path, run: int, out: Path | None, *, json: bool, quiet: bool) -> None:
    """Make a run of a campaign again, compare it with what the store has of it, print its figures and write its files.

    Parameters
    ----------
    store : pathlib.Path
        Folder of the campaign.
    run : int
        Number of the run.
    out : pathlib.Path or None
        Folder for ``result.npz``, ``figure.png`` and ``figures.json``.
    json, quiet : bool
        How the figures are printed: as JSON, or not at all.
    """
    from bayesftc import __version__
    from bayesftc.cosim._campaign.repeating import kept_job
    from bayesftc.cosim._campaign.store import CampaignStore
    from bayesftc.cosim.metrics import figures
    from bayesftc.cosim.roles import loop_signals

    kept = CampaignStore.open(store)
    job = kept_job(kept)
    points, seeds = job.plan.of_runs()
    if not 0 <= run < len(points):
        raise ModelError(f"There is no run {run}; the campaign in {store} has the runs 0 to {len(points) - 1}.")
    if out is not None:
        output.check_folder(out)
    diagram, seed = job.diagram(int(points[run])), int(seeds[run])
    try:
        result = diagram.simulate(job.duration, seed=seed)
    except SimulationError as error:
        if error.result is None:
            raise
        result = error.result
    numbers: dict[str, Any] = {
        "scenario": f"{Path(store).name} run {run}",
        "bayesftc": __version__,
        "seed": seed,
        "engine": result.metadata.get("engine"),
        "factors": dict(kept.plan.points[int(points[run])]),
        "duration": float(job.steps * job.step),
        "steps": max(len(result.time) - 1, 0),
        "stopped": result.stopped,
        "notes": [_same(kept, job.decimation, run, result)],
    }
    try:
        signals = loop_signals(diagram, result)
    except BayesFTCError as error:  # a diagram that is no closed loop has no figures
        if out is not None:
            with output.staged(out) as stage:
                result.save(stage / output.RESULT)
        if not quiet:
            typer.echo(output.as_json(numbers) if json else f"{numbers['notes'][0]} {error}")
        return
    numbers |= {"units": {q.name: q.unit for q in signals.quantities}, **figures(signals).to_dict()}
    if out is not None:
        output.write_files(out, result, numbers, signals)
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        output.print_report(numbers, out)
    elif result.stopped:
        sys.stderr.write(f"{result.stopped}\n")


def _same(kept: Any, decimation: int, run: int, result: Any) -> str:
    """Return in a sentence whether the run has the bits that the store has of it, and what became of one that had failed."""
    table = kept.table().set_index("run")
    if run not in table.index:
        return "The store does not have this run yet."
    row = table.loc[run]
    said = ""
    if row["status"] == FAILED:
        said = f"In the store it has failed: {row['reason']} "
        said += "Now it has stopped as well. " if result.stopped else "Now it went to its end. "
    elif result.stopped:
        said = "In the store it went to its end. "
    names = [name for name in kept.metadata.signals if name in result]
    if not names:
        return f"{said}The store has no signals of this run to compare with."
    rows = min(int(row["steps"]), len(result.time) - 1) // decimation + 1  # as far as both have come
    data = kept.dataset()
    different = [
        name
        for name in names
        if not np.array_equal(data[name][run].to_numpy()[:rows], result[name][::decimation][:rows], equal_nan=True)
    ]
    if different:
        return (
            f"{said}It differs from the run in the store in {', '.join(different)}: another machine, or other versions."
        )
    return f"{said}It has the bits of the run in the store{', as far as that has come' if said else ''}."
