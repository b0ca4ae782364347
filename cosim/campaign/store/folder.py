"""A campaign in a folder: each piece is stored completely or not at all, even if the writing process is killed.

``campaign.json`` describes the campaign, ``signals.zarr`` contains the recorded signals, ``runs`` a part of the table for each
finished piece (``runs.parquet`` in the end), ``fmus`` the FMUs. Of each piece the signals are written first and the part last.
A piece is finished when its part exists. One process writes at a time, any number may read.
"""

from __future__ import annotations

import os
import time as clock
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
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
"""Number of files that are written at a time; seconds after which the names of new files are flushed to the disk."""


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
        units: Mapping[str, str] | None = None,
    ) -> CampaignStore:
        """Make an empty store, open for writing.

        Parameters
        ----------
        path : path
            Its folder, which must not exist yet, or be empty.
        description : mapping
            Description of the campaign: texts, numbers, lists and mappings.
        plan : Plan
            Points, seeds and pieces.
        signals : mapping of str to (shape, unit)
            The recorded signals of each run.
        time : ndarray of shape (rows,)
            Time of each row of the signals, in seconds.
        metrics : iterable of str
            Names of the metrics.
        fmus : mapping of str to path, optional
            The FMUs, by their SHA-256; they are copied.
        labels : iterable of mapping, optional
            The label of each factor in tables, for each point; by default the values.
        units : mapping of str to str, optional
            The unit of each column of the table that has one.

        Raises
        ------
        StoreError
            If the folder cannot be written, is not empty, or an FMU has another hash.
        """
        path = Path(path).resolve()
        make(path, metadata_of(description, plan, signals, time, metrics, fmus, labels, units), time, fmus or {})
        return cls(path, locked(path))

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> CampaignStore:
        """Open a store for reading; another process may write to it at the same time.

        Raises
        ------
        StoreError
            If there is none, or it is damaged or of a later version.
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
        units: Mapping[str, str] | None = None,
    ) -> CampaignStore:
        """Open a store for writing, to make the missing runs; unfinished files of a killed writer are removed.

        The pieces are those of the store: use `plan` of the returned store, whose pieces may have another size.

        Parameters
        ----------
        path : path
            Its folder.
        description, plan, signals, time, metrics, fmus, labels, units
            The campaign to resume, as for `create`. The units may be others than before.

        Raises
        ------
        StoreError
            If there is none, it is damaged, another process writes to it, or it is another campaign.

        Warns
        -----
        UserWarning
            If versions, the platform or last digits of libraries have changed, or pieces are damaged.
        """
        path = Path(path).absolute()
        given = metadata_of(description, plan, signals, time, metrics, fmus, labels, units)
        stored = Metadata.read(path)
        unlike = differences(stored.identity(), given.identity())
        if unlike:
            raise StoreError(f"The campaign in {path} {_another(unlike, stored.plan, given.plan)}")
        store = cls(path, locked(path))
        try:
            with written_to(path):
                store._recover()
                store._note_units(given.units)
                store._note_environment(given.environment)
        except BaseException:
            store.close()
            raise
        return store

    def close(self) -> None:
        """Close the store, so that other processes can write."""
        if self._pool is not None:
            with suppress(OSError):  # without the flush, only a power failure can lose written files
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
        """Add a piece; a finished piece is not changed.

        Parameters
        ----------
        outcome : Outcome
            The outcome of its runs.

        Raises
        ------
        StoreError
            If it cannot be written, is not a piece of this campaign, or the store is open for reading only.
        """
        piece = outcome.piece
        if not 0 <= piece.index < len(self._pieces) or self._pieces[piece.index] != piece:
            raise StoreError(f"{piece} is not a piece of the campaign in {self.path}.")
        self._check(outcome)
        name = self._parts.name(piece.index)
        if (self.path / name).exists() or (self.path / run_parts.WHOLE).exists():
            return
        with written_to(self.path):
            sizes = self._write_signals(piece.index, outcome.signals, self.path.joinpath)
            key = str(piece.index)
            part = Part(self._parts.rows(outcome), {key: outcome.seconds}, {key: sizes})
            write_whole(self.path / name, self._parts.encode(part))
            if clock.monotonic() - self._synced > UNSYNCED:
                self._sync()

    def replace(self, outcomes: Outcome | Iterable[Outcome]) -> None:
        """Replace finished runs by the same runs, made again.

        Each piece changes as a whole: all its rows and signals are old, or all are new.

        Parameters
        ----------
        outcomes : Outcome or iterable of Outcome
            The new outcomes. Their pieces may be any consecutive runs. Outcomes of one piece of the campaign are best given
            together.

        Raises
        ------
        StoreError
            If a run is not finished yet, or the store cannot be written.
        """
        given = [outcomes] if isinstance(outcomes, Outcome) else list(outcomes)
        for outcome in given:
            self._check(outcome)
        done = self.done()
        touched = sorted({run // self.plan.size for o in given for run in range(o.piece.begin, o.piece.end)})
        if not set(touched) <= done:
            raise StoreError("Only finished runs can be replaced; resume the campaign for the others.")
        with written_to(self.path):
            self._redo.recover()
            try:
                for index in touched:
                    self._replace(self._pieces[index], given)
            finally:
                self._redo.discard()

    def finish(self) -> None:
        """Join the parts of the table into one file, unless this is already done.

        Raises
        ------
        StoreError
            If not all runs are finished, or the store cannot be written.
        """
        self._writable()
        if not self.whole:
            raise StoreError(
                f"The campaign in {self.path} is not complete: {len(self.done())} of {len(self._pieces)} pieces are done; "
                "resume it."
            )
        with written_to(self.path):
            self._redo.recover()
            indices = self._part_indices()
            if indices or not (self.path / run_parts.WHOLE).exists():
                self._sync()
                write_whole(self.path / run_parts.WHOLE, self._parts.encode(self._read()))
                sync_folder(self.path)
                for index in indices:  # the whole file now has their rows
                    (self.path / self._parts.name(index)).unlink()

    def _write_signals(self, piece: int, signals: Mapping[str, Floats], place: Callable[[str], Path]) -> list[int]:
        """Write the chunks of a piece, several at a time, to the paths that `place` returns; return their sizes."""
        chunks, pool = self._chunks, self._pool
        if chunks is None or pool is None:
            return []

        def write(name: str, block: int) -> int:
            return write_whole(place(chunks.key(name, piece, block)), chunks.encode(name, signals[name], block))

        names = [name for name in self.metadata.signals if name in signals]
        tasks = [pool.submit(write, name, block) for name in names for block in range(chunks.blocks(name))]
        wait(tasks)  # for all, even if one has failed, so that none is still writing during the next piece
        return [task.result() for task in tasks]

    def _replace(self, piece: Piece, outcomes: list[Outcome]) -> None:
        """Write the files of a piece again, with new rows for some runs, and make them valid all at once."""
        key, name = str(piece.index), self._parts.name(piece.index)
        old = self._part(piece) if piece.index in self._part_indices() else self._parts.of_piece(self._whole(), piece)
        rows, seconds, sizes = old.rows, old.seconds[key], list[int]()
        new = [(outcome, _overlap(outcome.piece, piece)) for outcome in outcomes if _overlap(outcome.piece, piece)]
        for signal in self.metadata.signals:  # one at a time, because a piece may fill the memory
            values = self._signal(signal, piece)
            for outcome, runs in new:
                values[_rows(runs, piece)] = outcome.signals[signal][_rows(runs, outcome.piece)]
            sizes += self._write_signals(piece.index, {signal: values}, self._redo.stage)
        for outcome, runs in new:
            rows = self._parts.put(rows, self._parts.rows(outcome)[_rows(runs, outcome.piece)])
            seconds += outcome.seconds * len(runs) / len(outcome.piece)
        write_whole(self._redo.stage(name), self._parts.encode(Part(rows, {key: seconds}, {key: sizes})))
        self._redo.commit()

    def _sync(self) -> None:
        """Flush the names of all files to the disk."""
        folders = [self.path / run_parts.FOLDER]
        folders += [self.path / signal_chunks.FOLDER / escaped(name) for name in self.metadata.signals]
        assert self._pool is not None
        list(self._pool.map(sync_folder, folders))
        self._synced = clock.monotonic()

    def _recover(self) -> None:
        """Complete a valid replacement, and remove damaged files and those of unfinished pieces."""
        self._redo.recover()
        damaged = set()
        for index in self._part_indices():
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
                f"{len(damaged)} of {len(self._pieces)} pieces of the campaign in {self.path} were damaged, perhaps by a power "
                "failure; they are made again.",
                UserWarning,
                stacklevel=3,
            )
        begun = [*self.path.glob(f"*{TEMPORARY}"), *(self.path / run_parts.FOLDER).glob(f"*{TEMPORARY}")]
        if self._chunks is not None:
            begun += signal_chunks.stray(self.path, self._chunks, self.done())
        for path in begun:
            path.unlink()

    def _recover_whole(self, damaged: set[int]) -> set[int]:
        """Check the whole file; if it has damaged pieces, replace it by parts, and return the pieces without a part.

        Its rows of the pieces `damaged`, whose newer parts are damaged, are no longer valid.
        """
        indices = set(self._part_indices())
        try:
            whole = self._whole()
        except StoreError:
            damaged = {piece.index for piece in self._pieces} - indices
        else:
            damaged = (self._torn(whole) | damaged) - indices
            if not damaged:
                return damaged
            for piece in self._pieces:
                if piece.index not in indices | damaged:
                    part = self._parts.of_piece(whole, piece)
                    write_whole(self.path / self._parts.name(piece.index), self._parts.encode(part))
        (self.path / run_parts.WHOLE).unlink()
        return damaged

    def _torn(self, part: Part) -> set[int]:
        """Return the pieces of a part whose signal files have another size than when they were written."""
        return {
            int(piece)
            for piece, sizes in part.sizes.items()
            if self._chunks and [_size(self.path / key) for key in self._chunks.keys(int(piece))] != sizes
        }

    def _note_units(self, now: Mapping[str, str]) -> None:
        if now != self.metadata.units:  # as of a store of an early version
            self.metadata = replace(self.metadata, units=now)
            self.metadata.write(self.path)

    def _note_environment(self, now: Mapping[str, Any]) -> None:
        changes = environment.changes(self.metadata.latest, now)
        if not changes:
            return
        self.metadata = self.metadata.again(now, len(self.done()))
        self.metadata.write(self.path)
        warnings.warn(
            f"The campaign in {self.path} continues in another environment ({'; '.join(changes)}); the last digits of its "
            "numbers may differ from those of the first environment.",
            UserWarning,
            stacklevel=3,
        )

    def _writable(self) -> None:
        if self._lock is None:
            raise StoreError(f"The campaign in {self.path} is open for reading only; resume it to write.")

    def _check(self, outcome: Outcome) -> None:
        """Check that an outcome belongs to this campaign."""
        self._writable()
        n, of = len(outcome.piece), self.metadata
        shapes = {name: np.shape(values) for name, values in outcome.signals.items()}
        expected = {name: (n, of.rows, *shape) for name, (shape, _) in of.signals.items()}
        lengths = {len(outcome.steps), len(outcome.status), len(outcome.reasons), *map(len, outcome.metrics.values())}
        valid = set(outcome.status) <= {OK, FAILED} and set(outcome.metrics) == set(of.metrics)
        if shapes != expected or lengths != {n} or not valid or outcome.piece.end > self.plan.runs:
            raise StoreError(f"The outcome of {outcome.piece} does not fit the campaign in {self.path}.")


def _another(unlike: Sequence[str], stored: Plan, given: Plan) -> str:
    """Return how a campaign differs from the stored one, and what to do."""
    (old, *_), (new, *_) = stored.seeds or ((),), given.seeds or ((),)
    before, now, begin_alike = len(old), len(new), all(a == b for a, b in zip(old, new, strict=False))
    if before != now and begin_alike and all(text.startswith("seeds") for text in unlike):
        return (
            f"has seeds={before}, not seeds={now}. A store keeps its number of runs. Choose another folder, or give "
            f"seeds={before} to go on."
        )
    factors, others = (list(dict.fromkeys(name for point in plan.points for name in point)) for plan in (stored, given))
    only = [
        f"{', '.join(names)} only {where}"
        for where, names in (
            ("in the store", [name for name in factors if name not in others]),
            ("now", [name for name in others if name not in factors]),
        )
        if names
    ]
    if only:
        unlike = [f"it varies {' and '.join(only)}"]
    more = f" (and {len(unlike) - 3} more)" if len(unlike) > 3 else ""
    advice = "Choose another folder, or use the settings of the stored campaign. To read its results, open runs.parquet there."
    return f"is another one: {'; '.join(unlike[:3])}{more}. {advice}"


def _overlap(a: Piece, b: Piece) -> range:
    return range(max(a.begin, b.begin), min(a.end, b.end))


def _rows(runs: range, of: Piece) -> slice:
    """Return the places of runs in the arrays of a piece."""
    return slice(runs.start - of.begin, runs.stop - of.begin)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else -1


__all__ = ["PENDING", "CampaignStore"]
