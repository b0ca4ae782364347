"""A steady state of a plant that is given by its equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

NEARER = 1e-6
"""A steady state is nearer than another one if its distance is smaller by this share, more than rounding."""

AT_START = 1e-9
"""Largest distance of a steady state that counts as the start itself."""

FEW = 50
"""Evaluations of a search that only explains a failure."""

NEVER_RESTS = (
    "If a state always changes, as the mass of a rocket does, design for a plant that has a constant in its place (in Python: "
    "give design that plant; in a scenario: [known.plant])."
)
"""Advice for a plant that has no steady state."""

TRIED = 4
"""Number of states that are tried as the cause of a failure; each takes several searches."""

NAMED = 3
"""Number of states that a message names."""


def steady_state(
    residual: Callable[[Floats, Floats], Floats],
    x: Floats,
    u: Floats,
    free: Sequence[int],
    *,
    scale: Floats | None = None,
    stated: bool = True,
    inside: Floats | None = None,
    names: Sequence[str] = (),
    per: str = "second",
) -> tuple[Floats, Floats, Floats | None]:
    """Find a steady state near the start, if necessary with other inputs.

    Inputs that are not stated may also hold the start best, where this gives a nearer steady state. If there is none with either,
    states and inputs are searched together. If there is none, a steady motion suffices: states on which nothing depends (the
    position of a car) change at a constant rate.

    Parameters
    ----------
    residual : callable
        Change of the state in a second or a sample, of state and inputs.
    x, u : ndarray
        State and inputs at the start.
    free : sequence of int
        The inputs that may change.
    scale : ndarray, optional
        Sizes of the states.
    stated : bool
        Whether the plant itself gives the inputs at the start.
    inside : ndarray, optional
        Values of the free inputs from which to search as well: at the start they may be outside a limit of the plant, where they
        have no effect.
    names : sequence of str
        Names of the states, for messages.
    per : {"second", "sample"}
        Time of `residual`, for messages.

    Returns
    -------
    tuple
        State, inputs and the rate of a steady motion; None if it is zero.

    Raises
    ------
    ModelError
        If there is neither.
    """
    size = np.maximum(np.abs(x), 1.0 if scale is None else scale)
    n, z, given = len(x), x / size, u[list(free)]
    guesses = [] if not len(free) else [given] if inside is None or np.array_equal(inside, given) else [given, inside]

    def put(w: Floats) -> Floats:
        inputs = u.copy()
        inputs[list(free)] = w
        return inputs

    def change(z: Floats, w: Floats) -> Floats:
        return np.asarray(residual(z * size, put(w))) / size

    def without(states: Floats, z: Floats, w: Floats) -> Floats:
        return np.where(states, 0.0, change(z, w))

    def away(rest: Floats) -> float:
        return float(np.linalg.norm(rest - z))

    def nearest(
        f: Callable[[Floats, Floats], Floats], hold: bool, most: int | None = None
    ) -> tuple[Floats, Floats] | None:
        """Return state and free inputs where f is zero; None if none were found."""
        rest, w = _zero(lambda y: f(y, given), z, most), given
        for guess in guesses if hold else ():
            if rest is not None and away(rest) <= AT_START:
                break
            held = _least(partial(f, z), guess, most)
            other = _zero(lambda y, held=held: f(y, held), z, most)  # type: ignore[misc]
            if other is not None and (rest is None or away(other) < (1.0 - NEARER) * away(rest)):
                rest, w = other, held
        for guess in guesses:
            if (
                rest is None
                and (both := _zero(lambda j: f(j[:n], j[n:]), np.concatenate([z, guess]), most)) is not None
            ):
                rest, w = both[:n], both[n:]
        return None if rest is None else (rest, w)

    with np.errstate(over="ignore", invalid="ignore"):
        if np.abs(change(z, given)).max(initial=0.0) <= 1e-9:
            return x, u, None
        still = np.array([not (change(z + step, given) - change(z - step, given)).any() for step in 0.1 * np.eye(n)])
    if (found := nearest(change, not stated)) is not None:
        return found[0] * size, put(found[1]), None
    if still.any() and (rest := _zero(lambda y: without(still, y, given), z)) is not None:
        return rest * size, u, np.where(still, residual(rest * size, u), 0.0)

    def rates() -> dict[int, float]:
        """Return the rate of each state that alone prevents a steady state, with the others at rest."""
        found = {}
        start = np.concatenate([z, *guesses[-1:]])
        nearly = _least(lambda j: without(still, j[:n], j[n:]), start, FEW)
        with np.errstate(all="ignore"):
            left = np.abs(without(still, nearly[:n], nearly[n:]))
        for i in [i for i in np.argsort(-left)[:TRIED].tolist() if left[i] > 0]:
            if (point := nearest(partial(without, still | (np.arange(n) == i)), True, FEW)) is not None:
                found[i] = float(change(*point)[i])
        return found

    any_inputs = " and with any actuated inputs" if len(free) else ""
    raise ModelError(
        f"No steady state was found near the start, even without integrators on which nothing depends{any_inputs}. "
        f"{_changing(rates(), size, names, per)}Give other start values, or other inputs (at=...). {NEVER_RESTS}"
    )


def _changing(rates: dict[int, float], size: Floats, names: Sequence[str], per: str) -> str:
    """Return a sentence about states, each of which changes if all others rest; those that change least come first."""
    least = sorted((i for i, rate in rates.items() if np.isfinite(rate)), key=lambda i: abs(rates[i]))[:NAMED]
    if not least:
        return ""
    each = [f"{names[i] if names else f'x[{i}]'} changes by {rates[i] * size[i]:.3g}" for i in least]
    return f"With all other states at rest, {each[0]} in a {per}{''.join(f', or {text}' for text in each[1:])}. "


def _zero(f: Callable[[Floats], Floats], start: Floats, most: int | None = None) -> Floats | None:
    """Return where f is zero near a start; None if nowhere."""
    found = _least(f, start, most)
    with np.errstate(all="ignore"):
        return found if np.abs(f(found)).max() <= 1e-8 else None


def _least(f: Callable[[Floats], Floats], start: Floats, most: int | None = None) -> Floats:
    """Return where f is smallest near a start; the start if f is not finite there."""
    from scipy.optimize import least_squares

    try:
        with np.errstate(all="ignore"):
            return np.asarray(least_squares(f, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=most).x)
    except (ValueError, np.linalg.LinAlgError):
        return start
