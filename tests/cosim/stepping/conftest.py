"""Lets the tests import casadi_ops.py, which stands for the operations while symbols are traced."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
