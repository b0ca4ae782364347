"""Scenario files: a whole closed loop (plant, sensors, faults, reference, controller) as one TOML file.

>>> from bayesftc.scenario import load_scenario
>>> scenario = load_scenario("cruise_control")
>>> result = scenario.simulate(duration=1.0)
"""

from bayesftc.scenario._files import find_scenario, shipped_scenarios
from bayesftc.scenario._scenario import Scenario, load_scenario
from bayesftc.scenario._sections import Simulation

__all__ = [
    "Scenario",
    "Simulation",
    "find_scenario",
    "load_scenario",
    "shipped_scenarios",
]
