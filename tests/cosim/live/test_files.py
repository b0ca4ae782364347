"""Files that grow: partial rows, rotation, columns."""

import time

import pytest

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live import File, Inbox, Limits


@pytest.fixture
def opened():
    bridges = []

    def make(path, size=1, **settings):
        bridge, box = File(str(path), **settings), Inbox(size)
        bridges.append(bridge)
        bridge.open(box)
        return bridge, box

    yield make
    for bridge in bridges:
        bridge.close()


def append(path, text):
    with open(path, "a", encoding="utf-8") as file:
        file.write(text)


def test_only_complete_rows_are_used(tmp_path, opened, until):
    path = tmp_path / "speeds.csv"
    append(path, "t,left,right\n0.0,1.0,2.0\n0.1,1.")
    _, box = opened(path, 2, time="t", from_start=True)
    until(lambda: box.received == 1)
    append(path, "5,2")
    append(path, ".5\n")
    until(lambda: box.received == 2)
    assert box.take().tolist() == [1.5, 2.5]


def test_by_default_only_new_rows_are_used(tmp_path, opened, until):
    path = tmp_path / "speeds.csv"
    append(path, "left,right\n1.0,2.0\n1.5,")
    bridge, box = opened(path, columns=["right"])
    until(lambda: bridge.connected)
    append(path, "99.0\n7.0,8.0\n")
    until(lambda: box.received)
    assert box.take().tolist() == [8.0]


@pytest.mark.parametrize("written", ["", "left,ri"])
def test_a_file_whose_first_row_is_not_complete_is_read_from_its_beginning(tmp_path, opened, until, written):
    path = tmp_path / "speeds.csv"
    append(path, written)
    bridge, box = opened(path, columns=["right"])
    until(lambda: bridge.connected)
    append(path, "left,right\n7.0,8.0\n".removeprefix(written))
    until(lambda: box.received or box.rejected)
    assert (box.take().tolist(), dict(box.rejected)) == ([8.0], {})


@pytest.mark.parametrize("how", ["replaced", "shortened"])
def test_a_rotated_file_is_read_from_its_beginning(tmp_path, opened, until, how):
    path = tmp_path / "speeds.csv"
    append(path, "v\n" + "1.0\n" * 100)
    bridge, box = opened(path, from_start=True)
    until(lambda: box.received == 100)
    if how == "replaced":
        path.rename(tmp_path / "speeds.1.csv")
        append(path, "v\n2.0\n")
    else:
        path.write_text("v\n2.0\n")
    until(lambda: box.received == 101)
    assert box.take().tolist() == [2.0]
    assert "connection" not in bridge.problem


def test_a_file_that_comes_later(tmp_path, opened, until):
    path = tmp_path / "later.csv"
    bridge, box = opened(path, from_start=True)
    until(lambda: bridge.problem)
    path.write_text("3.0\n")
    until(lambda: box.received)
    assert box.take().tolist() == [3.0]


def test_rows_that_are_no_samples(tmp_path, opened, until):
    path = tmp_path / "speeds.csv"
    path.write_text("t,v\n0.0,warm\n0.1\n,1.0\n0.2,\n0.3,5.0\n")
    _, box = opened(path, columns=["v"], time="t", from_start=True)
    until(lambda: box.received == 5)
    assert box.take().tolist() == [5.0]
    assert dict(box.rejected) == {"not decodable": 3, "not a number": 1}


def test_what_is_sent_is_a_csv_file(tmp_path, until):
    path = tmp_path / "out.csv"
    for force in ([1.0, 2.0], [3.0, 4.0]):  # the second time it is extended
        bridge = File(str(path), columns=["a", "b"], time="seconds")
        bridge.open(None)
        until(lambda b=bridge: b.connected)
        bridge.send(force, 0.5)
        bridge.close()
    assert path.read_text() == "seconds,a,b\n0.5,1.0,2.0\n0.5,3.0,4.0\n"


def test_times_have_the_unit_in_the_name_of_their_column(tmp_path, until):
    path = tmp_path / "speeds.csv"
    append(path, "t_ms,v\n1000,1.0\n")
    bridge, box = File(str(path), columns=["v"], time="t_ms", from_start=True), Inbox(1, Limits(stale_after=0.1))
    bridge.open(box)
    until(lambda: box.received == 1)
    time.sleep(0.3)
    append(path, "1001,2.0\n")  # a millisecond later, but on its way for 0.3 s
    until(lambda: box.received == 2)
    bridge.close()
    assert dict(box.rejected) == {"late": 1}
    bridge = File(str(tmp_path / "out.csv"), columns=["a"], time="t [ms]")
    bridge.open(None)
    until(lambda: bridge.connected)
    bridge.send([1.0], 0.5)
    bridge.close()
    assert (tmp_path / "out.csv").read_text() == "t [ms],a\n500.0,1.0\n"


def test_a_poll_without_sense_is_refused():
    with pytest.raises(ModelError, match="poll=0"):
        File("x.csv", poll=0)
