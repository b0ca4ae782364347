"""Syntax trees of step functions."""

import sys
import threading
import time

import pytest

from bayesftc.cosim.stepping.source import tree

TEXT = "".join(f"def f{i}(a, b):\n    return a[{i}] + b * ({i} - a)\n" for i in range(150))


class Waste:
    """A circle, which the garbage collector frees in any thread, and which then lets other threads go on."""

    def __init__(self):
        self.itself = self

    def __del__(self):
        time.sleep(0)


@pytest.fixture
def in_threads():
    """Return the errors of parsing in threads whose stacks have different depths."""

    def run(parse):
        errors = []

        def go(deeper):
            if deeper:
                return go(deeper - 1)
            try:
                for _ in range(40):
                    Waste(), Waste(), Waste()
                    parse(TEXT)
            except SystemError as error:
                errors.append(error)

        threads = [threading.Thread(target=go, args=(depth,)) for depth in (0, 40, 80)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return errors

    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield run
    sys.setswitchinterval(usual)


def test_threads_may_parse_at_once(in_threads):
    assert not in_threads(tree.parsed)
