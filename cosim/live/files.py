"""Samples and controls as rows of a CSV file that grows."""

from __future__ import annotations

import os
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import IO, Any

from bayesftc.cosim.base.recordings.table_files import time_unit
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATH, Reconnecting
from bayesftc.cosim.live.formats import LONGEST, encode

PIECE = 1 << 16
"""Bytes that are read at once."""


@dataclass(eq=False)
class File(Reconnecting):
    r"""A CSV file that another program extends row by row, or that this one extends.

    Columns are separated by commas, or by semicolons; then numbers may have decimal commas. Only complete rows are used. A file
    that is replaced, shortened or deleted is opened again from its beginning.

    Parameters
    ----------
    path : str
        The file. One that does not exist yet is waited for, or made.
    columns : sequence of str
        The columns with the numbers of a message, by their names in the first row. By default all but `time`; the file then needs
        no names.
    time : str, optional
        The column with the sender's time, in seconds or in the unit that ends its name, as in ``t_ms`` or ``t [min]``.
    from_start : bool
        Whether to use the rows that are already there; by default only new ones.
    poll : float
        Seconds between two looks at the file.

    Examples
    --------
    >>> import time
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc.cosim import live
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "speeds.csv")
    ...     _ = path.write_text("t,left,right\n0.0,20.0,20.2\n0.1,20.1,20")
    ...     inbox = live.Inbox(1)
    ...     file = live.File(str(path), columns=["right"], time="t", from_start=True)
    ...     file.open(inbox)
    ...     while not inbox.received:
    ...         time.sleep(0.01)
    ...     file.close()
    >>> inbox.take().tolist()
    [20.2]
    """

    path: str = field(metadata=PATH)
    columns: Sequence[str] = ()
    time: str | None = None
    from_start: bool = False
    poll: float = 0.01
    _names: list[str] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 < self.poll <= 1:
            raise ModelError(f"File has poll={self.poll!r}; it must be above 0 and at most 1 s.")
        self._again = False
        self._unit = float(time_unit(self.time))

    def connect(self) -> IO[bytes]:
        """Open the file."""
        if self.inbox is None:
            return open(self.path, "ab", buffering=0)
        file = open(self.path, "rb", buffering=0)  # noqa: SIM115 - closed by `Reconnecting`
        self._rest, self._names, self._skipping = b"", None, False
        if not self.from_start and not self._again:
            first = file.readline()
            if first.endswith(b"\n"):
                self._names = _words(first)
                end = file.seek(0, os.SEEK_END)
                file.seek(end - 1)
                self._skipping = file.read(1) != b"\n"  # in the middle of a row
            else:  # the names of the columns are not complete: everything else is new
                file.seek(0)
        self._again = True
        return file

    def read(self, connection: IO[bytes]) -> None:
        """Use the rows that have been added."""
        assert self.inbox is not None
        came = connection.read(PIECE)
        if not came:
            self._check(connection)
            clock.sleep(self.poll)
            return
        *lines, self._rest = (self._rest + came).split(b"\n")
        for line in lines:
            if self._skipping:
                self._skipping = False
            elif line.strip():
                self._use_row(line)
        if len(self._rest) > LONGEST:
            self._rest, self._skipping = b"", True
            self.inbox.reject("a row without end")

    def write(self, connection: IO[bytes], values: Sequence[float], time: float) -> None:
        """Add a row: the time and the values."""
        if not connection.tell() and not os.fstat(connection.fileno()).st_size:
            names = self.columns or [f"value{i}" for i in range(len(values))]
            connection.write((",".join([self.time or "t", *names]) + "\n").encode())
        connection.write(encode([time / self._unit, *values], time, "text") + b"\n")

    def _check(self, connection: IO[bytes]) -> None:
        """Raise an OSError if the file is another one by now."""
        there, here = os.stat(self.path), os.fstat(connection.fileno())
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            raise OSError("The file was replaced.")
        if here.st_size < connection.tell():
            raise OSError("The file was shortened.")

    def _use_row(self, line: bytes) -> None:
        assert self.inbox is not None
        words = _words(line)
        if self._names is None:
            self._names = words
            if any(_number(word) is None for word in words):
                return
        wanted = self.columns or ([name for name in self._names if name != self.time] if self.time else None)
        if wanted is None:
            self.inbox.receive(line, "text")
            return
        row = dict(zip(self._names, words, strict=False))
        missing = [name for name in (*wanted, *([self.time] if self.time else [])) if name not in row]
        if missing:
            self.inbox.reject(f"no column {missing[0]!r}")
            return
        numbers = [float("nan") if not row[name] else _number(row[name]) for name in wanted]
        sent = None if self.time is None else _number(row[self.time])
        if None in numbers or (self.time is not None and (sent is None or not isfinite(sent))):
            self.inbox.reject("not a number")
        else:
            self.inbox.put(
                [value for value in numbers if value is not None], None if sent is None else sent * self._unit
            )


def _words(line: bytes) -> list[str]:
    text = line.decode("utf-8-sig", errors="replace")
    return [word.strip().strip('"') for word in text.split(";" if ";" in text else ",")]


def _number(word: str) -> Any:
    try:
        return float(word.replace(",", "."))  # decimal commas are possible between semicolons only
    except ValueError:
        return None
