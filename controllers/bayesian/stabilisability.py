"""Which modes of a model no control moves and no sensor sees, by Popov, Belevitch and Hautus."""

from __future__ import annotations

import numpy as np

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

_EDGE = 1e-9
"""A mode within this distance of the unit circle, or outside it, does not die out by itself."""

_REACH = 1e-9
"""A mode whose reach is smaller than this, relative to the model's own size, is out of reach."""


def unreached(A: Floats, B: Floats, *, edge: float = _EDGE) -> list[complex]:
    """Return the eigenvalues of A, each that does not die out, at which [lambda I - A, B] loses rank."""
    from scipy.linalg import matrix_balance

    # In units in which the states move each other alike, and each control as much as they do: no choice of units decides. Where
    # states hardly move each other these may be as far apart as 1e27: then the mode must be out of reach in its own units, too.
    with np.errstate(invalid="ignore"):  # of a permutation that SciPy reads out of the scales and nobody asked for
        balanced, (units, _) = matrix_balance(A, permute=False, separate=True)
    forms = [(balanced, B / units[:, None]), (A, B)]
    return [
        complex(e) for e in np.linalg.eigvals(balanced) if abs(e) >= 1.0 - edge and all(_misses(e, *f) for f in forms)
    ]


def _misses(eigenvalue: complex, A: Floats, B: Floats) -> bool:
    size, columns = max(float(np.abs(A).max()), 1.0), np.linalg.norm(B, axis=0)
    reach = B * (size / np.where(columns > 0, columns, 1.0))
    smallest = np.linalg.svd(np.hstack([eigenvalue * np.eye(len(A)) - A, reach]), compute_uv=False)[-1]
    return bool(smallest <= _REACH * size)


def refuse_unstabilisable(model: LinearModel) -> None:
    """Refuse a model in which a mode that does not die out is moved by no control.

    Raises
    ------
    ModelError
        That names the mode by its eigenvalue.
    """
    plant = model.states - model.disturbances
    lost = unreached(model.matrix("A")[:plant, :plant], model.matrix("B")[:plant])
    if lost:
        raise ModelError(
            f"The model cannot be stabilised: no control moves {_modes(lost)}. Actuate a further input, or leave the part of the "
            "plant to which this belongs out of the model."
        )


def refuse_undetectable(model: LinearModel) -> None:
    """Refuse a model in which a mode that does not die out is seen by no sensor.

    Raises
    ------
    ModelError
        That names the mode by its eigenvalue.
    """
    moving = model.moving
    lost = unreached(moving.matrix("A").T, moving.matrix("C").T)
    if lost:
        more = (
            " If it is an estimated disturbance, there are more of them than the sensors can tell apart."
            if model.disturbances
            else ""
        )
        raise ModelError(
            f"The model cannot be estimated: no sensor sees {_modes(lost)}. Measure a further output of the plant.{more}"
        )


def refuse_unseen_by_goal(A: Floats, H: Floats) -> None:
    """Refuse goals that do not see a mode on the unit circle: nothing would be paid for its going on for ever.

    Raises
    ------
    ModelError
        That names the mode by its eigenvalue.
    """
    lost = [mode for mode in unreached(A.T, H.T) if abs(abs(mode) - 1.0) <= 1e-6]
    if lost:
        raise ModelError(
            f"The goals do not see {_modes(lost)}: it would go on for ever at no cost. Set a goal for a further output."
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
        what = (
            "stays"
            if abs(grows) < 1e-6
            else f"grows by {100 * grows:.3g} % a sample"
            if grows > 0
            else "hardly dies out"
        )
        words.append(f"the mode with the eigenvalue {shown(e)}{pair}, which {what}")
    return " and ".join(words)
