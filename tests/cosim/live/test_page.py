"""The pages on wires: each file of wires in them is read, with all its keys."""

import re
from pathlib import Path

import pytest

from bayesftc.cosim.errors import BayesFTCError
from bayesftc.cosim.live.kinds import BRIDGES
from bayesftc.scenario.live import load_wires

PAGES = Path(__file__).resolve().parents[3] / "docs" / "how-to"
NAMES = ("connect-mqtt-and-opc-ua", "live", "watch-sensors-now")
FILES = [
    text
    for name in NAMES
    for text in re.findall(r"^```toml\n(.*?)^```", (PAGES / f"{name}.md").read_text(encoding="utf-8"), re.S | re.M)
]


def wires(tmp_path, text):
    (tmp_path / "wires.toml").write_text(text)
    return load_wires(tmp_path / "wires.toml").wires


@pytest.mark.parametrize("text", FILES)
def test_the_files_of_the_page_are_read(tmp_path, text):
    read = wires(tmp_path, text)
    assert len(read) == text.count("[bridge.")
    for name, wire in read.items():
        assert type(wire.bridge).__name__ == re.search(rf"\[bridge\.{name}\].*?kind = \"(\w+)\"", text, re.S)[1]
        if getattr(wire.bridge, "key", None):
            assert wire.bridge.key == str(tmp_path / "certificates" / "controller.key")


def test_there_are_eight_and_one_of_each_kind():
    assert len(FILES) == 8
    assert {kind for text in FILES for kind in re.findall(r'^kind = "(\w+)"', text, re.M)} == {
        cls.__name__ for cls in BRIDGES
    }


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        ('kind = "MQTT"\ntopic = "y"\nqos = 3', r"bridge.*y.*qos=3; it must be 0, 1 or 2"),
        ('kind = "MQTT"\ntopic = "y"\nqso = 1', r"qso"),
        ('kind = "MQTT"', r"topic"),
        ('kind = "MQTT"\ntopic = "y"\nformat = "xml"', r"format"),
        ('kind = "OPCUA"\nurl = "opc.tcp://plc"\nnode = "Speed"', r"is no node id"),
        ('kind = "OPCUA"\nurl = "plc"\nnode = "i=1"', r"opc.tcp://host:4840"),
        ('kind = "OPCUAA"\nurl = "opc.tcp://plc"\nnode = "i=1"', r"OPCUA"),
    ],
)
def test_wrong_keys_are_named(tmp_path, lines, sentence):
    with pytest.raises(BayesFTCError, match=sentence):
        wires(tmp_path, f'[bridge.y]\nto = "controller.y"\n{lines}\n')
