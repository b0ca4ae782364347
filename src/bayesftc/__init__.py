"""Fault-tolerant control by Bayesian inference, as blocks for co-simulation.

Two sub-packages have everything for a script: :mod:`bayesftc.cosim` (plants, sensors, faults, sources, diagrams and the engine
that runs them) and :mod:`bayesftc.controllers` (the Bayesian controllers). :mod:`bayesftc.monitoring` finds faults in recorded
samples, and :mod:`bayesftc.fmus` finds the shipped FMUs. Large packages are imported only when they are used.
"""

from importlib import import_module
from pathlib import Path
from types import ModuleType

__version__ = "0.1.0"
__all__ = ["__version__", "controllers", "cosim", "fmus", "monitoring"]

_root = Path(__file__).resolve().parents[2]
if (_root / "hatch_build.py").is_file() and not (Path(__file__).parent / "cosim").is_dir():
    # A checkout without its links (such as a zip unpacked on Windows): the folders are at its root.
    __path__.append(str(_root))
del _root


def __getattr__(name: str) -> ModuleType:
    from bayesftc._public import PACKAGES, unknown

    if name in {*PACKAGES, "fmus", "examples"}:
        return import_module(f"bayesftc.{name}")
    raise unknown(name, __all__, "bayesftc")
