"""Co-simulation: plants, sensors, faults, sources, diagrams and the engines that run them.

Everything public is importable from here and loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOMES = {
    "block": ("Block", "Definition", "ExternalBlock"),
    "diagram": ("Diagram", "Node"),
    "errors": (
        "AlgebraicLoopError",
        "BayesFTCError",
        "ConnectionError",
        "FMUError",
        "KernelError",
        "ModelError",
        "ResultFileError",
        "ScenarioError",
        "SimulationError",
        "StepSizeError",
        "UnknownNameError",
    ),
    "faults": (
        "FAULTS",
        "Bias",
        "Drift",
        "Dropout",
        "Fault",
        "Freeze",
        "GainFault",
        "Injection",
        "NoiseIncrease",
        "RandomFaults",
        "Spikes",
    ),
    "fmu": ("FMU",),
    "loops": ("closed_loop",),
    "mathblocks": ("Gain", "Saturation", "Sum", "UnitDelay"),
    "online": ("Online",),
    "ports": ("Port", "PortRef"),
    "result": ("Result",),
    "sensors": ("Sensors",),
    "sources": ("Constant", "Gaussian", "Ramp", "Sine", "Source", "Step", "Table"),
    "state_space": ("StateSpace",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}
__all__ = [*sorted(_HOME), "ops"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"bayesftc.cosim.{_HOME[name]}"), name)
    if name in {"ops", "errors", "random"}:
        return import_module(f"bayesftc.cosim.{name}")
    raise AttributeError(f"module 'bayesftc.cosim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
