"""A serial line, with a pseudo-terminal pair as device and port."""

import os

import pytest

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live import Inbox, Serial

pytest.importorskip("serial")


@pytest.fixture
def pair():
    device, port = os.openpty()
    yield device, os.ttyname(port)
    for descriptor in (device, port):
        os.close(descriptor)


def test_lines_come_in_pieces_and_the_first_is_left_out(pair, until):
    device, name = pair
    bridge, box = Serial(name), Inbox(2)
    bridge.open(box)
    until(lambda: bridge.connected)
    for piece in (b"4.0,", b"99.0\n20.", b"5,21", b".5\n"):
        os.write(device, piece)
    until(lambda: box.received == 1)
    assert box.take().tolist() == [20.5, 21.5]
    os.write(device, b"warm\n\n[1, 2]\n22.0 23.0\r\n")
    until(lambda: box.received == 4)
    assert box.take().tolist() == [22.0, 23.0]
    assert dict(box.rejected) == {"not decodable": 2}
    bridge.close()
    assert not bridge.connected


def test_values_are_written_as_lines(pair, until):
    device, name = pair
    bridge = Serial(name, format="json")
    bridge.open(None)
    until(lambda: bridge.connected)
    bridge.send([1.5, 2.5], 0.25)
    assert os.read(device, 100).replace(b"\r", b"") == b'{"time": 0.25, "values": [1.5, 2.5]}\n'
    bridge.close()


def test_a_missing_port_is_waited_for(tmp_path, until):
    port = tmp_path / "port"
    bridge, box = Serial(str(port)), Inbox(1)
    bridge.open(box)
    until(lambda: bridge.problem)
    assert not bridge.connected
    device, end = os.openpty()
    port.symlink_to(os.ttyname(end))
    until(lambda: bridge.connected)

    def heard():
        os.write(device, b"1.0\n")
        return box.received

    until(heard)
    bridge.close()
    for descriptor in (device, end):
        os.close(descriptor)


def test_a_rate_without_sense_is_refused():
    with pytest.raises(ModelError, match="baud=0"):
        Serial("/dev/ttyUSB0", baud=0)
