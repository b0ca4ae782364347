"""Lets the tests import recordings_of_a_car.py."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
