"""What is wrong with a model, from a recorded run: explanations compared by how well each predicts what all sensors read.

Observers of disjoint sets of sensors (`_observers`) predict the samples under each explanation: the control arrives with another
sign or size, late, through a lag or within a limit; time passes faster or slower than the model's; a constant load acts; the
plant has other dynamics, or some that bend. Each is judged by its likelihood, with the scale of the innovations left free (so that
wrong noise decides nothing), less what its parameters cost (BIC). An explanation counts only if the sensors of *every* set say so:
what one set says alone is a fault of its sensors. Stretches in which sensors of one quantity disagree are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers._explanations import Recording, delayed, faster, innovations, lagged
from bayesftc.controllers._healthy_stretches import healthy_stretches
from bayesftc.controllers._observers import Observers, observers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bayesftc.controllers.model import LinearModel
    from bayesftc.cosim.block import Floats

EVIDENCE = 10.0
CLOSE = 0.07
RELEVANT = {"dynamics": 0.05, "nonlinear": 0.05}
MOST_SAMPLES = 20_000
LATEST = 1.0
COARSE = 40
LAGS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
FACTORS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
NEAR = (0.87, 0.91, 0.95, 0.98, 1.02, 1.05, 1.1, 1.15)
LEVELS = tuple(np.linspace(0.1, 0.97, 24))
CUTS = (1e6, 300.0, 100.0, 30.0, 10.0, 6.0)
NOISE = 2.0
SIMPLE = frozenset({"sign", "gain", "dt", "late", "limit"})
LEAST_SAMPLES = 12


@dataclass(frozen=True)
class Explanation:
    kind: str
    values: tuple[float, ...]
    support: tuple[float, ...]  # log-likelihood ratio less BIC by set
    left: tuple[float, ...]  # mean squared innovation by set over that of the model as it is
    square: tuple[float, ...]  # mean squared innovation by set

    @property
    def least(self) -> float:
        return min(self.support)

    @property
    def total(self) -> float:
        return sum(self.support)

    @property
    def counts(self) -> bool:
        off = abs(self.values[0] - 1.0) if self.kind in ("gain", "dt") else 1.0
        return self.least > EVIDENCE and max(self.left) < 1 - RELEVANT.get(self.kind, 0.0) and off > CLOSE


class _Judge:
    """The run, its observers, and what the model as it is leaves unexplained."""

    def __init__(self, model: LinearModel, seers: Observers, seen: Recording):
        self.model, self.seers, self.seen = model, seers, seen
        self.moved = seen.u @ model.matrix("B").T
        (white,), self.states = innovations([model], [seers], seen, self.moved[None, None])
        self.base = white[:, :1]
        use, there = healthy_stretches(model, seers, seen.y), np.isfinite(seen.y)
        self.masks = [use & there[:, list(chosen)].all(axis=1) for chosen in seers.sensors]
        self.begin = self.beginnings(white)
        self.first, self.first_squares = self.cost(self.base, seers, self.begin)

    def part(self, white: Floats, k: int) -> Floats:
        """Return what counts of one set's innovations under H explanations (H x scalars)."""
        return white[k][:, self.masks[k]][:, :, list(self.seers.sensors[k])].reshape(len(white[k]), -1)

    def beginnings(self, white: Floats) -> list[Floats]:
        """Return an orthonormal basis of what the unknown initial state does to each set's innovations (scalars x n)."""
        found = []
        for k in range(len(self.seers)):
            u, s, _ = np.linalg.svd(self.part(white, k)[-self.model.states :].T, full_matrices=False)
            found.append(u[:, s > 1e-9 * max(s[0], 1e-300)])
        return found

    def free(self, white: Floats, k: int, begin: list[Floats]) -> Floats:
        """Return the part that does not depend on the initial state."""
        part = self.part(white, k)
        return part - (part @ begin[k]) @ begin[k].T

    def cost(self, white: Floats, seers: Observers, begin: list[Floats]) -> tuple[Floats, Floats]:
        """Return the negative log-likelihood by set and explanation, and mean squares (sets x H)."""
        losses, squares = [], []
        for k, chosen in enumerate(map(list, seers.sensors)):
            with np.errstate(all="ignore"):
                part = self.free(white, k, begin)
                square = np.nan_to_num((part**2).mean(axis=1), nan=np.inf)
            volume = np.log(np.diag(seers.whiten[k])[chosen]).sum() * self.masks[k].sum()
            losses.append(0.5 * part.shape[1] * np.log(np.maximum(square, 1e-300)) - volume)
            squares.append(square)
        return np.array(losses), np.array(squares)

    def of(
        self, kind: str, values: list[tuple[float, ...]], costs: tuple[Floats, Floats], parameters: int = 1
    ) -> list[Explanation]:
        losses, squares = costs
        price = np.array([0.5 * parameters * np.log(mask.sum()) for mask in self.masks])
        gain = self.first - losses - price[:, None]
        left = squares / self.first_squares
        return [
            Explanation(kind, value, *(tuple(map(float, table[:, h])) for table in (gain, left, squares)))
            for h, value in enumerate(values)
        ]

    def inputs(self, courses: list[tuple[str, tuple[float, ...], Floats]]) -> list[Explanation]:
        """Judge courses of the control, each with its kind and its values, of which one is fitted."""
        if not courses:
            return []
        moved = np.array([course for _, _, course in courses]) @ self.model.matrix("B").T
        (white,), _ = innovations([self.model], [self.seers], self.seen, moved[None])
        costs = self.cost(white[:, : len(courses)], self.seers, self.begin)
        return [
            self.of(kind, [values], (costs[0][:, h : h + 1], costs[1][:, h : h + 1]))[0]
            for h, (kind, values, _) in enumerate(courses)
        ]

    def pushes(self, pushes: Floats) -> Floats:
        """Return the innovations' answers to pushes (H x T x n) of any size."""
        scale = np.maximum(np.abs(pushes).max(axis=(1, 2), keepdims=True), 1e-300)
        silent = Recording(
            np.where(np.isfinite(self.seen.y), 0.0, np.nan), self.seen.u, np.zeros_like(self.seen.mean)
        )
        (white,), _ = innovations([self.model], [self.seers], silent, (pushes / scale)[None])
        return white[:, : len(pushes)] * scale[:, 0, 0][:, None, None]

    def fitted(self, kind: str, answers: Floats) -> Explanation:
        """Fit the sizes of pushes, whose answers are given, by least squares."""
        sets = range(len(self.seers))
        D = np.concatenate([self.free(answers, k, self.begin) for k in sets], axis=1).T
        e = np.concatenate([self.free(self.base, k, self.begin)[0] for k in sets])
        scale = np.maximum(np.sqrt((D**2).sum(axis=0)), 1e-300)
        theta = np.linalg.lstsq(D / scale, -e, rcond=1e-10)[0] / scale
        rest = self.base + np.tensordot(answers, theta, axes=(1, 0))[:, None]
        costs = self.cost(rest, self.seers, self.begin)
        return self.of(kind, [tuple(map(float, theta))], costs, len(theta))[0]


def diagnose(model: LinearModel, y: ArrayLike, u: ArrayLike, initial_mean: ArrayLike = 0.0):
    seers = observers(model)
    if seers is None:
        return None, []
    y = np.asarray(y, float).reshape(-1, model.sensors)[:MOST_SAMPLES]
    u = np.asarray(u, float).reshape(-1, model.controls)[:MOST_SAMPLES]
    seen = Recording(y, u, np.broadcast_to(np.asarray(initial_mean, float), model.states))
    moved = seen.u @ model.matrix("B").T
    base = innovations([model], [seers], seen, moved[None, None])[0][0][:, 0]
    with np.errstate(all="ignore"):
        missed = np.nan_to_num(np.abs(base), nan=np.inf).max(axis=2).min(axis=0)
    fallback: list[Explanation] = []
    tried: set[int] = set()
    for cut in CUTS:
        end = int(np.argmax(missed > cut)) if (missed > cut).any() else len(y)
        if end in tried or end < LEAST_SAMPLES:
            continue
        tried.add(end)
        judge = _Judge(model, seers, Recording(y[:end], u[:end], seen.mean))
        if min(mask.sum() for mask in judge.masks) < LEAST_SAMPLES:
            continue
        ranked = [x for x in explanations(judge) if x.counts]
        if ranked and ranked[0].kind in SIMPLE and max(ranked[0].square) < NOISE:
            return ranked[0], ranked
        if ranked and (not fallback or max(ranked[0].square) < NOISE <= max(fallback[0].square)):
            fallback = ranked
    return (fallback[0] if fallback else None), fallback


Course = tuple[str, tuple[float, ...], "Floats"]


def explanations(judge: _Judge) -> list[Explanation]:
    """Return the best explanation of each kind, the best first."""
    model, u = judge.model, judge.seen.u
    coarse = judge.inputs([*_late(judge), *(c for j in range(model.controls) for c in _limits(judge, j))])
    fine = judge.inputs(
        [*_late(judge, coarse), *(c for j in range(model.controls) for c in _limits(judge, j, coarse))]
    )
    found = coarse + fine + _times(judge) + _pushed(judge)
    best: dict[str, Explanation] = {}
    for x in found:
        if x.kind not in best or x.total > best[x.kind].total:
            best[x.kind] = x
    return sorted(best.values(), key=lambda x: -x.total)


def _pushed(judge: _Judge) -> list[Explanation]:
    """Judge all that pushes of the state explain: another gain, a load, other dynamics."""
    model, u = judge.model, judge.seen.u
    B, plant = model.matrix("B"), model.states - model.disturbances
    linear, bent = _features(judge)
    directions = np.eye(model.states)[:plant]
    p, each, first = len(B.T), plant, len(linear) * plant
    pushes = [u[:, j, None] * B[:, j] for j in range(p)] + [np.outer(np.ones(len(u)), b) for b in B.T]
    answers = judge.pushes(np.array(pushes + [np.outer(f, d) for f in linear + bent for d in directions]))
    found = []
    for j in range(p):
        fit = judge.fitted("gain", answers[:, j : j + 1])
        g = 1.0 + fit.values[0]
        found.append(replace(fit, kind="sign" if g < 0 else "gain", values=(g, j)))
    found.append(judge.fitted("load", answers[:, p : 2 * p]))
    answers = answers[:, 2 * p :]
    found.append(judge.fitted("dynamics", answers[:, :first]))
    for i in range(first, answers.shape[1], each):
        found.append(judge.fitted("nonlinear", answers[:, i : i + each]))
    found.append(judge.fitted("nonlinear", answers[:, first:]))
    found.append(judge.fitted("nonlinear", answers))
    return found


def _features(judge: _Judge) -> tuple[list[Floats], list[Floats]]:
    model, seen = judge.model, judge.seen
    plant = model.states - model.disturbances
    x, u = judge.states - seen.mean, seen.u - _holding(model, seen.mean)
    rows = np.unique(model.quantities, axis=0)
    outputs = [x @ row for row in rows]
    linear = [np.ones(len(u)), *x[:, :plant].T, *u.T]
    both = [*outputs, *u.T]
    bent = [both[i] * both[j] for i in range(len(both)) for j in range(i + 1)] + [f**3 for f in outputs]
    return linear, bent


def _holding(model: LinearModel, x: Floats) -> Floats:
    """Return the control that holds the plant where it is, as nearly as one does."""
    A, B = model.matrix("A"), model.matrix("B")
    return np.linalg.lstsq(B, x - A @ x, rcond=None)[0]


def _best(found: list[Explanation], kind: str, chosen: Callable[[Explanation], bool]) -> Explanation:
    return max((x for x in found if x.kind == kind and chosen(x)), key=lambda x: x.total)


def _late(judge: _Judge, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return late controls: coarsely, or about the best of the coarse ones."""
    u, dt = judge.seen.u, float(judge.model.step)
    most = max(1, min(round(LATEST / dt), 2 * len(u) // 3))
    steps = sorted({max(1, round(k)) for k in np.linspace(1, most, COARSE)})
    if coarse is None:
        lags: list[Course] = [("late", (most * f * dt, 1.0), lagged(u, most * f)) for f in LAGS]
        return lags + [("late", (k * dt, 0.0), delayed(u, k)) for k in steps]
    best = round(_best(coarse, "late", lambda x: not x.values[1]).values[0] / dt)
    width = -(-most // COARSE)
    near = [k for k in range(max(1, best - width), best + width + 1) if k not in steps]
    return [("late", (k * dt, 0.0), delayed(u, k)) for k in near]


def _limits(judge: _Judge, j: int, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return limited controls, to both sides alike, above and below: coarsely, or about the best of the coarse ones."""
    u = judge.seen.u
    levels = np.unique(np.quantile(np.abs(u[:, j]), LEVELS))
    if coarse is not None:
        low, high, _ = _best(coarse, "limit", lambda x: x.values[2] == j).values
        i = int(np.argmin(np.abs(levels - (high if np.isfinite(high) else -low))))
        levels = np.linspace(levels[max(i - 1, 0)], levels[min(i + 1, len(levels) - 1)], 9)[1:-1]
    found: list[Course] = []
    for level in levels:
        for low, high in ((-level, level), (-np.inf, level), (-level, np.inf)):
            course = u.copy()
            course[:, j] = np.clip(u[:, j], low, high)
            found.append(("limit", (float(low), float(high), float(j)), course))
    return found


def _times(judge: _Judge) -> list[Explanation]:
    """Judge time scales, first coarsely, then about the best."""

    def tried(factors: Iterable[float]) -> list[Explanation]:
        known = []
        for f in factors:
            model = faster(judge.model, f)
            if model is not None and (seers := observers(model, judge.seers.sensors)) is not None:
                known.append((f, model, seers))
        if not known:
            return []
        moved = np.array([(judge.seen.u @ model.matrix("B").T)[None] for _, model, _ in known])
        models, seers = [m for _, m, _ in known], [s for _, _, s in known]
        whites, _ = innovations(models, seers, judge.seen, moved)
        return [
            judge.of("dt", [(f,)], judge.cost(white[:, :1], seers, judge.beginnings(white)))[0]
            for (f, _, seers), white in zip(known, whites, strict=True)
        ]

    found = tried(FACTORS)
    return found + tried(max(found, key=lambda x: x.total).values[0] * f for f in NEAR) if found else []
