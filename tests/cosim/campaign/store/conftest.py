"""Lets the tests of stores share what is in stored.py."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
