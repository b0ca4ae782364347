"""The choices of a fit, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from bayesftc.cosim.base.numbers import check_count, real
from bayesftc.cosim.errors import ModelError


@dataclass(frozen=True)
class FitSettings:
    """How a fit searches and when it ends.

    Parameters
    ----------
    screened : int
        Number of points of the ranges (a Sobol sequence) at which the FMU runs before the search. The default finds a basin of
        attraction that takes a tenth of the ranges with 97 % probability.
    starts : int
        Number of the best of them from which a search starts. More than one, because a local minimum can be the best at first.
    steps : int
        Largest number of steps of one search. Gauss-Newton needs about ten.
    difference : float
        Half the distance of the two runs of a derivative, as a share of a parameter's range. The error of a central difference
        is its square, 1e-6. The error of an integrator with a tolerance of 1e-6 is divided by it.
    rounds : int
        Largest number of rounds: the learner weighs the samples with the fit, then the fit follows with these weights.
    settled : float
        Rounds end when the parameters move by less, as a multiple of their standard error: then a further round does not matter.
    white : float
        Residuals are correlated if white noise is as correlated with less than this probability. Then standard errors take the
        correlation into account. Lower than usual, because a fit tests many residuals.
    seed : int
        Seed of the Sobol sequence.

    Raises
    ------
    ModelError
        If a setting is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from bayesftc import cosim, fmus
    >>> time = 0.1 * np.arange(200)
    >>> table = pd.DataFrame({"time": time, "v": 20.0 * np.exp(-0.05 * time)})
    >>> settings = cosim.FitSettings(screened=4, starts=1, rounds=1)  # quick, for a problem with one minimum
    >>> fitted = cosim.fit(fmus.path("CruiseControl"), table, {"v0": (10.0, 30.0)}, outputs="v", settings=settings)
    >>> {name: round(value, 1) for name, value in fitted.parameters.items()}
    {'v0': 20.0}
    """

    screened: int = 32
    starts: int = 3
    steps: int = 50
    difference: float = 1e-3
    rounds: int = 6
    settled: float = 0.1
    white: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("screened", "starts", "steps", "rounds"):
            check_count(self, name)
        for name, most in (("difference", 0.1), ("settled", 1.0), ("white", 1.0)):
            if not 0 < real(getattr(self, name)) <= most:
                raise ModelError(
                    f"FitSettings has {name}={getattr(self, name)!r}; it must be above 0, at most {most:g}."
                )
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise ModelError(f"FitSettings has seed={self.seed!r}; it must be a whole number, at least 0.")
