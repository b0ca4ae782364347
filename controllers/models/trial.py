"""Functions of a user's, tried out before anything runs with them."""

from __future__ import annotations

from collections.abc import Sequence
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.stepping.fingerprint import functions_called, where
from bayesftc.cosim.types import argument_names


def try_out(title: str, function: Any, form: str, inputs: Sequence[int], outputs: Sequence[tuple[int, ...]]) -> None:
    """Run a user's function as plain Python, and see that it takes the right arguments and writes its results, all of them.

    Compiled, a function that reaches beyond its arrays would read and write other memory without a word.

    Parameters
    ----------
    title : str
        What the function is, for the error: ``"The model's f"``.
    function : function
        The step function.
    form : str
        How it should be called, for the error: ``"f(x, u, x_next)"``.
    inputs : sequence of int
        Lengths of the vectors that it is given, its first arguments.
    outputs : sequence of tuple
        Shapes of the arrays that it writes, its last arguments.

    Raises
    ------
    ModelError
        If it is no such function.
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
    results = []
    for blank in (1.25e77, -3.5e88):  # two numbers that no function writes both of
        given = [np.full(size, 0.5) for size in inputs]
        written = [np.full(shape, blank) for shape in outputs]
        try:
            with np.errstate(all="ignore"):
                function(*given, *written)
        except IndexError as error:
            sizes = ", ".join(
                f"{n} has {'x'.join(map(str, a.shape))}" for n, a in zip(names, [*given, *written], strict=True)
            )
            raise ModelError(f"{title} reaches beyond its arguments ({error}); {sizes}.") from None
        except Exception as error:  # whatever the user's function may raise
            raise ModelError(f"{title} {where(function)} cannot be computed: {error}.") from error
        if any((array != 0.5).any() for array in given):
            raise ModelError(
                f"{title} writes into what it is given; it must write {', '.join(names[len(inputs) :])} only."
            )
        results.append([array == blank for array in written])
    for argument, first, second in zip(names[len(inputs) :], *results, strict=True):
        left = np.argwhere(first & second)
        if len(left):
            raise ModelError(
                f"{title} does not write {argument}[{', '.join(map(str, left[0]))}]; it must write every element."
            )
