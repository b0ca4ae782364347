"""What is wrong with a model, from a recorded run: explanations compared by how well each predicts what all sensors read.

Observers of disjoint sets of sensors (`_observers`) predict the samples under each explanation: the control arrives with another
sign or size, late, through a lag or within a limit; time passes faster or slower than the model's; a constant load acts; the
plant has other dynamics, or some that bend. Each is judged by its likelihood, with the scale of the innovations left free (so that
wrong noise decides nothing), less what its parameters cost (BIC). An explanation counts only if the sensors of *every* set say so:
what one set says alone is a fault of its sensors. Stretches in which sensors of one quantity disagree are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers._explanations import Recording, delayed, faster, forgetting, innovations, lagged, of_models, seers_of
from bayesftc.controllers._healthy_stretches import healthy_stretches
from bayesftc.controllers._observers import Observers, observers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bayesftc.controllers.model import LinearModel
    from bayesftc.cosim.block import Floats

EVIDENCE = 10.0
CLOSE = 0.12
RELEVANT = {"dynamics": 0.05, "nonlinear": 0.05}
MOST_SAMPLES = 20_000
LATEST = 1.0
COARSE = 40
FACTORS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
NEAR = (0.87, 0.91, 0.95, 0.98, 1.02, 1.05, 1.1, 1.15)
LEVELS = tuple(np.linspace(0.1, 0.97, 24))
CUTS = (1e6, 300.0, 30.0)
NOISE = 3.0
LEAST_SAMPLES = 50


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
        base, self.states = innovations(model, seers, seen, seen.u[None])
        self.base = base[:, 0]
        use = healthy_stretches(model, seers, seen.y)
        there = np.isfinite(seen.y)
        self.masks = [use & there[:, list(chosen)].all(axis=1) for chosen in seers.sensors]
        self.begin = self.beginnings(model, seers)
        self.first, self.first_squares = self.cost(self.base[:, None])

    @property
    def enough(self) -> bool:
        return all(mask.sum() >= LEAST_SAMPLES for mask in self.masks)

    def part(self, white: Floats, k: int) -> Floats:
        """Return what counts of one set's innovations under H explanations (H x scalars)."""
        return white[k][:, self.masks[k]][:, :, list(self.seers.sensors[k])].reshape(len(white[k]), -1)

    def beginnings(self, model: LinearModel, seers: Observers) -> list[Floats]:
        """Return an orthonormal basis of what the unknown initial state does to each set's innovations (scalars x n)."""
        white = forgetting(model, seers, self.seen)
        found = []
        for k in range(len(seers)):
            u, s, _ = np.linalg.svd(self.part(white, k).T, full_matrices=False)
            found.append(u[:, s > 1e-9 * max(s[0], 1e-300)])
        return found

    def cost(
        self, white: Floats, seers: Observers | None = None, begin: list[Floats] | None = None
    ) -> tuple[Floats, Floats]:
        """Return the negative log-likelihood by set and explanation, and mean squares (sets x H)."""
        seers, begin = seers or self.seers, begin or self.begin
        losses, squares = [], []
        for k, chosen in enumerate(map(list, seers.sensors)):
            with np.errstate(all="ignore"):
                part = self.part(white, k)
                part = part - (part @ begin[k]) @ begin[k].T
                square = np.nan_to_num((part**2).mean(axis=1), nan=np.inf)
            volume = np.log(np.diag(seers.whiten[k])[chosen]).sum() * self.masks[k].sum()
            losses.append(0.5 * part.shape[1] * np.log(np.maximum(square, 1e-300)) - volume)
            squares.append(square)
        return np.array(losses), np.array(squares)

    def of(
        self, kind: str, values: list[tuple[float, ...]], losses: Floats, squares: Floats, parameters: int = 1
    ) -> list[Explanation]:
        price = np.array([0.5 * parameters * np.log(mask.sum()) for mask in self.masks])
        gain = self.first - losses - price[:, None]
        left = squares / self.first_squares
        return [
            Explanation(kind, value, *(tuple(map(float, table[:, h])) for table in (gain, left, squares)))
            for h, value in enumerate(values)
        ]

    def inputs(self, kind: str, courses: list[Floats], values: list[tuple[float, ...]]) -> list[Explanation]:
        """Judge courses of the control, each of one parameter."""
        if not courses:
            return []
        white, _ = innovations(self.model, self.seers, self.seen, np.array(courses))
        return self.of(kind, values, *self.cost(white))

    def pushes(self, pushes: Floats) -> Floats:
        """Return the innovations' answers to pushes (H x T x n), each scaled to a largest element of 1."""
        zeros = np.zeros_like(self.seen.u)
        silent = Recording(np.where(np.isfinite(self.seen.y), 0.0, np.nan), zeros, np.zeros_like(self.seen.mean))
        pushes = pushes / np.maximum(np.abs(pushes).max(axis=(1, 2), keepdims=True), 1e-300)
        return innovations(self.model, self.seers, silent, np.broadcast_to(zeros, (len(pushes), *zeros.shape)), pushes)[0]

    def fitted(self, kind: str, answers: Floats) -> Explanation:
        """Fit the sizes of pushes, whose answers are given, by least squares."""
        D = np.concatenate([self._free(answers, k) for k in range(len(self.seers))], axis=1).T
        e = np.concatenate([self._free(self.base[:, None], k)[0] for k in range(len(self.seers))])
        scale = np.maximum(np.sqrt((D**2).sum(axis=0)), 1e-300)
        theta = np.linalg.lstsq(D / scale, -e, rcond=1e-10)[0] / scale
        rest = self.base + np.einsum("khti,h->kti", answers, theta)
        return self.of(kind, [tuple(map(float, theta))], *self.cost(rest[:, None]), len(theta))[0]

    def _free(self, white: Floats, k: int) -> Floats:
        part = self.part(white, k)
        return part - (part @ self.begin[k]) @ self.begin[k].T


def diagnose(model: LinearModel, y: ArrayLike, u: ArrayLike, initial_mean: ArrayLike = 0.0):
    seers = observers(model)
    if seers is None:
        return None, []
    y = np.asarray(y, float).reshape(-1, model.sensors)[:MOST_SAMPLES]
    u = np.asarray(u, float).reshape(-1, model.controls)[:MOST_SAMPLES]
    seen = Recording(y, u, np.broadcast_to(np.asarray(initial_mean, float), model.states))
    base = innovations(model, seers, seen, seen.u[None])[0][:, 0]
    with np.errstate(all="ignore"):
        missed = np.nan_to_num(np.abs(base), nan=np.inf).max(axis=2).min(axis=0)
    best, known, tried = None, [], set()
    for cut in CUTS:
        end = int(np.argmax(missed > cut)) if (missed > cut).any() else len(y)
        if end in tried:
            continue
        tried.add(end)
        judge = _Judge(model, seers, Recording(y[:end], u[:end], seen.mean)) if end >= LEAST_SAMPLES else None
        if judge is None or not judge.enough:
            continue
        ranked = explanations(judge)
        named = next((x for x in ranked if x.counts), None)
        if not known:
            known = ranked
        if named is not None and (best is None or max(named.square) < max(best.square)):
            best, known = named, ranked
        if best is None or max(best.square) < NOISE:
            break
    return best, known


def explanations(judge: _Judge) -> list[Explanation]:
    """Return the best explanation of each kind, the best first."""
    found = _late(judge) + _times(judge)
    model, u = judge.model, judge.seen.u
    B, plant = model.matrix("B"), model.states - model.disturbances
    for j in range(model.controls):
        found += _limits(judge, j)
        pushes = u[:, j, None] * B[:, j]
        fit = judge.fitted("gain", judge.pushes(pushes[None]))
        g = 1.0 + fit.values[0] / max(float(np.abs(pushes).max()), 1e-300)
        found.append(replace(fit, kind="sign" if g < 0 else "gain", values=(g, j)))
    found.append(judge.fitted("load", judge.pushes(np.array([np.outer(np.ones(len(u)), b) for b in B.T]))))
    linear, bent = _features(judge)
    directions = np.eye(model.states)[:plant]
    answers = judge.pushes(np.array([np.outer(f, d) for f in linear + bent for d in directions]))
    each, first = len(directions), len(linear) * len(directions)
    found.append(judge.fitted("dynamics", answers[:, :first]))
    for i in range(first, answers.shape[1], each):
        found.append(judge.fitted("nonlinear", answers[:, i : i + each]))
    found.append(judge.fitted("nonlinear", answers[:, first:]))
    found.append(judge.fitted("nonlinear", answers))
    best: dict[str, Explanation] = {}
    for x in found:
        if x.kind not in best or x.total > best[x.kind].total:
            best[x.kind] = x
    return sorted(best.values(), key=lambda x: -x.total)


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


def _late(judge: _Judge) -> list[Explanation]:
    """Judge delays and lags, first coarsely, then about the best."""
    u, dt = judge.seen.u, float(judge.model.step)
    most = max(1, min(round(LATEST / dt), len(u) // 4))
    coarse = sorted({max(1, round(k)) for k in np.linspace(1, most, COARSE)})

    def tried(steps):
        return judge.inputs("late", [delayed(u, k) for k in steps], [(k * dt, 0.0) for k in steps])

    found = tried(coarse)
    best = round(max(found, key=lambda x: x.total).values[0] / dt)
    width = -(-most // COARSE)
    found += tried([k for k in range(max(1, best - width), best + width + 1) if k not in coarse])
    lags = [most * f for f in (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)]
    return found + judge.inputs("late", [lagged(u, tau) for tau in lags], [(tau * dt, 1.0) for tau in lags])


def _limits(judge: _Judge, j: int) -> list[Explanation]:
    """Judge limits to one control: to both sides alike, above and below."""
    u = judge.seen.u

    def tried(levels):
        courses, values = [], []
        for level in levels:
            for low, high in ((-level, level), (-np.inf, level), (-level, np.inf)):
                course = u.copy()
                course[:, j] = np.clip(u[:, j], low, high)
                courses.append(course)
                values.append((low, high, j))
        return judge.inputs("limit", courses, values)

    levels = np.unique(np.quantile(np.abs(u[:, j]), LEVELS))
    found = tried(levels)
    best = max(found, key=lambda x: x.total).values
    level = best[1] if np.isfinite(best[1]) else -best[0]
    i = int(np.argmin(np.abs(levels - level)))
    return found + tried(np.linspace(levels[max(i - 1, 0)], levels[min(i + 1, len(levels) - 1)], 9)[1:-1])


def _times(judge: _Judge) -> list[Explanation]:
    """Judge time scales, first coarsely, then about the best."""

    def tried(factors):
        models = [(f, faster(judge.model, f)) for f in factors]
        known = [(f, model, seers) for f, model in models if (seers := seers_of(model, judge.seers)) is not None]
        if not known:
            return []
        whites = of_models([m for _, m, _ in known], [s for _, _, s in known], judge.seen)
        return [
            judge.of("dt", [(f,)], *judge.cost(white, seers, judge.beginnings(model, seers)))[0]
            for (f, model, seers), white in zip(known, whites, strict=True)
        ]

    found = tried(FACTORS)
    if found:
        best = max(found, key=lambda x: x.total).values[0]
        found += tried([best * f for f in NEAR])
    return found
