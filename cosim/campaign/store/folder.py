"""A campaign in a folder: each piece is in it whole or not at all, whatever happens to the process that writes it.

``campaign.json`` says what the campaign is, ``signals.zarr`` has what was recorded, ``runs`` a part of the table for each
piece that is done (``runs.parquet`` in the end), ``fmus`` the FMUs. Of a piece the signals are written first and the part last;
the part is what makes it done. One process writes at a time, any number may read.
"""

from __future__ import annotations

import os
import time as clock
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import FAILED, OK, Outcome, Piece, Plan
from bayesftc.cosim.campaign.store import chunks as signal_chunks, environment, parts as run_parts
from bayesftc.cosim.campaign.store.chunks import escaped
from bayesftc.cosim.campaign.store.durable import TEMPORARY, sync_folder, write_whole, written_to
from bayesftc.cosim.campaign.store.locking import locked
from bayesftc.cosim.campaign.store.making import make, metadata_of
from bayesftc.cosim.campaign.store.metadata import Metadata, Signal, differences
from bayesftc.cosim.campaign.store.parts import Part
from bayesftc.cosim.campaign.store.reading import PENDING, StoredCampaign
from bayesftc.cosim.errors import StoreError
from bayesftc.cosim.types import Floats

WRITERS, UNSYNCED = 8, 1.0
"""Files that are on their way to the disk at a time; seconds after which the names of new ones have to be there."""


class CampaignStore(StoredCampaign):
    """A stored campaign; made by `create`, `resume` or `open`."""

    def __init__(self, path: Path, lock: Any = None):
        super().__init__(path)
        self._lock, self._synced = lock, clock.monotonic()
        self._pool = ThreadPoolExecutor(WRITERS, "campaign-store") if lock is not None else None

    @classmethod
    def create(
        cls,
        path: str | os.PathLike[str],
        description: Mapping[str, Any],
        plan: Plan,
        signals: Mapping[str, Signal],
        time: Floats,
        metrics: Iterable[str],
        fmus: Mapping[str, str | os.PathLike[str]] | None = None,
        labels: Iterable[Mapping[str, Any]] | None = None,
    ) -> CampaignStore:
        """Make a store with nothing in it, open for writing.

        Parameters
        ----------
        path : path
            Its folder, which must not be there yet, or be empty.
        description : mapping
            What the campaign is: texts, numbers, lists and mappings.
        plan : Plan
            Points, seeds and pieces.
        signals : mapping of str to (shape, unit)
            What is recorded of each run.
        time : ndarray of shape (rows,)
            Of each row of the signals, in seconds.
        metrics : iterable of str
            Their names.
        fmus : mapping of str to path, optional
            The FMUs, by their SHA-256; they are copied.
        labels : iterable of mapping, optional
            For each point what stands for each factor's value in tables; the values themselves by default.

        Raises
        ------
        StoreError
            If the folder cannot be written, has something in it, or an FMU is not what its hash says.
        """
        path = Path(path).resolve()
        make(path, metadata_of(description, plan, signals, time, metrics, fmus, labels), time, fmus or {})
        return cls(path, locked(path))

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> CampaignStore:
        """Open a store for reading; someone may be writing it at the same time.

        Raises
        ------
        StoreError
            If there is none, or it is damaged or that of a later version.
        """
        return cls(Path(path).absolute())

    @classmethod
    def resume(
        cls,
        path: str | os.PathLike[str],
        description: Mapping[str, Any],
        plan: Plan,
        signals: Mapping[str, Signal],
        time: Floats,
        metrics: Iterable[str],
        fmus: Mapping[str, str | os.PathLike[str]] | None = None,
        labels: Iterable[Mapping[str, Any]] | None = None,
    ) -> CampaignStore:
        """Open a store for writing, to do what is not done yet; what a killed writer had begun is removed.

        The pieces are those of the store: `plan` of what is returned, not the one given here, says how the runs are cut.

        Parameters
        ----------
        path : path
            Its folder.
        description, plan, signals, time, metrics, fmus, labels
            As for `create`: what the campaign is that is to go on.

        Raises
        ------
        StoreError
            If there is none, it is damaged, another process writes it, or it is another campaign.

        Warns
        -----
        UserWarning
            If versions, the C library or the processor's features are others than before, or pieces are damaged.
        """
        path = Path(path).absolute()
        wanted = metadata_of(description, plan, signals, time, metrics, fmus, labels)
        stored = Metadata.read(path)
        unlike = differences(stored.identity(), wanted.identity())
        if unlike:
            more = f" (and {len(unlike) - 3} more)" if len(unlike) > 3 else ""
            raise StoreError(
                f"The campaign in {path} is another one: {'; '.join(unlike[:3])}{more}. Choose another folder, or give the "
                "settings that it was made with."
            )
        store = cls(path, locked(path))
        try:
            with written_to(path):
                store._recover()
                store._note_environment(wanted.environment)
        except BaseException:
            store.close()
            raise
        return store

    def close(self) -> None:
        """Let others write."""
        if self._pool is not None:
            with suppress(OSError):  # what was written is there, if not after a power cut
                self._sync()
            self._pool.shutdown()
            self._pool = None
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> CampaignStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, outcome: Outcome) -> None:
        """Add a piece; one that is done already stays as it is.

        Parameters
        ----------
        outcome : Outcome
            What its runs have come to.

        Raises
        ------
        StoreError
            If it cannot be written, is no piece of this campaign, or the store is open for reading only.
        """
        piece = outcome.piece
        if not 0 <= piece.index < len(self._pieces) or self._pieces[piece.index] != piece:
            raise StoreError(f"{piece} is no piece of the campaign in {self.path}.")
        self._check(outcome)
        name = self._parts.name(piece.index)
        if (self.path / name).exists() or (self.path / run_parts.WHOLE).exists():
            return
        with written_to(self.path):
            sizes = self._write_signals(piece.index, outcome.signals, self.path.joinpath)
            own = str(piece.index)
            part = Part(self._parts.rows(outcome), {own: outcome.seconds}, {own: sizes})
            write_whole(self.path / name, self._parts.encode(part))
            if clock.monotonic() - self._synced > UNSYNCED:
                self._sync()

    def replace(self, outcomes: Outcome | Iterable[Outcome]) -> None:
        """Replace runs that are done by the same runs, made again.

        Each piece changes as a whole: rows and signals are the old ones, or the new ones.

        Parameters
        ----------
        outcomes : Outcome or iterable of Outcome
            What the runs have come to; their pieces may be any runs in a row. Those of one piece of the campaign are best
            given together.

        Raises
        ------
        StoreError
            If a run is not done yet, or nothing can be written.
        """
        given = [outcomes] if isinstance(outcomes, Outcome) else list(outcomes)
        for outcome in given:
            self._check(outcome)
        done = self.done()
        touched = sorted({run // self.plan.size for o in given for run in range(o.piece.begin, o.piece.end)})
        if not set(touched) <= done:
            raise StoreError("Only runs that are done can be replaced; resume the campaign for the others.")
        with written_to(self.path):
            self._redo.recover()
            try:
                for index in touched:
                    self._replace(self._pieces[index], given)
            finally:
                self._redo.discard()

    def finish(self) -> None:
        """Put the parts of the table together into one file; where that has been done already, nothing happens.

        Raises
        ------
        StoreError
            If not all runs are done, or nothing can be written.
        """
        self._writable()
        if not self.whole:
            raise StoreError(
                f"The campaign in {self.path} is not whole: {len(self.done())} of {len(self._pieces)} pieces are done; "
                "resume it."
            )
        with written_to(self.path):
            self._redo.recover()
            found = self._found()
            if found or not (self.path / run_parts.WHOLE).exists():
                self._sync()
                write_whole(self.path / run_parts.WHOLE, self._parts.encode(self._read()))
                sync_folder(self.path)
                for index in found:  # each of which has what the file has
                    (self.path / self._parts.name(index)).unlink()

    # How

    def _write_signals(self, piece: int, signals: Mapping[str, Floats], place: Callable[[str], Path]) -> list[int]:
        """Write the chunks of a piece to where `place` says for their names, several at a time; return their sizes."""
        chunks, pool = self._chunks, self._pool
        if chunks is None or pool is None:
            return []

        def write(name: str, block: int) -> int:
            return write_whole(place(chunks.key(name, piece, block)), chunks.encode(name, signals[name], block))

        names = [name for name in self.metadata.signals if name in signals]
        tasks = [pool.submit(write, name, block) for name in names for block in range(chunks.blocks(name))]
        wait(tasks)  # for all, also where one has failed: none may write on when the next piece comes
        return [task.result() for task in tasks]

    def _replace(self, piece: Piece, outcomes: list[Outcome]) -> None:
        """Write the files of a piece again, with other rows for some runs, and let them be valid all at once."""
        own, name = str(piece.index), self._parts.name(piece.index)
        old = self._part(piece) if piece.index in self._found() else self._parts.of_piece(self._whole(), piece)
        rows, seconds, sizes = old.rows, old.seconds[own], list[int]()
        mine = [(outcome, _overlap(outcome.piece, piece)) for outcome in outcomes if _overlap(outcome.piece, piece)]
        for signal in self.metadata.signals:  # one at a time: a piece may have as much as fits into memory
            values = self._signal(signal, piece)
            for outcome, runs in mine:
                values[_rows(runs, piece)] = outcome.signals[signal][_rows(runs, outcome.piece)]
            sizes += self._write_signals(piece.index, {signal: values}, self._redo.stage)
        for outcome, runs in mine:
            rows = self._parts.put(rows, self._parts.rows(outcome)[_rows(runs, outcome.piece)])
            seconds += outcome.seconds * len(runs) / len(outcome.piece)
        write_whole(self._redo.stage(name), self._parts.encode(Part(rows, {own: seconds}, {own: sizes})))
        self._redo.commit()

    def _sync(self) -> None:
        """Have the names of all files on the disk."""
        folders = [self.path / run_parts.FOLDER]
        folders += [self.path / signal_chunks.FOLDER / escaped(name) for name in self.metadata.signals]
        assert self._pool is not None
        list(self._pool.map(sync_folder, folders))
        self._synced = clock.monotonic()

    def _recover(self) -> None:
        """Complete what was declared valid, and remove what is of no piece that is done, or damaged."""
        self._redo.recover()
        damaged = set()
        for index in self._found():
            try:
                if not self._torn(self._part(self._pieces[index])):
                    continue
            except StoreError:
                pass
            damaged.add(index)
            (self.path / self._parts.name(index)).unlink()
        if (self.path / run_parts.WHOLE).exists():
            damaged |= self._recover_whole(damaged)
        if damaged:
            warnings.warn(
                f"{len(damaged)} of {len(self._pieces)} pieces of the campaign in {self.path} were damaged, as by a power "
                "cut; they are made again.",
                UserWarning,
                stacklevel=3,
            )
        begun = [*self.path.glob(f"*{TEMPORARY}"), *(self.path / run_parts.FOLDER).glob(f"*{TEMPORARY}")]
        if self._chunks is not None:
            begun += signal_chunks.stray(self.path, self._chunks, self.done())
        for path in begun:
            path.unlink()

    def _recover_whole(self, damaged: set[int]) -> set[int]:
        """Check the file of all rows; where it is not in order, leave parts in its place and return what these lack.

        Of pieces whose newer parts are `damaged` it has rows that are not valid any more.
        """
        found = set(self._found())
        try:
            whole = self._whole()
        except StoreError:
            damaged = {piece.index for piece in self._pieces} - found
        else:
            damaged = (self._torn(whole) | damaged) - found
            if not damaged:
                return damaged
            for piece in self._pieces:
                if piece.index not in found | damaged:
                    part = self._parts.of_piece(whole, piece)
                    write_whole(self.path / self._parts.name(piece.index), self._parts.encode(part))
        (self.path / run_parts.WHOLE).unlink()
        return damaged

    def _torn(self, part: Part) -> set[int]:
        """Return the pieces of a part whose signals are not as long as they were when they were written."""
        return {
            int(piece)
            for piece, sizes in part.sizes.items()
            if self._chunks and [_size(self.path / key) for key in self._chunks.keys(int(piece))] != sizes
        }

    def _note_environment(self, now: Mapping[str, Any]) -> None:
        other = environment.changes(self.metadata.latest, now)
        if not other:
            return
        self.metadata = self.metadata.again(now, len(self.done()))
        self.metadata.write(self.path)
        warnings.warn(
            f"The campaign in {self.path} goes on in another environment ({'; '.join(other)}): the last places of its "
            "numbers may differ from what the first one would have given.",
            UserWarning,
            stacklevel=3,
        )

    def _writable(self) -> None:
        if self._lock is None:
            raise StoreError(f"The campaign in {self.path} is open for reading only; resume it to write.")

    def _check(self, outcome: Outcome) -> None:
        """Check that an outcome is one of this campaign."""
        self._writable()
        n, of = len(outcome.piece), self.metadata
        shapes = {name: np.shape(values) for name, values in outcome.signals.items()}
        wanted = {name: (n, of.rows, *shape) for name, (shape, _) in of.signals.items()}
        lengths = {len(outcome.steps), len(outcome.status), len(outcome.reasons), *map(len, outcome.metrics.values())}
        known = set(outcome.status) <= {OK, FAILED} and set(outcome.metrics) == set(of.metrics)
        if shapes != wanted or lengths != {n} or not known or outcome.piece.end > self.plan.runs:
            raise StoreError(f"What {outcome.piece} has come to does not fit the campaign in {self.path}.")


def _overlap(a: Piece, b: Piece) -> range:
    return range(max(a.begin, b.begin), min(a.end, b.end))


def _rows(runs: range, of: Piece) -> slice:
    """Return where runs stand in the arrays of a piece."""
    return slice(runs.start - of.begin, runs.stop - of.begin)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else -1


__all__ = ["PENDING", "CampaignStore"]
