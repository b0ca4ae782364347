"""Loads, and losses of a control's effect, that begin during a run, and may end again.

Each is a push of the state between two instants. Responses to pushes are linear, so that the one between two instants is the
difference of two that last to the end. Normal equations of those at all instants therefore judge all pairs of instants.

An observer that estimates a load follows it within some samples. The evidence for a load then has narrow peaks at its begin and
its end, between the instants of a coarse search. The instants at which it is largest are therefore searched as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.judge import Explanation, Judge

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.cosim.types import Floats

TIMES = 24
"""Number of instants in the coarse search."""

FINE = 13
"""Number of instants about each one of the coarse search."""

LIKELY = 8
"""Number of instants with the most evidence for a load that begins there."""

LEAST_PUSHED = 8
"""Least number of samples of a push."""


def changes(judge: Judge) -> list[Explanation]:
    """Return the best load that begins during the run, and the best loss of effect; none without a control."""
    model, steps = judge.model, len(judge.recording.u)
    width, last = max(1, steps // (TIMES + 1)), steps - LEAST_PUSHED
    regular = range(width, last + 1, width)
    if not np.any(model.B) or not regular:
        return []
    instants = sorted({*regular, *(k for k in _likely(judge) if 1 <= k <= last)})
    coarse = _Pushes(judge, instants)
    return [
        _explained(judge, kind, _finer(judge, kind, best, width))
        for kind in ("onset", "loss")
        if (best := coarse.best(kind)) is not None
    ]


def _likely(judge: Judge) -> list[int]:
    """Return the instants with the most evidence for a load that begins there and lasts, apart from each other.

    The response to a load from an instant on is taken for that from the first sample on, shifted.
    """
    steps = len(judge.recording.u)
    loads = judge.pushes(np.repeat(judge.model.matrix("B").T[:, np.newaxis], steps, axis=1))
    moments, squares = np.zeros((2, loads.shape[1], steps))
    for k, chosen in enumerate(judge.bank.sensors):
        e = np.zeros((steps, len(chosen)))
        e[judge.masks[k]] = judge.free(judge.base, k, judge.begin)[0].reshape(-1, len(chosen))
        responses = loads[k][:, :, list(chosen)]
        shifts, errors = (
            np.fft.rfft(of, 2 * steps, axis=-2) for of in (responses, e)
        )  # twice as long: no wrapping around
        moments += np.fft.irfft(np.conj(shifts) * errors, axis=1)[:, :steps].sum(axis=2)
        squares += np.cumsum((responses**2).sum(axis=2), axis=1)[:, ::-1]
    evidence = np.max(moments**2 / np.maximum(squares, 1e-300), axis=0)
    found: list[int] = []
    while len(found) < LIKELY and np.max(evidence) > 0.0:  # never with NaN, of a plant that is lost
        found.append(int(np.argmax(evidence)))
        evidence[max(found[-1] - LEAST_PUSHED, 0) : found[-1] + LEAST_PUSHED + 1] = 0.0
    return found


def _finer(judge: Judge, kind: str, best: _Found, width: int) -> _Found:
    """Return the best push with instants near those of another one, to the sample."""
    last = len(judge.recording.u) - LEAST_PUSHED
    while width > 1:
        grids = [np.linspace(k - width + 1, k + width - 1, FINE).round().astype(int) for k in best.instants]
        near = {int(k) for k in np.concatenate(grids) if 1 <= k <= last}
        best = _Pushes(judge, sorted(near | set(best.instants))).best(kind, best.columns) or best
        width = max(1, 2 * width // (FINE - 1))
    return best


@dataclass(frozen=True)
class _Found:
    """A push: its instants (begin, and end unless it lasts), its columns, their sizes, and its costs.

    ``products`` are those of the responses to pushes along B, and to its own.
    """

    instants: tuple[int, ...]
    columns: tuple[int, ...]
    sizes: Floats
    products: Floats
    losses: Floats
    squares: Floats

    @property
    def parameters(self) -> int:
        """Number of fitted parameters."""
        return len(self.instants) + len(self.sizes)

    @property
    def load(self) -> Floats:
        """The push along B with the response most like this one: a value for each control."""
        p = len(self.products) - len(self.sizes)
        response = self.products[:p, p:] @ self.sizes
        return np.asarray(_solved(self.products[np.newaxis, :p, :p], response[np.newaxis])[0])


class _Pushes:
    """The normal equations of pushes from each of some instants to the end: along B, along each state, and of each control."""

    def __init__(self, judge: Judge, instants: Sequence[int]):
        model, u = judge.model, judge.recording.u
        p, plant = model.controls, model.plant_states
        B = model.matrix("B").T
        constant = np.vstack([B, np.eye(model.states)[:plant]])[:, np.newaxis, :] * np.ones((1, len(u), 1))
        kinds = np.concatenate([constant, u.T[:, :, np.newaxis] * B[:, np.newaxis, :]])
        late = np.arange(len(u))[:, np.newaxis] >= np.array([[k] for k in instants])[:, :, np.newaxis]
        self.judge, self.instants, self.each = judge, list(instants), len(kinds)
        along, states, controls = np.split(np.arange(self.each), [p, p + plant])
        self.columns = {"onset": [tuple(along), tuple(states)], "loss": [(int(j),) for j in controls]}
        self.along = along
        responses = judge.pushes((late[:, np.newaxis] * kinds).reshape(-1, *kinds.shape[1:]))
        self.sets = [self._equations(responses, k) for k in range(len(judge.bank))]

    def _equations(self, responses: Floats, k: int) -> tuple[Floats, Floats, float, int]:
        """Return products of the responses with each other and with the innovations, the latter's square, and their number."""
        with np.errstate(all="ignore"):  # of a plant that is lost; what is not finite explains nothing
            D, e = (self.judge.free(of, k, self.judge.begin) for of in (responses, self.judge.base))
            return D @ D.T, D @ e[0], float(e[0] @ e[0]), e.shape[1]

    def best(self, kind: str, columns: tuple[int, ...] | None = None) -> _Found | None:
        """Return the push of a kind with the most evidence: one that lasts to the end, or one between two instants."""
        places = range(len(self.instants))
        pairs = [(i, j) for i, j in combinations(places, 2) if self.instants[j] - self.instants[i] >= LEAST_PUSHED]
        found = [
            push
            for group in (self.columns[kind] if columns is None else [columns])
            for ends in ([(i,) for i in places], pairs)
            if ends and (push := self._best(np.array(ends), group)) is not None
        ]
        counts = [0.5 * np.log(mask.sum()) for mask in self.judge.masks]
        return min(found, key=lambda x: float(x.losses.sum() + x.parameters * sum(counts)), default=None)

    def _best(self, ends: NDArray[np.intp], group: tuple[int, ...]) -> _Found | None:
        """Fit the columns of a group between pairs of instants, or from each of some on; return the push with the least loss.

        None if they explain nothing finite.
        """
        places = self.each * ends[:, :, np.newaxis] + np.array([*self.along, *group])
        rows, columns = places[:, :, :, np.newaxis, np.newaxis], places[:, np.newaxis, np.newaxis]
        signs, own = np.array([1.0, -1.0])[: ends.shape[1]], slice(len(self.along), None)
        products = [np.einsum("i,kiajb,j->kab", signs, G[rows, columns], signs) for G, *_ in self.sets]
        moments = [np.einsum("i,kia->ka", signs, b[places]) for _, b, *_ in self.sets]
        whole, right = np.sum(products, axis=0), np.sum(moments, axis=0)
        finite = np.isfinite(whole).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        ends, whole = ends[finite], whole[finite]
        sizes = -_solved(whole[:, own, own], right[finite][:, own])
        squares = np.array([
            (c + 2.0 * np.einsum("ka,ka->k", sizes, moment[finite][:, own])
             + np.einsum("ka,kab,kb->k", sizes, product[finite][:, own, own], sizes)) / n
            for product, moment, (_, _, c, n) in zip(products, moments, self.sets, strict=True)
        ])  # fmt: skip
        possible = (squares > 0.0).all(axis=0)
        if not possible.any():
            return None
        losses = self.judge.losses(squares)
        i = int(np.argmin(np.where(possible, losses.sum(axis=0), np.inf)))
        instants = tuple(self.instants[k] for k in ends[i])
        return _Found(instants, group, sizes[i], whole[i], losses[:, i], squares[:, i])


def _solved(G: Floats, b: Floats) -> Floats:
    """Return the solutions of normal equations, the smallest of several, in units in which each column has length 1."""
    lengths = np.sqrt(np.maximum(np.diagonal(G, axis1=1, axis2=2), 1e-300))
    scaled = G / (lengths[:, :, np.newaxis] * lengths[:, np.newaxis])
    solution: Floats = (
        np.einsum("kab,kb->ka", np.linalg.pinv(scaled, rcond=1e-10, hermitian=True), b / lengths) / lengths
    )
    return solution


def _explained(judge: Judge, kind: str, found: _Found) -> Explanation:
    step = float(judge.model.step)
    begin, end = found.instants[0] * step, found.instants[1] * step if len(found.instants) > 1 else float("inf")
    if kind == "onset":
        values = begin, end, *map(float, found.load)
    else:
        control = found.columns[0] - judge.model.controls - judge.model.plant_states
        values = begin, end, 1.0 + float(found.sizes[0]), float(control)
    return judge.of(kind, [values], (found.losses[:, np.newaxis], found.squares[:, np.newaxis]), found.parameters)[0]


__all__ = ["changes"]
