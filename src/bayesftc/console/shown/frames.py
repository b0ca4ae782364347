"""Binary frames for the page: rows of signals, reduced to the smallest and largest value of each stretch."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesftc.console.desk.history import Rows
from bayesftc.cosim.types import Floats


def thinned(rows: Rows, most: int) -> tuple[np.ndarray[Any, np.dtype[np.int64]], Floats]:
    """Return steps and values of at most `most` rows.

    Of each stretch of steps two rows remain, with the smallest and the largest value of each column in the order in which they
    occur. So no spike is lost. Missing values (NaN) remain only where a stretch has no other.
    """
    values, count = rows.values, len(rows.values)
    if count <= most:
        return rows.first + np.arange(count, dtype=np.int64), values
    stretches = max(most // 2, 1)
    size = -(-count // stretches)
    whole = count // size
    parts = [values[: whole * size].reshape(whole, size, -1)]
    starts = np.arange(whole) * size
    reduced = [_ends(parts[0])]
    lengths = np.full(whole, size)
    if whole * size < count:
        reduced.append(_ends(values[None, whole * size :]))
        starts, lengths = np.append(starts, whole * size), np.append(lengths, count - whole * size)
    steps = np.column_stack([starts, starts + np.maximum(lengths // 2, 1) * (lengths > 1)]).ravel()
    kept = np.column_stack([np.ones(len(starts), bool), lengths > 1]).ravel()  # a stretch of one row remains one row
    return rows.first + steps[kept], np.concatenate(reduced).reshape(-1, values.shape[1])[kept]


def _ends(part: Floats) -> Floats:
    """Return the smallest and the largest value of each column in each stretch, in the order in which they occur."""
    least, most = np.fmin.reduce(part, axis=1), np.fmax.reduce(part, axis=1)
    first = np.where(np.isnan(part), np.inf, part).argmin(axis=1) <= np.where(np.isnan(part), -np.inf, part).argmax(
        axis=1
    )
    return np.stack([np.where(first, least, most), np.where(first, most, least)], axis=1)


def packed(header: Mapping[str, Any], steps: np.ndarray[Any, np.dtype[np.int64]], values: Floats) -> bytes:
    """Return a frame: the length of the header, the header in JSON, steps (float64), and values (float32) column by column.

    The header's ``shape`` has the number of rows and of columns. The header is padded with spaces, so that numbers begin at a
    multiple of 8 bytes.
    """
    text = json.dumps({**header, "shape": list(values.shape)}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 8)
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(values.T, dtype="<f4").tobytes()
    return b"".join((struct.pack("<I", len(text)), text, steps.astype("<f8").tobytes(), data))


__all__ = ["packed", "thinned"]
