"""Samples and controls as UDP packets."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from selectors import EVENT_READ, DefaultSelector
from threading import Lock, Thread
from typing import Any

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATIENCE, Bridge
from bayesftc.cosim.live.formats import LONGEST, Format, encode
from bayesftc.cosim.live.inbox import WAITING, Inbox  # at run time: files of wires evaluate the annotations

POLL = 0.2
"""Most seconds after which the thread looks whether the bridge was closed."""

ARRIVAL = 35 if sys.platform == "linux" else None
"""Linux: the option SO_TIMESTAMPNS of a socket, and the kind of the ancillary data with the time of a packet's arrival."""

OFTEN = 0.02
"""Seconds between two looks of the thread if packets have the time of their arrival: the buffer must not overflow."""

ANCILLARY = 64
"""Most bytes of the ancillary data of a packet."""

MOST = 256
"""Most packets that are taken at once: a flood must not hold up a step."""


@dataclass(eq=False)
class UDP(Bridge):
    """UDP packets: one message a packet.

    Parameters
    ----------
    port : int
        The port to listen at, or to send to. 0 listens at a free one (see `port_number`).
    address : str
        The own address to listen at, or the one to send to. By default only this machine.
    format : {"doubles", "stamped doubles", "json", "text"}
        Format of the messages.
    sender : str, optional
        The only address whose packets are used; by default those of all.

    Examples
    --------
    >>> from time import sleep
    >>> from bayesftc.cosim.live import UDP, Inbox
    >>> inbox, listener = Inbox(2), UDP(port=0)
    >>> listener.open(inbox)
    >>> sender = UDP(port=listener.port_number)
    >>> sender.open(None)
    >>> sender.send([20.0, 21.0], time=0.0)
    >>> while not inbox.received:
    ...     sleep(0.01)
    >>> inbox.take().tolist()
    [20.0, 21.0]
    >>> sender.close(), listener.close()
    (None, None)
    """

    port: int
    address: str = "127.0.0.1"
    format: Format = "doubles"
    sender: str | None = None
    _socket: socket.socket | None = field(default=None, init=False, repr=False)
    _thread: Thread | None = field(default=None, init=False, repr=False)
    _inbox: Inbox | None = field(default=None, init=False, repr=False)
    _reading: Any = field(default=None, init=False, repr=False)
    _is_stamped: bool = field(default=False, init=False, repr=False)
    _emptied: float = field(default=0.0, init=False, repr=False)
    _last: bytes = field(default=b"", init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ModelError(f"UDP has port={self.port!r}; it must be from 0 to 65535.")

    @property
    def port_number(self) -> int:
        """The port at which the open bridge listens."""
        assert self._socket is not None
        return int(self._socket.getsockname()[1])

    def open(self, inbox: Inbox | None) -> None:
        """Open the socket, and listen if there is an inbox.

        Raises
        ------
        ModelError
            If the address is not one, or the port is used already.
        """
        self.lost, self.problem, self._last = 0, "", b""
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(self.address, self.port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            if inbox is None:
                self._where = where
            else:
                self._socket.bind(where)
                self._is_stamped = _stamped(self._socket)
        except OSError as error:
            self.close()
            what = "send to" if inbox is None else "listen at"
            raise ModelError(
                f"UDP cannot {what} {self.address}, port {self.port} ({error.strerror or error}). Check address and port, and "
                "whether another program uses the port."
            ) from None
        self.connected, self._inbox, self._emptied = True, inbox, time.monotonic()
        self._reading = Lock()
        if inbox is not None:
            self._thread = Thread(target=self._listen, args=(self._socket,), name="UDP", daemon=True)
            self._thread.start()

    def send(self, values: Sequence[float], time: float) -> None:
        """Send a packet; nobody says whether it arrives."""
        try:
            assert self._socket is not None
            self._last = encode(values, time, self.format)
            self._socket.sendto(self._last, self._where)
            self.connected = True
        except (OSError, AssertionError) as error:
            self.connected, self.problem, self.lost = False, str(error), self.lost + 1

    def close(self) -> None:
        """Send the last packet twice more, as one may be lost, then close the socket and end the thread."""
        opened, self._socket, self.connected = self._socket, None, False
        if opened is not None and self._last:
            with suppress(OSError):
                for _ in range(2):
                    opened.sendto(self._last, self._where)
        if self._thread is not None:
            self._thread.join(PATIENCE)
            self._thread = None
        if opened is not None:
            opened.close()

    def collect(self) -> None:
        """Put the packets that have come into the inbox; of very many only the newest, because no step uses the others."""
        with self._reading:
            opened, inbox = self._socket, self._inbox
            if opened is None or inbox is None:
                return
            newest: deque[tuple[bytes, float]] = deque(maxlen=WAITING)
            skipped = 0
            for _ in range(MOST):
                now = time.monotonic()
                try:
                    payload, age, sender = _packet(opened, self._is_stamped)
                except BlockingIOError:
                    self._emptied = now
                    break
                except OSError as error:
                    self.problem = str(error)
                    continue
                age = min(age, now - self._emptied)  # also if the clock of the kernel's times is set
                if self.sender is not None and sender != self.sender:
                    inbox.reject(f"from {sender}", age=age)
                    continue
                skipped += len(newest) == WAITING
                newest.append((payload, age))
            inbox.skip(skipped)
            for payload, age in newest:
                inbox.receive(payload, self.format, age=age)

    def _listen(self, opened: socket.socket) -> None:
        """Take packets beside the steps.

        The loop takes them before each step by itself: to wake a thread for each packet would cost it more than all else that it
        does. Without the time of their arrival, the thread waits for each one. With it, the thread only keeps the buffer of the
        socket from overflowing if the steps are few.
        """
        with DefaultSelector() as waiting:
            waiting.register(opened, EVENT_READ)
            while self._socket is opened:
                if self._is_stamped:
                    time.sleep(OFTEN)
                elif not waiting.select(POLL):
                    continue
                self.collect()


def _stamped(opened: socket.socket) -> bool:
    """Ask for the time at which the kernel gets each packet; return whether it gives it."""
    if ARRIVAL is None:
        return False
    try:
        opened.setsockopt(socket.SOL_SOCKET, ARRIVAL, 1)
    except OSError:  # such as a sandbox that leaves out this option
        return False
    return True


def _packet(opened: socket.socket, is_stamped: bool) -> tuple[bytes, float, str]:
    """Return the next packet, the seconds since the kernel got it (0 if that is unknown), and the address of its sender."""
    if not is_stamped:
        payload, (sender, *_) = opened.recvfrom(LONGEST)
        return payload, 0.0, sender
    payload, ancillary, _, (sender, *_) = opened.recvmsg(LONGEST, ANCILLARY)
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, ARRIVAL):
            seconds, nanoseconds = struct.unpack("@ll", data)
            return payload, max(time.time() - (seconds + 1e-9 * nanoseconds), 0.0), sender
    return payload, 0.0, sender
