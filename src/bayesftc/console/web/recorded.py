"""The signals of a live run as a download, from the pieces of its recording, a part at a time."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.responses import StreamingResponse

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError, ResultFileError
from bayesftc.cosim.live.recorder import pieces_of

if TYPE_CHECKING:
    from starlette.types import Message, Receive, Scope, Send

    from bayesftc.console.desk.live import LiveRun

PURPOSE = "A download of the signals of a live run"
NUMBERS = 200_000
"""Numbers that are read at once."""
GROUP = 10 * NUMBERS
"""Numbers in a group of rows of the Parquet file: its list of groups is in memory until the end."""
UNREAD = 30.0
"""Seconds after which a download ends that nobody reads."""


def signals_of(run: LiveRun, name: str) -> Iterator[bytes]:
    """Return the parts of a file with the signals up to the last complete piece.

    Parameters
    ----------
    run : LiveRun
        The run.
    name : str
        One of `SIGNALS`.

    Raises
    ------
    ModelError
        If nothing is recorded, or no piece is complete yet.
    ResultFileError
        If a piece is damaged.
    """
    if run.recording is None:
        raise ModelError("The signals of this run are not recorded. Start it with --record DIR to download them.")
    batches = _batches(pieces_of(run.folder) if run.folder is not None else [])
    first = next(batches, None)  # an error before the first part gets a sentence as the answer
    if first is None:
        raise ModelError(
            f"The recording has no complete piece yet. The first one is there after {run.recording.seconds:g} s."
        )
    return _FORMS[name](first.schema, chain((first,), batches))


def _batches(pieces: list[Path]) -> Iterator[Any]:
    """Yield the rows of all pieces in small batches."""
    arrow, parquet = extra("pyarrow", PURPOSE, "live"), extra("pyarrow.parquet", PURPOSE, "live")
    for piece in pieces:
        try:
            with parquet.ParquetFile(piece, page_checksum_verification=True) as file:
                most = max(NUMBERS // len(file.schema_arrow), 1)
                yield from file.iter_batches(most, use_threads=False)
        except FileNotFoundError:  # the run has deleted it, as the oldest one
            continue
        except (OSError, ValueError, arrow.ArrowException):
            raise ResultFileError(f"{piece} is damaged. Move it to another folder to download the others.") from None


def _csv(schema: Any, batches: Iterator[Any]) -> Iterator[bytes]:
    """Yield a table with a header; missing numbers are empty."""
    arrow, csv = extra("pyarrow", PURPOSE, "live"), extra("pyarrow.csv", PURPOSE, "live")
    compute = extra("pyarrow.compute", PURPOSE, "live")
    has_header = False
    for batch in batches:
        columns = [
            compute.if_else(compute.is_nan(column), None, column) if arrow.types.is_floating(column.type) else column
            for column in batch.columns
        ]
        text = io.BytesIO()
        whole = arrow.RecordBatch.from_arrays(columns, names=schema.names)
        csv.write_csv(whole, text, csv.WriteOptions(include_header=not has_header))
        has_header = True
        yield text.getvalue()


def _parquet(schema: Any, batches: Iterator[Any]) -> Iterator[bytes]:
    """Yield one Parquet file with the rows of all pieces."""
    arrow, parquet = extra("pyarrow", PURPOSE, "live"), extra("pyarrow.parquet", PURPOSE, "live")
    sink = _Sink()
    with parquet.ParquetWriter(sink, schema, compression="zstd", use_dictionary=False) as writer:
        group: list[Any] = []
        for batch in batches:
            group.append(batch)
            if sum(each.num_rows for each in group) * len(schema) >= GROUP:
                writer.write_table(arrow.Table.from_batches(group))
                group.clear()
                yield sink.taken()
        if group:
            writer.write_table(arrow.Table.from_batches(group))
    yield sink.taken()


class _Sink(io.RawIOBase):
    """A file that is only written; what was written is taken away piece by piece."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._place = 0

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._place

    def write(self, data: Any) -> int:
        part = bytes(data)
        self._parts.append(part)
        self._place += len(part)
        return len(part)

    def taken(self) -> bytes:
        """Return what was written since the last time."""
        parts, self._parts = self._parts, []
        return b"".join(parts)


class Streamed(StreamingResponse):
    """A download that ends early, as an error of the connection, if its parts fail or nobody reads them.

    Parameters
    ----------
    parts : iterator of bytes
        The parts, each made when the one before has been sent.
    ended : callable
        Called at the end with the sentence of an error, or an empty text.
    """

    def __init__(self, parts: Iterator[bytes], ended: Callable[[str], None], **options: Any):
        super().__init__(parts, **options)
        self._ended, self._sentence = ended, ""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended(self._sentence)

    async def stream_response(self, send: Send) -> None:
        """Send the parts. An answer that is not completed is a failed download for a browser, not a short file."""

        async def send_soon(message: Message) -> None:
            await asyncio.wait_for(send(message), UNREAD)

        try:
            await super().stream_response(send_soon)
        except ResultFileError as error:
            self._sentence = str(error)
        except TimeoutError:
            self._sentence = f"A download has ended: nobody has read it for {UNREAD:g} s."


_FORMS: Mapping[str, Callable[[Any, Iterator[Any]], Iterator[bytes]]] = {
    "signals.csv": _csv,
    "signals.parquet": _parquet,
}

SIGNALS = frozenset(_FORMS)
"""The names of the files."""

__all__ = ["SIGNALS", "Streamed", "signals_of"]
