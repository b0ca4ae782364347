"""How a linear controller comes from the samples to its belief: precision learned and then used, or both inferred together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers._filter import measure


@cache
def make_believe(learn: Callable[..., None], infer: Callable[..., None] | None) -> Callable[..., None]:
    """Return the step function from the innovations to the belief, for a precision learner's two ways (see `Learner`)."""
    if infer is None:

        def believe(
            y, e, present, spread, nominal, A, C, Q, largest, mean, covariance, memory, settings, work,
            R, used, precision, beta, fault_probability, chol, D, whitened, v, gain, J, JP, x_hat, P,
        ):  # fmt: skip
            learn(y, e, present, spread, nominal, memory, settings, work, R, used, precision, beta, fault_probability)
            measure(e, used, R, C, mean, covariance, chol, D, whitened, v, gain, J, JP, x_hat, P)

        return believe

    def believe_together(
        y, e, present, spread, nominal, A, C, Q, largest, mean, covariance, memory, settings, work,
        R, used, precision, beta, fault_probability, chol, D, whitened, v, gain, J, JP, x_hat, P,
    ):  # fmt: skip
        infer(
            y, e, present, nominal, A, C, Q, mean, covariance, largest, memory, settings,
            R, used, precision, beta, fault_probability, x_hat, P,
        )  # fmt: skip

    return believe_together
