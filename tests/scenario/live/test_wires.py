"""Files of wires: keys, types, places in messages, and classes of a user."""

from math import inf
from pathlib import Path

import pytest

from bayesftc.cosim.errors import BayesFTCError, ModelError, ScenarioError, UnknownNameError
from bayesftc.cosim.live import BRIDGES, UDP, File, Serial
from bayesftc.scenario._files import shipped_files
from bayesftc.scenario._schema import settings
from bayesftc.scenario.live import load_wires

SPEED = '[bridge.speed]\nkind = "UDP"\nport = 5001\nto = "controller.y"\n'
FORCE = '[bridge.force]\nkind = "UDP"\nport = 5002\nfrom = "controller.u"\nsafe = 0.0\n'


@pytest.fixture
def load(tmp_path):
    def load(text):
        (tmp_path / "wires.toml").write_text(text, encoding="utf-8")
        return load_wires(tmp_path / "wires.toml")

    return load


def test_every_key_arrives_where_it_belongs(load):
    read = load(
        "watchdog = 5\n[recording]\nseconds = 2.5\nrows = 100\nkeep = 7\n"
        '[bridge.speed]\nkind = "udp"\nport = 5001\naddress = "0.0.0.0"\nformat = "stamped doubles"\nsender = "10.0.0.3"\n'
        'to = ["controller.y[0]", "controller.y[1]"]\nstale_after = 0.06\nhold = false\nscale = 0.2778\noffset = 1\n'
        "low = -5\nhigh = 80.0\n" + FORCE.replace("safe = 0.0", 'safe = "last"\nlow = -10\nscale = 2.0')
    )
    assert read.watchdog == 5.0
    speed, force = read.wires["speed"], read.wires["force"]
    assert isinstance(speed.bridge, UDP)
    bridge = (speed.bridge.port, speed.bridge.address, speed.bridge.format, speed.bridge.sender)
    assert bridge == (5001, "0.0.0.0", "stamped doubles", "10.0.0.3")
    assert (speed.is_input, speed.names) == (True, ("controller.y[0]", "controller.y[1]"))
    limits = speed.limits(hold=True)
    assert (limits.stale_after, limits.hold, limits.scale, limits.offset, limits.low, limits.high) == (
        0.06, False, 0.2778, 1.0, -5.0, 80.0,
    )  # fmt: skip
    assert (force.is_input, force.names, force.safe, force.low, force.high) == (
        False, ("controller.u",), "last", -10.0, inf,
    )  # fmt: skip
    recording = read.recording("runs")
    assert (recording.folder, recording.seconds, recording.rows, recording.keep) == ("runs", 2.5, 100, 7)
    assert read.recording(None) is None


@pytest.mark.parametrize("cls", BRIDGES)
def test_every_kind_can_be_named(load, cls):
    """With values of the right type for what it needs."""
    needed = {"port": 5001, "topic": "'y'", "url": "'opc.tcp://plc'", "node": "'i=1'", "path": "'y.csv'"}
    needed |= {"port": "'/dev/ttyUSB0'"} if cls is Serial else {}
    keys = [f"{name} = {needed[name]}" for name, required in settings(cls).items() if required]
    text = "\n".join([f"[bridge.y]\nkind = '{cls.__name__}'\nto = 'controller.y'", *keys])
    assert type(load(text).wires["y"].bridge) is cls


def test_defaults(load):
    read = load(SPEED)
    assert read.watchdog == 10.0
    assert list(read.wires) == ["speed"]
    assert read.wires["speed"].limits(hold=True).hold is True
    assert (read.pieces.seconds, read.pieces.rows, read.pieces.keep) == (10.0, None, None)


def test_paths_begin_at_the_folder_of_the_file(load, tmp_path):
    wire = '[bridge.speed]\nkind = "File"\npath = "data/speeds.csv"\nto = "controller.y"\n'
    bridge = load(wire).wires["speed"].bridge
    assert isinstance(bridge, File)
    assert bridge.path == str(tmp_path / "data" / "speeds.csv")
    absolute = wire.replace("data/speeds.csv", "/var/log/speeds.csv")
    assert load(absolute).wires["speed"].bridge.path == "/var/log/speeds.csv"


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("", ScenarioError, r"wires.toml has no bridge. Add \[bridge.<name>\] with kind = ..."),
        ("bridge = 3\n", ScenarioError, r"'bridge' is 3. It must be a table"),
        ("[bridge]\nspeed = 3\n", ScenarioError, r"'bridge.speed' is 3. It must be a table"),
        ("[bridges.speed]\n", ScenarioError, r"has the unknown section 'bridges'; did you mean 'bridge'"),
        ("watchdog = 0\n" + SPEED, ScenarioError, r"'watchdog' is 0; it must be a positive number of periods"),
        ("watchdog = nan\n" + SPEED, ScenarioError, r"'watchdog' is nan"),
        ("watchdog = 'often'\n" + SPEED, ScenarioError, r"'watchdog' is 'often'; it must be a number"),
        (SPEED.replace('kind = "UDP"\n', ""), ScenarioError, r"'bridge.speed' lacks 'kind'"),
        (SPEED.replace('"UDP"', '"UPD"'), ScenarioError, r"'bridge.speed.kind' is 'UPD'.*did you mean 'UDP'"),
        (SPEED.replace('"UDP"', "3"), ScenarioError, r"'bridge.speed.kind' is 3"),
        (SPEED.replace("port = 5001\n", ""), ScenarioError, r"'bridge.speed' lacks 'port', which UDP needs"),
        (SPEED.replace("5001", "'5001'"), ScenarioError, r"'bridge.speed.port' is '5001'; it must be a whole number"),
        (SPEED.replace("5001", "70000"), ModelError, r"'bridge.speed': UDP has port=70000"),
        (SPEED.replace("to =", "tO ="), ScenarioError, r"'bridge.speed' has the unknown key 'tO'; did you mean 'to'"),
        (SPEED + "stale_afer = 1\n", ScenarioError, r"unknown key 'stale_afer'; did you mean 'stale_after'"),
        (SPEED + "source = 'y'\n", ScenarioError, r"unknown key 'source'"),
        (SPEED + "baud = 9600\n", ScenarioError, r"unknown key 'baud'"),
        (SPEED + "connected = true\n", ScenarioError, r"unknown key 'connected'"),
        (SPEED + "stale_after = 0\n", ModelError, r"'bridge.speed': stale_after is 0.*must be a positive number"),
        (
            SPEED + "stale_after = '60 ms'\n",
            ScenarioError,
            r"'bridge.speed.stale_after' is '60 ms'; it must be a number",
        ),
        (SPEED + "scale = 0\n", ModelError, r"'bridge.speed': scale is 0"),
        (SPEED + "scale = inf\n", ModelError, r"'bridge.speed': scale is inf"),
        (SPEED + "low = 2\nhigh = 1\n", ModelError, r"'bridge.speed': low is 2.*low must be less than high"),
        (SPEED + "password = 98765\n", ScenarioError, r"'bridge.speed.password' is no text; put it in quotes"),
        (SPEED + "hold = 1\n", ScenarioError, r"'bridge.speed.hold' is 1; it must be true or false"),
        (SPEED + "safe = 0\n", ModelError, r"'bridge.speed': safe has no effect on a wire with to"),
        (SPEED + "from = 'controller.u'\n", ModelError, r"'bridge.speed': A wire has either to"),
        (SPEED.replace('to = "controller.y"\n', ""), ModelError, r"'bridge.speed': A wire has either to"),
        (SPEED.replace('"controller.y"', "3"), ScenarioError, r"'bridge.speed.to' is 3"),
        (FORCE.replace("safe = 0.0\n", ""), ModelError, r"'bridge.force': controller.u drives an actuator"),
        (FORCE.replace("0.0", '"first"'), BayesFTCError, r"'bridge.force.*safe.*'first'"),
        (
            "watchdog = inf\n" + FORCE,
            ScenarioError,
            r"'watchdog' is inf; it must be a positive number of periods, and finite",
        ),
        (FORCE + "hold = true\n", ModelError, r"'bridge.force': hold has no effect on a wire with from"),
        (FORCE.replace('"controller.u"', "[]"), ModelError, r"'bridge.force': A wire has either to"),
        (SPEED + "[recording]\nsecond = 3\n", ScenarioError, r"'recording' has the unknown key 'second'"),
        (SPEED + SPEED, ScenarioError, r"is no valid TOML"),
    ],
)
def test_mistakes_are_named_with_their_place(load, tmp_path, text, error, words):
    with pytest.raises(error, match=words) as raised:
        load(text)
    assert str(raised.value).startswith(str(tmp_path / "wires.toml"))


def test_settings_of_the_recording_are_checked_when_there_is_one(load, tmp_path):
    read = load(SPEED + "[recording]\nkeep = 0\n")
    assert read.recording(None) is None
    with pytest.raises(ModelError, match=r"wires.toml: 'recording': The recording has keep=0"):
        read.recording(tmp_path)


def test_a_file_that_is_not_there():
    with pytest.raises(ScenarioError, match=r"no shipped wires of this name; did you mean 'car_by_udp'"):
        load_wires("car_by_upd")
    with pytest.raises(ScenarioError, match="There is no file of wires"):
        load_wires("nowhere.toml")


def test_every_shipped_file_is_read():
    shipped = shipped_files("wires")
    assert "car_by_udp" in shipped
    for name, file in shipped.items():
        read = load_wires(name)
        assert read.path == file
        assert any(wire.safe is not None for wire in read.wires.values())


OWN = """
from dataclasses import dataclass
from bayesftc.cosim.live import Bridge

COUNT = 0

@dataclass(eq=False)
class Lamp(Bridge):
    pin: int
    name: str = "lamp"

    def open(self, inbox): ...
    def send(self, values, time): ...
    def close(self): ...


class Plain(Bridge):
    def open(self, inbox): ...
    def send(self, values, time): ...
    def close(self): ...


class Other: ...


@dataclass(eq=False)
class Unknown(Lamp):
    mode: "Mode" = 1
"""


@pytest.fixture
def own(tmp_path, load):
    (tmp_path / "my_bridges.py").write_text(OWN, encoding="utf-8")

    def own(kind, **keys):
        lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
        return load(f'[bridge.lamp]\nkind = "{kind}"\nfrom = "controller.beta"\n{lines}')

    return own


def test_a_bridge_of_ones_own_is_of_its_file(own):
    bridge = own("my_bridges.py:Lamp", pin=7).wires["lamp"].bridge
    assert (type(bridge).__name__, bridge.pin, bridge.name) == ("Lamp", 7, "lamp")


def test_all_wires_have_the_same_class_of_a_file(own, load):
    wire = 'kind = "my_bridges.py:Lamp"\npin = 1\nfrom = "controller.beta"\n'
    wires = load(f"[bridge.a]\n{wire}[bridge.b]\n{wire}").wires
    assert type(wires["a"].bridge) is type(wires["b"].bridge)


def test_a_bridge_of_a_module(own, tmp_path, monkeypatch):
    folder = tmp_path / "installed"
    folder.mkdir()
    (folder / "bridges_of_a_package.py").write_text(OWN, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)
    assert own("bridges_of_a_package:Lamp", pin=2).wires["lamp"].bridge.pin == 2
    (folder / "broken_bridges.py").write_text("1 / 0", encoding="utf-8")
    with pytest.raises(ModelError, match=r"The module 'broken_bridges' .* cannot be imported \(division by zero\)"):
        own("broken_bridges:Lamp")


@pytest.mark.parametrize(
    ("kind", "keys", "error", "words"),
    [
        ("my_bridges.py:Lmap", {}, UnknownNameError, r"my_bridges.py has no class 'Lmap'; did you mean 'Lamp'"),
        ("my_bridges.py:Other", {}, ModelError, r"my_bridges.py:Other is no bridge. Derive the class from"),
        ("my_bridges.py:COUNT", {}, ModelError, r"is no bridge"),
        ("my_bridges.py:Plain", {}, ScenarioError, r"'my_bridges.py:Plain', which is no dataclass. Write @dataclass"),
        ("my_bridges.py:Unknown", {}, ScenarioError, r"annotations cannot be evaluated \(name 'Mode' is not defined\)"),
        ("no_bridges.py:Lamp", {}, ModelError, r"There is no file .*no_bridges.py with a bridge. Its path begins at"),
        (
            "no_such_module_here:Lamp",
            {},
            ModelError,
            r"The module 'no_such_module_here' with a bridge cannot be imported",
        ),
        (":Lamp", {}, ModelError, r"The module '' with a bridge cannot be imported"),
        ("my_bridges.py:Lamp", {}, ScenarioError, r"'bridge.lamp' lacks 'pin', which Lamp needs"),
        ("my_bridges.py:Lamp", {"pin": "'1'"}, ScenarioError, r"'bridge.lamp.pin' is '1'; it must be a whole number"),
        ("my_bridges.py:Lamp", {"pni": 1}, ScenarioError, r"unknown key 'pni'; did you mean 'pin'"),
    ],
)
def test_mistakes_with_ones_own_bridge(own, kind, keys, error, words):
    with pytest.raises(error, match=words) as raised:
        own(kind, **keys)
    assert "wires.toml: 'bridge.lamp" in str(raised.value)


@pytest.mark.parametrize("text", ["import no_such_module_here\n", "1 / 0\n", "def broken(:\n", "raise SystemError\n"])
def test_a_file_that_cannot_be_executed(own, tmp_path, text):
    (tmp_path / "my_bridges.py").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"my_bridges.py cannot be executed: \w+Error.*Correct the file"):
        own("my_bridges.py:Lamp", pin=1)
    (tmp_path / "my_bridges.py").write_text(OWN, encoding="utf-8")
    assert own("my_bridges.py:Lamp", pin=1).wires["lamp"].bridge.pin == 1  # corrected in the same process


def test_the_error_of_a_wire_is_named_with_its_file(load, tmp_path):
    read = load(SPEED)
    with pytest.raises(ModelError, match=r"wires.toml: The port is used"), read.named():
        raise ModelError("The port is used.")
    assert read.path == Path(tmp_path / "wires.toml")
