"""Samples and controls as MQTT messages."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATH, Bridge
from bayesftc.cosim.live.connections.broker import Broker, Connection, Will, join, leave
from bayesftc.cosim.live.connections.credentials import Login
from bayesftc.cosim.live.formats import Format, encode
from bayesftc.cosim.live.inbox import Inbox

WINDOW = 8
"""Messages of a wire that may be under way. Further ones are lost, so that a slow broker never gets old controls."""

LAST = 1.0
"""Seconds in which `MQTT.close` sends the last message."""


@dataclass(eq=False)
class MQTT(Login, Bridge):
    """MQTT messages of one topic.

    Wires with the same broker and login share a connection. A wire with a safe value has a connection of its own: the safe value
    is the will of the connection, which the broker publishes if this process dies.

    Parameters
    ----------
    topic : str
        The topic, without wildcards.
    host : str
        Name or address of the broker.
    port : int, optional
        Port of the broker. By default 1883, and 8883 with TLS.
    format : {"json", "text", "doubles", "stamped doubles"}
        Format of the messages.
    qos : {0, 1, 2}
        Quality of service: a message arrives at most once, at least once, or exactly once.
    retained : bool
        Whether the broker keeps the last message for those who subscribe later. Only for wires that send.
    will : bool
        Whether the broker gets the safe value as the will.
    user, password_env, password_file, password
        See `Login`.
    tls : bool
        Whether the connection is encrypted. It is with any of the next three.
    ca_file : str, optional
        File with the certificates of the authorities to trust (PEM). By default those of the operating system.
    certificate, key : str, optional
        Files with the certificate of this client and its private key (PEM), for brokers that require it.
    client_id : str, optional
        Name of this client at the broker. By default a random one.
    keepalive : int
        Seconds of silence after which each side looks whether the other is still there. The broker publishes the will after 1.5
        times as many.

    Notes
    -----
    A retained message is as old as it is. If its time stamp is in seconds since 1970, it is used within ``stale_after`` seconds.
    A retained message without time stamp is late. An input that holds its last sample (``hold = true``) and has no
    ``stale_after`` takes any retained message, such as a reference that was set yesterday.

    Raises
    ------
    ModelError
        If a setting is not possible.

    Examples
    --------
    >>> from bayesftc.cosim import live
    >>> bridge = live.MQTT(topic="car/force", host="localhost", port=9, qos=1)
    >>> bridge.open(None)  # there is no broker at this port
    >>> bridge.send([500.0], time=0.0)
    >>> bridge.close()
    >>> bridge.connected, bridge.lost
    (False, 1)
    """

    topic: str
    host: str = "localhost"
    port: int | None = None
    format: Format = "json"
    qos: int = 0
    retained: bool = False
    will: bool = True
    tls: bool = False
    ca_file: str | None = field(default=None, metadata=PATH)
    certificate: str | None = field(default=None, metadata=PATH)
    key: str | None = field(default=None, metadata=PATH)
    client_id: str | None = None
    keepalive: int = 5
    receives: bool = field(default=False, init=False, repr=False)
    _inbox: Inbox | None = field(default=None, init=False, repr=False)
    _connection: Connection | None = field(default=None, init=False, repr=False)
    _client: Any = field(default=None, init=False, repr=False)
    _under_way: list[Any] = field(default_factory=list, init=False, repr=False)
    _unsent: tuple[Sequence[float], float] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.topic or len(self.topic.encode()) > 65535 or any(each in self.topic for each in "+#\0"):
            raise ModelError(
                f"MQTT has topic={self.topic!r}. A wire needs one topic without the wildcards + and #. Make a wire for each one."
            )
        if not self.host:
            raise ModelError("MQTT has an empty host. Give the name or address of the broker.")
        if self.port is not None and not 1 <= self.port <= 65535:
            raise ModelError(f"MQTT has port={self.port!r}; it must be from 1 to 65535.")
        if isinstance(self.qos, bool) or self.qos not in (0, 1, 2):
            raise ModelError(f"MQTT has qos={self.qos!r}; it must be 0, 1 or 2.")
        if (
            isinstance(self.keepalive, bool)
            or self.keepalive != int(self.keepalive)
            or not 1 <= self.keepalive <= 65535
        ):
            raise ModelError(
                f"MQTT has keepalive={self.keepalive!r}; it must be a whole number of seconds from 1 to 65535."
            )
        if self.key is not None and self.certificate is None:
            raise ModelError("MQTT has a key without a certificate. Add certificate = ...")
        self.check_login("MQTT")

    def open(self, inbox: Inbox | None) -> None:
        """Join the connection to the broker, or begin one.

        Raises
        ------
        ModelError
            If the password or a certificate cannot be read.
        BayesFTCError
            If paho-mqtt is not installed.
        """
        self._inbox, self.receives = inbox, inbox is not None
        self.lost, self.problem, self.connected = 0, "", False
        self._client, self._under_way, self._unsent = None, [], None
        tls = self.tls or self.ca_file is not None or self.certificate is not None
        broker = Broker(
            self.host,
            self.port if self.port is not None else 8883 if tls else 1883,
            self.user,
            self.read_password("MQTT"),
            tls,
            self.ca_file,
            self.certificate,
            self.key,
            self.client_id,
            int(self.keepalive),
            self._will(),
        )
        self._connection = join(broker, self)

    def send(self, values: Sequence[float], time: float) -> None:
        """Publish the values. If too many messages are under way, they are lost, and so they are without a connection."""
        self._unsent = None
        if not self._publish(values, time):
            self.lost, self._unsent = self.lost + 1, (tuple(values), time)

    def close(self) -> None:
        """Send the last values, and leave the connection."""
        connection, self._connection = self._connection, None
        if connection is None:
            return
        end = clock.monotonic() + LAST
        while connection.client is not None and clock.monotonic() < end:
            if self._unsent is not None and self._publish(*self._unsent, connection):
                self._unsent, self.lost = None, self.lost - 1
            if self._unsent is None and all(each.is_published() for each in self._under_way):
                break
            clock.sleep(0.005)
        leave(connection, self)
        self.connected = False

    def receive(self, payload: bytes, retained: bool) -> None:
        """Give a message to the inbox."""
        if self._inbox is not None:
            self._inbox.receive(payload, self.format, kept=retained)

    def _publish(self, values: Sequence[float], time: float, connection: Connection | None = None) -> bool:
        connection = connection or self._connection
        client = None if connection is None else connection.client
        flying = [each for each in self._under_way if not each.is_published()]
        if client is not self._client:  # what was under way at the old connection may not have arrived
            self.lost += len(flying)
            self._client, flying = client, []
        self._under_way = flying
        if client is None or len(flying) >= WINDOW:
            return False
        try:
            message = client.publish(self.topic, encode(values, time, self.format), self.qos, self.retained)
        except (OSError, ValueError) as error:
            self.problem = str(error)
            return False
        if message.rc != 0:
            return False
        flying.append(message)
        return True

    def _will(self) -> Will | None:
        if not self.will or self.receives or self.safe is None:
            return None
        if self.format == "stamped doubles":
            raise ModelError(
                'MQTT has the format "stamped doubles" and a safe value. The broker publishes the safe value as the will, which '
                'has no time stamp. Choose the format "json" or "doubles", or will = false.'
            )
        return Will(self.topic, encode(self.safe, None, self.format), self.qos, self.retained)


__all__ = ["MQTT"]
