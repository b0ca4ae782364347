"""Samples and controls as values of OPC UA nodes: of another server, or of one in this process."""

from __future__ import annotations

import asyncio
import socket
import threading
import time as clock
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from typing import Any

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATH, PATIENCE, Bridge
from bayesftc.cosim.live.connections import opcua_server, opcua_session
from bayesftc.cosim.live.connections.credentials import Login, is_loopback, readable
from bayesftc.cosim.live.connections.event_loop import event_loop, submit
from bayesftc.cosim.live.connections.opcua_certificates import check_pair
from bayesftc.cosim.live.connections.opcua_values import check_node, check_security, check_url, give
from bayesftc.cosim.live.inbox import Inbox

OPENING = 30.0
"""Longest time in seconds until the event loop knows a wire; it is busy for about a second while a server starts."""

LAST = 1.0
"""Seconds in which `close` sends the last values."""


class _Node(Bridge):
    """What both bridges share: the newest values, for the event loop."""

    node: str
    inbox: Inbox | None = None
    _values: Sequence[float] | None = None
    _writing = False
    _opened: Any = None

    def _open(self, inbox: Inbox | None) -> None:
        extra("asyncua", "OPC UA", of="live")
        self.inbox, self.lost, self.problem, self.connected = inbox, 0, "", False
        self._values, self._writing, self._lock = None, False, threading.Lock()

    def send(self, values: Sequence[float], time: float) -> None:
        """Give the values to the event loop; if it has not sent those before, they are lost."""
        if self._opened is None or not self.connected:
            self.lost += 1
            return
        with self._lock:
            self.lost += self._values is not None
            self._values = tuple(values)
        event_loop().call_soon_threadsafe(self._wake)

    def close(self) -> None:
        """Send the last values, and leave the server."""
        opened, self._opened = self._opened, None
        if opened is None:
            return
        end = clock.monotonic() + LAST
        while self.connected and (self._values is not None or self._writing) and clock.monotonic() < end:
            clock.sleep(0.005)
        with suppress(TimeoutError):
            submit(opened.remove(self)).result(2 * PATIENCE)
        self.connected = False

    def next_values(self) -> Sequence[float] | None:
        """Return the newest values that were not sent yet (for the event loop)."""
        with self._lock:
            values, self._values = self._values, None
            self._writing = values is not None
        return values

    def sent(self) -> None:
        """Note that the values of before were sent or refused (for the event loop)."""
        self._writing = False

    def _wake(self) -> None:
        raise NotImplementedError


@dataclass(eq=False)
class OPCUA(Login, _Node):
    """A node of an OPC UA server: changes of its value are samples, controls are written into it.

    Wires with the same server and login share a session.

    Parameters
    ----------
    url : str
        Address of the server: ``"opc.tcp://plc:4840"``.
    node : str
        The node id: ``"ns=2;s=Car.Speed"`` or ``"ns=2;i=1001"``. ``"nsu=urn:factory;s=Car.Speed"`` has the name of the
        namespace, whose number may change when a server starts.
    period : float
        Seconds between two samples or more, as the server allows.
    user, password_env, password_file, password
        See `Login`.
    security : str, optional
        Policy and mode: ``"Basic256Sha256,SignAndEncrypt"``. By default nothing is signed or encrypted.
    certificate, key : str, optional
        Files with the certificate of this client and its private key (PEM or DER), for `security`.
    server_certificate : str, optional
        File with the certificate of the server. By default any certificate that the server shows is accepted.

    Notes
    -----
    The time stamp of a sample is that of its source. A status other than good is a missing sample, and ends a held one. The first
    value after each connection may be old: its age is the time since its time stamp, by the clock of this machine.

    A control is written with the type of the node; for a whole number it is rounded.

    Raises
    ------
    ModelError
        If a setting is not possible.

    Examples
    --------
    >>> from time import sleep
    >>> from bayesftc.cosim import live
    >>> speed = live.OPCUA(url="opc.tcp://localhost:9", node="ns=2;s=Car.Speed", period=0.05)
    >>> speed.open(live.Inbox(1))  # there is no server at this port
    >>> while not speed.problem:
    ...     sleep(0.01)
    >>> speed.problem[:56]
    'The server opc.tcp://localhost:9 cannot be reached (Conn'
    >>> speed.close()
    """

    url: str
    node: str
    period: float = 0.1
    security: str | None = None
    certificate: str | None = field(default=None, metadata=PATH)
    key: str | None = field(default=None, metadata=PATH)
    server_certificate: str | None = field(default=None, metadata=PATH)

    def __post_init__(self) -> None:
        check_url("OPC UA", self.url)
        check_node("OPC UA", self.node)
        if not 0 < self.period < inf:
            raise ModelError(f"OPC UA has period={self.period!r}; it must be a positive number of seconds.")
        check_security("OPC UA", self.security, self.certificate, self.key)
        self.check_login("OPC UA")

    def open(self, inbox: Inbox | None) -> None:
        """Join the session at the server, or begin one.

        Raises
        ------
        ModelError
            If the password or a certificate cannot be read.
        BayesFTCError
            If asyncua is not installed.
        """
        self._open(inbox)
        _check_files(self, "certificate", "key", "server_certificate")
        address = opcua_session.Address(
            self.url,
            self.user,
            self.read_password("OPC UA"),
            self.security,
            self.certificate,
            self.key,
            self.server_certificate,
        )
        self.news = asyncio.Event()
        self._opened = submit(opcua_session.join(address, self)).result(OPENING)

    def arrived(self, value: Any, first: bool) -> None:
        """Give a value of the node to the inbox; the first one may be old (for the event loop)."""
        if self.inbox is not None:
            give(value, self.inbox, kept=first)

    def _wake(self) -> None:
        self.news.set()


@dataclass(eq=False)
class OPCUAServer(Login, _Node):
    """A node of an OPC UA server in this process: others read the controls, or write the samples.

    Wires with the same `url` share the server. Its nodes are in the folder ``bayesftc``, and in the namespace
    ``urn:bayesftc:live``. Their type is Double: a number, or an array of several.

    Parameters
    ----------
    node : str
        Name of the node: its id is ``"nsu=urn:bayesftc:live;s=<node>"``.
    url : str
        Address to listen at. By default only programs of this machine can connect.
    user : str, optional
        The only user who may connect. Without one, all may who can reach the address.
    password_env, password_file, password
        See `Login`.
    security : str, optional
        Policy and mode: ``"Basic256Sha256,SignAndEncrypt"``. By default nothing is signed or encrypted.
    certificate, key : str, optional
        Files with the certificate of the server and its private key (PEM or DER), for `security`.
    anonymous : bool
        Whether a server without a user may have an address that other machines can reach.

    Raises
    ------
    ModelError
        If a setting is not possible.

    Examples
    --------
    A server, and a client that reads its node:

    >>> from time import sleep
    >>> from bayesftc.cosim import live
    >>> force = live.OPCUAServer(node="force", url="opc.tcp://127.0.0.1:48407")
    >>> force.open(None)
    >>> inbox = live.Inbox(1)
    >>> reader = live.OPCUA(url=force.url, node="nsu=urn:bayesftc:live;s=force", period=0.02)
    >>> reader.open(inbox)
    >>> while not reader.connected:
    ...     sleep(0.01)
    >>> sample = inbox.take()
    >>> while not sample[0] == 500.0:
    ...     force.send([500.0], time=0.0)
    ...     sleep(0.02)
    ...     sample = inbox.take()
    >>> reader.close(), force.close()
    (None, None)
    """

    node: str
    url: str = "opc.tcp://127.0.0.1:4840"
    security: str | None = None
    certificate: str | None = field(default=None, metadata=PATH)
    key: str | None = field(default=None, metadata=PATH)
    anonymous: bool = False

    def __post_init__(self) -> None:
        host, _ = check_url("The OPC UA server", self.url)
        if not self.node:
            raise ModelError("The OPC UA server has an empty node. Give the node a name.")
        check_security("The OPC UA server", self.security, self.certificate, self.key)
        self.check_login("The OPC UA server")
        if self.user is not None and not (self.password or self.password_env or self.password_file):
            raise ModelError("The OPC UA server has a user without a password. Add password_env = ...")
        if self.user is None and not self.anonymous and not is_loopback(host):
            raise ModelError(
                f"The OPC UA server at {self.url} has no user: everybody who can reach this address could write samples. Add "
                "user and password_env, or anonymous = true if everybody may."
            )

    def open(self, inbox: Inbox | None) -> None:
        """Start the server, or add the node to it. This takes about a second; the bridge is then `connected`.

        Raises
        ------
        ModelError
            If the port is used already, or a password or certificate cannot be read, or two wires do not fit together.
        BayesFTCError
            If asyncua is not installed.
        """
        self._open(inbox)
        _check_files(self, "certificate", "key")
        offer = opcua_session.Address(
            self.url,
            self.user,
            self.read_password("The OPC UA server"),
            self.security,
            self.certificate,
            self.key,
        )
        if self.url not in opcua_server.addresses():
            _check_free(*check_url("The OPC UA server", self.url))
        self._opened = submit(opcua_server.join(offer, self)).result(OPENING)

    def _wake(self) -> None:
        if self._opened is not None:
            self._showing = asyncio.ensure_future(self._opened.show(self))


def _check_files(bridge: Any, *keys: str) -> None:
    for key in keys:
        if getattr(bridge, key) is not None:
            readable("OPC UA", key, getattr(bridge, key))
    if bridge.certificate is not None and bridge.key is not None:
        check_pair(bridge.certificate, bridge.key)


def _check_free(host: str, port: int) -> None:
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
    except OSError as error:
        raise ModelError(
            f"The OPC UA server cannot listen at {host}, port {port} ({error.strerror or error}). Check the url, and whether "
            "another program uses the port."
        ) from None


__all__ = ["OPCUA", "OPCUAServer"]
