"""Lets the tests import block_kinds.py and random_diagrams.py, the blocks and diagrams of several of them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
