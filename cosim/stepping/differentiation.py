"""Jacobians of step functions, by forward-mode automatic differentiation with dual numbers.

The function is run once on symbols that consist of a value and its derivatives with respect to each input number (dual numbers).
The operations on them are recorded as the text of a new step function. A step function never branches on data, so one run is
enough. The Jacobian is an ordinary step function: it runs in Python or compiled, and can be differentiated again.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from traceback import walk_tb
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from bayesftc.cosim import ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.fingerprint import depends_on, functions_called
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.stepping.tracing import rebound
from bayesftc.cosim.types import Kernel, argument_names

Shape = int | tuple[int, ...]
Input = tuple[str, int]
"""The input number of a derivative: the name of the argument, and the index in it."""

_cache: WeakKeyDictionary[FunctionType, dict[Any, tuple[list[Any], Kernel]]] = WeakKeyDictionary()


def jacobian(function: Kernel, shapes: Mapping[str, Shape], output: str, wrt: Sequence[str]) -> Kernel:
    """Return a step function that computes the derivatives of a step function's output.

    Parameters
    ----------
    function : function
        A step function with any arguments, as ``f(x, u, x_next)``. It must write every element of `output` and nothing else.
    shapes : mapping of str to int or tuple
        The shape of each of its arguments.
    output : str
        The argument that it writes: a vector.
    wrt : sequence of str
        The arguments with respect to which it is differentiated: vectors.

    Returns
    -------
    function
        Its arguments, in this order: those of `function` without `output`, then a matrix (outputs x inputs) for each name in
        `wrt`, called ``<output>_<name>``. Every element is written.

    Raises
    ------
    KernelError
        If the function breaks the rules of step functions, does not write its output, writes anything else, or branches on data.
        The error names the function and the line.

    Notes
    -----
    At a kink the derivative is that of the branch taken there. For ``minimum`` and ``maximum`` of equal arguments this is the
    derivative of the second one. The derivative of ``absolute`` at zero is 1, that of ``floor`` is zero everywhere.

    The derivative of ``sqrt`` at zero is infinite. The chain rule may multiply it by zero, which gives NaN, as for
    ``sqrt(square(x))``. The nonlinear controllers make no step to or from such a point. If it can occur, add a small number below
    the root.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim import jacobian, ops
    >>> def polar(x, y):
    ...     y[0] = x[0] * ops.sin(x[1])
    >>> derivative, result = jacobian(polar, {"x": 2, "y": 1}, "y", ["x"]), np.empty((1, 2))
    >>> derivative(np.array([2.0, 0.0]), result)
    >>> result.tolist()
    [[0.0, 2.0]]
    """
    names = argument_names(function)
    assert isinstance(function, FunctionType)  # checked by `argument_names`
    _check(function, names, shapes, output, wrt)
    sizes = {name: _tuple(shapes[name]) for name in names}
    # Blocks need the same derivative many times, but globals of the function's module may change in between.
    dependencies, cached = depends_on(function), _cache.setdefault(function, {})
    key = tuple(sizes.items()), output, tuple(wrt)
    if key not in cached or not all(map(operator.is_, cached[key][0], dependencies)):
        cached[key] = dependencies, _derived(function, sizes, output, wrt)
    return cached[key][1]


def _derived(function: FunctionType, shapes: Mapping[str, tuple[int, ...]], output: str, wrt: Sequence[str]) -> Kernel:
    functions = functions_called(function)  # raises the compiler's errors for functions that break the rules
    tape = _Tape()
    arrays: dict[str, Any] = {}
    for name, shape in shapes.items():
        array = np.empty(shape, dtype=object)
        if name != output:
            for index in np.ndindex(shape):
                partials: dict[Input, Any] = {(name, index[0]): 1.0} if name in wrt else {}
                array[index] = _Dual(tape, f"{name}[{', '.join(map(str, index))}]", partials)
        arrays[name] = array
    originals = {name: array.copy() for name, array in arrays.items() if name != output}
    try:
        rebound(function, _operations(tape))(*arrays.values())
    except Exception as error:  # anything that Python cannot do with symbols
        raise _refusal(functions, error) from error
    for name, array in originals.items():
        if any(a is not b for a, b in zip(array.flat, arrays[name].flat, strict=True)):
            raise KernelError(f"{function.__name__!r} writes into {name}; it must write {output} only.")
    for i, value in enumerate(arrays[output]):
        if value is None:
            raise KernelError(f"{function.__name__!r} does not write {output}[{i}]; write every element.")
        if not isinstance(value, Real | _Dual | _Condition):
            raise KernelError(
                f"{function.__name__!r} writes a {type(value).__name__} into {output}[{i}]; it must be a number."
            )
    lines = []
    for name in wrt:
        for i, value in enumerate(arrays[output]):
            of_value = value.partials if isinstance(value, _Dual) else {}
            for j in range(shapes[name][0]):
                lines.append(f"{output}_{name}[{i}, {j}] = {_text(of_value.get((name, j), 0.0))}")
    return _compiled(function, [*originals, *(f"{output}_{name}" for name in wrt)], [*tape.lines, *lines])


def _check(
    function: Kernel, names: Sequence[str], shapes: Mapping[str, Shape], output: str, wrt: Sequence[str]
) -> None:
    title = f"The function {function.__name__!r}"
    unknown = [name for name in (output, *wrt) if name not in names] or [n for n in names if n not in shapes]
    if unknown:
        raise KernelError(
            f"{title} has the arguments {', '.join(names)}, but {unknown[0]!r} is none of them, or shapes= has no shape for it."
        )
    for name in (output, *wrt):
        if len(_tuple(shapes[name])) != 1:
            raise KernelError(
                f"{title} has the array {name!r}, but only vectors can be differentiated; make it a vector."
            )


def _refusal(functions: Sequence[FunctionType], error: Exception) -> KernelError:
    """Return the KernelError for an error of functions that ran on symbols, with the line of its origin."""
    codes = {f.__code__: f.__name__ for f in functions}
    place = ""
    for frame, line in walk_tb(error.__traceback__):
        if frame.f_code in codes:
            place = f"{codes[frame.f_code]!r} ({Path(frame.f_code.co_filename).name}, line {line})"
    if isinstance(error, KernelError):
        return KernelError(f"Step function {place} cannot be differentiated: {error}")
    if isinstance(error, IndexError):
        return KernelError(f"Step function {place} uses an index beyond its arguments: {error}. Correct the index.")
    reason = str(error)
    for symbol, meaning in (
        ("'_Dual' object", "a number of data"),
        ("'_Dual'", "a number"),
        ("'_Condition'", "a condition"),
    ):
        reason = reason.replace(symbol, meaning)
    return KernelError(
        f"Step function {place} cannot be differentiated: {reason.rstrip('.')}. Write plain loops over numbers with + - * /, "
        f"comparisons, and the mathematics of bayesftc.cosim.ops ({', '.join(ops.NAMES)})."
    )


def _tuple(shape: Shape) -> tuple[int, ...]:
    return (shape,) if isinstance(shape, int) else tuple(shape)


def _compiled(function: Kernel, arguments: Sequence[str], lines: Sequence[str]) -> Kernel:
    names: dict[str, Any] = {n: getattr(ops, n) for n in ops.NAMES} | {"inf": math.inf, "nan": math.nan}
    names["__name__"] = function.__module__
    return function_from_text(f"jacobian_of_{function.__name__}", arguments, lines, names)


def _text(value: Any) -> str:
    if isinstance(value, _Dual | _Condition):
        return value.name
    if not isinstance(value, Real):
        raise TypeError(
            "an element is read before it is written" if value is None else f"{type(value).__name__} is no number"
        )
    return repr(float(value))


class _Tape:
    """The statements so far; repeated expressions are computed once."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._known: dict[str, str] = {}

    def name(self, expression: str) -> str:
        """Return the variable that holds the expression."""
        if expression not in self._known:
            self._known[expression] = f"_{len(self.lines)}"
            self.lines.append(f"{self._known[expression]} = {expression}")
        return self._known[expression]


class _Condition:
    """The symbol of a condition."""

    def __init__(self, name: str):
        self.name = name

    def __bool__(self) -> bool:
        raise KernelError(
            "it branches on data; write ops.select(condition, a, b) for if, and ops.both, either, negate for and, or, not."
        )


class _Dual:
    """The symbol of a number, with its derivatives by input: numbers, or symbols without derivatives of their own."""

    __array_ufunc__ = None  # makes NumPy's numbers use this class's operators
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, tape: _Tape, name: str, partials: Mapping[Input, Any]):
        self.tape, self.name, self.partials = tape, name, partials

    def __add__(self, other: Any) -> Any:
        return _result(self.tape, _add(self.tape, _value(self), _value(other)), [(self, 1.0), (other, 1.0)])

    def __radd__(self, other: Any) -> Any:
        return _result(self.tape, _add(self.tape, other, _value(self)), [(self, 1.0)])

    def __sub__(self, other: Any) -> Any:
        return _result(self.tape, _sub(self.tape, _value(self), _value(other)), [(self, 1.0), (other, -1.0)])

    def __rsub__(self, other: Any) -> Any:
        return _result(self.tape, _sub(self.tape, other, _value(self)), [(self, -1.0)])

    def __mul__(self, other: Any) -> Any:
        a, b = _value(self), _value(other)
        return _result(self.tape, _plain(self.tape, "*", a, b), [(self, b), (other, a)])

    def __rmul__(self, other: Any) -> Any:
        return _result(self.tape, _plain(self.tape, "*", other, _value(self)), [(self, other)])

    def __truediv__(self, other: Any) -> Any:
        return _divided(self.tape, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _divided(self.tape, other, self)

    def __neg__(self) -> Any:
        return _result(self.tape, _Dual(self.tape, self.tape.name(f"-{self.name}"), {}), [(self, -1.0)])

    def __pos__(self) -> Any:
        return self

    def __bool__(self) -> bool:
        return bool(_Condition(self.name))

    def __lt__(self, other: Any) -> Any:
        return _compared(self.tape, "<", self, other)

    def __le__(self, other: Any) -> Any:
        return _compared(self.tape, "<=", self, other)

    def __gt__(self, other: Any) -> Any:
        return _compared(self.tape, ">", self, other)

    def __ge__(self, other: Any) -> Any:
        return _compared(self.tape, ">=", self, other)

    def __eq__(self, other: object) -> Any:
        return _compared(self.tape, "==", self, other)

    def __ne__(self, other: object) -> Any:
        return _compared(self.tape, "!=", self, other)


def _value(x: Any) -> Any:
    """Return the symbol without its derivatives."""
    return _Dual(x.tape, x.name, {}) if isinstance(x, _Dual) else x


def _compared(tape: _Tape, sign: str, a: Any, b: Any) -> _Condition:
    return _Condition(tape.name(f"{_text(a)} {sign} {_text(b)}"))


def _plain(tape: _Tape, sign: str, a: Any, b: Any) -> Any:
    """Return ``a sign b`` of two values; the result of two numbers is computed at once."""
    if isinstance(a, Real) and isinstance(b, Real):
        with np.errstate(all="ignore"):
            x, y = np.float64(a), np.float64(b)
            return float(x * y if sign == "*" else x / y if sign == "/" else x + y if sign == "+" else x - y)
    return _Dual(tape, tape.name(f"{_text(a)} {sign} {_text(b)}"), {})


def _add(tape: _Tape, a: Any, b: Any) -> Any:
    return _plain(tape, "+", a, b)


def _sub(tape: _Tape, a: Any, b: Any) -> Any:
    return _plain(tape, "-", a, b)


def _times(tape: _Tape, a: Any, b: Any) -> Any:
    """Return the product of a factor and a derivative; factors of exactly 1 are left out."""
    if isinstance(a, Real) and a == 1.0:
        return b
    if isinstance(b, Real) and b == 1.0:
        return a
    return _plain(tape, "*", a, b)


def _result(tape: _Tape, value: Any, terms: Sequence[tuple[Any, Any]]) -> Any:
    """Return `value` with the derivative ``sum of factor * d(operand)`` over the `terms` (operand, factor)."""
    partials: dict[Input, Any] = {}
    for operand, factor in terms:
        for place, partial in operand.partials.items() if isinstance(operand, _Dual) else ():
            term = _times(tape, factor, partial)
            partials[place] = _add(tape, partials[place], term) if place in partials else term
    return _Dual(tape, value.name, partials)


def _divided(tape: _Tape, a: Any, b: Any) -> Any:
    value = _plain(tape, "/", _value(a), _value(b))
    over = _plain(tape, "/", 1.0, _value(b))
    return _result(tape, value, [(a, over), (b, _plain(tape, "*", _plain(tape, "*", -1.0, value), over))])


def _operations(tape: _Tape) -> dict[str, Callable[..., Any]]:
    """Return the versions of all operations for symbols."""

    def call(name: str, *arguments: Any) -> Any:
        symbol = tape.name(f"{name}({', '.join(map(_text, arguments))})")
        return _Condition(symbol) if name in {"both", "either", "negate", "isnan"} else _Dual(tape, symbol, {})

    def unary(derivative: Callable[[Any, Any], Any]) -> Callable[[str, Any], Any]:
        return lambda name, x: _result(
            tape, value := call(name, x), [(x, derivative(_value(x), value))] if x.partials else []
        )

    def chosen(name: str, condition: Any, a: Any, b: Any) -> Any:
        """Return ``select``; its derivative is that of the chosen alternative."""
        value = call(name, condition, _value(a), _value(b))
        of_a, of_b = (x.partials if isinstance(x, _Dual) else {} for x in (a, b))
        partials = {}
        for place in sorted({*of_a, *of_b}):
            left, right = of_a.get(place, 0.0), of_b.get(place, 0.0)
            same = isinstance(left, Real) and isinstance(right, Real) and left == right
            partials[place] = left if same else call("select", condition, left, right)
        return _Dual(tape, value.name, partials)

    def square(name: str, x: Any) -> Any:
        return _result(tape, call(name, x), [(x, _plain(tape, "*", 2.0, _value(x)))])

    rules: dict[str, Callable[..., Any]] = {
        **dict.fromkeys(("both", "either", "floor", "isnan", "negate"), call),  # steps: nothing to differentiate
        "absolute": unary(lambda x, value: call("select", _compared(tape, "<", x, 0.0), -1.0, 1.0)),
        "cos": unary(lambda x, value: -call("sin", x)),
        "exp": unary(lambda x, value: value),
        "log": unary(lambda x, value: 1.0 / x),
        "select": chosen,
        "sin": unary(lambda x, value: call("cos", x)),
        "sqrt": unary(lambda x, value: 0.5 / value),
        "square": square,
    }

    def operation(name: str, rule: Callable[..., Any]) -> Callable[..., Any]:
        count = getattr(ops, name).__code__.co_argcount

        def apply(*arguments: Any) -> Any:
            if len(arguments) != count:
                raise TypeError(f"{name} has {count} argument{'s' * (count > 1)}, not {len(arguments)}")
            if not any(isinstance(a, _Dual | _Condition) for a in arguments):
                return getattr(ops, name)(*arguments)
            return rule(name, *arguments)

        return apply

    operations = {name: operation(name, rule) for name, rule in rules.items()}
    rest = {name: rebound(function, operations) for name, function in ops.COMPOSED.items() if name not in rules}
    return operations | rest


__all__ = ["jacobian"]
