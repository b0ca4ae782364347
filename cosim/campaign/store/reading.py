"""Read a stored campaign, while it is written or after."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import FAILED, Piece, Plan
from bayesftc.cosim.campaign.runs.columns import unit_attributes
from bayesftc.cosim.campaign.store import parts as run_parts
from bayesftc.cosim.campaign.store.chunks import Chunks
from bayesftc.cosim.campaign.store.making import FMUS, digest_of
from bayesftc.cosim.campaign.store.metadata import Metadata
from bayesftc.cosim.campaign.store.parts import Part, Parts
from bayesftc.cosim.campaign.store.redo import Redo
from bayesftc.cosim.errors import StoreError, UnknownNameError, did_you_mean
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PENDING = "pending"
"""Status of unfinished runs in a dataset."""
PATIENCE = 10.0
"""Seconds in which a writer on a busy machine lets the files stand as they are once."""


class StoredCampaign:
    """The folder of a campaign, for reading.

    Parameters
    ----------
    path : pathlib.Path
        The folder.

    Attributes
    ----------
    path : pathlib.Path
        Its folder.
    metadata : Metadata
        Its metadata.
    plan : Plan
        Its points (with labels as values), seeds and pieces.

    Raises
    ------
    StoreError
        If there is none, or it is damaged or of a later version.
    """

    def __init__(self, path: Path):
        self.path, self.metadata = path, Metadata.read(path)
        self.plan: Plan = self.metadata.plan
        self._parts, self._redo = Parts(self.metadata), Redo(path)
        self._chunks = Chunks(self.metadata) if self.metadata.signals else None
        self._pieces = self.plan.pieces

    def done(self) -> set[int]:
        """Return the numbers of the pieces that are done."""
        indices = self._part_indices()  # before the check for the whole file, because its writer then removes the parts
        if (self.path / run_parts.WHOLE).exists():
            return {piece.index for piece in self._pieces}
        return set(indices)

    @property
    def whole(self) -> bool:
        """Whether all pieces are done."""
        return len(self.done()) == len(self._pieces)

    @property
    def time(self) -> Floats:
        """Time in seconds of each row of the signals; empty if none were recorded."""
        if self._chunks is None:
            return np.empty(0)
        return self._chunks.times(self.metadata.times, self._redo.read)

    @property
    def seconds(self) -> float:
        """Computing time of the runs in seconds."""
        return sum(self._read().seconds.values())

    def table(self) -> pd.DataFrame:
        """Return a table with a row for each finished run: run, point, seed, factors, status, reason, steps, metrics.

        Raises
        ------
        StoreError
            If a file of it is damaged.
        """
        table: pd.DataFrame = self._read().rows.to_pandas()
        return table

    def failed(self) -> list[int]:
        """Return the numbers of the runs that have failed."""
        rows = self._read().rows
        status = np.array(rows["status"].to_pylist(), dtype=object)
        return [int(run) for run in rows["run"].to_numpy()[status == FAILED]]

    def dataset(self) -> xr.Dataset:
        """Return the signals over run and time, read from the disk at each use; NaN for unfinished runs.

        Coordinates are run, time (s), point, seed, each factor, and status: ``"ok"``, ``"failed"`` or ``"pending"``. For runs
        that finish later, call this method again.

        Raises
        ------
        StoreError
            If a file of it is damaged.
        """
        import xarray as xr

        rows = self._read().rows
        runs = rows["run"].to_numpy()
        status = np.full(self.plan.runs, PENDING, dtype=object)
        status[runs] = np.array(rows["status"].to_pylist(), dtype=object)
        columns = {**self._parts.runs, "status": status.astype(str)}
        units = self.metadata.units
        coordinates: dict[str, Any] = {
            n: ("run", column, unit_attributes(units.get(n))) for n, column in columns.items()
        }
        if self._chunks is None:
            return xr.Dataset(coords=coordinates)
        from xarray.core.indexing import CopyOnWriteArray, LazilyIndexedArray

        from bayesftc.cosim.campaign.store.lazy import StoredSignal

        pieces = [self._pieces[i] for i in np.unique(runs // self.plan.size)]
        signals = {}
        for name, (shape, unit) in self.metadata.signals.items():
            lazy: Any = LazilyIndexedArray(StoredSignal(self._chunks, name, pieces, self.plan.runs, self._redo.read))
            axes = ("run", "time", *(f"{name}_{axis}" for axis in range(len(shape))))
            signals[name] = xr.Variable(axes, CopyOnWriteArray(lazy), unit_attributes(unit))
        coordinates["time"] = ("time", self.time, {"units": "s"})
        attributes = {"description": json.dumps(self.metadata.description, ensure_ascii=False)}
        return xr.Dataset(signals, coordinates, attributes)

    def pieces_of_signals(self, names: Iterable[str] | None = None) -> Iterator[tuple[Piece, dict[str, Floats]]]:
        """Yield each finished piece with some signals of its runs, of shape (runs, rows, ...).

        Parameters
        ----------
        names : iterable of str, optional
            Names of the signals; all by default.

        Raises
        ------
        UnknownNameError
            If a signal was not recorded.
        StoreError
            If a file is damaged.
        """
        chosen = list(self.metadata.signals if names is None else names)
        for name in chosen:
            if name not in self.metadata.signals:
                raise UnknownNameError(
                    f"The campaign has no signal {name!r}; {did_you_mean(name, self.metadata.signals)}"
                )
        for index in sorted(self.done()):
            piece = self._pieces[index]
            yield piece, {name: self._signal(name, piece) for name in chosen}

    def fmu(self, digest: str) -> Path:
        """Return the copy of the FMU with that SHA-256.

        Raises
        ------
        StoreError
            If it is missing or damaged.
        """
        if digest not in self.metadata.fmus:
            raise StoreError(f"The campaign {self.path} has no FMU {digest}.")
        path = self.path / FMUS / f"{digest}.fmu"
        try:
            if digest_of(path) == digest:
                return path
        except OSError:
            pass
        raise StoreError(
            f"{path}, the copy of {self.metadata.fmus[digest]}, is missing or damaged; copy the original FMU of the campaign "
            "to this path."
        )

    def _part_indices(self) -> list[int]:
        """Return the numbers of the pieces that have a part, in order."""
        try:
            numbers = map(self._parts.piece, self._redo.names(run_parts.FOLDER))
        except OSError as error:
            raise StoreError(
                f"The folder {self.path / run_parts.FOLDER} cannot be read ({error.strerror or error}); without it the "
                "campaign is damaged: run it again in another folder."
            ) from None
        return sorted(i for i in numbers if i is not None and i < len(self._pieces))

    def _read(self) -> Part:
        """Return all rows as one part; parts are newer than the whole file."""
        end = monotonic() + PATIENCE
        while monotonic() < end:  # a writer may be joining the parts, and then removes them
            try:
                indices = self._part_indices()
                parts = [self._part(self._pieces[i]) for i in indices]
                if (self.path / run_parts.WHOLE).exists():
                    whole = self._whole()
                    older = self._parts.without(whole.rows, (self._pieces[i] for i in indices))
                    parts.insert(0, replace(whole, rows=older))
                rows = self._parts.joined(part.rows for part in parts)
                seconds = {piece: taken for part in parts for piece, taken in part.seconds.items()}
                return Part(rows, seconds, {piece: sizes for part in parts for piece, sizes in part.sizes.items()})
            except FileNotFoundError:
                sleep(0.01)
            except OSError as error:
                raise StoreError(f"The campaign {self.path} cannot be read: {error.strerror or error}.") from None
        raise StoreError(
            f"The campaign {self.path} cannot be read, because its files appear and disappear; check whether another process "
            "removes it."
        )

    def _part(self, piece: Piece) -> Part:
        name = self._parts.name(piece.index)
        return self._parts.decode(self._redo.read(name), name, piece)

    def _whole(self) -> Part:
        return self._parts.decode((self.path / run_parts.WHOLE).read_bytes(), run_parts.WHOLE)

    def _signal(self, name: str, piece: Piece) -> Floats:
        assert self._chunks is not None
        return self._chunks.decode(name, piece, self._redo.read)


__all__ = ["PENDING", "StoredCampaign"]
