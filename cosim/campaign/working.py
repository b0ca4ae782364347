"""Make the missing runs of a campaign, keep their outcomes as they arrive, and report progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext, suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.campaign.describing import described
from bayesftc.cosim.campaign.designs.plan import FAILED, Outcome, Piece
from bayesftc.cosim.campaign.outcomes import CampaignResult, InMemory
from bayesftc.cosim.campaign.runs.fmus import fmus_of
from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.store.durable import written_to
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.cosim.campaign.store.metadata import NAME
from bayesftc.cosim.campaign.store.repeating import keep_job
from bayesftc.cosim.errors import BayesFTCError

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.executors.base import Executor

Progress = Callable[[int, int, int], None]
"""Called as ``progress(done, of, failed)``, numbers of runs."""
Labels = list[dict[str, Any]]


HINT = "To see how many are done, give progress=print, or any function of (done, of, failed)."


def work(
    job: Job,
    pieces: list[Piece],
    executor: Executor,
    keep: Callable[[Outcome], None],
    done: int,
    failed: int,
    progress: Progress | None,
) -> None:
    """Run pieces and keep their outcomes.

    Parameters
    ----------
    job : Job
        The job of the pieces.
    pieces : list of Piece
        The pieces that are left.
    executor : Executor
        The executor that runs them.
    keep : callable
        Called with each outcome.
    done, failed : int
        Numbers of runs that were done, and that have failed, before.
    progress : callable, optional
        Called with the progress.
    """
    if progress:
        progress(done, job.plan.runs, failed)
    count = sum(map(len, pieces))
    what = f"Making {count} run{'s' * (count != 1)}. {HINT}"
    quiet = nullcontext() if progress else reported(what)
    with quiet, closing(executor.run(job, pieces)) as outcomes:
        for outcome in outcomes:
            keep(outcome)
            done, failed = done + len(outcome.piece), failed + outcome.status.count(FAILED)
            if progress:
                progress(done, job.plan.runs, failed)


def in_memory(job: Job, labels: Labels, executor: Executor, progress: Progress | None) -> CampaignResult:
    """Make all runs and keep their outcomes in memory."""
    kept = InMemory(job, labels)
    work(job, list(job.plan.pieces), executor, kept.write, 0, 0, progress)
    return kept.result()


def in_store(
    job: Job,
    labels: Labels,
    path: Path,
    description: Mapping[str, Any],
    choose: Callable[[], Executor],
    progress: Progress | None,
    *,
    retry_failed: bool,
) -> CampaignResult:
    """Make the runs that a store lacks; with `retry_failed` also those that have failed there.

    Raises
    ------
    StoreError
        If it is the store of another campaign, or cannot be written.
    """
    signals = {name: (signal.shape, signal.unit) for name, signal in job.signals.items()}
    begin = CampaignStore.resume if (path / NAME).exists() else CampaignStore.create
    units = job.units_of_columns(labels)
    with begin(
        path, {**described(job), **description}, job.plan, signals, job.time, job.columns, fmus_of(job), labels, units
    ) as store:
        with written_to(path):
            keep_job(path, job)
        done = store.done()
        left = [piece for piece in store.plan.pieces if piece.index not in done]
        runs = sum(len(piece) for piece in store.plan.pieces) - sum(map(len, left))
        failed = store.failed()
        again = list(_stretches(failed, store.plan.size)) if retry_failed else []
        if left or again:
            executor = choose()
            replacing = _Replacing(store, again)
            redone = sum(map(len, again))

            def keep(outcome: Outcome) -> None:
                replacing.write(outcome) if outcome.piece in replacing else store.write(outcome)

            work(job, left + again, executor, keep, runs - redone, len(failed) - redone, progress)
        elif progress:
            progress(runs, job.plan.runs, len(failed))
        store.finish()
    kept = CampaignStore.open(path)
    return CampaignResult(kept.table, kept.dataset, kept.metadata.units)


@contextmanager
def noting_what_is_kept(path: Path | None, runs: int) -> Iterator[None]:
    """Note at a `KeyboardInterrupt` how many runs are kept, and how to continue."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if path is None:
            stop.add_note(f"Stopped by Ctrl-C: none of the {runs} runs is kept, because the campaign has no store.")
        else:
            kept, of = kept_runs(path) or (0, runs)
            stop.add_note(
                f"Stopped by Ctrl-C: {kept} of {of} runs are kept in {path}. To continue, call run() with it again."
            )
        raise


def kept_runs(path: Path) -> tuple[int, int] | None:
    """Return how many runs a store has, and how many its campaign has; None if there is no store."""
    with suppress(BayesFTCError):
        store = CampaignStore.open(path)
        return sum(len(store.plan.pieces[index]) for index in store.done()), store.plan.runs
    return None


class _Replacing:
    """Repeated runs, written to the store piece by piece when all runs of a piece have arrived."""

    def __init__(self, store: CampaignStore, stretches: list[Piece]):
        self._store, self._arrived = store, dict[int, list[Outcome]]()
        self._awaited: dict[int, set[Piece]] = {}
        for stretch in stretches:
            self._awaited.setdefault(stretch.index, set()).add(stretch)

    def __contains__(self, piece: Piece) -> bool:
        return piece in self._awaited.get(piece.index, ())

    def write(self, outcome: Outcome) -> None:
        index = outcome.piece.index
        self._arrived.setdefault(index, []).append(outcome)
        self._awaited[index].remove(outcome.piece)
        if not self._awaited[index]:
            self._store.replace(self._arrived.pop(index))


def _stretches(runs: list[int], size: int) -> Iterator[Piece]:
    """Yield runs as pieces of consecutive runs, each within one piece of the campaign."""
    for (index, _), group in groupby(enumerate(runs), key=lambda pair: (pair[1] // size, pair[1] - pair[0])):
        members = [run for _, run in group]
        yield Piece(index, members[0], members[-1] + 1)


__all__ = ["Progress", "in_memory", "in_store", "kept_runs", "noting_what_is_kept"]
