"""Samples and controls as lines on a serial port."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import Reconnecting
from bayesftc.cosim.live.formats import LONGEST, encode

WAIT = 0.2
"""Seconds that a read waits for bytes."""


@dataclass(eq=False)
class Serial(Reconnecting):
    r"""Lines on a serial port, each with one message.

    The first line after the connection is left out, because its beginning may be missing. If the device is unplugged, the port
    is opened again as soon as it is there.

    Parameters
    ----------
    port : str
        Name of the port, ``"/dev/ttyUSB0"``, or an address of pyserial, ``"socket://host:7777"``.
    baud : int
        Bits per second.
    format : {"text", "json"}
        Format of a line.

    Examples
    --------
    >>> import os, time
    >>> from bayesftc.cosim import live
    >>> device, port = os.openpty()  # stands for a device and its port
    >>> serial, inbox = live.Serial(os.ttyname(port)), live.Inbox(1)
    >>> serial.open(inbox)
    >>> while not serial.connected:
    ...     time.sleep(0.01)
    >>> while not inbox.received:
    ...     _ = os.write(device, b"20.5\n")
    ...     time.sleep(0.01)
    >>> serial.close()
    >>> inbox.take().tolist()
    [20.5]
    """

    port: str
    baud: int = 115200
    format: Literal["text", "json"] = "text"
    _rest: bytes | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.baud <= 0:
            raise ModelError(f"Serial has baud={self.baud!r}; it must be a positive number of bits per second.")

    def connect(self) -> Any:
        """Open the port."""
        self._rest = None
        serial = extra("serial", "A serial bridge", "live")
        try:
            return serial.serial_for_url(self.port, baudrate=self.baud, timeout=WAIT, write_timeout=1.0)
        except ValueError as error:  # an unknown rate or address
            raise OSError(str(error)) from None

    def read(self, connection: Any) -> None:
        """Read the bytes that have come, and use their lines."""
        came = connection.read(max(1, min(connection.in_waiting, LONGEST)))
        if self._rest is None:  # still in the first line
            _, found, came = came.partition(b"\n")
            if not found:
                return
            self._rest = b""
        *lines, self._rest = (self._rest + came).split(b"\n")
        assert self.inbox is not None
        for line in lines:
            if line.strip():
                self.inbox.receive(line, self.format)
        if len(self._rest) > LONGEST:
            self._rest = None
            self.inbox.reject("a line without end")

    def write(self, connection: Any, values: Sequence[float], time: float) -> None:
        """Write a line."""
        connection.write(encode(values, time, self.format) + b"\n")

    def open(self, inbox: Any) -> None:
        """Start the thread.

        Raises
        ------
        BayesFTCError
            If pyserial is not installed.
        """
        extra("serial", "A serial bridge", "live")
        super().open(inbox)
