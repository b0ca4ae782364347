"""Lets the attacks share harness.py; their seed is ATTACK_SEED (0 by default)."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent))

SEED = int(os.environ.get("ATTACK_SEED", "0"))


@pytest.fixture(scope="session")
def attack_seed():
    """Return the seed of what has no generator of its own."""
    return SEED


@pytest.fixture
def chance(request):
    """Return a generator of random numbers of the test's own, so that each test alone does what it does among all."""
    return np.random.default_rng([SEED, *request.node.name.encode()])


@pytest.fixture
def line(tmp_path, monkeypatch):
    """Return a command line that is watched, with empty folders for the temporary files and for what FMUs unpack."""
    from harness import CommandLine

    for name in ("temporary", "cases"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    with CommandLine(tmp_path / "cases", tmp_path / "temporary") as line:
        yield line
