"""The plants that are shipped: one small C file each, and their descriptions."""

from bayesftc.fmus.plants.cruise_control import CRUISE_CONTROL
from bayesftc.fmus.plants.regulated import CART_PENDULUM, HYDRO_TURBINE, POSITION_SERVO, TWO_MASSES
from bayesftc.fmus.plants.two_link_arm import TWO_LINK_ARM

__all__ = [
    "CART_PENDULUM",
    "CRUISE_CONTROL",
    "HYDRO_TURBINE",
    "PLANTS",
    "POSITION_SERVO",
    "TWO_LINK_ARM",
    "TWO_MASSES",
]

PLANTS = (CRUISE_CONTROL, TWO_LINK_ARM, POSITION_SERVO, TWO_MASSES, CART_PENDULUM, HYDRO_TURBINE)
"""The car under cruise control of the paper's second and third experiments, the arm of the first, and four to be regulated."""
