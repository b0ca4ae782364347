"""A transfer function by its coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

from bayesftc.cosim.base.numbers import reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port


@dataclass(frozen=True)
class TransferFunction(Block):
    """A transfer function: continuous, with its input held over each step (zero-order hold), or discrete.

    Parameters
    ----------
    numerator, denominator : sequence of float
        Coefficients, of the highest power of s or z first; the numerator has no higher power than the denominator.
    dt : float
        0 for continuous time; of a discrete one the sample time in seconds, which is then the block's only one.

    Raises
    ------
    ModelError
        If these are no coefficients of a proper transfer function.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> lag = cosim.TransferFunction([1.0], [0.5, 1.0]).online(dt=0.5)
    >>> [round(float(lag(u=1.0).y), 3) for _ in range(3)]
    [0.0, 0.632, 0.865]
    """

    numerator: Sequence[float]
    denominator: Sequence[float]
    dt: float = field(default=0.0, kw_only=True)

    checks_finite: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator"):
            values = reals(getattr(self, name))
            if values.ndim != 1 or not values.any():
                raise ModelError(
                    f"TransferFunction has {name}={brief(getattr(self, name))}; give its coefficients, not all of them zero."
                )
            object.__setattr__(self, name, tuple(values.tolist()))
        _ = self._space  # refuses what cannot be realised

    @cached_property
    def _space(self) -> StateSpace:
        import control

        return StateSpace(control.tf(self.numerator, self.denominator, self.dt, inputs=["u"], outputs=["y"]))

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return self._space.inputs

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return self._space.outputs

    @property
    def sample_time(self) -> Fraction | None:
        """See `Block.sample_time`."""
        return self._space.sample_time

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return self._space.define(step)


__all__ = ["TransferFunction"]
