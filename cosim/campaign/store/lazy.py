"""Signals of a stored campaign for xarray: read when they are used, chunk by chunk; NaN for pieces that are not done."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from xarray.backends import BackendArray
from xarray.core import indexing

from bayesftc.cosim.campaign.designs.plan import Piece
from bayesftc.cosim.campaign.store.chunks import Chunks
from bayesftc.cosim.types import Floats


class StoredSignal(BackendArray):
    """A signal over run, time and the axes of the signal.

    Files are read with the layout in `Chunks`, not with the metadata of the zarr group, which may be damaged.

    Parameters
    ----------
    chunks : Chunks
        The layout of the chunks.
    name : str
        Name of the signal.
    pieces : iterable of Piece
        The finished pieces.
    runs : int
        Number of runs of the campaign.
    read : callable
        Returns the bytes of a file, by its name in the campaign's folder.
    """

    def __init__(self, chunks: Chunks, name: str, pieces: Iterable[Piece], runs: int, read: Callable[[str], bytes]):
        self.shape = (runs, chunks.rows, *chunks.signals[name][0])
        self.dtype = np.dtype(np.float64)
        self._chunks, self._name, self._read = chunks, name, read
        self._pieces = {piece.index: piece for piece in pieces}

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_out)

    def _read_out(self, key: tuple[Any, ...]) -> Floats:
        """Return the elements of an outer index: for each axis a number, a slice or an array."""
        places = [np.atleast_1d(np.arange(size)[index]) for size, index in zip(self.shape, key, strict=True)]
        values = np.full((len(places[0]), len(places[1]), *self.shape[2:]), np.nan)
        sizes = self._chunks.shape(self._name)
        pieces, blocks = places[0] // sizes[0], places[1] // sizes[1]
        for piece in (self._pieces[i] for i in np.unique(pieces) if i in self._pieces):
            for block in np.unique(blocks):
                chunk = self._chunks.chunk(self._name, piece, int(block), self._read)
                runs, rows = pieces == piece.index, blocks == block
                values[np.ix_(runs, rows)] = chunk[np.ix_(places[0][runs] % sizes[0], places[1][rows] % sizes[1])]
        for axis, place in enumerate(places[2:], start=2):
            values = values.take(place, axis)
        return values.squeeze(
            tuple(axis for axis, index in enumerate(key) if np.ndim(index) == 0 and not isinstance(index, slice))
        )


__all__ = ["StoredSignal"]
