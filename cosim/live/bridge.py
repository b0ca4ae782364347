"""The interface of bridges: connections that bring samples in or carry controls out."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from bayesftc.cosim.live.inbox import Inbox  # at run time: files of wires evaluate the annotations

FIRST_PAUSE, LONGEST_PAUSE = 0.1, 5.0
"""Seconds before the first new attempt to connect, and the most between two; the pause doubles at each."""

PATH = {"path": True}
"""Metadata of a field with a path, which begins at the folder of the file of wires."""

PATIENCE = 2.0
"""Seconds that a bridge waits for its thread when it is closed."""


class Bridge(ABC):
    """A connection to the outside: it brings samples to an inbox, or carries values out.

    A bridge does one of the two: it is opened with an inbox, or it sends. To write one:

    1. Make it a dataclass (``eq=False``). Its fields are the keys of ``[bridge.<name>]``, except for those with ``init=False``.
       A path has ``field(metadata={"path": True})``: in a file of wires it begins at the folder of that file.
    2. `open` returns at once, also if the other side cannot be reached now; the bridge then connects again by itself. It
       raises a `bayesftc.cosim.BayesFTCError` only for what cannot become right by waiting, such as a wrong setting.
    3. For each message that arrives it calls ``inbox.put(values, sent)`` or ``inbox.receive(payload, format)``, from any
       thread. It calls ``inbox.reject(reason)`` for a message that it cannot decode. A bridge that can look for messages
       without waiting needs no thread: it does so in `collect`, which the loop calls before each step. It returns at once, and
       gives ``age=`` if it knows for how long a message has waited.
    4. `send` returns at once and never raises. A value that cannot be sent now is lost, and `lost` counts it.
    5. `close` ends its threads, and sends what was given to `send` last, if it can within a second or two.

    The loop calls `send` from two threads (its own, and that of the watchdog), but never at once.

    `Reconnecting` does all of this for a connection that blocks; a bridge then has three short methods.

    Attributes
    ----------
    connected : bool
        Whether the other side can be reached, as far as the bridge knows.
    lost : int
        Number of values that could not be sent.
    problem : str
        The last error of the connection, or an empty text.
    safe : sequence of float, optional
        The safe values of the wire; set before `open`. A bridge can leave them with the other side, for the case that this
        process dies.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from bayesftc.cosim.live import Bridge, Inbox
    >>> @dataclass(eq=False)
    ... class Echo(Bridge):
    ...     gain: float = 1.0
    ...     def open(self, inbox):
    ...         self.inbox, self.connected = inbox, True
    ...     def send(self, values, time):
    ...         self.inbox.put([self.gain * value for value in values], sent=time)
    ...     def close(self):
    ...         self.connected = False
    >>> inbox, echo = Inbox(1), Echo(gain=2.0)
    >>> echo.open(inbox)
    >>> echo.send([3.0], 0.1)
    >>> inbox.take().tolist()
    [6.0]
    """

    connected: bool = False
    lost: int = 0
    problem: str = ""
    safe: Sequence[float] | None = None

    @abstractmethod
    def open(self, inbox: Inbox | None) -> None:
        """Connect, and begin to put samples into `inbox`; for a bridge that sends, the inbox is None."""

    def collect(self) -> None:  # noqa: B027 - most bridges have nothing to do here
        """Put what has come into the inbox: called before each step, for a bridge that does not do so by itself."""

    @abstractmethod
    def send(self, values: Sequence[float], time: float) -> None:
        """Send the values of the step at `time` (seconds since the start), without waiting."""

    @abstractmethod
    def close(self) -> None:
        """End the connection and its threads."""


class Reconnecting(Bridge):
    r"""A bridge with a thread that connects, reads or writes, and connects again after an error.

    A subclass has `connect`, and `read` or `write` or both. They may raise `OSError`, or any other error: the connection is then
    closed, and made again after a pause. If values come faster than `write` sends them, the newest one is sent and the others
    are lost.

    Attributes
    ----------
    inbox : Inbox or None
        Where `read` puts the samples.

    Examples
    --------
    >>> import os
    >>> from dataclasses import dataclass, field
    >>> from select import select
    >>> from tempfile import TemporaryDirectory
    >>> from time import sleep
    >>> from bayesftc.cosim.live import Inbox, Reconnecting
    >>> @dataclass(eq=False)
    ... class Pipe(Reconnecting):  # lines of numbers through a named pipe
    ...     path: str = field(metadata={"path": True})
    ...     def connect(self):
    ...         self.rest = b""
    ...         return os.fdopen(os.open(self.path, os.O_RDWR | os.O_NONBLOCK), "r+b", buffering=0)
    ...     def read(self, connection):
    ...         if select([connection], [], [], 0.2)[0]:  # waits for a short time only, so that `close` ends the thread
    ...             *lines, self.rest = (self.rest + connection.read(65536)).split(b"\n")
    ...             for line in lines:
    ...                 self.inbox.receive(line, "text")
    ...     def write(self, connection, values, time):
    ...         connection.write((" ".join(map(repr, values)) + "\n").encode())
    >>> with TemporaryDirectory() as folder:
    ...     path, inbox = os.path.join(folder, "pipe"), Inbox(2)
    ...     os.mkfifo(path)
    ...     reader, writer = Pipe(path), Pipe(path)
    ...     reader.open(inbox)
    ...     writer.open(None)
    ...     while not (reader.connected and writer.connected):
    ...         sleep(0.01)
    ...     writer.send([1.5, 2.0], 0.0)
    ...     while not inbox.received:
    ...         sleep(0.01)
    ...     writer.close()
    ...     reader.close()
    >>> inbox.take().tolist()
    [1.5, 2.0]
    """

    inbox: Inbox | None = None

    @abstractmethod
    def connect(self) -> Any:
        """Return an open connection with a method ``close``.

        Raises
        ------
        OSError
            If it cannot be opened now.
        """

    def read(self, connection: Any) -> None:
        """Wait at most half a second for a message and put its sample into ``self.inbox``."""
        raise NotImplementedError(f"{type(self).__name__} cannot read; use it in a wire with from = ...")

    def write(self, connection: Any, values: Sequence[float], time: float) -> None:
        """Send the values of the step at `time`."""
        raise NotImplementedError(f"{type(self).__name__} cannot write; use it in a wire with to = ...")

    def open(self, inbox: Inbox | None) -> None:
        """Start the thread."""
        self.inbox, self.lost, self.problem = inbox, 0, ""
        self._next: tuple[Sequence[float], float] | None = None
        self._ended = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)
        self._thread.start()

    def send(self, values: Sequence[float], time: float) -> None:
        """Give the values to the thread; if it has not sent those before, they are lost."""
        with self._news:
            self.lost += self._next is not None or not self.connected
            self._next = (tuple(values), time)
            self._news.notify()

    def close(self) -> None:
        """Send the last values if the connection stands, and end the thread."""
        with self._news:
            self._ended = True
            self._news.notify()
        self._thread.join(PATIENCE)
        self.connected = False

    def _run(self) -> None:
        pause = FIRST_PAUSE
        while not self._ended:
            try:
                connection = self.connect()
            except Exception as error:  # noqa: BLE001 - a bridge of one's own may raise anything, and must not end silently
                self._note(error)
            else:
                self.connected, pause = True, FIRST_PAUSE
                try:
                    self._use(connection)
                except Exception as error:  # noqa: BLE001
                    self._note(error)
                finally:
                    self.connected = False
                    with suppress(Exception):  # otherwise the thread would end, and never connect again
                        connection.close()
            with self._news:
                if not self._ended:
                    self._news.wait_for(lambda: self._ended, pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _note(self, error: Exception) -> None:
        self.problem = str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"

    def _use(self, connection: Any) -> None:
        if self.inbox is not None:
            while not self._ended:
                self.read(connection)
            return
        while True:
            with self._news:
                self._news.wait_for(lambda: self._next is not None or self._ended)
                given, self._next = self._next, None
            if given is None:
                return
            try:
                self.write(connection, *given)
            except Exception:
                self.lost += 1
                raise
