"""Live runs from files: the controller of a scenario, and the wires to its plant."""

from bayesftc.scenario.live.controller import live_controller
from bayesftc.scenario.live.wires import load_wires

__all__ = ["live_controller", "load_wires"]
