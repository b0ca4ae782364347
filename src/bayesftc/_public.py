"""The public names of a package, loaded on first use."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import lazy_loader  # type: ignore[import-untyped]

PACKAGES = ("cosim", "controllers", "monitoring")
"""The packages with public names, other than `path` and `names` of fmus, which may mean anything."""

_WORDS = {
    "add": ("cosim.Sum",),
    "adder": ("cosim.Sum",),
    "derivative": ("cosim.TransferFunction",),
    "ekf": ("controllers.StateEstimator",),
    "filter": ("cosim.ExponentialFilter", "cosim.TransferFunction"),
    "kalman": ("controllers.StateEstimator",),
    "kalmanfilter": ("controllers.StateEstimator",),
    "limiter": ("cosim.Saturation", "cosim.RateLimiter"),
    "lowpass": ("cosim.ExponentialFilter",),
    "lqr": ("controllers.LQGController", "controllers.design"),
    "noise": ("cosim.Gaussian",),
    "observer": ("controllers.StateEstimator",),
    "offset": ("cosim.Bias",),
    "outage": ("cosim.Dropout",),
    "pd": ("controllers.ProportionalDerivative",),
    "pi": ("controllers.PID",),
    "pidcontroller": ("controllers.PID",),
    "plant": ("cosim.FMU", "cosim.StateSpace"),
    "pulsegenerator": ("cosim.Pulse",),
    "randomnumber": ("cosim.Gaussian",),
    "rectangle": ("cosim.Pulse",),
    "relay": ("cosim.Hysteresis",),
    "square": ("cosim.Pulse",),
    "squarewave": ("cosim.Pulse",),
    "subtract": ("cosim.Sum",),
    "transportdelay": ("cosim.VariableDelay", "cosim.UnitDelay"),
    "whitenoise": ("cosim.Gaussian",),
    "zeroorderhold": ("cosim.SampleAndHold",),
}
"""Names of other tools, in lower case without underscores, with the public names here that they may mean."""


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package from its ``__init__.pyi``.

    A wrong name gets similar ones, as in error messages elsewhere, and a name of other tools the one that it has here.
    """
    load, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name in names or name.startswith("_"):
            return load(name)
        raise unknown(name, names, package)

    return get, listed, names


def unknown(name: str, names: list[str], package: str) -> AttributeError:
    """Return the error of a package that lacks a public name. A name of another package is said to be there."""
    if name.startswith("_"):  # Python itself asks for it
        return AttributeError(f"module {package!r} has no attribute {name!r}")
    error = AttributeError(f"{package} has no {name!r}; {_hint(name, names, package)}")
    error.name = ""  # else Python adds to an uncaught one its own "Did you mean", after our full stop
    return error


def meant(name: str) -> tuple[str, ...]:
    """Return the public names that a name of other tools may mean, each with its package: ``cosim.Pulse`` for ``Square``."""
    return _WORDS.get(name.replace("_", "").lower(), ())


def _hint(name: str, names: list[str], package: str) -> str:
    from bayesftc.cosim.errors import did_you_mean

    elsewhere = [f"{each}.{name}" for each in PACKAGES if name in import_module(f"bayesftc.{each}").__all__]
    if elsewhere and not meant(name):
        return f"it is {' or '.join(elsewhere)}."
    here = [f"bayesftc.{each}".removeprefix(f"{package}.") for each in meant(name)]
    if here and name.lower() not in {each.lower() for each in names}:
        return f"did you mean {' or '.join(map(repr, here))}?"
    return did_you_mean(name, names)


__all__ = ["PACKAGES", "meant", "public_names", "unknown"]
