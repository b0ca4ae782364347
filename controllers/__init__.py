"""Bayesian controllers, precision learners and baselines, as co-simulation blocks.

Everything public is importable from here and loaded on first use.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "baselines": ("EFFDI", "SERFDI"),
    "bayesian": ("BayesianController", "UnstableLoopWarning"),
    "calibration": ("calibrate",),
    "model": ("LinearModel",),
    "precision": ("Calibration", "FixedPrecision", "GammaPrecision", "Learner", "PrecisionLearner"),
    "registry": ("LEARNERS",),
    "validation": ("KalmanCheck", "check_kalman", "ser_reference"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"bayesftc.controllers.{_HOME[name]}"), name)
    raise AttributeError(f"module 'bayesftc.controllers' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
