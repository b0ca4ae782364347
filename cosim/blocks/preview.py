"""A source together with its future: the present value, and the value some time ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from typing import Any

from bayesftc.cosim.base.timebase import rational_step, whole_steps
from bayesftc.cosim.block import Block, Definition, sample_time_of
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import absolute, floor, select
from bayesftc.cosim.ports import Port
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.types import Kernel, argument_names

GIVEN = ("t", "y")
"""Arguments of a source's step function that are no parameters."""


def later(t, steps, numerator, denominator):
    """Return the time some steps later, at a time t_k exactly t_k+steps; in between the sum."""
    k = floor(t * denominator / numerator + 0.5)
    here, there = k * numerator / denominator, (k + steps) * numerator / denominator
    return select(absolute(t - here) <= 1e-6 * numerator / denominator, there, t + (there - here))


@cache
def _kernel(source: Kernel, numerator: int, denominator: int) -> Kernel:
    """Return the step function that calls that of a source twice; the numbers are those of the step size."""
    names = argument_names(source)
    parameters = [name for name in names if name not in GIVEN]
    ahead = {"t": f"later(t, steps[0], {numerator}.0, {denominator}.0)", "y": "ahead"}
    lines = [f"source({', '.join(names)})", f"source({', '.join(ahead.get(name, name) for name in names)})"]
    arguments = ["t", *parameters, "steps", "y", "ahead"]
    return function_from_text("source_with_preview", arguments, lines, {"source": source, "later": later})


@dataclass(frozen=True)
class Preview(Block):
    """A source whose future is known: ``y`` is its present value, ``ahead`` its value `time` seconds later.

    A controller with a preview gets ``ahead`` as its goal. For such a controller, `closed_loop` itself replaces the reference by
    this block.

    Parameters
    ----------
    source : Source or float
        A source that depends on time alone, such as `Sine` or `Table`; a number is a constant.
    time : float, str or Fraction
        Seconds, a whole number of steps of the block; 0 for no preview.

    Raises
    ------
    ModelError
        If the source has inputs, noise or a state, so that its future is not known.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> step = cosim.Preview(cosim.Step(time=0.3, after=1.0), time=0.2).online(dt=0.1)
    >>> [(float(out.y), float(out.ahead)) for out in (step() for _ in range(4))]
    [(0.0, 0.0), (0.0, 1.0), (0.0, 1.0), (1.0, 1.0)]
    """

    source: Any
    time: float | str | Fraction

    def __post_init__(self) -> None:
        if isinstance(self.source, int | float) and not isinstance(self.source, bool):
            object.__setattr__(self, "source", Constant(float(self.source)))
        if not isinstance(self.source, Block) or [port.name for port in self.source.outputs] != ["y"]:
            raise ModelError(
                f"Preview has source={brief(self.source)}; it must be a source with the one output y, such as "
                "cosim.Sine(amplitude=1.0, period=2.0)."
            )
        name = type(self.source).__name__
        if self.source.inputs:
            kind = "noise" if any(port.draw for port in self.source.inputs) else "inputs"
            raise ModelError(f"The future of {name} is not known, because it has {kind}. {_INSTEAD}")
        if self.time != 0:
            object.__setattr__(self, "time", rational_step(self.time, "A preview"))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``y`` and ``ahead``."""
        (port,) = self.source.outputs
        return port, replace(port, name="ahead", description="The value that y has later")

    @property
    def sample_time(self) -> Fraction | None:
        """See `Block.sample_time`."""
        return sample_time_of(self.source)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        inner: Definition = self.source.define(step)
        name = type(self.source).__name__
        if inner.state or inner.update is not None or inner.output is None:
            raise ModelError(f"The future of {name} is not known, because it has a state. {_INSTEAD}")
        strange = set(argument_names(inner.output)) - {*GIVEN, *inner.parameters, *inner.scratch}
        if strange or {"steps", "ahead"} & {*inner.parameters, *inner.scratch} or inner.records:
            raise ModelError(
                f"The step function of {name} cannot be called for a later time; its arguments must be t, y and its "
                "parameters, none of which may be called 'steps' or 'ahead'."
            )
        steps = whole_steps(self.time, step, "A preview") if self.time else 0
        parameters: Mapping[str, Any] = {**inner.parameters, "steps": float(steps)}
        kernel = _kernel(inner.output, step.numerator, step.denominator)
        return Definition(kernel, parameters=parameters, scratch=inner.scratch, compiled=inner.compiled)


_INSTEAD = "Use a source that depends on time alone, such as a Table of its values."

__all__ = ["Preview"]
