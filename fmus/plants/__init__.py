"""The plants that are shipped: one small C file and one description each."""

from bayesftc.fmus.plants.cruise_control import CRUISE_CONTROL

__all__ = ["CRUISE_CONTROL", "PLANTS"]

PLANTS = (CRUISE_CONTROL,)
