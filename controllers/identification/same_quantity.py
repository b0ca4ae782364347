"""Outputs of a recording that measure one quantity: their common reading is identified, and each keeps its own noise.

The common reading is the mean of the present sensors, weighted by their precisions. Of sensors with white noise it contains all
that they say about the state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fitting.offsets import PARTS, STEADY, levels_of_parts
from bayesftc.cosim.run.tables import named_columns
from bayesftc.cosim.statistics._whiteness import FEW
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

    from bayesftc.controllers.models.linear import LinearModel

LEAST = 1e-3
"""Smallest variance of a sensor's noise, as a share of the largest one of its quantity; estimates of less are chance."""

APART = 0.5
"""Difference between the readings of sensors of one quantity, in standard deviations of their noise, that is reported."""


@dataclass(frozen=True, eq=False)
class Quantities:
    """Which columns measure which quantity.

    Attributes
    ----------
    columns : list of str
        All columns of outputs.
    names : list of str
        The quantities; a column without others of its kind is a quantity of its name.
    of : ndarray of int
        The number of the quantity of each column.
    """

    columns: list[str]
    names: list[str]
    of: np.ndarray[tuple[int], np.dtype[np.int64]]

    @property
    def shared(self) -> dict[str, tuple[str, ...]]:
        """The columns of each quantity that several of them measure."""
        return {self.names[self.of[places[0]]]: tuple(self.columns[i] for i in places) for places in self._groups()}

    @property
    def named(self) -> dict[str, tuple[str, ...]]:
        """The columns of each quantity that has a name of its own."""
        every = {name: tuple(np.array(self.columns)[self.of == q].tolist()) for q, name in enumerate(self.names)}
        return {name: columns for name, columns in every.items() if columns != (name,)}

    @property
    def alone(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Whether each column is the only one of its quantity."""
        return np.asarray(np.bincount(self.of)[self.of] == 1)

    def noise(self, y: Floats) -> Floats:
        """Return the variance of each sensor's noise from its differences to the others of its quantity; 1 without others."""
        variances = np.ones(len(self.columns))
        for places in self._groups():
            variances[places] = _noise(y[:, places], [self.columns[i] for i in places])
        return variances

    def weights(self, noise: Floats) -> Floats:
        """Return the weights of the sensors in the common reading of each quantity (quantities x sensors)."""
        weights = np.equal.outer(np.arange(len(self.names)), self.of) / noise
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def fused(self, y: Floats, weights: Floats) -> Floats:
        """Return the common reading of each quantity, from the sensors that have a sample; NaN if none has one."""
        if not self.shared:
            return y
        present = np.isfinite(y)
        total = present @ weights.T
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(present, y, 0.0) @ weights.T / np.where(total > 0, total, np.nan))

    def fused_noise(self, y: Floats, noise: Floats) -> Floats:
        """Return the mean variance of the noise of each common reading, which grows while sensors have no sample."""
        precisions = np.isfinite(y) @ (np.equal.outer(self.of, np.arange(len(self.names))) / noise[:, None])
        with np.errstate(divide="ignore"):
            return np.asarray(np.nanmean(np.where(precisions > 0, 1.0 / precisions, np.nan), axis=0))

    def innovations(self, K: Floats, S: Floats, noise: Floats, fused: Floats) -> tuple[Floats, Floats]:
        """Return gain and covariance of the innovations of all sensors from those of the common readings, `K` and `S`.

        A sensor's innovation is that of the quantity without the noise of its common reading (`fused`), and its own noise.
        """
        alone = np.bincount(self.of) == 1  # then all of the innovation counts as that of the quantity
        values, vectors = np.linalg.eigh(S - np.diag(np.where(alone, 0.0, fused)))
        common = (vectors * np.maximum(values, 0.0)) @ vectors.T
        whole = common[np.ix_(self.of, self.of)] + np.diag(np.where(self.alone, 0.0, noise))
        return np.asarray(np.linalg.solve(whole, (K @ S)[:, self.of].T).T), whole

    def deviations(self, y: Floats, split: int, weights: Floats, noise: Floats) -> dict[str, list[str]]:
        """Return, for each quantity with such sensors, sentences about those whose reading is not the common one.

        A difference counts if it is there in the whole recording, or in the held-out part, from the row `split` on.
        """
        found: dict[str, list[str]] = {}
        off = y - self.fused(y, weights)[:, self.of]
        for places in self._groups():
            levels, held = (levels_of_parts(off[begin:, places]) for begin in (0, split))
            name, scatter = self.names[self.of[places[0]]], _scatter(y[:, places])
            common = f"the {'mean' if len(places) == 2 else 'median'} of the sensors of {name}"
            for i, own, late, most in zip(places, levels.T, held.T, scatter, strict=True):
                typical = [abs(of(part)) for part in (own, late) if len(part) for of in (np.mean, np.median)]
                if len(own) and max(typical) > APART * min(noise[i] ** 0.5, most):
                    found.setdefault(name, []).append(f"{self.columns[i]}: {_deviation(own, common)}")
        return found

    def _groups(self) -> list[list[int]]:
        every = (np.flatnonzero(self.of == q).tolist() for q in range(len(self.names)))
        return [places for places in every if len(places) > 1]


def _deviation(levels: Floats, common: str) -> str:
    """Return a sentence about what a sensor reads more than the common reading, in parts of the recording."""
    level = float(np.median(levels))
    if np.std(levels) < STEADY * abs(level):
        return (
            f"reads {abs(level):.3g} {'more' if level > 0 else 'less'} than {common} (median over ten parts of the recording). "
            "Subtract that from the column, or name it as another quantity."
        )
    return (
        f"its difference from {common} changes: in ten parts of the recording it is from {levels.min():.3g} to "
        f"{levels.max():.3g}. A sensor drifts, or has failed for a while, so do not subtract a constant. Empty its cells in this "
        "time, identify another stretch, or name it as another quantity."
    )


def quantities_of(table: pd.DataFrame, outputs: str | Sequence[str] | Mapping[str, str | Sequence[str]]) -> Quantities:
    """Return the columns of outputs, with the quantities that a mapping names.

    Raises
    ------
    ModelError
        If a column is given twice.
    """
    if not isinstance(outputs, Mapping):
        columns = named_columns(table, outputs, "output")
        return Quantities(columns, columns, np.arange(len(columns)))
    if not outputs:
        raise ModelError("outputs={}; give at least one quantity with its columns.")
    members = [named_columns(table, columns, "output") for columns in outputs.values()]
    columns = [column for columns in members for column in columns]
    twice = [column for column in dict.fromkeys(columns) if columns.count(column) > 1]
    if twice:
        raise ModelError(f"The outputs name the column {twice[0]!r} twice; give each column once.")
    return Quantities(
        columns, list(map(str, outputs)), np.repeat(np.arange(len(members)), [len(each) for each in members])
    )


def similar(model: LinearModel, columns: Sequence[str]) -> str:
    """Return a sentence about outputs that move so alike that they may measure one quantity; empty if there are none."""
    n, C, R = model.plant_states, model.undelayed.matrix("C"), np.diag(model.matrix("sensor_covariance"))
    groups: list[list[int]] = []
    for i in range(len(columns)):
        group = next((group for group in groups if _similar(C[group[0]], C[i], n, R[group[0]] + R[i])), None)
        if group is None:
            groups.append([i])
        else:
            group.append(i)
    several = [group for group in groups if len({model.quantity[i] for i in group}) > 1]
    if not several:
        return ""
    names = [columns[i] for i in several[0]]
    return (
        f"{', '.join(names)} move alike. If they measure one quantity, name it, so that they count as redundant: "
        f"outputs={{'quantity': {names}}}."
    )


def _similar(a: Floats, b: Floats, n: int, noise: float) -> bool:
    """Return whether two rows of C, whose states have unit variance, differ by less than the noise and hardly at all."""
    difference, size = np.linalg.norm(a[:n] - b[:n]), min(np.linalg.norm(a[:n]), np.linalg.norm(b[:n]))
    small = APART * noise**0.5
    return bool(difference < min(small, 0.1 * size) and abs(a[n:] - b[n:]).sum() < small)


def _noise(y: Floats, names: Sequence[str]) -> Floats:
    """Return the variances of the noise of sensors of one quantity, whose pairwise sums are those of their differences.

    The method is that of Grubbs (J. Am. Stat. Assoc. 43, 1948). Two sensors have one difference. What they do not share from
    sample to sample then divides its variance among them.
    """
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    rows, sums = np.zeros((len(pairs), len(names))), np.zeros(len(pairs))
    for row, (i, j) in enumerate(pairs):
        difference = y[:, i] - y[:, j]
        if np.isfinite(difference).sum() < FEW:
            raise ModelError(
                f"The columns {names[j]!r} and {names[i]!r} are sensors of one quantity, but fewer than {FEW} rows for learning "
                "have samples of both. Record more, or name them as two quantities."
            )
        rows[row, [i, j]], sums[row] = 1.0, np.nanvar(difference)
    if len(names) == 2:
        found = sums[0] * _shares(y)
    else:
        found = np.linalg.lstsq(rows, sums, rcond=None)[0]
    return np.asarray(np.maximum(found, LEAST * found.max()))


def _scatter(y: Floats) -> Floats:
    """Return the most that the noise of sensors of one quantity has (standard deviation), without outliers; infinite if unknown.

    A value that stands for a missing sample, such as -9999, makes the variance of the noise very large.
    """
    together = y[np.isfinite(y).all(axis=1)]
    if len(together) < FEW:
        return np.full(y.shape[1], np.inf)
    off = together - np.median(together, axis=1, keepdims=True)
    within = np.concatenate([np.abs(part - np.median(part, axis=0)) for part in np.array_split(off, PARTS)])
    # Half the difference of two sensors has at least half the standard deviation of each.
    found = 2.0 * MAD * np.median(within, axis=0)
    return np.where(found > 0.0, found, np.inf)


def _shares(y: Floats) -> Floats:
    """Return the shares of two sensors in the variance of their difference."""
    moves = np.diff(y, axis=0)
    moves = moves[np.isfinite(moves).all(axis=1)]
    if len(moves) < FEW:
        return np.full(2, 0.5)
    V = np.cov(moves.T)
    own = np.maximum(np.diag(V) - V[0, 1], LEAST * np.trace(V))
    return np.asarray(own / own.sum())
