"""For tests of live runs: waiting for a condition, and a bridge in memory."""

import time
from dataclasses import dataclass

import pytest

from bayesftc.cosim.live import Bridge


@pytest.fixture
def until():
    def wait(condition, seconds=30.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, "it has not come"
            time.sleep(0.005)

    return wait


@dataclass(eq=False)
class Memory(Bridge):
    """A bridge that keeps what it sends."""

    def __post_init__(self):
        self.sent, self.inbox, self.closed = [], None, False

    def open(self, inbox):
        self.inbox, self.connected = inbox, True

    def send(self, values, time):
        assert not self.closed
        self.sent.append((time, list(values)))

    def close(self):
        self.closed, self.connected = True, False


@pytest.fixture
def memory():
    return Memory
