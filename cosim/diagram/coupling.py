"""How FMUs that feed each other are stepped together: whose values each of them sees while it makes its step.

An FMU holds its inputs during a step, so a coupling is a choice of the value that is held; docs/coupling.md shows what each
choice costs and yields.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from numbers import Integral
from typing import Any, Literal

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

Method = Literal["gauss-seidel", "jacobi", "iterated"]

METHODS = ("gauss-seidel", "jacobi", "iterated")
ACCELERATIONS = (None, "aitken", "anderson")
HOLDS = ("end", "mean")


@dataclass(frozen=True)
class Coupling:
    """How the plants of a diagram that are FMUs are coupled; given to `Diagram.build`.

    Parameters
    ----------
    method : {"gauss-seidel", "jacobi", "iterated"}
        ``"jacobi"``: each FMU holds what the others showed at t_k. ``"gauss-seidel"``: an FMU that is fed directly by one added
        before it holds what that one shows at t_k+1. ``"iterated"``: steps are repeated from saved states until the values
        that are held are those that come out at t_k+1 (see `hold`); blocks without a memory between the FMUs (a gain, a sum)
        are computed along, at t_k+1. Algebraic loops at t_k, through blocks and sampled FMUs, are iterated, too; the other
        two refuse them.
    tolerance : float
        The iteration is over when no value ``v`` changes any more by more than ``tolerance * (1 + |v|)``.
    acceleration : {"anderson", "aitken", None}
        How the next guess follows from the last ones: by Anderson's method over as many guesses as there are values (at most
        twenty), by Aitken's relaxation (of Irons and Tuck, for vectors), or plainly the values that came out.
    iterations : int
        How often a step is repeated before the run stops because it does not converge.
    hold : {"end", "mean"}
        What an FMU holds during an iterated step: the values at its end (first order, takes energy out), or the mean of those at
        its beginning and its end (second order, keeps the energy).
    step_error : float, optional
        With a number, FMUs that are coupled with each other go from t_k to t_k+1 in steps of their own, found by step doubling:
        as small as needed for the error that one step adds to an output ``y`` to stay below ``step_error * (1 + |y|)``. All other
        blocks, and results, keep to t_k. By default one step from t_k to t_k+1.

    Raises
    ------
    ModelError
        If a setting is none of these.
    """

    method: Method = "gauss-seidel"
    tolerance: float = 1e-8
    acceleration: Literal["anderson", "aitken"] | None = "anderson"
    iterations: int = 50
    hold: Literal["end", "mean"] = "end"
    step_error: float | None = None

    def __post_init__(self) -> None:
        for name, known in (("method", METHODS), ("acceleration", ACCELERATIONS), ("hold", HOLDS)):
            if getattr(self, name) not in known:
                words = [repr(k) for k in known]
                what = "coupling is " if name == "method" else f"{name}="
                raise ModelError(f"{what}{getattr(self, name)!r}; it must be {', '.join(words[:-1])} or {words[-1]}.")
        for name in ("tolerance", "step_error"):
            given: Any = getattr(self, name)
            if given is None and name == "step_error":
                continue
            if not 0 < real(given) < inf:
                raise ModelError(f"{name}={given!r}; it must be a positive number.")
            object.__setattr__(self, name, float(given))
        if isinstance(self.iterations, bool) or not isinstance(self.iterations, Integral) or self.iterations < 1:
            raise ModelError(f"iterations={self.iterations!r}; it must be a whole number, at least 1.")
        if self.hold == "mean" and self.method != "iterated":
            raise ModelError(
                f"hold='mean' needs the values at the end of a step, which only iterated coupling knows, not {self.method}."
            )

    @property
    def iterated(self) -> bool:
        """Whether steps are repeated until values agree."""
        return self.method == "iterated"

    @property
    def order(self) -> int:
        """The power of the step size with which the error of a run falls."""
        return 2 if self.hold == "mean" else 1
