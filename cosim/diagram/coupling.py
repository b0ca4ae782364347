"""How FMUs that feed each other are stepped together.

An FMU holds its inputs during a step. So a coupling is a choice of the held values, which
docs/reference/coupling.md compares.
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
    """How FMUs of a diagram that are plants are coupled; for `Diagram.build`.

    Parameters
    ----------
    method : {"gauss-seidel", "jacobi", "iterated"}
        ``"jacobi"``: each FMU holds the outputs of the others at t_k. ``"gauss-seidel"``: an FMU that is fed directly by one
        added before it holds the output of that FMU at t_k+1. ``"iterated"``: steps are repeated from saved states until the
        held values agree with the outputs at t_k+1 (see `hold`). Stateless blocks between the FMUs (a gain, a sum) are then
        also computed at t_k+1. Algebraic loops at t_k, through blocks and sampled FMUs, are iterated, too; the other two
        methods refuse them.
    tolerance : float
        The iteration ends when no value ``v`` changes by more than ``tolerance * (1 + |v|)``.
    acceleration : {"anderson", "aitken", None}
        How the next guess is computed from the last ones: by Anderson's method over as many guesses as there are values (at
        most twenty), or by Aitken's relaxation (of Irons and Tuck, for vectors). With None it is the computed values.
    iterations : int
        How often a step is repeated before the run stops because it does not converge.
    hold : {"end", "mean"}
        The values that an FMU holds during an iterated step: those at its end (first order, energy is lost), or the mean of
        those at its beginning and its end (second order, energy is kept).
    step_error : float, optional
        With a number, coupled FMUs advance from t_k to t_k+1 in smaller steps, whose size is controlled by step doubling: the
        error that one step adds to an output ``y`` stays below ``step_error * (1 + |y|)``. All other blocks, and results, keep
        to t_k. By default one step from t_k to t_k+1.

    Raises
    ------
    ModelError
        If a setting is none of these.

    Examples
    --------
    >>> from bayesftc import cosim, fmus
    >>> diagram = cosim.Diagram(dt=0.02)
    >>> lead = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"force": 100.0}), "lead")
    >>> follower = diagram.add(cosim.FMU(fmus.path("CruiseControl")), "follower")
    >>> diagram.connect(lead["v"], follower["disturbance"])
    >>> coupling = cosim.Coupling("iterated", hold="mean")
    >>> coupling.order, round(float(diagram.build(coupling).simulate(1.0, engine="interpreted")["follower.v"][-1]), 3)
    (2, 24.206)
    """

    method: Method = "gauss-seidel"
    tolerance: float = 1e-8
    acceleration: Literal["anderson", "aitken"] | None = "anderson"
    iterations: int = 50
    hold: Literal["end", "mean"] = "end"
    step_error: float | None = None

    def __post_init__(self) -> None:
        for name, allowed in (("method", METHODS), ("acceleration", ACCELERATIONS), ("hold", HOLDS)):
            if getattr(self, name) not in allowed:
                words = [repr(value) for value in allowed]
                what = "coupling is " if name == "method" else f"{name}="
                raise ModelError(f"{what}{getattr(self, name)!r}; it must be {', '.join(words[:-1])} or {words[-1]}.")
        for name in ("tolerance", "step_error"):
            value: Any = getattr(self, name)
            if value is None and name == "step_error":
                continue
            if not 0 < real(value) < inf:
                raise ModelError(f"{name}={value!r}; it must be a positive number.")
            object.__setattr__(self, name, float(value))
        if isinstance(self.iterations, bool) or not isinstance(self.iterations, Integral) or self.iterations < 1:
            raise ModelError(f"iterations={self.iterations!r}; it must be a whole number, at least 1.")
        if self.hold == "mean" and self.method != "iterated":
            raise ModelError(
                f"hold='mean' works with iterated coupling only, not with {self.method}; use method='iterated' or hold='end'."
            )

    @property
    def iterated(self) -> bool:
        """Whether steps are repeated until values agree."""
        return self.method == "iterated"

    @property
    def order(self) -> int:
        """The order of convergence: the power of the step size in the error of a run."""
        return 2 if self.hold == "mean" else 1
