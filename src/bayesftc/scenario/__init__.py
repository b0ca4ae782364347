"""Scenario files: a whole closed loop (plant, sensors, faults, reference, controller) as one TOML file.

>>> from bayesftc.scenario import load_scenario
>>> scenario = load_scenario("cruise_control")
>>> result = scenario.simulate(duration=1.0)
"""

from importlib import import_module
from typing import Any

from bayesftc.scenario._files import find_scenario, shipped_scenarios
from bayesftc.scenario._scenario import Scenario, load_scenario
from bayesftc.scenario._sections import Simulation

__all__ = [
    "Scenario",
    "Simulation",
    "find_scenario",
    "live_controller",
    "load_scenario",
    "load_wires",
    "shipped_scenarios",
]


def __getattr__(name: str) -> Any:
    # Wires load sockets and threads, which other commands do not need.
    modules = {"live_controller": "_live", "load_wires": "_wires"}
    if name in modules:
        return getattr(import_module(f"bayesftc.scenario.{modules[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
