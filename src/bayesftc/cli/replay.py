"""``bayesftc replay``: one run of a stored campaign once more, with everything recorded."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import typer

from bayesftc.cli import output
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
    """Return in a sentence whether the run has the bits that the store has of it."""
    names = list(kept.metadata.signals)
    if not names:
        return "The store has no signals of this run to compare with."
    data = kept.dataset()
    if str(data["status"][run].item()) not in {"ok", "failed"}:
        return "The store does not have this run yet."
    different = []
    for name in names:
        then, now = data[name][run].to_numpy(), result[name][::decimation] if name in result else None
        if now is not None and not np.array_equal(then[: len(now)], now, equal_nan=True):
            different.append(name)
    if different:
        return f"It differs from the run in the store in {', '.join(different)}: another machine, or other versions."
    return "It has the bits of the run in the store."
