"""The signals of a campaign as a zarr group that xarray can read: for each piece a chunk of each signal.

The chunks are encoded here and written with `write_whole`. zarr's own writing has no fsync and no mark of valid chunks, and
takes seven times as long for a chunk of 10 runs. Tests compare the chunks with those that zarr reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.designs.plan import Piece
from bayesftc.cosim.campaign.runs.columns import Array, unit_attributes
from bayesftc.cosim.campaign.store.metadata import Metadata, hash_of
from bayesftc.cosim.errors import StoreError
from bayesftc.cosim.types import Floats

FOLDER = "signals.zarr"
TIMES = f"{FOLDER}/time/c/0"
LARGEST = 1 << 27
"""Largest size of a chunk in bytes; a larger signal of a piece is also divided over time."""

PURPOSE = "A stored campaign"


class Chunks:
    """The layout and the encoding of the signals.

    Parameters
    ----------
    metadata : Metadata
        Metadata of the campaign.
    """

    def __init__(self, metadata: Metadata):
        self.signals, self.rows, self.size = metadata.signals, metadata.rows, metadata.plan.size
        self._codec = extra("numcodecs", PURPOSE).Zstd(level=0, checksum=True)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a chunk of a signal."""
        shape = self.signals[name][0]
        row = 8 * self.size * max(prod(shape), 1)
        return (self.size, max(1, min(self.rows, LARGEST // row)), *shape)

    def blocks(self, name: str) -> int:
        """Return the number of chunks over time of a piece's signal."""
        return -(-self.rows // self.shape(name)[1])

    def key(self, name: str, piece: int, block: int) -> str:
        """Return the name of the file of a chunk, in the campaign's folder."""
        return f"{FOLDER}/{escaped(name)}/c.{piece}.{block}" + ".0" * len(self.signals[name][0])

    def keys(self, piece: int) -> list[str]:
        """Return the names of all files of a piece."""
        return [self.key(name, piece, block) for name in self.signals for block in range(self.blocks(name))]

    def encode(self, name: str, values: Floats, block: int) -> Any:
        """Return the bytes of a chunk.

        Parameters
        ----------
        name : str
            Name of the signal.
        values : ndarray of shape (runs, rows, ...)
            The recorded signal of the runs of the piece.
        block : int
            Number of the chunk over time.
        """
        shape = self.shape(name)
        some = values[:, block * shape[1] : (block + 1) * shape[1]]
        if some.shape != shape:  # chunks at the ends are padded
            whole = np.full(shape, np.nan)
            whole[: some.shape[0], : some.shape[1]] = some
            some = whole
        return self._codec.encode(np.ascontiguousarray(some, dtype="<f8"))

    def decode(self, name: str, piece: Piece, read: Callable[[str], bytes]) -> Floats:
        """Return the signal of a piece, of shape (runs, rows, ...).

        Parameters
        ----------
        name : str
            Name of the signal.
        piece : Piece
            The runs.
        read : callable
            Returns the bytes of a file.

        Raises
        ------
        StoreError
            If a chunk is missing or damaged.
        """
        length = self.shape(name)[1]
        signal = np.empty((len(piece), self.rows, *self.signals[name][0]))
        for block in range(self.blocks(name)):
            chunk, begin = self.chunk(name, piece, block, read), block * length
            signal[:, begin : begin + length] = chunk[: len(piece), : self.rows - begin]
        return signal

    def chunk(self, name: str, piece: Piece, block: int, read: Callable[[str], bytes]) -> Floats:
        """Return the content of a chunk, padded at the ends; the arguments are those of `decode`."""
        key, chunk = self.key(name, piece.index, block), np.empty(self.shape(name), dtype="<f8")
        try:
            self._codec.decode(read(key), chunk)  # into an array, because a damaged chunk may state any size
        except (OSError, ValueError, RuntimeError) as error:
            reason = getattr(error, "strerror", None) or "its content has changed"
            raise StoreError(
                f"The file {key} of the campaign, with {name!r} of runs {piece.begin} to {piece.end - 1}, is missing or "
                f"damaged ({reason}); remove it and resume the campaign to repeat these runs."
            ) from None
        return chunk

    def times(self, expected: str, read: Callable[[str], bytes]) -> Floats:
        """Return the time of each row in seconds.

        Parameters
        ----------
        expected : str
            Their hash.
        read : callable
            Returns the bytes of a file.

        Raises
        ------
        StoreError
            If they are missing or damaged.
        """
        times = np.zeros(self.rows, dtype="<f8")
        try:
            self._codec.decode(read(TIMES), times)
        except FileNotFoundError:
            pass  # zarr writes no chunk of zeros
        except (OSError, ValueError, RuntimeError):
            times = np.empty(0)
        if hash_of(times) != expected:
            raise StoreError(
                f"The file {TIMES} of the campaign, with the time of each row, is missing or damaged; use a backup of it, or run "
                "the campaign again in another folder."
            )
        return times


def create(folder: Path, metadata: Metadata, times: Floats, coordinates: Mapping[str, Array]) -> None:
    """Make the zarr group of a campaign, with coordinates and no signals yet.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of the campaign.
    metadata : Metadata
        Metadata of the campaign.
    times : ndarray of shape (rows,)
        Time of each row in seconds.
    coordinates : mapping of str to ndarray of shape (runs,)
        Columns that identify each run.
    """
    import warnings

    zarr = extra("zarr", PURPOSE)
    chunks, runs = Chunks(metadata), metadata.plan.runs
    group = zarr.create_group(folder / FOLDER, zarr_format=3)
    _coordinate(group, "time", "time", times, "s")
    for name, values in coordinates.items():
        _coordinate(group, escaped(name), "run", values, metadata.units.get(name))
    for name, (shape, unit) in metadata.signals.items():
        group.create_array(
            escaped(name),
            shape=(runs, metadata.rows, *shape),
            chunks=chunks.shape(name),
            dtype="float64",
            fill_value=np.nan,
            compressors=[zarr.codecs.ZstdCodec(level=0, checksum=True)],
            chunk_key_encoding={"name": "default", "separator": "."},  # one folder for each signal
            dimension_names=("run", "time", *(f"{name}_{axis}" for axis in range(len(shape)))),
            attributes=unit_attributes(unit),
        )
    named = map(escaped, coordinates)
    group.attrs["coordinates"] = " ".join(name for name in named if not set(name) & set(" \t\n") and name != "run")
    with warnings.catch_warnings():  # xarray warns without consolidated metadata, zarr with it
        warnings.simplefilter("ignore")
        zarr.consolidate_metadata(group.store)


def _coordinate(group: Any, name: str, dimension: str, values: Array, unit: str | None) -> None:
    texts = values.dtype == object
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=(max(len(values), 1),),
        dtype=str if texts else values.dtype,
        dimension_names=(dimension,),
        attributes=unit_attributes(unit),
    )
    array[:] = np.array(["" if v is None else v for v in values], dtype=object) if texts else values


def escaped(name: str) -> str:
    """Return the name of an array: zarr turns slashes into groups, and reserves names that begin with two underscores."""
    result = name.replace("%", "%25").replace("/", "%2F")
    return f"%5F{result[1:]}" if result.startswith("__") else result


def stray(folder: Path, chunks: Chunks, done: set[int]) -> Iterator[Path]:
    """Yield files of signals that belong to no finished piece: a killed writer had begun them."""
    for name in chunks.signals:
        for path in (folder / FOLDER / escaped(name)).iterdir():
            parts = path.name.split(".")
            if parts[0] == "c" and (not parts[1].isdigit() or int(parts[1]) not in done or not parts[-1].isdigit()):
                yield path


__all__ = ["FOLDER", "PURPOSE", "Chunks", "create", "escaped", "stray"]
