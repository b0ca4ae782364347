"""Loads, and losses of a control's effect, that begin during a run, and may end again.

Each is a push of the state between two instants. Responses to pushes are linear, so that the one between two instants is the
difference of two that last to the end. Normal equations of those at all instants therefore judge all pairs of instants.

An observer that estimates a load follows it within some samples. The evidence for a load then has narrow peaks at its begin and
its end, between the instants of a coarse search. The instants at which it is largest are therefore searched as well.

Two loads are tried together where one has evidence. Found one after the other, the first one would cover both: a load of 2 and
one of -3 some time later look like a single one from the begin of the first to the begin of the second.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.judge import EVIDENCE, EXPLAINED, Explanation, Judge

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

STUCK = 0.2
"""Largest part of a control's effect that is left, with either sign, of an actuator that is stuck."""

LEAST_LOSS = 0.05
"""A change of a control's effect by a smaller share is none. Where the control is far from zero, as an absolute temperature, a
load looks like a change by 1 %."""

ROUNDS = 2
"""Number of times that each of two loads is fitted anew beside the other, at each width of the fine search."""

AT_ONCE = 5_000
"""Number of pushes that are fitted at once, for memory."""


def changes(judge: Judge, others: Sequence[Explanation] = ()) -> list[Explanation]:
    """Return the best load that begins during the run, or two, and the best losses of effect; none without a control.

    A loss is that of a part, or of all of an actuator that is stuck somewhere. Two loads are not tried where one number explains
    all, better than one load: among `others`.
    """
    model, steps = judge.model, len(judge.recording.u)
    width, last = max(1, steps // (TIMES + 1)), steps - LEAST_PUSHED
    regular = range(width, last + 1, width)
    if not np.any(model.B) or not regular:
        return []
    likely = [k for k in _likely(judge) if 1 <= k <= last]
    coarse = _Pushes(judge, sorted({*regular, *likely}))
    results = []
    for kind in ("onset", "loss"):
        if (best := coarse.best(kind)) is None:
            continue
        elsewhere = kind == "onset" and best.columns != coarse.along
        acting = coarse.best(kind, coarse.along) if elsewhere else None
        one = _placed(judge, kind, best, acting, width)
        if kind == "onset" or abs(one.values[2] - 1.0) >= LEAST_LOSS:
            results.append(one)
        if kind == "onset" and one.total > EVIDENCE and not any(_explains(x) and x.total > one.total for x in others):
            among = {*regular[::2], *likely}
            if (pair := coarse.best_two(coarse.columns[kind][1:] if elsewhere else [coarse.along], among)) is not None:
                acting = coarse.best_two([coarse.along], among) if elsewhere else None
                two = _placed(judge, kind, pair, acting, 2 * width)
                results += [two] * _pays(two, one)
    lost = any(x.kind == "loss" and x.total > EVIDENCE for x in results)
    if lost and (best := coarse.best("stuck")) is not None:
        stuck = _placed(judge, "stuck", best, None, width)
        results += [stuck] * (abs(stuck.values[2]) < STUCK)
    return results


def _placed(judge: Judge, kind: str, best: _Found, acting: _Found | None, width: int) -> Explanation:
    """Return the explanation by pushes that may act anywhere, and whether they act elsewhere than the best ones along B."""
    found = _explained(judge, kind, _finer(judge, kind, best, width))
    if acting is None:
        return found
    by_controls = _explained(judge, kind, _finer(judge, kind, acting, width))
    return replace(found, elsewhere=found.total > by_controls.total + EVIDENCE)


def _explains(x: Explanation) -> bool:
    """Return whether one number explains all."""
    return x.counts and x.parameters == 1 and max(x.square) < EXPLAINED


def _pays(two: Explanation, one: Explanation) -> bool:
    """Return whether there is enough evidence for a second load beside the first, some of it from every set of sensors."""
    more = [of_two - of_one for of_two, of_one in zip(two.support, one.support, strict=True)]
    return sum(more) > EVIDENCE and min(more) > 0.0


def _likely(judge: Judge) -> list[int]:
    """Return the instants with the most evidence for a load that begins there and lasts, each beside those before it.

    The response to a load from an instant on is taken for that from the first sample on, shifted. Without those found before,
    all instants would be near the largest load.
    """
    steps = len(judge.recording.u)
    p = judge.model.controls
    loads = np.delete(judge.lasting, range(p, p + judge.model.plant_states), axis=1)  # of controls and of the model
    sets = []
    for k, chosen in enumerate(judge.bank.sensors):
        e = np.zeros((steps, len(chosen)))
        e[judge.masks[k]] = judge.free(judge.base, k, judge.begin)[0]
        responses = loads[k][:, :, list(chosen)]
        shifts = np.conj(np.fft.rfft(responses, 2 * steps, axis=1))  # twice as long: no wrapping around
        sets.append((responses, shifts, e))
    squares = np.sum([np.cumsum((x**2).sum(axis=2), axis=1)[:, ::-1] for x, *_ in sets], axis=0)
    squares = np.maximum(squares, 1e-300)
    free = np.ones(steps, dtype=bool)
    found: list[int] = []
    while len(found) < LIKELY and free.any():
        moments = np.sum(
            [
                np.fft.irfft(shifts * np.fft.rfft(e, 2 * steps, axis=0), axis=1)[:, :steps].sum(axis=2)
                for _, shifts, e in sets
            ],
            axis=0,
        )
        evidence = np.where(free, moments**2 / squares, 0.0)
        j, at = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
        if not evidence[j, at] > 0.0:  # nothing left, or NaN, of a plant that is lost
            break
        found.append(int(at))
        free[max(at - LEAST_PUSHED, 0) : at + LEAST_PUSHED + 1] = False
        for responses, _, e in sets:
            e[at:] -= moments[j, at] / squares[j, at] * responses[j, : steps - at]
    return found


def _finer(judge: Judge, kind: str, best: _Found, width: int) -> _Found:
    """Return the best pushes with instants near those of others, to the sample."""
    last = len(judge.recording.u) - LEAST_PUSHED
    while width > 1:
        grids = [np.linspace(k - width + 1, k + width - 1, FINE).round().astype(int) for k in best.instants]
        near = {int(k) for k in np.concatenate(grids) if 1 <= k <= last}
        pushes = _Pushes(judge, sorted(near | set(best.instants)), best.columns)
        if len(best.instants) > 2:
            best = pushes.moved(best, grids)
        else:
            best = pushes.best(kind, best.columns) or best
        width = max(1, 2 * width // (FINE - 1))
    return best


@dataclass(frozen=True)
class _Found:
    """One or two pushes: their instants (begin, and end unless the last one lasts), columns, sizes (by push), and costs.

    ``loads`` are the pushes along B with the responses most like these: for each push a value for each control.
    """

    instants: tuple[int, ...]
    columns: tuple[int, ...]
    sizes: Floats
    loads: Floats
    losses: Floats
    squares: Floats

    @property
    def parameters(self) -> int:
        """Number of fitted parameters."""
        return len(self.instants) + self.sizes.size


class _Pushes:
    """The normal equations of pushes from each of some instants to the end.

    They act along B, along each state, as each lagged load of the model, and as each control. If `columns` are given, only these
    and those along B are kept.
    """

    def __init__(self, judge: Judge, instants: Sequence[int], columns: Sequence[int] | None = None):
        p, first = judge.model.controls, len(judge.constant)
        self.judge, self.instants = judge, list(instants)
        along, states, loads, controls = np.split(np.arange(first + p), [p, p + judge.model.plant_states, first])
        self.kept = np.unique([*along, *(range(first + p) if columns is None else columns)])
        self.along, self.states = tuple(map(int, along)), tuple(map(int, states))
        self.columns: dict[str, list[tuple[int, ...]]] = {
            "onset": [self.along, self.states, *((int(i),) for i in loads)],
            "loss": [(int(j),) for j in controls],
            "stuck": [(int(j), i) for i, j in enumerate(controls)],  # without its effect, but with a constant one
        }
        responses = self._responses()
        self.sets = [self._equations(responses, k) for k in range(len(judge.bank))]

    def _responses(self) -> Floats:
        """Return the responses to all pushes (sets x pushes x T x m): for each instant the constant ones, then the controls."""
        judge, u = self.judge, self.judge.recording.u
        B, steps = judge.model.matrix("B").T, len(u)
        late = np.arange(steps) >= np.array(self.instants)[:, np.newaxis]

        def late_ones(pushes: Floats) -> Floats:
            each = judge.pushes((late[:, np.newaxis, :, np.newaxis] * pushes).reshape(-1, *pushes.shape[1:]))
            return each.reshape(len(each), len(self.instants), -1, *each.shape[2:])

        responses = np.zeros((len(judge.bank), len(self.instants), len(self.kept), *judge.recording.y.shape))
        first = len(judge.constant)
        constant, controls = self.kept[self.kept < first], self.kept[self.kept >= first] - first
        if len(controls):
            pushes = u.T[:, :, np.newaxis] * B[:, np.newaxis]
            responses[:, :, len(constant) :] = late_ones(pushes[controls])
        if judge.whole:  # a constant push that begins later has the same response, later
            for i, k in enumerate(self.instants):
                responses[:, i, : len(constant), k:] = judge.lasting[:, constant, : steps - k]
        else:
            responses[:, :, : len(constant)] = late_ones(judge.constant[constant])
        return responses.reshape(len(responses), -1, *responses.shape[3:])

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
        return self._cheapest(found)

    def best_two(self, groups: Iterable[tuple[int, ...]], among: Container[int]) -> _Found | None:
        """Return the two loads with the most evidence, of one group of columns, one after the other, between some instants.

        The second one may last to the end.
        """
        places = [i for i, k in enumerate(self.instants) if k in among]
        found = []
        for number in (3, 4):
            chosen = combinations(range(len(places) + 1), number)
            ends = [
                (places[i], places[j], *(places[k - 1] for k in rest))  # the second may begin where the first ends
                for i, j, *rest in chosen
                if j < len(places)
            ]
            ends = [x for x in ends if self._in_order(x)]
            pushes = [self._best(np.array(ends), columns) for columns in groups if ends]
            found += [push for push in pushes if push is not None]
        return self._cheapest(found)

    def moved(self, two: _Found, grids: Sequence[NDArray[np.intp]]) -> _Found:
        """Return two loads of which each in turn has its best instants in its grids, beside the other one."""
        for first in (0, 2) * ROUNDS:
            tried = [
                [self.instants.index(k) for k in ({*map(int, grid)} & {*self.instants}) | {now}]
                if first <= i < first + 2
                else [self.instants.index(now)]
                for i, (grid, now) in enumerate(zip(grids, two.instants, strict=True))
            ]
            ends = [x for x in product(*tried) if self._in_order(x)]
            if ends and (push := self._best(np.array(ends), two.columns)) is not None:
                two = push
        return two

    def _apart(self, i: int, j: int) -> bool:
        """Return whether a push between two of the instants is long enough."""
        return self.instants[j] - self.instants[i] >= LEAST_PUSHED

    def _in_order(self, x: Sequence[int]) -> bool:
        return self._apart(x[0], x[1]) and x[2] >= x[1] and (len(x) == 3 or self._apart(x[2], x[3]))

    def _cheapest(self, found: Sequence[_Found]) -> _Found | None:
        """Return the pushes with the least loss and cost of parameters."""
        counts = [0.5 * np.log(rows) for rows in self.judge.rows]
        return min(found, key=lambda x: float(x.losses.sum() + x.parameters * sum(counts)), default=None)

    def _best(self, ends: NDArray[np.intp], group: tuple[int, ...]) -> _Found | None:
        """Fit the columns of a group between pairs of instants, the last one possibly to the end; return the best.

        None if they explain nothing finite.
        """
        parts = [self._least(ends[k : k + AT_ONCE], group) for k in range(0, len(ends), AT_ONCE)]
        return min((x for x in parts if x is not None), key=lambda x: float(x.losses.sum()), default=None)

    def _least(self, ends: NDArray[np.intp], group: tuple[int, ...]) -> _Found | None:
        signs = _signs(ends.shape[1])
        products, moments = self._normal(ends, signs, np.array(group))
        whole, right = np.sum(products, axis=0), np.sum(moments, axis=0)
        finite = np.isfinite(whole).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        ends, products, moments = ends[finite], products[:, finite], moments[:, finite]
        sizes = -_solved(whole[finite], right[finite])
        squares = np.array(
            [
                (c + 2.0 * np.einsum("ka,ka->k", sizes, moment) + np.einsum("ka,kab,kb->k", sizes, product, sizes)) / n
                for product, moment, (_, _, c, n) in zip(products, moments, self.sets, strict=True)
            ]
        )
        possible = (squares > 0.0).all(axis=0)
        if not possible.any():
            return None
        losses = self.judge.losses(squares)
        i = int(np.argmin(np.where(possible, losses.sum(axis=0), np.inf)))
        by_push = sizes[i].reshape(signs.shape[1], len(group))
        instants = tuple(self.instants[k] for k in ends[i])
        loads = self._along(ends[i], signs, group, by_push)
        return _Found(instants, group, by_push, loads, losses[:, i], squares[:, i])

    def _normal(self, ends: NDArray[np.intp], signs: Floats, group: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return, by set, the products of a group's pushes with each other and with the innovations, for each row of instants."""
        places = len(self.kept) * ends[:, :, np.newaxis] + np.searchsorted(self.kept, group)
        rows, columns = places[:, :, :, np.newaxis, np.newaxis], places[:, np.newaxis, np.newaxis]
        size = signs.shape[1] * len(group)
        products = [
            np.einsum("ih,kiajb,jg->khagb", signs, G[rows, columns], signs, optimize=True) for G, *_ in self.sets
        ]
        moments = [np.einsum("ih,kia->kha", signs, b[places]) for _, b, *_ in self.sets]
        return np.reshape(products, (-1, len(ends), size, size)), np.reshape(moments, (-1, len(ends), size))

    def _along(self, ends: NDArray[np.intp], signs: Floats, group: tuple[int, ...], sizes: Floats) -> Floats:
        """Return the loads along B with the responses most like those of some pushes."""
        p = len(self.along)
        loads = []
        for h, size in enumerate(sizes):
            products = self._normal(ends[np.newaxis], signs[:, h : h + 1], np.array([*self.along, *group]))[0].sum(
                axis=0
            )
            loads.append(_solved(products[:, :p, :p], products[:, :p, p:] @ size)[0])
        return np.array(loads)


def _signs(instants: int) -> Floats:
    """Return how pushes are sums of those that last from some instants on (instants x pushes): one push for two instants."""
    pushes = np.repeat(np.eye((instants + 1) // 2), 2, axis=0)[:instants]
    return np.asarray(pushes * np.where(np.arange(instants) % 2, -1.0, 1.0)[:, np.newaxis])


def _solved(G: Floats, b: Floats) -> Floats:
    """Return the solutions of normal equations, the smallest of several, in units in which each column has length 1.

    A column of which rounding has left no length, such as that of a push without a response, has the solution 0.
    """
    squares = np.diagonal(G, axis1=1, axis2=2)
    lengths = np.sqrt(np.where(squares > 0.0, squares, np.inf))
    scaled = np.clip(G / (lengths[:, :, np.newaxis] * lengths[:, np.newaxis]), -1.0, 1.0)
    solution: Floats = (
        np.einsum("kab,kb->ka", np.linalg.pinv(scaled, rcond=1e-10, hermitian=True), b / lengths) / lengths
    )
    return solution


def _explained(judge: Judge, kind: str, found: _Found) -> Explanation:
    times = [k * float(judge.model.step) for k in found.instants]
    times += [float("inf")] * (len(times) % 2)
    values: tuple[float, ...]
    if kind == "onset":
        values = tuple(x for h, load in enumerate(found.loads) for x in (*times[2 * h : 2 * h + 2], *map(float, load)))
    else:
        control = found.columns[0] - len(judge.constant)
        effect = 1.0 + float(found.sizes[0, 0])
        values = *times, effect, float(control)
        if kind == "stuck":  # with what is left of its effect, at its mean
            sent = judge.recording.u[found.instants[0] : (*found.instants, None)[1], control]
            kind, values = "loss", (*values, float(found.sizes[0, 1]) + effect * float(sent.mean()))
    of_load = found.columns[0] - judge.model.controls - judge.model.plant_states
    state = judge.lagged[of_load] if kind == "onset" and of_load >= 0 else None
    costs = found.losses[:, np.newaxis], found.squares[:, np.newaxis]
    return replace(judge.of(kind, [values], costs, found.parameters)[0], state=state)


__all__ = ["changes"]
