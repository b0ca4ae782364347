"""Checks of settings and matrices, with errors that name the wrong one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    Matrix = ArrayLike
else:  # at run time, the form that a scenario file may have
    Matrix = float | Sequence[float] | Sequence[Sequence[float]]
"""A matrix as a user may give it: rows, a diagonal, or one number."""


LARGEST, SMALLEST = 1e50, 1e-100
"""Largest entry and smallest variance of a model; products of several beyond these overflow or vanish in double precision."""


ROWS = "it must be a matrix of numbers: give its rows, as [[1, 0.1], [0, 1]]"


def frozen(array: Floats) -> Floats:
    """Return a read-only copy."""
    copy = np.array(array, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def as_numbers(name: str, value: object, example: str) -> Floats:
    """Return `value` as an array of any shape.

    Raises
    ------
    ModelError
        If it contains text, None or anything else that is no number, or rows of different lengths; `example` says what to give.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
        given = np.asarray(value)
        wrong = given.dtype.kind in "US" or (given.dtype.kind == "O" and any(each is None for each in given.ravel()))
    except (TypeError, ValueError, OverflowError):
        wrong = True
    if wrong:
        raise ModelError(f"{name} is {brief(value)}; {example}.")
    return array


def as_matrix(name: str, value: object, rows: int | None = None, columns: int | None = None) -> Floats:
    """Return `value` as a finite matrix of the given size; numbers become 1 x 1, vectors one column.

    Raises
    ------
    ModelError
        If it has another size or is not finite.
    """
    array = as_numbers(name, value, ROWS)
    if array.ndim < 2:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or not array.size:
        raise ModelError(f"{name} has the shape {array.shape}; give a matrix with rows and columns.")
    if not _fits(array, rows, columns):
        required = (
            f"have {rows} row{'s' * (rows != 1)}"
            if columns is None
            else f"have {columns} column{'s' * (columns != 1)}"
            if rows is None
            else f"be {rows} x {columns}"
        )
        transposed = " (is it transposed?)" if _fits(array.T, rows, columns) else ""
        raise ModelError(f"{name} is {_size(array.shape)}; it must {required}{transposed}.")
    if not np.isfinite(array).all():
        raise ModelError(f"{name} has entries that are NaN or infinite; check where it was computed.")
    _refuse_huge(name, array)
    return frozen(array)


def _fits(array: Floats, rows: int | None, columns: int | None) -> bool:
    return (rows is None or len(array) == rows) and (columns is None or array.shape[1] == columns)


def as_covariance(name: str, value: object, size: int, *, singular: bool = False) -> Floats:
    """Return `value` as a covariance matrix: a number or a vector stands for a diagonal.

    Parameters
    ----------
    name : str
        Title of the value in errors.
    value : number, vector or matrix
        The covariance.
    size : int
        Number of rows and columns.
    singular : bool
        Whether zero eigenvalues are allowed (a state without process noise).

    Raises
    ------
    ModelError
        If it is not symmetric or not positive (semi-)definite.
    """
    example = "it must be a number, a list of numbers for a diagonal, or rows of numbers"
    if isinstance(value, bool | np.bool_):
        raise ModelError(f"{name} is {value}; {example}.")
    array = as_numbers(name, value, example)
    if array.ndim == 0:
        array = array * np.eye(size)
    elif array.ndim == 1 and array.shape == (size,):
        array = np.diag(array)
    matrix = as_matrix(name, array, size, size)
    scale = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > 1e-9 * scale:
        raise ModelError(
            f"{name} is not symmetric; a covariance must be. Use (M + M.T) / 2 if the difference is rounding."
        )
    tiny = np.diag(matrix)[(np.diag(matrix) > 0) & (np.diag(matrix) < SMALLEST)]
    if tiny.size:
        raise ModelError(
            f"{name} has a variance of {tiny[0]:.3g}, below the smallest allowed one of {SMALLEST:g}; give "
            f"{'0 if there is no noise, or ' if singular else ''}a larger one."
        )
    # The test uses the correlation matrix, because units may differ: a pressure in pascals beside a position in metres.
    variances = np.diag(matrix)
    units = np.sqrt(np.where(variances > 0, variances, 1.0))
    correlation = float(np.linalg.eigvalsh(matrix / np.outer(units, units))[0])
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if (variances < 0).any() or correlation < -1e-9 or (not singular and correlation <= 1e-14):
        smallest = min(smallest, float(variances.min()))
        kind = "positive semi-definite (no negative eigenvalue)" if singular else "positive definite"
        raise ModelError(
            f"{name} is not {kind}: its smallest eigenvalue is {smallest:.3g}. Variances must be above zero."
        )
    return frozen((matrix + matrix.T) / 2)


def as_vector(name: str, value: object, size: int, *, finite: bool = True) -> Floats:
    """Return `value` as a vector; one number is repeated.

    Raises
    ------
    ModelError
        If it has another length, or is not finite although `finite` is True.
    """
    or_not = "" if finite else ", infinite for no limit"
    array = as_numbers(name, value, f"it must be a number or a list of numbers{or_not}")
    if array.ndim == 0:
        array = np.full(size, float(array))
    if array.shape != (size,):
        raise ModelError(f"{name} has the shape {array.shape}; it must be a vector of {size}.")
    if np.isnan(array).any() or (finite and not np.isfinite(array).all()):
        raise ModelError(f"{name} is {array.tolist()}; its entries must be {'finite ' if finite else ''}numbers.")
    if finite:
        _refuse_huge(name, array)
    return frozen(array)


def as_number(
    title: str,
    value: object,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    whole: bool = False,
    finite: bool = True,
    also: str = "",
) -> float:
    """Return `value` as a float between the bounds; NaN, text and truth values are refused.

    A finite number must have a finite square and a finite inverse of it, because many settings are squared.

    Parameters
    ----------
    title : str
        Title of the value in errors: ``"SERFDI has threshold"``.
    value : object
        The user's value.
    above, least, below, most : float, optional
        Bounds; `above` and `below` are themselves excluded.
    whole, finite : bool
        Whether it must be a whole number, or finite.
    also : str
        What else the caller allows, at the end of the message.

    Raises
    ------
    ModelError
        If it is not such a number.
    """
    bounds = [
        (above, "above", lambda v: v > above),
        (least, "at least", lambda v: v >= least),
        (below, "below", lambda v: v < below),
        (most, "at most", lambda v: v <= most),
    ]
    limits = [(f"{word} {bound:g}", holds) for bound, word, holds in bounds if bound is not None]
    number = real(value)
    proper = not np.isnan(number) and (np.isfinite(number) or not (finite or whole))
    if proper and (not whole or number.is_integer()) and all(holds(number) for _, holds in limits):
        size = abs(number)
        if LARGEST < size < np.inf or 0 < size < SMALLEST:
            change = "smaller" if size > LARGEST else "larger"
            raise ModelError(
                f"{title}={brief(value)}; its size must be between {SMALLEST:g} and {LARGEST:g}, or zero; choose a unit in "
                f"which it is {change}."
            )
        return number
    kind = "whole number" if whole else "finite number" if finite else "number"
    required = " and ".join(text for text, _ in limits)
    raise ModelError(f"{title}={brief(value)}; it must be a {kind} {required}".rstrip() + f"{also}.")


def check_limits(low: Floats, high: Floats, names: Sequence[str] = (), owner: str = "") -> None:
    """Refuse lower limits of controls above their upper limits.

    Raises
    ------
    ModelError
        With the controls and their limits.
    """
    wrong = [j for j in range(len(low)) if low[j] > high[j]]
    if not wrong:
        return
    who = [f" of {names[j]}" if len(names) == len(low) else f" of control {j}" if len(low) > 1 else "" for j in wrong]
    pairs = [f"u_min{of} is {low[j]:g}, above its u_max of {high[j]:g}" for j, of in zip(wrong, who, strict=True)]
    raise ModelError(f"{owner}{'; '.join(pairs)}. The lower limit of a control must lie below its upper limit.")


def check_number(owner: object, name: str, *, optional: bool = False, **bounds: Any) -> None:
    """Check a setting of `owner` by `as_number`; None is allowed if it is `optional`.

    Raises
    ------
    ModelError
        If it is not such a number.
    """
    value = getattr(owner, name)
    if not (optional and value is None):
        as_number(f"{type(owner).__name__} has {name}", value, also=", or None" if optional else "", **bounds)


def check_choice(owner: object, name: str, *choices: str) -> None:
    """Check that a setting of `owner` is one of the choices.

    Raises
    ------
    ModelError
        If it is not.
    """
    value = getattr(owner, name)
    if not isinstance(value, str) or value not in choices:
        required = " or ".join(map(repr, choices))
        raise ModelError(f"{type(owner).__name__} has {name}={value!r}; it must be {required}.")


def check_flags(owner: object, *names: str) -> None:
    """Check that settings of `owner` are True or False.

    Raises
    ------
    ModelError
        If one is not.
    """
    for name in names:
        if not isinstance(getattr(owner, name), bool | np.bool_):
            raise ModelError(f"{type(owner).__name__} has {name}={getattr(owner, name)!r}; it must be True or False.")


def refuse_missing(name: str, rows: Floats) -> None:
    """Refuse rows of samples with a missing number; `name` is the user's name for them.

    Raises
    ------
    ModelError
        If one is NaN or infinite.
    """
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise ModelError(
            f"{name} has {len(bad)} rows with a NaN or inf, the first at index {bad[0]}; leave missing samples "
            f"out: {name}[np.isfinite({name}).all(axis=1)]."
        )


def _refuse_huge(name: str, array: Floats) -> None:
    largest = float(np.abs(array).max(initial=0.0))
    if largest > LARGEST:
        raise ModelError(
            f"{name} has an entry of {largest:.3g}, above the largest allowed one of {LARGEST:g}; choose a unit in which it is "
            "smaller."
        )


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
