"""Lets the tests import block_kinds.py, the examples of all blocks."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "cosim"))
