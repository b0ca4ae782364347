"""Evidence for explanations of a wrong model in a recorded run, by the sensors of each set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.diagnosis.healthy_stretches import after_gaps, healthy_stretches, shifted
from bayesftc.controllers.models.disturbances import lagged_loads

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

EVIDENCE = 10.0
"""Least log-likelihood ratio of an explanation to the unchanged model, beyond its BIC: of all sets together without any one.

This and the following were chosen on the seeds 1000 to 1023 of ``tests/controllers/diagnosis/wrong_models.py``. The rules for
left-out stretches and for nearly equal explanations were changed after a look at the seeds 0 to 24, so that only the seeds from
25 on are unseen."""

SILENT = 2.0
"""Log-likelihood ratio up to which a set of sensors is neither for nor against an explanation."""

EXPLAINED = 2.0
"""Mean squared innovation up to which a run counts as explained."""

CLOSE = 0.07
"""A gain or a time scale closer to 1 than this counts as right."""

REVERSED, SURELY = (-2.0, -0.5), 3.0
"""A control counts as reversed if its fitted effect is between -2 and -0.5 times the model's, and 3 standard deviations
below it."""

TOGETHER = 2.0
"""Log-likelihood ratio, for each effect beyond the first, of other effects of all controls to one of a single control, from
which on they are named: two standard deviations of each."""

RELEVANT = {"dynamics": 0.05, "nonlinear": 0.05}
"""Least relative decrease of every set's mean squared innovation by these flexible kinds."""


@dataclass(frozen=True)
class Explanation:
    """A way in which the model may be wrong, and the evidence for it.

    Attributes
    ----------
    kind : str
        Kind of the explanation.
    values : tuple of float
        Parameters of the explanation.
    support : tuple of float
        Log-likelihood ratio to the unchanged model less the BIC of the parameters, by set of sensors.
    left : tuple of float
        Mean squared innovation relative to that of the unchanged model, by set.
    square : tuple of float
        Mean squared innovation, by set; 1 if all is explained.
    parameters : int
        Number of fitted parameters.
    prices : tuple of float
        BIC of the parameters, by set.
    elsewhere : bool
        Of a load: whether there is evidence that it acts where no control does.
    state : int or None
        Of a load: the number of the state of the model that acts as it does, if there is one.
    """

    kind: str
    values: tuple[float, ...]
    support: tuple[float, ...]
    left: tuple[float, ...]
    square: tuple[float, ...]
    parameters: int
    prices: tuple[float, ...] = ()
    elsewhere: bool = False
    state: int | None = None

    @property
    def total(self) -> float:
        """Sum of the evidence of all sets."""
        return sum(self.support)

    @property
    def heard(self) -> list[int]:
        """The sets that are for or against it, if these are two or more; else all.

        The others cannot tell, such as a thermocouple that a control does not reach.
        """
        prices = self.prices or (0.0,) * len(self.support)
        likelier = [support + price for support, price in zip(self.support, prices, strict=True)]
        heard = [k for k, gain in enumerate(likelier) if abs(gain) > SILENT]
        return heard if len(heard) > 1 else [*range(len(likelier))]

    @property
    def least(self) -> float:
        """The least evidence of a set that is for or against it."""
        return min(self.support[k] for k in self.heard)

    @property
    def most_left(self) -> float:
        """The largest mean squared innovation, relative to that of the unchanged model, of such a set."""
        return max(self.left[k] for k in self.heard)

    @property
    def evident(self) -> bool:
        """Whether the sensors of every set that is `heard` have enough evidence for it, however small the error is.

        Each set has its share of `EVIDENCE` if all sets without any one of them are to have that much.
        """
        # A model of other noise has another scale of its innovations, so that their squares may grow where the likelihood does.
        less = self.kind == "noise" or self.most_left < 1.0
        return self.least > EVIDENCE / max(1, len(self.heard) - 1) and less

    @property
    def counts(self) -> bool:
        """Whether it is evident, and the error is large enough."""
        off = abs(self.values[0] - 1.0) if self.kind in ("gain", "dt") else 1.0
        relevant = self.kind not in RELEVANT or self.most_left < 1.0 - RELEVANT[self.kind]
        return self.evident and relevant and off > CLOSE


class Judge:
    """The run, its observers, and the innovations of the unchanged model."""

    def __init__(self, model: LinearModel, bank: Observers, recording: Recording):
        self.model, self.bank = model, bank
        self.recording = recording = _agreeing(model, recording)
        self.moved = recording.u @ model.matrix("B").T
        (white,), self.states = innovations([model], [bank], recording, self.moved[None, None])
        self.base = white[:, :1]
        present: NDArray[np.bool_] = np.isfinite(recording.y)
        of_sets = [present[:, list(chosen)] for chosen in bank.sensors]
        # Without slow sensors, a step at which one of a set is missing does not count: the filter expects all of them.
        self.masks = of_sets if recording.presence else [x & x.all(axis=1, keepdims=True) for x in of_sets]
        # A filter that loses its covariance in rounding says nothing from then on.
        self.masks = [mask & np.isfinite(white[k, 0][:, list(bank.sensors[k])]) for k, mask in enumerate(self.masks)]
        self.rows = [int(mask.any(axis=1).sum()) for mask in self.masks]
        self.begin = self.beginnings(white)
        self.first, self.first_squares = self.cost(self.base, bank, self.begin)

    def part(self, white: Floats, k: int) -> Floats:
        """Return the innovations of one set that count, under H explanations (H x scalars)."""
        mask, chosen = self.masks[k], self.bank.sensors[k]
        # np.take copies in the order of the result, so that reshape need not copy once more.
        if mask.all():
            return np.take(white[k], chosen, axis=2).reshape(len(white[k]), -1)
        if self.recording.presence is None:
            return np.take(white[k][:, mask[:, 0]], chosen, axis=2).reshape(len(white[k]), -1)
        return np.take(white[k], chosen, axis=2)[:, mask]

    def beginnings(self, white: Floats) -> list[Floats]:
        """Return an orthonormal basis of the effects of what is unknown on each set's innovations (scalars x basis).

        Unknown are initial states, and offsets of some sensors.

        The innovations are those of `innovations` for one explanation.
        """
        bases = []
        for k in range(len(self.bank)):
            effects = np.nan_to_num(self.part(white, k)[1:])  # of a filter that is lost, whose cost is infinite
            u, s, _ = np.linalg.svd(effects.T, full_matrices=False)
            bases.append(u[:, s > 1e-9 * s.max(initial=1e-300)])
        return bases

    def free(self, white: Floats, k: int, begin: list[Floats]) -> Floats:
        """Return the part that does not depend on unknown initial states and offsets."""
        part = self.part(white, k)
        return part - (part @ begin[k]) @ begin[k].T

    def cost(self, white: Floats, bank: Observers, begin: list[Floats]) -> tuple[Floats, Floats]:
        """Return the negative log-likelihood by set and explanation, and mean squares (sets x H)."""
        squares = []
        for k in range(len(bank)):
            with np.errstate(all="ignore"):
                free = self.free(white, k, begin)
                squares.append(np.nan_to_num((free**2).sum(axis=1) / free.shape[1], nan=np.inf))
        return self.losses(np.array(squares), bank), np.array(squares)

    def losses(self, squares: Floats, bank: Observers | None = None) -> Floats:
        """Return the negative log-likelihood of mean squares (sets, or sets x H), by observers, by default the model's own."""
        each = [
            0.5 * mask.sum() * np.log(np.maximum(square, 1e-300)) - self._weights(bank or self.bank, k)
            for k, (mask, square) in enumerate(zip(self.masks, squares, strict=True))
        ]
        return np.array(each)

    def _weights(self, bank: Observers, k: int) -> float:
        """Return the sum of the logarithms by which the innovations of one set that count are weighted."""
        chosen, presence = list(bank.sensors[k]), self.recording.presence
        if presence is None:
            return float(np.log(np.diag(bank.whiten[k])[chosen]).sum() * self.rows[k])
        filters = presence.of(bank)
        weights = np.diagonal(filters.whiten[k], axis1=1, axis2=2)[:, chosen]
        return float(np.log(weights[filters.index[: len(self.masks[k])]][self.masks[k]]).sum())

    def of(
        self, kind: str, values: list[tuple[float, ...]], costs: tuple[Floats, Floats], parameters: int = 1
    ) -> list[Explanation]:
        """Return the explanations of one kind, each with its evidence relative to the unchanged model, by sets of sensors."""
        losses, squares = costs
        price = 0.5 * parameters * np.log(self.rows)
        gain = self.first - losses - price[:, None]
        left = squares / self.first_squares
        by_set = [[tuple(map(float, column)) for column in table.T] for table in (gain, left, squares)]
        return [
            Explanation(kind, v, s, share, residual, parameters, tuple(price.tolist()))
            for v, s, share, residual in zip(values, *by_set, strict=True)
        ]

    def inputs(self, courses: list[tuple[str, tuple[float, ...], Floats]]) -> list[Explanation]:
        """Judge courses of the control, each with its kind and its values, one of them fitted."""
        if not courses:
            return []
        moved = np.array([course for _, _, course in courses]) @ self.model.matrix("B").T
        (white,), _ = innovations([self.model], [self.bank], self.recording, moved[None])
        costs = self.cost(white[:, : len(courses)], self.bank, self.begin)
        return [
            self.of(kind, [values], (costs[0][:, h : h + 1], costs[1][:, h : h + 1]))[0]
            for h, (kind, values, _) in enumerate(courses)
        ]

    def pushes(self, pushes: Floats, *, whole: bool = False) -> Floats:
        """Return the responses of the innovations to pushes (H x T x n) of any size; `whole`: as if no sample were missing."""
        scale = np.maximum(np.abs(pushes).max(axis=(1, 2), keepdims=True), 1e-300)
        return np.asarray(self._responses(pushes / scale, 0.0, whole=whole) * scale[:, 0, 0][:, None, None])

    @property
    def whole(self) -> bool:
        """Whether no sample is missing and none is left out."""
        return self.recording.begins == (0,) and bool(np.isfinite(self.recording.y).all())

    @property
    def constant(self) -> Floats:
        """Constant pushes along each control and each state of the plant, and by each lagged load of it (H x T x n)."""
        pushed, lagged = np.eye(self.model.states)[: self.model.plant_states], list(self.lagged)
        along = np.vstack([self.model.matrix("B").T, pushed, self.model.matrix("A").T[lagged] * (1.0 - pushed[lagged])])
        return np.repeat(along[:, np.newaxis], len(self.recording.u), axis=1)

    @cached_property
    def lagged(self) -> tuple[int, ...]:
        """The states of the plant that are loads: lags of their own noise."""
        return tuple(lagged_loads(self.model))

    @cached_property
    def lasting(self) -> Floats:
        """Responses to the constant pushes from the first sample on, as if no sample were missing (sets x H x T x m).

        With slow sensors these are responses of the steady filters: a guess of where to look, not of what is there.
        """
        return self.pushes(self.constant, whole=True)

    def offset(self, readings: Floats) -> Floats:
        """Return the response of the innovations to constant readings of the sensors (sets x T x m)."""
        return np.asarray(self._responses(np.zeros((1, *self.moved.shape)), readings)[:, 0])

    def _responses(self, pushes: Floats, readings: Floats | float, *, whole: bool = False) -> Floats:
        """Return the innovations of a plant that begins at zero, for some pushes of its state, and constant readings."""
        silent = replace(
            self.recording,
            y=np.where(np.isfinite(self.recording.y) | whole, readings, np.nan),
            mean=np.zeros_like(self.recording.mean),
            begins=(0,) if whole else self.recording.begins,
            presence=None if whole else self.recording.presence,
            offsets=(),
        )
        pushed = np.flatnonzero(pushes.any(axis=(0, 2)))
        first = int(pushed.min(initial=len(self.moved))) if np.ndim(readings) == 0 and not readings else 0
        (white,), _ = innovations([self.model], [self.bank], silent, pushes[None], first)
        return np.asarray(white[:, : len(pushes)])

    def fitted(self, kind: str, responses: Floats, meaning: Floats | None = None) -> Explanation:
        """Fit sizes by least squares, from their responses; the values are these, or their sum over rows of a meaning."""
        theta, _, costs = self._fit(responses)
        values = theta if meaning is None else theta @ meaning
        return self.of(kind, [tuple(map(float, values))], costs, len(theta))[0]

    def flipped(self, responses: Floats, control: int) -> list[Explanation]:
        """Fit pushes of which the first is the control's effect; return ``"sign"`` if that effect is clearly reversed."""
        theta, spreads, costs = self._fit(responses)
        ratio = 1.0 + float(theta[0])
        surely = ratio + SURELY * spreads[0] * np.sqrt(costs[1].max()) < 1.0
        if not (surely and REVERSED[0] < ratio < REVERSED[1]):
            return []
        return self.of("sign", [(ratio, float(control))], costs, len(theta))

    def gains(self, effects: Floats) -> list[Explanation]:
        """Fit the effect of each control alone, and all together, from their responses.

        An effect that is below zero, but not clearly, is none.
        Together they count if they explain clearly more than the best one alone, and none is reversed. Otherwise the run may tell
        no more than a ratio of two effects, which any of them may explain: then each one is returned, else the best.
        """
        alone = []
        for j in range(self.model.controls):
            theta, spreads, costs = self._fit(effects[:, j : j + 1])
            g, spread = 1.0 + float(theta[0]), float(spreads[0] * np.sqrt(costs[1].max()))
            reversed_ = g + SURELY * spread < 0.0
            if g < 0.0 and not reversed_:
                g, costs = 0.0, self.cost(self.base - effects[:, j : j + 1], self.bank, self.begin)
            alone += self.of("sign" if reversed_ else "gain", [(g, float(j))], costs)
        best, more = max(alone, key=lambda x: x.total), len(alone) - 1
        if not more:
            return alone
        theta, spreads, costs = self._fit(effects)
        every = (*(1.0 + theta), *(spreads * np.sqrt(costs[1].max())))
        (together,) = self.of("gains", [tuple(map(float, every))], costs, len(theta))
        any_reversed = (theta + SURELY * np.array(every[len(theta) :]) < -1.0).any()
        ahead = together.total - best.total + 0.5 * more * np.log(self.rows).sum()  # without the cost of the parameters
        return [best, together] if ahead > TOGETHER * more and not any_reversed else alone

    def _fit(self, responses: Floats) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
        """Return the sizes of pushes by least squares, their standard deviations for unit noise, and the costs."""
        sets = range(len(self.bank))
        D = np.concatenate([self.free(responses, k, self.begin) for k in sets], axis=1).T
        e = np.concatenate([self.free(self.base, k, self.begin)[0] for k in sets])
        with np.errstate(all="ignore"):
            scale = np.maximum(np.sqrt((D**2).sum(axis=0)), 1e-300)
        if not (np.isfinite(scale).all() and np.isfinite(e).all()):  # plant or model are not finite
            nothing = np.full(len(responses), np.nan)
            return nothing, nothing, self.cost(self.base * np.nan, self.bank, self.begin)
        basis, triangle = np.linalg.qr(D / scale)  # the pseudoinverse of a tall matrix takes ten times as long
        inverse = np.linalg.pinv(triangle, rcond=1e-10)
        theta = -(inverse @ (basis.T @ e)) / scale
        residual = self.base + np.tensordot(responses, theta, axes=(1, 0))[:, None]
        return theta, np.sqrt((inverse**2).sum(axis=1)) / scale, self.cost(residual, self.bank, self.begin)


def _agreeing(model: LinearModel, recording: Recording) -> Recording:
    """Return a recording without the samples of stretches in which sensors of one quantity disagree."""
    healthy = healthy_stretches(model, recording.y)
    begins = [k for k in range(1, len(healthy)) if healthy[k] and not healthy[k - 1]]
    begins += [k for k in after_gaps(recording.y) if healthy[k - 1]]
    # A recording that is judged again has no such stretches: its own begins and offsets remain.
    return replace(
        recording,
        y=np.where(healthy[:, None], recording.y, np.nan),
        begins=(0, *sorted({*begins, *recording.begins[1:]})),
        offsets=recording.offsets if healthy.all() else shifted(model, recording.y),
    )
