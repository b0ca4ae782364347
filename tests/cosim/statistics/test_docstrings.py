"""Examples in the docstrings of the statistics give what stands there."""

import doctest
from importlib import import_module

import pytest


@pytest.mark.parametrize("name", ["_summary", "_compare", "_roc", "_delays"])
def test_examples_of_docstrings(name):
    found = doctest.testmod(import_module(f"bayesftc.cosim.statistics.{name}"))
    assert found.attempted >= 3
    assert found.failed == 0
