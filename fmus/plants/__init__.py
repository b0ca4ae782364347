"""The plants that are shipped: one small C file each, and its description."""

from bayesftc.fmus.plants.cart_pendulum import CART_PENDULUM
from bayesftc.fmus.plants.cruise_control import CRUISE_CONTROL
from bayesftc.fmus.plants.hydro_turbine import HYDRO_TURBINE
from bayesftc.fmus.plants.position_servo import POSITION_SERVO
from bayesftc.fmus.plants.two_link_arm import TWO_LINK_ARM
from bayesftc.fmus.plants.two_masses import TWO_MASSES

PLANTS = (CRUISE_CONTROL, TWO_LINK_ARM, POSITION_SERVO, TWO_MASSES, CART_PENDULUM, HYDRO_TURBINE)
"""All of them: first those of the paper's experiments."""

__all__ = ["PLANTS"]
