"""Linear systems as plain numbers: converted from python-control, and discretised."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import with_article
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class LinearSystem:
    """A linear system as plain numbers: ``dx/dt`` (or the next ``x``) is ``A x + B u``, and ``y = C x + D u``.

    Objects of python-control hold functions and cannot be sent to another process; this class can.

    Attributes
    ----------
    A, B, C, D : tuple of tuple of float
        Matrices of n x n, n x m, p x n and p x m numbers, for n states, m inputs and p outputs.
    dt : float, True or None
        0 for continuous time, a sample time in seconds, True for discrete time with any sample time, None for a system without
        states, which does not depend on time.
    input_names, output_names : tuple of str
        Names of the signals.
    state_names : tuple of str
        Names of the states; empty if they have none.
    """

    A: Rows
    B: Rows
    C: Rows
    D: Rows
    dt: float | None
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    state_names: tuple[str, ...] = ()

    def matrices(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A, B, C and D as arrays."""
        n, m, p = len(self.A), len(self.input_names), len(self.output_names)
        shapes = ((self.A, (n, n)), (self.B, (n, m)), (self.C, (p, n)), (self.D, (p, m)))
        a, b, c, d = (np.array(rows, dtype=np.float64).reshape(shape) for rows, shape in shapes)
        return a, b, c, d


def is_system(value: Any) -> bool:
    """Return whether a value is a system of python-control, without importing that package for other values."""
    return any(kind.__module__.partition(".")[0] == "control" for kind in type(value).__mro__)


def normalised(system: Any) -> Any:
    """Return a `LinearSystem` for a linear system of python-control, and a nonlinear system as it is.

    Raises
    ------
    ModelError
        If it is not such a system, has no definite time base, or has matrices that are not finite.
    """
    import control

    if isinstance(system, control.TransferFunction):
        names, dt = signal_names(system), system.dt
        try:
            converted = _entry_by_entry(system)
        except Exception as error:  # noqa: BLE001 - python-control raises the errors of its backend
            reason = str(error).strip().removesuffix(".")
            raise ModelError(
                f"The transfer function cannot be converted to a state space: {reason}. Make it proper, or give a state space."
            ) from None
    elif isinstance(system, control.StateSpace):
        names, dt, converted = signal_names(system), system.dt, system
    elif isinstance(system, control.NonlinearIOSystem):
        if system.dt is None:
            raise ModelError("The system has dt=None; give it dt=0 (continuous time) or its sample time in seconds.")
        if not system.noutputs:
            raise ModelError(
                "The number of outputs of the nonlinear system is not known; give it outputs=... (and inputs, states)."
            )
        return system
    else:
        raise ModelError(
            f"StateSpace takes a StateSpace, TransferFunction or NonlinearIOSystem of python-control, "
            f"not {with_article(type(system).__name__)}."
        )
    if dt is None and converted.nstates:
        raise ModelError("The system has dt=None; give it dt=0 (continuous time) or its sample time in seconds.")
    a, b, c, d = (np.asarray(m, dtype=np.float64) for m in (converted.A, converted.B, converted.C, converted.D))
    if not all(np.isfinite(matrix).all() for matrix in (a, b, c, d)):
        raise ModelError("The system has matrices with NaN or infinite elements; all must be finite.")
    dt = dt if dt is None or dt is True else float(dt)
    states = tuple(system.state_labels) if converted is system else ()
    return LinearSystem(as_rows(a), as_rows(b), as_rows(c), as_rows(d), dt, *names, states)


def _entry_by_entry(system: Any) -> Any:
    """Return the state space of a transfer function; for a matrix of them, with the states of each entry, row by row.

    python-control can convert such a matrix only with Slycot, a Fortran library that few users have.
    """
    import control
    from scipy.linalg import block_diag

    if system.issiso():
        return control.ss(system)
    rows, columns = system.noutputs, system.ninputs
    parts = [[control.ss(system[i, j]) for j in range(columns)] for i in range(rows)]
    each = [(i, j, parts[i][j]) for i in range(rows) for j in range(columns)]
    unit_in, unit_out = np.eye(columns), np.eye(rows)
    b = [part.B @ unit_in[j : j + 1] for _, j, part in each]
    c = [unit_out[:, i : i + 1] @ part.C for i, _, part in each]
    d = np.block([[part.D for part in row] for row in parts])
    return control.ss(block_diag(*(part.A for *_, part in each)), np.vstack(b), np.hstack(c), d, system.dt)


def signal_names(system: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of a system's inputs and outputs."""
    return _named(system.input_labels, "u"), _named(system.output_labels, "y")


def _named(labels: Sequence[str], letter: str) -> tuple[str, ...]:
    """Return the labels, with python-control's default ``u[0]`` as ``u`` or ``u0``, because brackets mean elements here."""
    if all(re.fullmatch(rf"{letter}\[\d+\]", label) for label in labels):
        return (letter,) if len(labels) == 1 else tuple(f"{letter}{i}" for i in range(len(labels)))
    return tuple(labels)


def as_rows(matrix: Floats) -> Rows:
    """Return a matrix as plain numbers, row by row."""
    return tuple(tuple(row) for row in matrix.tolist())


def held(a: Floats, b: Floats, h: float) -> tuple[Floats, Floats]:
    """Return the matrices A and B of a step of `h` seconds with the inputs held; one matrix exponential gives both."""
    from scipy.linalg import expm

    n = len(a)
    block = np.zeros((n + b.shape[1],) * 2)
    block[:n, :n], block[:n, n:] = a, b
    exponential: Floats = expm(block * h)
    return exponential[:n, :n], exponential[:n, n:]


__all__ = ["LinearSystem"]
