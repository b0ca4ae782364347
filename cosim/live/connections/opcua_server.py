"""The OPC UA server of this process: one for all wires with the same address."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Protocol

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import FIRST_PAUSE, LONGEST_PAUSE, PATIENCE
from bayesftc.cosim.live.connections.event_loop import outcome
from bayesftc.cosim.live.connections.opcua_certificates import application_uri, encoding
from bayesftc.cosim.live.connections.opcua_session import Address, quiet_log
from bayesftc.cosim.live.connections.opcua_values import give

if TYPE_CHECKING:
    from bayesftc.cosim.live.inbox import Inbox

NAMESPACE = "urn:bayesftc:live"
"""The namespace of the nodes, and the name of the server without a certificate."""


class Hosted(Protocol):
    """A wire at the server. Only the event loop calls these."""

    node: str
    inbox: Inbox | None
    connected: bool
    problem: str

    def next_values(self) -> Sequence[float] | None:
        """Return the newest values that were not shown yet."""

    def sent(self) -> None:
        """Note that the values of before were shown."""


class Host:
    """The server with the nodes of the wires."""

    def __init__(self, offer: Address):
        self._asyncua, self._ua = (extra(name, "OPC UA", of="live") for name in ("asyncua", "asyncua.ua"))
        quiet_log()
        self.offer = offer
        self._wires: list[Hosted] = []
        self._nodes: dict[int, Any] = {}
        self._server: Any = None
        self._lock = asyncio.Lock()
        self._task = asyncio.ensure_future(self._run())

    async def add(self, wire: Hosted) -> None:
        """Add a wire."""
        self._wires.append(wire)
        async with self._lock:
            if self._server is not None and id(wire) not in self._nodes:
                await self._begin(wire)

    async def remove(self, wire: Hosted) -> None:
        """Remove a wire and its node; after the last one, end the server."""
        await self.show(wire)
        self._wires = [each for each in self._wires if each is not wire]
        wire.connected = False
        if not self._wires:
            _HOSTS.pop(self.offer.url, None)
            self._task.cancel()
            await asyncio.wait([self._task])
        elif (node := self._nodes.pop(id(wire), None)) is not None:
            await outcome(self._server.delete_nodes([node]), PATIENCE)

    async def show(self, wire: Hosted) -> None:
        """Write the newest values of a wire into its node."""
        node = self._nodes.get(id(wire))
        if node is None or (values := wire.next_values()) is None:
            return
        ua = self._ua
        content = list(values) if len(values) > 1 else values[0]
        now = datetime.now(UTC)
        value = ua.DataValue(ua.Variant(content, ua.VariantType.Double), ua.StatusCode(), now, now)
        await self._server.write_attribute_value(node.nodeid, value)
        wire.sent()

    async def _run(self) -> None:
        pause = FIRST_PAUSE
        while True:
            server = self._asyncua.Server(user_manager=self)
            error = await outcome(self._start(server))
            try:
                if error is None:
                    async with self._lock:
                        self._server = server
                        for wire in self._wires:
                            await self._begin(wire)
                    await asyncio.Event().wait()  # until the last wire leaves
            finally:
                self._server = None
                self._nodes.clear()
                await asyncio.shield(outcome(server.stop(), PATIENCE))
            for wire in self._wires:
                wire.problem = (
                    f"The OPC UA server {self.offer.url} cannot start ({error}). Check address and certificate."
                )
            await asyncio.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    async def _start(self, server: Any) -> None:
        ua, offer = self._ua, self.offer
        await server.init()
        server.set_endpoint(offer.url)
        server.set_server_name("bayesftc")
        await server.set_application_uri((offer.certificate and application_uri(offer.certificate)) or NAMESPACE)
        policy = ua.SecurityPolicyType.NoSecurity
        if offer.security is not None and offer.certificate is not None and offer.key is not None:
            name, _, mode = offer.security.partition(",")
            policy = ua.SecurityPolicyType[f"{name}_{mode}"]
            await server.load_certificate(offer.certificate, encoding(offer.certificate))
            await server.load_private_key(offer.key, None, encoding(offer.key))
        server.set_security_policy([policy])
        server.set_identity_tokens([ua.AnonymousIdentityToken if offer.user is None else ua.UserNameIdentityToken])
        self._space = await server.register_namespace(NAMESPACE)
        self._folder = await server.nodes.objects.add_folder(
            ua.NodeId("bayesftc", self._space), f"{self._space}:bayesftc"
        )
        await server.start()

    async def _begin(self, wire: Hosted) -> None:
        ua, server = self._ua, self._server
        waiting = ua.DataValue(
            ua.Variant(float("nan"), ua.VariantType.Double), ua.StatusCode(ua.StatusCodes.UncertainInitialValue)
        )
        node = await self._folder.add_variable(
            ua.NodeId(wire.node, self._space), f"{self._space}:{wire.node}", float("nan"), ua.VariantType.Double
        )
        await node.write_value_rank(ua.ValueRank.ScalarOrOneDimension)
        await server.write_attribute_value(node.nodeid, waiting)
        self._nodes[id(wire)] = node
        if wire.inbox is not None:
            inbox = wire.inbox

            async def written(_handle: int, value: Any) -> None:
                give(value, inbox)

            await node.set_writable()
            server.iserver.aspace.add_datachange_callback(node.nodeid, ua.AttributeIds.Value, written)
        wire.connected, wire.problem = True, ""
        await self.show(wire)

    def get_user(
        self, _server: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> Any:
        """Return the user who logs in, or None if this is not the one with the password (called by asyncua)."""
        rules = extra("asyncua.crypto.permission_rules", "OPC UA", of="live")
        offer = self.offer
        if offer.user is not None:
            pairs = ((username, offer.user), (password, offer.password))
            right = [hmac.compare_digest((given or "").encode(), (own or "").encode()) for given, own in pairs]
            if not all(right):
                return None
        return rules.User(role=rules.UserRole.User)


_HOSTS: dict[str, Host] = {}


def addresses() -> tuple[str, ...]:
    """Return the addresses of the servers of this process."""
    return tuple(_HOSTS)


async def join(offer: Address, wire: Hosted) -> Host:
    """Return the server of an address, with one more wire.

    Raises
    ------
    ModelError
        If there is one with other settings, or with a node of this name.
    """
    host = _HOSTS.get(offer.url)
    if host is not None and host.offer != offer:
        raise ModelError(
            f"Two wires have a server at {offer.url} with other users or security. Give both the same settings."
        )
    if host is not None and any(each.node == wire.node for each in host._wires):
        raise ModelError(f"Two wires have the node {wire.node!r} of the server {offer.url}. Give each its own node.")
    if host is None:
        host = _HOSTS[offer.url] = Host(offer)
    await host.add(wire)
    return host


__all__ = ["Host", "addresses", "join"]
