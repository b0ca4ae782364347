"""Samples and controls as UDP packets."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Thread
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATIENCE, Bridge
from bayesftc.cosim.live.formats import LONGEST, Format, encode

if TYPE_CHECKING:
    from bayesftc.cosim.live.inbox import Inbox

POLL = 0.2
"""Seconds after which the thread that waits for a packet looks whether the bridge was closed."""


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
            if inbox is None:
                self._where = where
                self._socket.setblocking(False)
            else:
                self._socket.settimeout(POLL)
                self._socket.bind(where)
        except OSError as error:
            self.close()
            what = "send to" if inbox is None else "listen at"
            raise ModelError(
                f"UDP cannot {what} {self.address}, port {self.port} ({error.strerror or error}). Check address and port, and "
                "whether another program uses the port."
            ) from None
        self.connected = True
        if inbox is not None:
            self._thread = Thread(target=self._listen, args=(self._socket, inbox), name="UDP", daemon=True)
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

    def _listen(self, opened: socket.socket, inbox: Inbox) -> None:
        while self._socket is opened:
            try:
                payload, (sender, *_) = opened.recvfrom(LONGEST)
            except TimeoutError:
                continue
            except OSError as error:
                self.problem = str(error)
                continue
            if self.sender is not None and sender != self.sender:
                inbox.reject(f"from {sender}")
            else:
                inbox.receive(payload, self.format)
