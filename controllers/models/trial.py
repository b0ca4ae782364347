"""Try out a user's functions before a run."""

from __future__ import annotations

from collections.abc import Sequence
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.stepping.fingerprint import foreign_functions, functions_called, where
from bayesftc.cosim.types import argument_names


def try_out(title: str, function: Any, form: str, inputs: Sequence[int], outputs: Sequence[tuple[int, ...]]) -> None:
    """Run a user's function as plain Python, and check that it has the right arguments and writes all of its results.

    A compiled function that reaches beyond its arrays would read and write other memory without an error.

    Parameters
    ----------
    title : str
        Title of the function in errors: ``"The model's f"``.
    function : function
        The step function.
    form : str
        Signature in errors: ``"f(x, u, x_next)"``.
    inputs : sequence of int
        Lengths of its input vectors, the first arguments.
    outputs : sequence of tuple
        Shapes of its output arrays, the last arguments.

    Raises
    ------
    ModelError
        If it is not such a function.
    KernelError
        If it breaks the rules of step functions.
    """
    if not isinstance(function, FunctionType):
        raise ModelError(f"{title} is {function!r}; it must be a step function {form}.")
    names = argument_names(function)
    if len(names) != len(inputs) + len(outputs):
        raise ModelError(f"{title} has the arguments {', '.join(names)}; it must be a step function {form}.")
    try:
        functions_called(function)
    except KernelError as error:
        raise KernelError(f"{title}: {error}") from None
    if foreign_functions(function):
        return  # an FMU need not have values at an arbitrary point
    results = []
    for blank in (1.25e77, -3.5e88):  # no function writes both of these numbers
        arguments = [np.full(size, 0.5) for size in inputs]
        written = [np.full(shape, blank) for shape in outputs]
        try:
            with np.errstate(all="ignore"):
                function(*arguments, *written)
        except IndexError as error:
            sizes = ", ".join(
                f"{n} has {'x'.join(map(str, a.shape))}" for n, a in zip(names, [*arguments, *written], strict=True)
            )
            raise ModelError(f"{title} reaches beyond its arguments ({error}); {sizes}.") from None
        except Exception as error:  # whatever the user's function may raise
            raise ModelError(f"{title} {where(function)} cannot be computed: {error}.") from error
        if any((array != 0.5).any() for array in arguments):
            raise ModelError(f"{title} writes into its inputs; it must write {', '.join(names[len(inputs) :])} only.")
        results.append([array == blank for array in written])
    for argument, first, second in zip(names[len(inputs) :], *results, strict=True):
        left = np.argwhere(first & second)
        if len(left):
            raise ModelError(
                f"{title} does not write {argument}[{', '.join(map(str, left[0]))}]; it must write every element."
            )
