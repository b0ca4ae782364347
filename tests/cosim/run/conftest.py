"""Runs by one function for the whole loop, whatever their length."""

import pytest

from bayesftc.cosim.run import engines, many
from bayesftc.cosim.run.fused import compiled


@pytest.fixture
def as_one(monkeypatch):
    """Use the one function for runs of any length."""
    used = []

    def noted(*arguments, usual=compiled.fused):
        used.append(usual(*arguments))
        return used[-1]

    monkeypatch.setattr(compiled, "LOADED", 0)
    monkeypatch.setattr(compiled, "COMPILED", 0)
    monkeypatch.setattr(engines, "fused", noted)
    yield used
    assert used
    assert all(used)


@pytest.fixture
def lanes(as_one, monkeypatch):
    """The numbers of runs that were made in lock step, call by call."""
    made = []

    def noted(self, *arguments, usual=many.ManyRuns._together):
        made.append(usual(self, *arguments))
        return made[-1]

    monkeypatch.setattr(many.ManyRuns, "_together", noted)
    monkeypatch.setattr(many, "WORTH", 0.0)
    return made
