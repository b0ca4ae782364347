"""Tests by Popov, Belevitch and Hautus for modes of a model that no control moves or no sensor sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.control.balance import balanced
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

Poles = NDArray[np.complex128]

_EDGE = 1e-9
"""A mode within this distance of the unit circle, or outside it, counts as not decaying."""

_NEAR = 1e-6
"""Distance of a pole from a mode that no control moves, up to which it is that of the mode."""

_REACH = 1e-9
"""A mode whose reach is smaller than this, relative to the model's size, counts as unreached."""


def unreached(A: Floats, B: Floats, *, edge: float = _EDGE) -> list[complex]:
    """Return the eigenvalues of A that do not decay and at which [lambda I - A, B] loses rank."""
    # In balanced units the states and controls have effects of equal size, so that the result does not depend on the user's
    # units. Balanced units of weakly coupled states may differ by 1e27; the mode must then be unreached in the user's units, too.
    same, units = balanced(A)
    forms = [(same, B / units[:, None]), (A, B)]
    return [complex(e) for e in np.linalg.eigvals(same) if abs(e) >= 1.0 - edge and all(_misses(e, *f) for f in forms)]


def without_modes(poles: Poles, modes: list[complex]) -> tuple[Poles, list[complex]]:
    """Return a loop's poles without those of modes that no control moves, and these modes.

    Of a repeated eigenvalue the control may move one copy, which is then no pole of the loop.
    """
    still = []
    for mode in modes:
        apart = np.abs(poles - mode)
        if apart.min(initial=np.inf) < _NEAR:
            poles = np.delete(poles, np.argmin(apart))
            still.append(mode)
    return poles, still


def _misses(eigenvalue: complex, A: Floats, B: Floats) -> bool:
    size, columns = max(float(np.abs(A).max()), 1.0), np.linalg.norm(B, axis=0)
    reach = B * (size / np.where(columns > 0, columns, 1.0))
    smallest = np.linalg.svd(np.hstack([eigenvalue * np.eye(len(A)) - A, reach]), compute_uv=False)[-1]
    return bool(smallest <= _REACH * size)


def refuse_unstabilisable(model: LinearModel) -> None:
    """Refuse a model with a mode that does not decay and that no control moves.

    Raises
    ------
    ModelError
        With the eigenvalue of the mode.
    """
    plant = model.states - model.disturbances
    lost = unreached(model.matrix("A")[:plant, :plant], model.matrix("B")[:plant])
    if lost:
        raise ModelError(
            f"The model cannot be stabilised: no control moves {_modes(lost)}. Actuate a further input, or leave that part of "
            "the plant out of the model. A load that lasts may have a long lag instead of an integrator, or be estimated as a "
            "disturbance of the control (disturbance=True in design)."
        )


def refuse_undetectable(model: LinearModel) -> None:
    """Refuse a model with a mode that does not decay and that no sensor sees.

    Raises
    ------
    ModelError
        With the eigenvalue of the mode.
    """
    moving = model.moving
    lost = unreached(moving.matrix("A").T, moving.matrix("C").T)
    if lost:
        more = (
            " If it is an estimated disturbance, there are more of them than the sensors can distinguish."
            if model.disturbances
            else ""
        )
        raise ModelError(
            f"The model cannot be estimated: no sensor sees {_modes(lost)}. Measure a further output of the plant.{more}"
        )


def refuse_unseen_by_goal(A: Floats, H: Floats) -> None:
    """Refuse goals that do not see a mode on the unit circle: it would never decay and cost nothing.

    Raises
    ------
    ModelError
        With the eigenvalue of the mode.
    """
    lost = [mode for mode in unreached(A.T, H.T) if abs(abs(mode) - 1.0) <= 1e-6]
    if lost:
        raise ModelError(
            f"The goals do not see {_modes(lost)}. The control would never damp it; set a goal for a further output."
        )


def shown(eigenvalue: complex) -> str:
    """Return an eigenvalue as text."""
    if abs(eigenvalue.imag) < 1e-12:
        return f"{eigenvalue.real:.6g}"
    return f"{eigenvalue.real:.6g}{eigenvalue.imag:+.6g}j"


def _modes(eigenvalues: list[complex]) -> str:
    upper = [e for e in eigenvalues if e.imag >= 0] or eigenvalues
    words = []
    for e in sorted(set(np.round(upper, 9)), key=abs, reverse=True):
        pair = " and its conjugate" if abs(e.imag) > 1e-12 else ""
        grows = abs(e) - 1.0
        behaviour = (
            "stays" if abs(grows) < 1e-6 else f"grows by {100 * grows:.3g} % a sample" if grows > 0 else "hardly decays"
        )
        words.append(f"the mode with the eigenvalue {shown(e)}{pair}, which {behaviour}")
    return " and ".join(words)
