"""Run a single block, one step at a time, in your own loop or on hardware."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.block import ExternalBlock, sample_time_of
from bayesftc.cosim.diagram.contract import checked
from bayesftc.cosim.diagram.memory import Slots, arrange, bind
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.run.interrupts import import_engine

if TYPE_CHECKING:
    from bayesftc.cosim.block import Block
    from bayesftc.cosim.ports import Port
    from bayesftc.cosim.types import Floats, Kernel

Step = Callable[[float, int], None]
"""A step function of time in seconds and of the step count."""


MOST_SHOWN = 60
"""Most characters of an output where all are shown; of a longer array its size is shown."""


def _shown(value: Any) -> str:
    text = brief(value, MOST_SHOWN)
    return f"<{' x '.join(map(str, value.shape))} numbers>" if text.endswith("...") and np.ndim(value) else text


class Outputs(dict[str, Any]):
    """The outputs of one step, by attribute (``out.u``) or by name (``out["u"]``)."""

    def __getattr__(self, name: str) -> Any:
        if name in self:
            return self[name]
        raise AttributeError(
            f"The block has no output {name!r}; {did_you_mean(name, self)} A controller's outputs depend on its learner "
            f"(fault_kind: SwitchingPrecision). Use out.get({name!r}), which is None where there is no such output."
        )

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self]

    def __repr__(self) -> str:
        return f"Outputs({', '.join(f'{name}={_shown(value)}' for name, value in self.items())})"

    def _repr_html_(self) -> str:
        """Return a table of the outputs, for notebooks."""
        return table("Outputs", self.items(), ("output", "value"))


class Online:
    """A block as a callable that makes one step at each call; made by `Block.online`.

    Call it with the block's inputs by name, as numbers or sequences; ``None`` or NaN is a missing sample, and ``y=None`` means
    that all are missing. If a call leaves out an input with a start value, the input has that value. A call returns the outputs
    of this step: numbers for scalar ports, arrays otherwise.

    Parameters
    ----------
    block : Block
        The block. This object holds its state; the block itself does not change.
    dt : float, str or Fraction, optional
        Sample time in seconds; not needed if the block has one.
    compiled : bool
        False for the plain Python form, which you can step through in a debugger.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> integral = cosim.Integrator().online(dt=0.5, compiled=False)
    >>> [integral(u=2.0).y for _ in range(3)]
    [0.0, 1.0, 2.0]
    >>> integral.reset()
    >>> integral(u=2.0)["y"]
    0.0
    """

    def __init__(self, block: Block, dt: float | str | Fraction | None = None, *, compiled: bool = True):
        own = sample_time_of(block)
        step = own if dt is None else rational_step(dt)
        if step is None:
            raise StepSizeError(f"{type(block).__name__} has no sample time; give online(dt=...) in seconds.")
        if own not in {None, step}:
            raise StepSizeError(f"{type(block).__name__} runs every {show(own)} s, not every {show(step)} s.")  # type: ignore[arg-type]
        if isinstance(block, ExternalBlock):
            raise ModelError(f"{type(block).__name__} runs in diagrams only; step an FMU on its own with fmpy.")
        self._block, self._step, self._compiled = block, step, compiled
        self._definition = checked(block, block.define(step), type(block).__name__)
        self._slots, self._initial = arrange(block, self._definition, 0)
        self._memory = self._initial.copy()
        kernels = [k for k in (self._definition.output, self._definition.update) if k is not None]
        self._inputs = {p.name: (p, self._view(p.name)) for p in block.inputs}
        self._outputs = {p.name: (p, self._view(p.name)) for p in block.outputs}
        made = compiled_step if compiled and self._definition.compiled else plain_step
        self._calls = [made(k, self._slots, self._memory) for k in kernels]
        self._k = 0

    def __repr__(self) -> str:
        names = ", ".join(f"{name}=..." for name in self._inputs)
        return f"<Step of {self._title} at {show(self._step)} s: step({names}) returns {', '.join(self._outputs)}>"

    def __call__(self, *unnamed: Any, **inputs: Any) -> Outputs:
        """Make one step; every input without a start value must be given, all of them by name."""
        if unnamed:
            named = ", ".join(f"{name}=..." for name in self._inputs)
            raise ModelError(
                f"{self._title} takes its inputs by name: step({named}), if step is what online() returned."
            )
        for name in inputs:
            if name not in self._inputs:
                raise UnknownNameError(f"{self._title} has no input {name!r}; {did_you_mean(name, self._inputs)}")
        for name, (port, view) in self._inputs.items():
            if name in inputs:
                view[...] = self._checked(name, inputs[name], view.shape)
            elif port.default is None:
                raise ModelError(f"{self._title} needs its input {name!r} at every step; give {name}=...")
            else:
                view[...] = port.default
        self._make_step()
        return Outputs({n: float(v[0]) if p.shape == () else v.copy() for n, (p, v) in self._outputs.items()})

    def advance(self, inputs: Floats) -> Floats:
        """Make one step with the elements of all inputs in one vector, and return those of all outputs.

        This is the quick form of a call, for loops that are short of time.

        Parameters
        ----------
        inputs : ndarray, shape (elements,)
            The elements of all `inputs` in their order, also of those with a start value; NaN for a missing sample.

        Returns
        -------
        ndarray, shape (elements,)
            The elements of all `outputs` in their order.

        Raises
        ------
        ModelError
            If there are more or fewer elements.

        Examples
        --------
        >>> from bayesftc import cosim
        >>> integral = cosim.Integrator().online(dt=0.5, compiled=False)
        >>> [integral.advance([2.0]).tolist() for _ in range(3)]
        [[0.0], [1.0], [2.0]]
        """
        into, out = self._places
        if len(inputs) != len(into):
            names = ", ".join(self._inputs)
            raise ModelError(f"{self._title} has {len(into)} elements of inputs ({names}), not {len(inputs)}.")
        self._memory[into] = inputs
        self._make_step()
        outputs: Floats = self._memory[out]
        return outputs

    def _make_step(self) -> None:
        t = self._k * self._step.numerator / self._step.denominator
        for call in self._calls:
            call(t, self._k)
        self._k += 1

    def reset(self) -> None:
        """Return to the state before the first step."""
        self._memory[:] = self._initial
        self._k = 0

    def save_state(self) -> Floats:
        """Return the state after the last step, as an array; `restore` goes on from there, also in a later process.

        Returns
        -------
        ndarray, shape (n,)
            To be kept as it is, such as by ``numpy.save``. It belongs to a block of these settings in this version.

        Examples
        --------
        >>> from bayesftc import cosim
        >>> integral = cosim.Integrator().online(dt=0.5, compiled=False)
        >>> [integral(u=2.0).y for _ in range(3)]
        [0.0, 1.0, 2.0]
        >>> later = cosim.Integrator().online(dt=0.5, compiled=False)
        >>> later.restore(integral.save_state())
        >>> later(u=2.0).y
        3.0
        """
        return np.append(self._memory, self._k)

    def restore(self, state: Floats) -> None:
        """Go on from a state that `save_state` returned, of this block or of another one with the same settings.

        Raises
        ------
        ModelError
            If it is no state of such a block with these settings.
        """
        try:
            kept = np.asarray(state, dtype=np.float64)
        except (TypeError, ValueError):
            kept = np.zeros(0)
        count, fixed = kept[-1] if kept.ndim == 1 and kept.size else -1.0, self._fixed
        if kept.shape != (self._memory.size + 1,) or not (count >= 0 and float(count).is_integer()):
            raise ModelError(f"{self._title}: this is no state of such a block; give what save_state() returned.")
        if not np.array_equal(kept[fixed], self._memory[fixed], equal_nan=True):
            raise ModelError(
                f"{self._title}: this state belongs to a block with other settings. Restore it in one with the same settings, or "
                "begin anew."
            )
        self._memory[:], self._k = kept[:-1], int(count)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy or pickle the block and its state; the copy has step functions of its own."""
        return _again, (type(self), self._block, self._step, self._compiled, self.save_state())

    @property
    def step(self) -> Fraction:
        """The sample time in seconds."""
        return self._step

    @property
    def inputs(self) -> dict[str, Port]:
        """The ports of the inputs, by name."""
        return {name: port for name, (port, _) in self._inputs.items()}

    @property
    def outputs(self) -> dict[str, Port]:
        """The ports of the outputs, by name."""
        return {name: port for name, (port, _) in self._outputs.items()}

    @property
    def _fixed(self) -> Any:
        """The numbers of those elements of the memory that are settings."""
        return np.arange(self._slots.start["parameters"], self._slots.start["inputs"])

    @cached_property
    def _places(self) -> tuple[Any, Any]:
        """The numbers of those elements of the memory that are inputs, and of those that are outputs."""
        return tuple(
            np.concatenate([np.arange(0), *(self._numbers(view) for _, view in ports.values())])
            for ports in (self._inputs, self._outputs)
        )  # type: ignore[return-value]

    def _numbers(self, view: Floats) -> Any:
        first = (view.ctypes.data - self._memory.ctypes.data) // view.itemsize
        return np.arange(first, first + view.size)

    @property
    def _title(self) -> str:
        return type(self._block).__name__

    def _view(self, name: str) -> Any:
        shape = self._slots.sections[name][2]
        start = self._slots.offset(name)
        return self._memory[start : start + int(np.prod(shape))].reshape(shape)

    def _checked(self, name: str, value: Any, shape: tuple[int, ...]) -> Any:
        try:
            array = np.full(shape, np.nan) if value is None else np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ModelError(
                f"{self._title}: the input {name}={value!r} is not a number or a sequence of numbers."
            ) from None
        if array.ndim == 0 and int(np.prod(shape)) == 1:
            array = array.reshape(shape)
        if array.shape != shape:
            raise ModelError(f"{self._title}: the input {name!r} has the shape {array.shape}; it must be {shape}.")
        return array


def _again(cls: type[Online], block: Block, step: Fraction, compiled: bool, state: Floats) -> Online:
    copy = cls(block, step, compiled=compiled)
    copy.restore(state)
    return copy


def plain_step(kernel: Kernel, slots: Slots, memory: Floats) -> Step:
    """Return a step function of time and step count, as plain Python, on the memory of a block."""
    function = bind(kernel, slots, memory)

    def call(t: float, k: int) -> None:
        with np.errstate(all="ignore"):
            function(t, k)

    return call


def compiled_step(kernel: Kernel, slots: Slots, memory: Floats) -> Step:
    """Return a step function of time and step count, as machine code, on the memory of a block."""
    import_engine()
    from bayesftc.cosim.stepping.machine.steps import compile_kernel

    address = [ctypes.c_int64(memory.ctypes.data + 8 * start) for start in slots.start.values()]
    i64 = ctypes.c_int64
    function = ctypes.CFUNCTYPE(ctypes.c_int32, i64, i64, i64, i64, ctypes.c_double, i64)(
        compile_kernel(kernel, slots.sections)
    )

    def call(t: float, k: int) -> None:
        function(*address, t, k)

    return call
