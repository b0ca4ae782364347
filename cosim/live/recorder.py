"""Recordings of any length: Parquet files with a piece each, which other programs can read while the run goes on."""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, prod
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.store.durable import sync_folder, write_whole
from bayesftc.cosim.errors import ModelError, ResultFileError
from bayesftc.cosim.ports import labels
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

PURPOSE = "The recording of a live run"
STEP, TIME, CLOCK = FIRST = ("step", "time", "clock")
"""The first columns: number of the step, its time in seconds, and the time of the clock (seconds since 1970, UTC)."""
HEADER = b"bayesftc"
MOST = 16e6
"""Largest size of a piece in memory, in bytes."""
OURS = "[0-9][0-9][0-9][0-9]-[0-9][0-9]-[0-9][0-9]T*/*.parquet"
"""The pieces of runs in the folder of a recording. Other files there belong to somebody else, and are never deleted."""

BUFFERS = 6
"""Pieces in memory: one is filled, the others are written or wait for it."""


@dataclass(frozen=True)
class Recording:
    """Where and how a live run is recorded.

    Each run has a folder of its own in `folder`, named after the time of its start (UTC). In it are the pieces,
    ``000000.parquet`` and so on. A piece appears under its name when it is complete. After a kill only the last piece is missing.

    Parameters
    ----------
    folder : str or path
        The folder. It may have recordings of earlier runs.
    seconds : float
        Length of a piece in seconds of the clock.
    rows : int, optional
        Largest number of steps in a piece.
    keep : int, optional
        Number of pieces to keep, with those of earlier runs; the oldest ones are deleted. By default all are kept.

    Raises
    ------
    ModelError
        If a setting is not positive.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc.cosim import live
    >>> with TemporaryDirectory() as folder:
    ...     recorder = live.Recorder(live.Recording(folder, rows=100), {"car.v": ()}, step=0.01)
    ...     for k in range(250):
    ...         _ = recorder.add(k, 0.01 * k, [20.0 + k])
    ...     recorder.close()
    ...     pieces = sorted(path.name for path in recorder.folder.iterdir())
    ...     result = live.read_recording(folder)
    >>> pieces
    ['000000.parquet', '000001.parquet', '000002.parquet']
    >>> result["car.v"][-1]
    np.float64(269.0)
    """

    folder: str | os.PathLike[str]
    seconds: float = 10.0
    rows: int | None = None
    keep: int | None = None

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise ModelError(f"A piece of the recording has seconds={self.seconds!r}; it must be positive.")
        for name in ("rows", "keep"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 1):
                raise ModelError(f"The recording has {name}={value!r}; it must be a whole number, at least 1.")


@dataclass(eq=False)
class _Piece:
    rows: Floats
    count: int = 0
    began: float = 0.0


class Recorder:
    """Writes a recording from a thread of its own.

    Parameters
    ----------
    recording : Recording
        Where and how.
    signals : mapping of str to tuple of int
        The shape of each signal, ``()`` for a scalar. A row has the elements of all signals.
    step : float or Fraction
        Seconds between two steps.
    metadata : mapping, optional
        Further properties, as JSON can hold them.

    Attributes
    ----------
    folder : pathlib.Path
        The folder of this run.
    lost : int
        Number of rows that were not recorded, because the disk was too slow or full.
    pieces : int
        Number of pieces that were written.
    problem : str
        The last error of the disk, or an empty text.

    Raises
    ------
    ResultFileError
        If the folder cannot be made.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc.cosim import live
    >>> with TemporaryDirectory() as folder:
    ...     recorder = live.Recorder(live.Recording(folder), {"controller.u": (1,)}, step=0.02)
    ...     recorder.add(0, 0.0, [500.0])
    ...     recorder.close()
    ...     recorder.pieces, recorder.lost
    True
    (1, 0)
    """

    def __init__(
        self,
        recording: Recording,
        signals: Mapping[str, tuple[int, ...]],
        step: float | Fraction,
        metadata: Mapping[str, Any] | None = None,
    ):
        self._arrow, self._parquet = extra("pyarrow", PURPOSE, "live"), extra("pyarrow.parquet", PURPOSE, "live")
        self.lost = self.pieces = 0
        self.problem = ""
        self._recording = recording
        names = [*FIRST, *(element for name, shape in signals.items() for element in labels(name, shape))]
        most = max(1, int(MOST / (8 * len(names))))
        wanted = ceil(recording.seconds / float(step)) + 1 if recording.rows is None else recording.rows
        self._rows = min(wanted, most)
        shapes = {name: list(shape) for name, shape in signals.items()}
        header = {"step": str(Fraction(str(step))), "signals": shapes, **(metadata or {})}
        types = {STEP: self._arrow.int64()}
        fields = [(name, types.get(name, self._arrow.float64())) for name in names]
        self._schema = self._arrow.schema(fields, metadata={HEADER: json.dumps(header).encode()})
        self._root = Path(recording.folder)
        self.folder = self._new_folder()
        self._free: queue.SimpleQueue[_Piece] = queue.SimpleQueue()
        self._full: queue.SimpleQueue[_Piece | None] = queue.SimpleQueue()
        for _ in range(BUFFERS):
            self._free.put(_Piece(np.empty((self._rows, len(names)))))
        self._piece: _Piece | None = None
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    def add(self, k: int, time_of_step: float, values: Sequence[float] | Floats) -> bool:
        """Add the row of step `k`, and return whether it will be recorded. This never waits for the disk."""
        piece = self._piece
        now = time.monotonic()
        if piece is not None and piece.count and now - piece.began >= self._recording.seconds:
            self._full.put(piece)
            piece = None
        if piece is None:
            try:
                piece = self._free.get_nowait()
            except queue.Empty:
                self._piece, self.lost = None, self.lost + 1
                return False
            piece.count, piece.began = 0, now
        row = piece.rows[piece.count]
        row[0], row[1], row[2] = k, time_of_step, time.time()
        row[3:] = values
        piece.count += 1
        if piece.count == len(piece.rows):
            self._full.put(piece)
            piece = None
        self._piece = piece
        return True

    def close(self) -> None:
        """Write the last piece and end the thread."""
        if self._piece is not None and self._piece.count:
            self._full.put(self._piece)
        self._piece = None
        self._full.put(None)
        self._thread.join()

    def _new_folder(self) -> Path:
        name = time.strftime("%Y-%m-%dT%H-%M-%S", time.gmtime())
        number = 1
        while True:
            folder = self._root / (name if number == 1 else f"{name}-{number}")
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                if folder.is_dir():
                    number += 1
                    continue
                raise ResultFileError(f"{self._root} is a file. Choose another folder for the recording.") from None
            except OSError as error:
                raise ResultFileError(
                    f"The folder {folder} for the recording cannot be made ({error.strerror}). Choose another one."
                ) from None
            return folder

    def _write_all(self) -> None:
        while (piece := self._full.get()) is not None:
            try:
                self._write(piece)
                self.pieces += 1
            except Exception as error:  # noqa: BLE001 - the thread must not end silently: later pieces may be written
                of_disk = error.strerror or str(error) if isinstance(error, OSError) else ""
                self.problem = of_disk or f"{type(error).__name__}: {error}"
                self.lost += piece.count
            self._free.put(piece)

    def _write(self, piece: _Piece) -> None:
        arrow = self._arrow
        rows = piece.rows[: piece.count]
        arrays = [arrow.array(rows[:, 0].astype(np.int64)), *(arrow.array(column) for column in rows[:, 1:].T)]
        sink = arrow.BufferOutputStream()
        table = arrow.Table.from_arrays(arrays, schema=self._schema)
        self._parquet.write_table(table, sink, write_page_checksum=True, compression="zstd", use_dictionary=False)
        path = self.folder / f"{self.pieces:06d}.parquet"
        # pandas and pyarrow ignore names that begin with a dot
        write_whole(path, sink.getvalue(), path.with_name(f".{path.name}.tmp"))
        sync_folder(self.folder)
        if self._recording.keep is not None:
            ours = [path for path in self._root.glob(OURS) if path.stem.isdecimal()]
            ours.sort(key=lambda path: (path.parent == self.folder, _order(path)))  # also if the clock was set back
            for old in ours[: -self._recording.keep]:
                old.unlink(missing_ok=True)
                with suppress(OSError):  # there are other files in it
                    if old.parent != self.folder:
                        old.parent.rmdir()


def pieces_of(folder: Path) -> list[Path]:
    """Return the pieces in a folder, or in the folders in it, in the order of time."""
    found = (path for pattern in ("*.parquet", "*/*.parquet") for path in folder.glob(pattern) if path.name[0] != ".")
    return sorted(found, key=_order)


def _order(path: Path) -> Path:
    """Return what sorts pieces by time: their numbers may have more than six digits."""
    return path.with_stem(path.stem.zfill(12)) if path.stem.isdecimal() else path


def read_recording(folder: str | os.PathLike[str]) -> Result:
    """Return the recording of a live run, also while it goes on.

    Parameters
    ----------
    folder : str or path
        The folder of a run, or the folder with those of several runs: then the last one is read.

    Returns
    -------
    Result
        The recorded inputs and outputs. Rows that are not recorded are NaN. The signal ``"clock"`` has the time of the clock, in
        seconds since 1970.

    Raises
    ------
    ResultFileError
        If there is no piece, or a piece is damaged.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc.cosim import live
    >>> with TemporaryDirectory() as folder:
    ...     recorder = live.Recorder(live.Recording(folder), {"tank.level": ()}, step=0.1)
    ...     for k in (0, 1, 3):
    ...         _ = recorder.add(k, 0.1 * k, [2.0])
    ...     recorder.close()
    ...     result = live.read_recording(folder)
    >>> result.time.tolist(), result["tank.level"].tolist()
    ([0.0, 0.1, 0.2, 0.3], [2.0, 2.0, nan, 2.0])
    """
    arrow, parquet = extra("pyarrow", PURPOSE, "live"), extra("pyarrow.parquet", PURPOSE, "live")
    path = Path(folder)
    pieces = pieces_of(path)
    if not pieces:
        raise ResultFileError(
            f"{path} has no piece of a recording. Give the folder of bayesftc live --record; the first piece appears after ten "
            "seconds."
        )
    tables = []
    for piece in (each for each in pieces if each.parent == pieces[-1].parent):
        try:
            tables.append(parquet.read_table(piece, page_checksum_verification=True, partitioning=None))
        except FileNotFoundError:  # the run has deleted it, as the oldest one
            continue
        except (OSError, ValueError, arrow.ArrowException):
            raise ResultFileError(f"{piece} is damaged. Move it to another folder to read the others.") from None
    try:
        header = json.loads(tables[-1].schema.metadata[HEADER])
        rows = np.column_stack([arrow.concat_tables(tables)[name].to_numpy() for name in tables[-1].schema.names])
        step = Fraction(header.pop("step"))
    except (LookupError, TypeError, ValueError):
        raise ResultFileError(f"{pieces[-1]} is no piece of a recording of bayesftc live.") from None
    steps = rows[:, 0].astype(np.int64)
    first = int(steps[0])
    whole = np.full((int(steps[-1]) - first + 1, rows.shape[1] - 2), np.nan)
    whole[steps - first] = rows[:, 2:]
    units = header.pop("units", {})
    columns: dict[str, tuple[int, tuple[int, ...]]] = {}
    place = 0
    for name, shape in {CLOCK: (), **header.pop("signals")}.items():
        columns[name] = place, tuple(shape)
        place += prod(shape)
    return Result(whole, columns, step, before=first, units=units, metadata=header)


__all__ = ["Recorder", "Recording", "read_recording"]
