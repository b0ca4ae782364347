"""Lets the tests import wrong_models.py, their cases."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
