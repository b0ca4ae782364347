"""The plants that are shipped: one small C file and one description each."""

from bayesftc.fmus.plants.cruise_control import CRUISE_CONTROL
from bayesftc.fmus.plants.two_link_arm import TWO_LINK_ARM

__all__ = ["CRUISE_CONTROL", "PLANTS", "TWO_LINK_ARM"]

PLANTS = (CRUISE_CONTROL, TWO_LINK_ARM)
"""The car under cruise control of the paper's second and third experiments, and the arm of the first."""
