"""Sessions at OPC UA servers: one for all wires with the same settings, made again after it breaks."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.live.bridge import FIRST_PAUSE, LONGEST_PAUSE, PATIENCE
from bayesftc.cosim.live.connections.event_loop import outcome
from bayesftc.cosim.live.connections.opcua_certificates import application_uri, encoding
from bayesftc.cosim.live.connections.opcua_values import NODE, converted

if TYPE_CHECKING:
    from bayesftc.cosim.live.inbox import Inbox

ANSWER = 4.0
"""Seconds in which a server must answer a request."""

WATCH = 1.0
"""Seconds between two looks whether the server is still there."""


class Client(Protocol):
    """A wire at a session. Only the event loop calls these."""

    node: str
    period: float
    inbox: Inbox | None
    connected: bool
    lost: int
    problem: str
    news: asyncio.Event

    def next_values(self) -> Sequence[float] | None:
        """Return the newest values that were not sent yet."""

    def sent(self) -> None:
        """Note that the values of before were sent or refused."""

    def arrived(self, value: Any, first: bool) -> None:
        """Take a value of the node; the first one of a subscription may be old."""


@dataclass(frozen=True)
class Address:
    """Address of a server, and how to log in; wires with equal ones share a session, or a server in this process."""

    url: str
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    security: str | None = None
    certificate: str | None = None
    key: str | None = None
    server_certificate: str | None = None


class Session:
    """A session at a server, with the wires that use it."""

    def __init__(self, address: Address):
        self._asyncua, self._ua = (extra(name, "OPC UA", of="live") for name in ("asyncua", "asyncua.ua"))
        quiet_log()
        self.address = address
        self._wires: list[Client] = []
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._handles: dict[int, tuple[Client, list[bool]]] = {}
        self._numbers = itertools.count(1)
        self._subscriptions: dict[float, Any] = {}
        self._client: Any = None
        self._broken = asyncio.Event()
        self._task = asyncio.ensure_future(self._run())

    def add(self, wire: Client) -> None:
        """Add a wire."""
        self._wires.append(wire)
        if self._client is not None:
            self._begin(wire)

    async def remove(self, wire: Client) -> None:
        """Remove a wire; after the last one, say goodbye to the server."""
        self._wires = [each for each in self._wires if each is not wire]
        wire.connected = False
        if (task := self._tasks.pop(id(wire), None)) is not None:
            task.cancel()
            await asyncio.wait([task])
        if not self._wires:
            _SESSIONS.pop(self.address, None)
            self._task.cancel()
            await asyncio.wait([self._task])

    async def _run(self) -> None:
        loop, pause = asyncio.get_running_loop(), FIRST_PAUSE
        while True:
            client = self._asyncua.Client(self.address.url, timeout=ANSWER, watchdog_intervall=WATCH)
            began = loop.time()
            try:
                error = await outcome(self._connect(client), 3 * ANSWER)
                if error is None:
                    error = await self._use(client)
                self._tell(self._sentence(error))
            finally:
                await asyncio.shield(self._leave(client))
            if loop.time() - began > LONGEST_PAUSE:  # it was connected for a while
                pause = FIRST_PAUSE
            await asyncio.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    async def _connect(self, client: Any) -> None:
        address = self.address
        if address.user is not None:
            client.set_user(address.user)
            client.set_password(address.password or "")
        if address.security is not None and address.certificate is not None and address.key is not None:
            policy, _, mode = address.security.partition(",")
            policies, crypto = (
                extra(f"asyncua.crypto.{n}", "OPC UA", of="live") for n in ("security_policies", "uacrypto")
            )
            certificate, key, server = (
                None if file is None else crypto.CertProperties(file, encoding(file))
                for file in (address.certificate, address.key, address.server_certificate)
            )
            client.application_uri = application_uri(address.certificate) or client.application_uri
            await client.set_security(
                getattr(policies, f"SecurityPolicy{policy}"),
                certificate,
                key,
                server_certificate=server,
                mode=getattr(self._ua.MessageSecurityMode, mode),
            )
        await client.connect()

    async def _use(self, client: Any) -> BaseException | None:
        """Serve the wires until the connection breaks, and return the reason."""
        self._broken = asyncio.Event()

        async def lost(_error: Exception) -> None:
            self._broken.set()

        client.connection_lost_callback = lost
        self._client, self._subscriptions = client, {}
        for wire in self._wires:
            self._begin(wire)
        while not self._broken.is_set():
            error = await outcome(client.nodes.server_state.read_value(), ANSWER)
            if error is not None:
                return error
            await outcome(self._broken.wait(), WATCH)
        return None

    async def _leave(self, client: Any) -> None:
        self._client = None
        tasks = list(self._tasks.values())
        self._tasks.clear()
        self._handles.clear()
        for task in tasks:
            task.cancel()
        for wire in self._wires:
            wire.connected = False
        await outcome(client.disconnect(), PATIENCE / 2)

    def _begin(self, wire: Client) -> None:
        task = asyncio.ensure_future(self._serve(wire, self._client))
        self._tasks[id(wire)] = task
        task.add_done_callback(self._served)

    def _served(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and task.exception() is not None:
            self._broken.set()

    async def _serve(self, wire: Client, client: Any) -> None:
        pause = FIRST_PAUSE
        refusals = (self._ua.UaStatusCodeError, self._ua.UaStringParsingError, ValueError)
        while True:
            try:
                node = client.get_node(await self._node_id(client, wire.node))
                if wire.inbox is not None:
                    await self._subscribe(wire, client, node)
                    wire.connected, wire.problem = True, ""
                    return
                kind, is_array = await self._type(node)
            except refusals as error:
                where = f"The server {self.address.url} refuses the node {wire.node!r}"
                wire.problem = f"{where} ({_reason(error)}). Check the node id."
                await asyncio.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
            else:
                wire.next_values()  # those of before
                wire.connected, wire.problem = True, ""
                await self._write(wire, node, kind, is_array)

    async def _node_id(self, client: Any, text: str) -> Any:
        match = NODE.fullmatch(text)
        if match is not None and match["uri"] is not None:
            text = f"ns={await client.get_namespace_index(match['uri'])};{match['name']}"
        return self._ua.NodeId.from_string(text)

    async def _subscribe(self, wire: Client, client: Any, node: Any) -> None:
        ua = self._ua
        if wire.period not in self._subscriptions:
            self._subscriptions[wire.period] = asyncio.ensure_future(
                client.create_subscription(1000 * wire.period, self)
            )
        subscription = await asyncio.shield(self._subscriptions[wire.period])
        # A value with a new time stamp is a new sample, even if it is the same number.
        changes = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValueTimestamp)
        for each in (changes, None):
            number = next(self._numbers)
            self._handles[number] = (wire, [True])
            parameters = ua.MonitoringParameters(number, 1000 * wire.period, each, 1, True)
            item = ua.ReadValueId(node.nodeid, ua.AttributeIds.Value)
            request = ua.MonitoredItemCreateRequest(item, ua.MonitoringMode.Reporting, parameters)
            (result,) = await subscription.create_monitored_items([request])
            if isinstance(result, int):
                return
            del self._handles[number]
            if "Filter" not in result.name:
                break
        raise ua.UaStatusCodeError(result.value)

    def datachange_notification(self, _node: Any, _value: Any, data: Any) -> None:
        """Give a value of a subscription to its wire."""
        wire, first = self._handles.get(data.subscription_data.client_handle, (None, [False]))
        if wire is not None and any(wire is each for each in self._wires):
            wire.arrived(data.monitored_item.Value, first.pop() if first else False)

    def status_change_notification(self, _status: Any) -> None:
        """Connect again: the server has ended a subscription."""
        self._broken.set()

    async def _type(self, node: Any) -> tuple[Any, bool | None]:
        kind = await node.read_data_type_as_variant_type()
        rank = int(await node.read_value_rank())
        return kind, {-1: False}.get(rank, True if rank >= 0 else None)

    async def _write(self, wire: Client, node: Any, kind: Any, is_array: bool | None) -> None:
        ua = self._ua
        while True:
            await wire.news.wait()
            wire.news.clear()
            values = wire.next_values()
            if values is None:
                continue
            wire.lost += 1  # until it is written
            try:
                content = converted(values, kind.name)
                if is_array is False and len(content) > 1:
                    raise ValueError(
                        f"The node holds one number, but the wire has {len(content)}. Make a wire for each."
                    )
                whole = content if is_array or len(content) > 1 else content[0]
                # Many servers refuse values with a status or a time stamp.
                await node.write_attribute(ua.AttributeIds.Value, ua.DataValue(ua.Variant(whole, kind), None))
                wire.lost, wire.problem = wire.lost - 1, ""
            except ValueError as error:
                wire.problem = str(error)
            except ua.UaStatusCodeError as error:
                wire.problem = f"The server refuses to write {wire.node!r} ({_reason(error)})."
            finally:
                wire.sent()

    def _tell(self, problem: str) -> None:
        for wire in self._wires:
            wire.connected, wire.problem = False, problem

    def _sentence(self, error: BaseException | None) -> str:
        url = self.address.url
        if error is None:
            return f"The server {url} has closed the connection."
        if isinstance(error, self._ua.UaStatusCodeError):
            return f"The server {url} refuses the connection ({_reason(error)}). Check user, password, security and certificate."
        if isinstance(error, self._ua.UaError):
            return f"The server {url} cannot be used ({_reason(error)}). Check the security policies that it offers."
        if isinstance(error, OSError | TimeoutError | asyncio.TimeoutError):
            return f"The server {url} cannot be reached ({_reason(error)}). Check the address, and whether the server runs."
        return f"The server {url} cannot be used ({_reason(error)})."


_SESSIONS: dict[Address, Session] = {}


async def join(address: Address, wire: Client) -> Session:
    """Return the session at a server, with one more wire."""
    if address not in _SESSIONS:
        _SESSIONS[address] = Session(address)
    _SESSIONS[address].add(wire)
    return _SESSIONS[address]


def quiet_log() -> None:
    """Silence the log of asyncua, unless the user has set its level: it prints each attempt to connect with a traceback."""
    log = logging.getLogger("asyncua")
    if log.level == logging.NOTSET:
        log.setLevel(logging.CRITICAL + 1)


def _reason(error: BaseException) -> str:
    code = getattr(error, "code", None)
    if code is not None:
        return str(extra("asyncua.ua", "OPC UA", of="live").StatusCode(code).name)
    return str(getattr(error, "strerror", None) or error or type(error).__name__).rstrip(".")


__all__ = ["Address", "Session", "join", "quiet_log"]
