"""OPC UA with real servers and clients of asyncua, which run in a loop of their own."""

import asyncio
import socket
import sys
import threading
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from asyncua import Client, Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from brokers import Certificates, free_port, until

from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.live import OPCUA, Inbox, Limits, OPCUAServer
from bayesftc.cosim.live.connections import opcua_server, opcua_session
from bayesftc.cosim.live.connections.opcua_values import converted

SPACE = "urn:factory"


class Elsewhere:
    """An event loop that is not that of the bridges."""

    def __init__(self):
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def __call__(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(60)

    def end(self):
        self(self._cancel())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    async def _cancel(self):
        """Cancel tasks that asyncua has left: asyncio would log an error when they are collected, during any later test."""
        left = asyncio.all_tasks() - {asyncio.current_task()}
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)


class Plant:
    """A foreign server with some nodes."""

    def __init__(self, elsewhere, user=None, certificates=None):
        self.run, self.user = elsewhere, user
        self.port = free_port()
        self.url = f"opc.tcp://127.0.0.1:{self.port}"
        self.run(self._start(certificates))

    async def _start(self, certificates):
        self.server = Server(user_manager=self)
        await self.server.init()
        self.server.set_endpoint(self.url)
        self.server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        if certificates:
            await self.server.load_certificate(certificates.server[0], "pem")
            await self.server.load_private_key(certificates.server[1], None, "pem")
            await self.server.set_application_uri("urn:bayesftc:test")
            self.server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        if self.user:
            self.server.set_identity_tokens([ua.UserNameIdentityToken])
        self.space = await self.server.register_namespace(SPACE)
        await self.server.start()

    def get_user(self, _server, username=None, password=None, certificate=None):
        if self.user is None or (username, password) == self.user:
            return User(role=UserRole.User)
        return None

    def add(self, name, value, kind=ua.VariantType.Double, writable=True):
        async def add():
            node = await self.server.nodes.objects.add_variable(ua.NodeId(name, self.space), name, value, kind)
            if writable:
                await node.set_writable()
            return node

        return self.run(add())

    def write(self, node, value, kind=ua.VariantType.Double, status=None, stamp=None):
        code = ua.StatusCode(ua.StatusCodes.Good if status is None else status)
        content = ua.DataValue(ua.Variant(value, kind), code, datetime.now(UTC) if stamp is None else stamp)
        self.run(self.server.write_attribute_value(node.nodeid, content))

    def cut(self):
        self.run(self.server.bserver.stop())

    def restore(self):
        self.run(self.server.bserver.start())

    def close(self):
        self.run(self.server.stop())


@pytest.fixture(scope="module")
def elsewhere():
    made = Elsewhere()
    yield made
    made.end()


@pytest.fixture(scope="module")
def plant(elsewhere):
    made = Plant(elsewhere)
    yield made
    made.close()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    return Certificates(tmp_path_factory.mktemp("certificates"))


@pytest.fixture(scope="module")
def guarded(elsewhere, certificates):
    made = Plant(elsewhere, user=("car", "secret"), certificates=certificates)
    made.add("y", 7.0)
    yield made
    made.close()


@pytest.fixture
def opened():
    bridges = []

    def opened(inbox=None, cls=OPCUA, **settings):
        bridges.append(cls(**settings))
        bridges[-1].open(inbox)
        return bridges[-1]

    yield opened
    for bridge in bridges:
        bridge.close()
    assert not opcua_session._SESSIONS
    assert not opcua_server._HOSTS


def reader(opened, plant, name, size=1, **limits):
    """Return a connected wire that has got its first value, and its inbox."""
    box = Inbox(size, Limits(**limits))
    bridge = opened(box, url=plant.url, node=f"nsu={SPACE};s={name}", period=0.01)
    until(lambda: box.received)
    return bridge, box


def test_values_are_samples_and_bad_ones_are_missing(plant, opened):
    node = plant.add("speed", 1.0)
    bridge, box = reader(opened, plant, "speed", hold=True)
    assert bridge.connected
    plant.write(node, 2.0)
    until(lambda: box.take()[0] == 2.0)
    plant.write(node, None, ua.VariantType.Null, ua.StatusCodes.BadSensorFailure)
    until(lambda: np.isnan(box.take()[0]))
    assert box.last_reason == "bad status: BadSensorFailure"
    plant.write(node, 3.0)
    until(lambda: box.take()[0] == 3.0)
    plant.write(node, 4.0, status=ua.StatusCodes.UncertainLastUsableValue)
    until(lambda: np.isnan(box.take()[0]))
    assert box.missing["bad status"] >= 2


def test_the_same_number_with_a_new_time_stamp_is_a_new_sample(plant, opened):
    node = plant.add("frozen", 5.0)
    _, box = reader(opened, plant, "frozen")
    for _ in range(3):
        before = box.received
        plant.write(node, 5.0)
        until(lambda before=before: box.received > before)
        assert box.take()[0] == 5.0
    stamp = datetime.now(UTC)
    plant.write(node, 6.0, stamp=stamp)
    until(lambda: box.take()[0] == 6.0)
    plant.write(node, 7.0, stamp=stamp - timedelta(seconds=1))
    until(lambda: box.rejected["out of order"])


@pytest.mark.parametrize(
    ("limits", "age", "used"),
    [
        ({}, 0, False),
        ({"hold": True}, 5000, True),
        ({"stale_after": 60.0}, 0, True),
        ({"stale_after": 60.0}, 100, False),
        ({"stale_after": 60.0, "hold": True}, 100, False),
    ],
)
def test_the_first_value_is_as_old_as_it_is(plant, opened, limits, age, used):
    node = plant.add(f"goal{sorted(limits)}{age}", 0.0)
    plant.write(node, 7.0, stamp=datetime.now(UTC) - timedelta(seconds=age))
    _, box = reader(opened, plant, f"goal{sorted(limits)}{age}", **limits)
    assert (box.take().tolist() == [7.0]) is used
    assert box.rejected["late"] == (not used)


@pytest.mark.parametrize(
    ("value", "kind", "taken"),
    [
        (-3, ua.VariantType.Int16, [-3.0]),
        (True, ua.VariantType.Boolean, [1.0]),
        (2.5, ua.VariantType.Float, [2.5]),
        ([1.0, 2.0], ua.VariantType.Double, [1.0, 2.0]),
        ("warm", ua.VariantType.String, None),
        ([1.0, 2.0, 3.0], ua.VariantType.Double, None),
    ],
)
def test_values_of_many_types_are_numbers(plant, opened, value, kind, taken):
    name = f"typed {kind.name} {value}"
    plant.add(name, value, kind)
    _, box = reader(opened, plant, name, size=2 if isinstance(value, list) else 1, hold=True)
    sample = box.take()
    assert np.isnan(sample).all() if taken is None else sample.tolist() == taken


@pytest.mark.parametrize(
    ("first", "kind", "values", "written"),
    [
        (0.0, ua.VariantType.Double, [1.5], 1.5),
        (0.0, ua.VariantType.Float, [2.5], 2.5),
        (0, ua.VariantType.Int16, [7.6], 8),
        (False, ua.VariantType.Boolean, [1.0], True),
        ([0.0, 0.0], ua.VariantType.Double, [1.0, 2.0], [1.0, 2.0]),
    ],
)
def test_controls_have_the_type_of_the_node(plant, opened, first, kind, values, written):
    name = f"written {kind.name} {first}"
    node = plant.add(name, first, kind)
    bridge = opened(url=plant.url, node=f"ns={plant.space};s={name}")
    until(lambda: bridge.connected)
    bridge.send(values, 0.0)
    until(lambda: plant.run(node.read_value()) == written)
    until(lambda: bridge.lost == 0)
    assert bridge.problem == ""


@pytest.mark.parametrize(
    ("first", "kind", "values", "problem"),
    [
        (0, ua.VariantType.Byte, [300.0], "outside the type Byte of the node (0 to 255)"),
        (0, ua.VariantType.Int32, [np.nan], "not a finite number"),
        ("", ua.VariantType.String, [1.0], "of the type String"),
        (0.0, ua.VariantType.Double, [1.0, 2.0], "holds one number"),
    ],
)
def test_controls_that_cannot_be_written(plant, opened, first, kind, values, problem):
    name = f"refused {kind.name}"
    plant.add(name, first, kind)
    bridge = opened(url=plant.url, node=f"ns={plant.space};s={name}")
    until(lambda: bridge.connected)
    bridge.send(values, 0.0)
    until(lambda: problem in bridge.problem)
    assert bridge.lost == 1


def test_a_node_that_nobody_may_write(plant, opened):
    plant.add("locked", 0.0, writable=False)
    bridge = opened(url=plant.url, node=f"nsu={SPACE};s=locked")
    until(lambda: bridge.connected)
    bridge.send([1.0], 0.0)
    until(lambda: "refuses to write" in bridge.problem)
    assert "BadUserAccessDenied" in bridge.problem or "BadNotWritable" in bridge.problem


def test_a_node_that_comes_later(plant, opened):
    bridge = opened(Inbox(1), url=plant.url, node=f"nsu={SPACE};s=later")
    other = opened(Inbox(1), url=plant.url, node="nsu=urn:nowhere;s=x")
    until(lambda: bridge.problem and other.problem)
    assert "refuses the node 'nsu=urn:factory;s=later' (BadNodeIdUnknown)" in bridge.problem
    assert "refuses the node 'nsu=urn:nowhere;s=x'" in other.problem
    plant.add("later", 1.0)
    until(lambda: bridge.connected)
    assert not other.connected


def test_wires_share_a_session(plant, opened):
    plant.add("shared", 1.0)
    before = len(plant.server.bserver.clients)
    boxes = [Inbox(1, Limits(hold=True)) for _ in range(3)]
    readers = [
        opened(box, url=plant.url, node=f"nsu={SPACE};s=shared", period=0.01 * (1 + k)) for k, box in enumerate(boxes)
    ]
    until(lambda: all(box.take()[0] == 1.0 for box in boxes))
    assert len(plant.server.bserver.clients) == before + 1
    readers[0].close()
    assert readers[1].connected


def test_a_server_that_stops_and_starts(plant, opened):
    node, control = plant.add("y", 1.0), plant.add("u", 0.0)
    bridge, box = reader(opened, plant, "y")
    writer = opened(url=plant.url, node=f"nsu={SPACE};s=u")
    until(lambda: writer.connected)
    plant.cut()
    until(lambda: not (bridge.connected or writer.connected))
    writer.send([1.0], 0.0)
    assert writer.lost == 1
    until(lambda: "cannot be reached" in bridge.problem)
    plant.restore()
    until(lambda: bridge.connected and writer.connected)
    assert bridge.problem == ""
    plant.write(node, 2.0)
    writer.send([3.0], 0.1)
    until(lambda: plant.run(control.read_value()) == 3.0)
    # The first value after a connection may be old, and is not used; so one is written until it comes as a change.
    until(lambda: (plant.write(node, 3.0), box.take()[0] == 3.0)[1])


@pytest.mark.slow
def test_a_server_that_ends_and_another_one_at_its_address(elsewhere, opened):
    first = Plant(elsewhere)
    first.add("y", 1.0)
    bridge, box = reader(opened, first, "y", hold=True)
    first.close()
    until(lambda: not bridge.connected)
    second = Plant.__new__(Plant)
    second.run, second.user, second.port, second.url = elsewhere, None, first.port, first.url
    elsewhere(second._start(None))
    second.add("y", 2.0)
    until(lambda: box.take()[0] == 2.0)
    second.close()


@pytest.mark.slow
def test_user_password_and_certificates(guarded, opened, certificates, monkeypatch):
    settings = {"url": guarded.url, "node": f"nsu={SPACE};s=y"}
    certificate, key = certificates.client
    safe = {"security": "Basic256Sha256,SignAndEncrypt", "certificate": certificate, "key": key}
    monkeypatch.setenv("PLANT_PASSWORD", "secret")
    box = Inbox(1, Limits(hold=True))
    right = opened(box, **settings, **safe, user="car", password_env="PLANT_PASSWORD")
    wrong = opened(Inbox(1), **settings, **safe, user="car", password="guess")
    plain = opened(Inbox(1), **settings)
    weak = opened(Inbox(1), **settings, **(safe | {"security": "Aes128Sha256RsaOaep,Sign"}))
    until(lambda: box.take()[0] == 7.0)
    assert right.connected
    until(lambda: wrong.problem and plain.problem and weak.problem)
    assert "BadUserAccessDenied" in wrong.problem or "BadIdentityTokenRejected" in wrong.problem
    assert "Check user, password, security and certificate" in wrong.problem
    assert not any(each.connected for each in (wrong, plain, weak))


def foreign(elsewhere, url, work, user=None):
    """Let a foreign client do something at our server."""

    async def visit():
        client = Client(url)
        if user:
            client.set_user(user[0])
            client.set_password(user[1])
        async with client:
            space = await client.get_namespace_index("urn:bayesftc:live")
            return await work(client, space)

    return elsewhere(visit())


@pytest.mark.slow
def test_others_read_and_write_our_nodes(elsewhere, opened):
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    box = Inbox(1)
    speed = opened(box, OPCUAServer, node="speed", url=url)
    force = opened(cls=OPCUAServer, node="force", url=url)
    both = opened(cls=OPCUAServer, node="probability", url=url)
    until(lambda: speed.connected and force.connected and both.connected)
    force.send([500.0], 0.0)
    both.send([0.1, 0.9], 0.0)

    async def work(client, space):
        nodes = [client.get_node(ua.NodeId(name, space)) for name in ("force", "probability", "speed")]
        while (await nodes[1].read_data_value(False)).Value.Value != [0.1, 0.9]:
            await asyncio.sleep(0.01)
        await nodes[2].write_value(22.5)
        with pytest.raises(ua.UaStatusCodeError):
            await nodes[0].write_value(9.0)
        folder = await client.nodes.objects.get_child(f"{space}:bayesftc")
        return await nodes[0].read_value(), sorted(
            [(await each.read_browse_name()).Name for each in await folder.get_children()]
        )

    assert foreign(elsewhere, url, work) == (500.0, ["force", "probability", "speed"])
    assert box.take()[0] == 22.5

    async def bad(client, space):
        node = client.get_node(ua.NodeId("speed", space))
        value = ua.DataValue(ua.Variant(1.0, ua.VariantType.Double), ua.StatusCode(ua.StatusCodes.BadSensorFailure))
        await node.write_attribute(ua.AttributeIds.Value, value)

    foreign(elsewhere, url, bad)
    assert np.isnan(box.take()[0])
    assert box.missing["bad status"] == 1
    with pytest.raises(ModelError, match="Two wires have the node 'force'"):
        OPCUAServer(node="force", url=url).open(None)
    with pytest.raises(ModelError, match="with other users or security"):
        OPCUAServer(node="other", url=url, user="a", password="b").open(None)
    late = opened(cls=OPCUAServer, node="late", url=url)
    until(lambda: late.connected)
    late.close()
    assert force.connected


@pytest.mark.slow
def test_our_server_refuses_a_wrong_password(elsewhere, opened):
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    force = opened(cls=OPCUAServer, node="force", url=url, user="car", password="secret")
    until(lambda: force.connected)

    async def look(client, space):
        return (await client.get_node(ua.NodeId("force", space)).read_data_value(False)).StatusCode.name

    assert foreign(elsewhere, url, look, ("car", "secret")) == "UncertainInitialValue"
    for user in (("car", "guess"), ("bus", "secret"), None):
        with pytest.raises(ua.UaError):
            foreign(elsewhere, url, look, user)


def test_a_used_port_is_refused(plant):
    with pytest.raises(ModelError, match=f"cannot listen at 127.0.0.1, port {plant.port}"):
        OPCUAServer(node="force", url=plant.url).open(None)
    with socket.socket() as used:
        used.bind(("127.0.0.1", 0))
        used.listen()
        with pytest.raises(ModelError, match="another program uses the port"):
            OPCUAServer(node="force", url=f"opc.tcp://127.0.0.1:{used.getsockname()[1]}").open(Inbox(1))


@pytest.mark.parametrize(
    ("cls", "settings", "sentence"),
    [
        (OPCUA, {"url": "plc:4840"}, "opc.tcp://host:4840"),
        (OPCUA, {"url": "http://plc"}, "opc.tcp://host:4840"),
        (OPCUA, {"url": "opc.tcp://plc:x"}, "opc.tcp://host:4840"),
        (OPCUA, {"url": "opc.tcp://a:b@plc"}, "a user or a password in its url"),
        (OPCUA, {"node": "Car.Speed"}, "which is no node id"),
        (OPCUA, {"node": "ns=x;s=Car"}, "which is no node id"),
        (OPCUA, {"node": "i=abc"}, "which is no node id"),
        (OPCUA, {"period": 0.0}, "a positive number of seconds"),
        (OPCUA, {"security": "Basic256"}, "a policy and a mode"),
        (OPCUA, {"security": "Basic256Sha256,Sign"}, "without the others"),
        (OPCUA, {"certificate": "a.pem"}, "without the others"),
        (OPCUA, {"password": "x"}, "a password without a user"),
        (OPCUAServer, {"node": ""}, "an empty node"),
        (OPCUAServer, {"user": "a"}, "a user without a password"),
        (OPCUAServer, {"url": "tcp://x"}, "opc.tcp://host:4840"),
    ],
)
def test_wrong_settings_are_refused(cls, settings, sentence):
    defaults = {"url": "opc.tcp://plc:4840", "node": "i=1"} if cls is OPCUA else {"node": "y"}
    with pytest.raises(ModelError, match=sentence):
        cls(**{**defaults, **settings})


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.0.2", "[::]", "plc", "controller.local"])
def test_a_server_that_others_can_reach_needs_a_user_or_the_word_of_the_user(host):
    url = f"opc.tcp://{host}:4840"
    with pytest.raises(ModelError, match=r"has no user: everybody .* Add user and password_env, or anonymous = true"):
        OPCUAServer(node="y", url=url)
    assert OPCUAServer(node="y", url=url, anonymous=True).user is None
    assert OPCUAServer(node="y", url=url, user="plant", password_env="PLANT").anonymous is False
    for own in ("127.0.0.1", "127.0.0.2", "localhost", "[::1]"):
        OPCUAServer(node="y", url=f"opc.tcp://{own}:4840")


def test_files_that_cannot_be_used_are_refused_at_the_opening(tmp_path, certificates):
    missing = str(tmp_path / "no.pem")
    settings = {"security": "Basic256Sha256,Sign", "certificate": missing, "key": missing}
    for bridge in (OPCUA(url="opc.tcp://x", node="i=1", **settings), OPCUAServer(node="y", **settings)):
        with pytest.raises(ModelError, match="cannot be read"):
            bridge.open(None)
    settings |= {"certificate": certificates.client[0], "key": certificates.server[1]}
    with pytest.raises(ModelError, match="a certificate and its private key"):
        OPCUAServer(node="y", **settings).open(None)


def test_without_the_package_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    for bridge in (OPCUA(url="opc.tcp://x", node="i=1"), OPCUAServer(node="y")):
        with pytest.raises(BayesFTCError, match=r"OPC UA needs the package asyncua.*pip install 'bayesftc\[live\]'"):
            bridge.open(None)


@pytest.mark.parametrize("kind", ["SByte", "Byte", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"])
def test_whole_numbers_of_all_types_are_what_asyncua_packs(kind):
    from asyncua.ua.ua_binary import pack_uatype

    low = 0 if kind in {"Byte"} or kind.startswith("U") else -(2 ** (bits(kind) - 1))
    assert pack_uatype(ua.VariantType[kind], converted([float(low)], kind)[0])
    with pytest.raises(ValueError, match=f"outside the type {kind}"):
        converted([low - 2.0**12], kind)


def bits(kind):
    return 8 if kind.endswith("Byte") else int(kind[-2:])


def test_closing_twice_and_before_opening_is_allowed():
    for bridge in (OPCUA(url="opc.tcp://localhost:9", node="i=1"), OPCUAServer(node="y")):
        bridge.close()
        bridge.send([1.0], 0.0)
        assert bridge.lost == 1
