"""Connections to MQTT brokers: one for all wires with the same settings, made again after it breaks."""

from __future__ import annotations

import secrets
import ssl
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import FIRST_PAUSE, LONGEST_PAUSE, PATIENCE
from bayesftc.cosim.live.connections.credentials import readable

ANSWER = 5.0
"""Seconds in which a broker must accept the connection, and then the login."""


class Will(NamedTuple):
    """The message that the broker publishes if this process dies."""

    topic: str
    payload: bytes
    qos: int
    retained: bool


class Subscriber(Protocol):
    """A wire at a connection."""

    topic: str
    qos: int
    connected: bool
    problem: str
    receives: bool

    def receive(self, payload: bytes, retained: bool) -> None:
        """Take a message of its topic."""


@dataclass(frozen=True)
class Broker:
    """Address of a broker, and how to log in; wires with equal ones share a connection."""

    host: str
    port: int
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False
    ca_file: str | None = None
    certificate: str | None = None
    key: str | None = None
    client_id: str | None = None
    keepalive: int = 5
    will: Will | None = None

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    def context(self) -> ssl.SSLContext | None:
        """Return the settings of TLS.

        Raises
        ------
        ModelError
            If a file cannot be read, or has no certificate or key.
        """
        if not self.tls:
            return None
        for name in ("ca_file", "certificate", "key"):
            if getattr(self, name) is not None:
                readable("MQTT", name, getattr(self, name))
        try:
            context = ssl.create_default_context(cafile=self.ca_file)
            if self.certificate is not None:
                context.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ValueError) as error:
            raise ModelError(
                f"The TLS files of MQTT cannot be used ({error}). ca_file and certificate must be PEM files with certificates, "
                "and key one with the private key of the certificate, without a password."
            ) from None
        return context


class Connection:
    """A connection to a broker, with the wires that use it.

    Attributes
    ----------
    client : paho.mqtt.client.Client or None
        The client while it is connected. Each connection has a new one, so that old values are not sent again.
    """

    def __init__(self, broker: Broker):
        self.broker = broker
        self.client: Any = None
        self._paho = extra("paho.mqtt.client", "MQTT", of="live")
        self._tls = broker.context()
        self._wires: list[Subscriber] = []
        self._asked: dict[int, str] = {}
        self._lock = threading.RLock()
        self._ended, self._answered, self._gone = (threading.Event() for _ in range(3))
        self._explained = False
        self._thread = threading.Thread(target=self._run, name=f"MQTT {broker}", daemon=True)

    def add(self, wire: Subscriber) -> None:
        """Add a wire, and start with the first one."""
        with self._lock:
            self._wires.append(wire)
            if self.client is not None:
                self._begin(self.client, [wire])
            if self._thread.ident is None:
                self._thread.start()

    def remove(self, wire: Subscriber) -> bool:
        """Remove a wire, and return whether it was the last one."""
        with self._lock:
            self._wires = [each for each in self._wires if each is not wire]
            return not self._wires

    def end(self) -> None:
        """Say goodbye to the broker, which then publishes no will, and end the threads."""
        self._ended.set()
        self._answered.set()
        self._gone.set()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        pause = FIRST_PAUSE
        while not self._ended.is_set():
            client = self._new_client()
            began = time.monotonic()
            try:
                client.connect(self.broker.host, self.broker.port, self.broker.keepalive)
            except (OSError, ValueError) as error:
                self._tell(f"The broker {self.broker} cannot be reached ({_reason(error)}). {_advice(error)}")
            else:
                client.loop_start()
                if not self._answered.wait(ANSWER):
                    self._tell(f"The broker {self.broker} does not answer. Check that it is an MQTT broker.")
                elif self.client is client:
                    self._gone.wait()
                self._down(client)
            if time.monotonic() - began > LONGEST_PAUSE:  # it was connected for a while
                pause = FIRST_PAUSE
            self._ended.wait(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _new_client(self) -> Any:
        paho, broker = self._paho, self.broker
        name = broker.client_id or f"bayesftc-{secrets.token_hex(6)}"
        client = paho.Client(
            paho.CallbackAPIVersion.VERSION2, client_id=name, protocol=paho.MQTTv311, reconnect_on_failure=False
        )
        client.connect_timeout = ANSWER
        if broker.user is not None:
            client.username_pw_set(broker.user, broker.password)
        if self._tls is not None:
            client.tls_set_context(self._tls)
        if broker.will is not None:
            client.will_set(*broker.will)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_subscribe, client.on_message = self._on_subscribe, self._on_message
        self._answered.clear()
        self._gone.clear()
        if self._ended.is_set():
            self._answered.set()
            self._gone.set()
        self._explained = False
        return client

    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            why = str(reason).lower()
            self._tell(f"The broker {self.broker} refuses the connection ({why}). Check user, password and client_id.")
        else:
            with self._lock:
                self.client = client
                self._begin(client, self._wires)
        self._answered.set()

    def _begin(self, client: Any, wires: Sequence[Subscriber]) -> None:
        for wire in wires:
            wire.problem = ""
            if not wire.receives:
                wire.connected = True
        topics = {wire.topic for wire in wires if wire.receives}
        for topic in sorted(topics):
            qos = max(wire.qos for wire in self._wires if wire.receives and wire.topic == topic)
            _, number = client.subscribe(topic, qos)
            self._asked[number] = topic

    def _on_subscribe(self, client: Any, _data: Any, number: int, reasons: Sequence[Any], _properties: Any) -> None:
        refused = any(reason.is_failure for reason in reasons)
        with self._lock:
            topic = self._asked.pop(number, None)
            for wire in self._wires:
                if wire.topic == topic and wire.receives and self.client is client:
                    wire.connected = not refused
                    if refused:
                        wire.problem = (
                            f"The broker {self.broker} refuses the topic {topic!r}. Allow it there for this user."
                        )

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        for wire in self._wires:
            if wire.receives and wire.topic == message.topic:
                wire.receive(message.payload, message.retain)

    def _on_disconnect(self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if not self._explained:
            self._tell(f"The broker {self.broker} has closed the connection ({str(reason).lower()}).")
        self._answered.set()
        self._gone.set()

    def _down(self, client: Any) -> None:
        self._explained = True
        with self._lock:
            self.client = None
            self._asked.clear()
            for wire in self._wires:
                wire.connected = False
        self._gone.clear()
        if client.disconnect() == self._paho.MQTT_ERR_SUCCESS:
            self._gone.wait(1.0)  # until the queue and the goodbye are sent
        opened = client.socket()
        if opened is not None:  # the broker does not read
            opened.close()
        client.loop_stop()

    def _tell(self, problem: str) -> None:
        self._explained = True
        for wire in self._wires:
            wire.connected, wire.problem = False, problem


_CONNECTIONS: dict[Broker, Connection] = {}
_LOCK = threading.Lock()


def join(broker: Broker, wire: Subscriber) -> Connection:
    """Return the connection to a broker, with one more wire.

    Raises
    ------
    ModelError
        If a connection with other settings has this client id; the broker would end one of them.
    """
    with _LOCK:
        for other in _CONNECTIONS:
            same = (other.host, other.port, other.client_id) == (broker.host, broker.port, broker.client_id)
            if same and broker.client_id is not None and other != broker:
                raise ModelError(
                    f"Two connections to the broker {broker} have client_id={broker.client_id!r}; the broker ends one of them. "
                    "Wires with a safe value have a connection of their own. Give each its own client_id, or none."
                )
        if broker not in _CONNECTIONS:
            _CONNECTIONS[broker] = Connection(broker)
        _CONNECTIONS[broker].add(wire)
        return _CONNECTIONS[broker]


def leave(connection: Connection, wire: Subscriber) -> None:
    """Remove a wire from its connection, and end this after the last one."""
    with _LOCK:
        last = connection.remove(wire)
        if last:
            _CONNECTIONS.pop(connection.broker, None)
    if last:
        connection.end()


def _reason(error: Exception) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message.rstrip(".")
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _advice(error: Exception) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return "Give the certificate of its authority as ca_file, and the name in its certificate as host."
    if isinstance(error, ssl.SSLError):
        return "Check that this port of the broker has TLS, and whether it requires a certificate."
    return "Check host and port, and whether the broker runs."


__all__ = ["Broker", "Connection", "Will", "join", "leave"]
