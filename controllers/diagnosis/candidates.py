"""The explanations in a diagnosis: changed controls, other time scales, loads, other dynamics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.changes import changes
from bayesftc.controllers.diagnosis.explanations import (
    Recording,
    dead_zone,
    delayed,
    earlier,
    faster,
    holding,
    innovations,
    lagged,
    played,
    slowed,
)
from bayesftc.controllers.diagnosis.judge import EVIDENCE, RELEVANT, Explanation, Judge
from bayesftc.controllers.diagnosis.offsets import late_sensors, offsets
from bayesftc.controllers.estimation.innovation import steady_prediction
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.disturbances import has_loads, with_loads
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

LATEST, LATEST_STEPS = 1.0, 40
"""Longest delay and lag to try, in seconds, and at least in samples: slow plants have long ones."""

COARSE = 40
"""Number of delays in the coarse search."""

LAGS = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
"""Time constants to try, relative to the longest one."""

FACTORS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
"""Time scales in the coarse search."""

NEAR = (0.87, 0.91, 0.95, 0.98, 1.02, 1.05, 1.1, 1.15)
"""Multiples of the best time scale in the fine search."""

NOISES = (0.1, 1.0, 10.0, 100.0, 1000.0)
"""Additional process noise of the coarse search: its variance in a sample, relative to that of the steady filter's belief."""

WANDERING = (1e-5, 1e-4, 1e-3, 0.01, *NOISES)
"""The same for a load: what changes little from sample to sample moves a plant far in time."""

FINER = (10.0**-0.5, 10.0**-0.25, 10.0**0.25, 10.0**0.5)
"""Multiples of the best of these in the fine search."""

LOUDER = (2.0, 5.0, 15.0, 50.0, 150.0, 500.0, 1500.0)
"""Factors of the process covariance, where it may be stated too small."""

AS_STATED = -2.0
"""In place of the number of a state: the noise acts as the model says, but is larger."""

QUIETER = (1.0, 0.3, 0.1, 0.01, 1e-4)
"""Factors of the process covariance, of the plant's states and of loads, where it may be stated too large."""

LEVELS = tuple(np.linspace(0.1, 0.97, 24))
"""Quantiles of the control's size to try as limits in the coarse search."""

LOWER = (0.05, 0.1, 0.2, 0.4, 0.7)
"""Limits to try relative to the least of these: the control may exceed its limit nearly always."""

LEAST_LIMIT = 0.1
"""Least limit on both sides, in standard deviations of the control: with a smaller one the control has no effect."""

RATES = tuple(0.7**k for k in range(16))
"""Limits of the rate to try in the coarse search, relative to the largest change of the control from sample to sample."""

WIDTHS = (0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.3, 0.45, 0.65)
"""Widths of a dead band to try, relative to the range of the control."""

BETWEEN = (0.6, 0.7, 0.8, 0.9, 1.1, 1.2, 1.35, 1.5)
"""Multiples of the best width in the fine search."""

RARE = 5.0
"""Percentage of the samples, at each end, that the range of a control leaves out: it may start far from where it then is."""

ROUNDING = 1e-18
"""Largest variance, relative to that of another state, of a state that is known exactly: no unit makes states so different."""

NEARLY = 5.0
"""Log-likelihood ratio within which a flexible explanation counts as nearly as good; for simple ones it is `EVIDENCE`."""

AT_ONCE, MOST_NUMBERS = 16, 10_000_000
"""Number of models that are judged at once where sensors are slow, and of numbers in their innovations, for memory."""

EFFECT = {"sign", "gain", "gains"}
"""One kind in three words: the effect of a control, or of several."""

BOUNDS = {"limit", "rate"}
"""Bounds of a control: named only with clearly more evidence than another effect of it."""

EQUAL = 0.1
"""Difference of two log-likelihood ratios, below the best one, that tells nothing: a tenth in probability."""

Course = tuple[str, tuple[float, ...], "Floats"]
"""A kind, its values, and the assumed controls at the plant."""

_Fitted = tuple[tuple[float, ...], int, "LinearModel", "Observers"]
"""Values, the number of them that are fitted, another model, and its observers."""


def explanations(judge: Judge) -> list[Explanation]:
    """Return the best explanation of each kind, the best first."""
    model = judge.model
    controls = range(model.controls)

    def tried(best: list[Explanation] | None = None) -> list[Explanation]:
        of_each = [c for j in controls for of in (_limits, _rates, _bands) for c in of(judge, j, best)]
        return judge.inputs([*_late(judge, best), *_early(judge, best), *of_each])

    coarse = tried()
    fine = tried(coarse)
    finest = judge.inputs([c for j in controls for c in _limits(judge, j, coarse + fine)])
    results = coarse + fine + finest + judge.inputs(_exchanged(judge)) + _times(judge) + _pushed(judge)
    effects = {x.values[1]: x.total for x in results if x.kind in ("sign", "gain")}
    results = [
        x for x in results if x.kind not in BOUNDS or x.total > effects.get(x.values[-1], -np.inf) + NEARLY
    ]  # a bound that leaves hardly anything of a control explains what no effect of it does
    results += changes(judge, results) + offsets(judge)
    if any(x.counts for x in results):  # else it would only take time
        results += late_sensors(judge)
    return ranked(best_of_each(results))


def best_of_each(found: Iterable[Explanation]) -> list[Explanation]:
    """Return the best explanation of each kind; the effect of each control is a kind of its own."""
    best: dict[tuple[object, ...], Explanation] = {}
    for x in found:
        kind = (x.kind, *x.values[1:]) if x.kind == "gain" else (x.kind,)
        if kind not in best or x.total > best[kind].total:
            best[kind] = x
    return list(best.values())


def ranked(found: Iterable[Explanation]) -> list[Explanation]:
    """Return explanations, the best first; of equal ones, such as a load and an offset of a speed, in the order given.

    Those that nearly equal the best one count as equal to it: a control that hardly varies tells its sign no better than a load.
    """
    given = list(found)
    most = max((x.total for x in given), default=0.0)
    return sorted(given, key=lambda x: -round(most if x.total > most - EQUAL else x.total, 6))


@lru_cache(maxsize=512)  # called again for each shorter part of a recording
def _noisy(
    model: LinearModel, sets: tuple[tuple[int, ...], ...], added: tuple[float, ...]
) -> tuple[LinearModel, Observers] | None:
    """Return the model with additional noise on its first states, and its observers; None if they do not exist."""
    Q = model.matrix("process_covariance").copy()
    Q[: len(added), : len(added)] += np.diag(added)
    changed = replace(model, process_covariance=Q)
    bank = observers(changed, sets)
    return None if bank is None else (changed, bank)


@lru_cache(maxsize=512)
def _loaded(
    model: LinearModel, sets: tuple[tuple[int, ...], ...], control: int, covariance: float, share: float
) -> tuple[LinearModel, Observers] | None:
    """Return the model with a load on a control, a random walk, and a share of its noise; and its observers, None without any."""
    changed = with_loads(_calmer(model, share), covariance, [control])
    bank = observers(changed, sets)
    return None if bank is None else (changed, bank)


def quieter(judge: Judge) -> Judge:
    """Return a judge of the same run whose model has less process noise, if the run has evidence for that; else the same judge.

    Noise that is stated too large makes the observers follow the sensors too closely. Their innovations are then correlated, as
    they are with other dynamics, and with the control that reacts to them.
    """
    Q, plant = judge.model.matrix("process_covariance"), judge.model.plant_states
    possible: list[_Fitted] = []
    for of_plant, of_loads in product(QUIETER, QUIETER if Q[plant:, plant:].any() else QUIETER[:1]):
        size = np.where(np.arange(len(Q)) < plant, of_plant, of_loads) ** 0.5
        changed = replace(judge.model, process_covariance=Q * np.outer(size, size))
        if (bank := observers(changed, judge.bank.sensors)) is not None:
            possible.append(((of_plant, of_loads), 2, changed, bank))
    found = _by_models(judge, "quieter", possible)
    best = max(range(len(found)), key=lambda h: found[h].total, default=-1)
    return Judge(*possible[best][2:], judge.recording) if found and found[best].least > EVIDENCE else judge


def noisier(judge: Judge, found: list[Explanation]) -> list[Explanation]:
    """Return the best explanation by more process noise on one state of the plant, on all, or on one load; none if there is none.

    Without the loads, a force that wanders faster than the model's disturbance, or that the model does not have, looks like a
    nonlinear plant or like other dynamics. `found` are the best explanations of the other kinds.
    """
    model = judge.model
    moving = model.moving
    A, C, R = (moving.matrix(name) for name in ("A", "C", "sensor_covariance"))
    try:  # with the process noise of the observers, which is some also where the model has none
        prediction = steady_prediction(A, C, judge.bank.noise[0][: len(A), : len(A)], R)
    except (ModelError, np.linalg.LinAlgError):
        return []
    belief = np.diag(prediction)
    belief = np.where(belief > ROUNDING * belief.max(), belief, 0.0)
    constant = next((x for x in found if x.kind == "load"), None)
    noises = _with_noise(judge, belief) + _louder(judge)
    if not has_loads(model):
        noises += _wandering(judge, belief, constant)
    return [max(noises, key=lambda x: x.total)] if noises else []


def moved_at_random(
    judge: Judge, found: list[Explanation], judged: tuple[list[Explanation], list[Explanation]]
) -> list[Explanation]:
    """Return counting explanations without noise, or only it, where all sensors together have clearly more evidence for that.

    A control that answers a gust knows of it from all sensors. To the observers of a few of them it therefore tells what they do
    not see, so that its effect looks lost or reversed; to an observer of all sensors it tells nothing new. Where the noise of the
    model is too large, the other kinds are judged with the smaller one, too: else a load that begins would look like one that
    wanders beside less noise. Where all sensors leave it open, the explanations are theirs, with the evidence of all.

    `judged` are the best explanations of each kind and by noise, of which `found` are those that count.
    """
    everyone = (tuple(sorted({i for chosen in judge.bank.sensors for i in chosen})),)
    noise, kinds = [x for x in found if x.kind == "noise"], {x.kind for x in found} - {"noise"}
    bank = observers(judge.model, everyone) if noise and kinds else None
    if bank is None:
        return found
    kinds |= EFFECT if kinds & EFFECT else set()
    together, (of_all, random) = judge, judged
    if judge.bank.sensors != everyone:
        together = Judge(judge.model, bank, judge.recording)
        random = noisier(together, of_all := explanations(together))
    others = [x for x in of_all if x.kind in kinds]
    shares = {x.values[3] for x in [*noise, *random] if len(x.values) > 3} - {1.0}
    for share in shares if _best_evidence(random) > _best_evidence(others) else ():
        calmer = _calmer(judge.model, share)
        if (bank := observers(calmer, everyone)) is not None:
            calm = Judge(calmer, bank, judge.recording)
            less = float((together.first - calm.first).sum()) - 0.5 * np.log(calm.rows[0])  # the share is fitted
            others += [replace(x, support=(x.total + less,)) for x in explanations(calm) if x.kind in kinds]
    ahead = _best_evidence(random) - _best_evidence(others)
    if ahead > NEARLY and _best_evidence(random) > EVIDENCE:
        return [replace(x, values=by_all.values) for x, by_all in zip(noise, random, strict=True)]
    if ahead < -NEARLY or _best_evidence(random) < EVIDENCE:
        return [x for x in found if x.kind != "noise" or x.values[3:] in ((), (1.0,))]
    return ranked(x for x in best_of_each([*others, *random]) if x.counts)


def _best_evidence(found: Sequence[Explanation]) -> float:
    """Return the evidence of the best explanation; 0, that of the unchanged model, if it has more."""
    return max((x.total for x in found), default=0.0)


def _calmer(model: LinearModel, share: float) -> LinearModel:
    """Return the model with a share of its process noise."""
    return model if share == 1.0 else replace(model, process_covariance=share * model.matrix("process_covariance"))


def _with_noise(judge: Judge, belief: Floats) -> list[Explanation]:
    """Judge more noise on the states that the model has, of which the steady belief has these variances."""
    model, plant = judge.model, judge.model.plant_states
    first = model.states - model.disturbances
    loads = slice(first, first + model.controls * has_loads(model))

    def tried(noises: list[Floats]) -> list[tuple[Explanation, Floats]]:
        found = [(noise, _noisy(model, judge.bank.sensors, tuple(noise.tolist()))) for noise in noises if noise.any()]
        possible = [(*_size(noise), *changed) for noise, changed in found if changed is not None]
        noise_of = {_size(noise)[0]: noise for noise, _ in found}  # of some, the observers diverge
        return [(x, noise_of[x.values]) for x in _by_models(judge, "noise", possible)]

    each = np.diag(belief)
    of_all = np.where(np.arange(len(belief)) < plant, belief, 0.0)
    alone_and_all = [*each[:plant], *[of_all] * (plant > 1), *each[loads]]
    coarse = tried([times * noise for noise in alone_and_all for times in NOISES])
    if not coarse:
        return []
    best, noise = max(coarse, key=lambda found: found[0].total)
    fine = tried([noise * times for times in FINER])
    return [max([best, *(x for x, _ in fine)], key=lambda x: x.total)]


def _louder(judge: Judge) -> list[Explanation]:
    """Judge more noise where the model has some, such as that of a stated input: the shape of its covariance stays."""
    Q = judge.model.matrix("process_covariance")
    plant = np.arange(len(Q)) < judge.model.plant_states

    def tried(factors: Iterable[float]) -> list[Explanation]:
        possible: list[_Fitted] = []
        for factor in factors:
            changed = replace(
                judge.model, process_covariance=Q * np.outer(size := np.where(plant, factor**0.5, 1.0), size)
            )
            if (bank := observers(changed, judge.bank.sensors)) is not None:
                possible.append(((AS_STATED, factor**0.5), 1, changed, bank))
        return _by_models(judge, "noise", possible)

    if not Q[:, plant].any() or not (coarse := tried(LOUDER)):
        return []
    best = max(coarse, key=lambda x: x.total)
    return [best, *tried(f for times in FINER if (f := best.values[1] ** 2 * times) > LOUDER[0])]


def _wandering(judge: Judge, belief: Floats, constant: Explanation | None) -> list[Explanation]:
    """Judge a load on one control, a random walk, with a share of the model's noise: both and its first value are fitted.

    A gust that the model has as white noise is both: less noise, and a load.
    """
    model, sets = judge.model, judge.bank.sensors
    first = model.states - model.disturbances
    recording = replace(judge.recording, mean=np.insert(judge.recording.mean, first, 0.0))
    loads = constant.values if constant is not None and constant.counts else (0.0,) * model.controls

    def tried(sizes: list[tuple[int, float]], shares: Sequence[float] = QUIETER) -> list[Explanation]:
        possible: list[_Fitted] = [
            ((float(first + j), size**0.5, loads[j], share), 2 + (share != 1.0), *changed)
            for (j, size), share in product(sizes, shares)
            if (changed := _loaded(model, sets, j, size, share)) is not None
        ]
        return _by_models(judge, "noise", possible, recording)

    n, A = len(belief), model.moving.matrix("A")
    scales = {j: _share(A, model.effects[:n, j], belief) for j in range(model.controls)}
    coarse = tried([(j, times * scale) for j, scale in scales.items() if scale for times in WANDERING])
    if not coarse:
        return []
    state, std, _, share = max(coarse, key=lambda x: x.total).values
    return coarse + tried([(int(state) - first, std**2 * times) for times in FINER], [share])


def _share(A: Floats, effect: Floats, belief: Floats) -> float:
    """Return the variance of a control whose effect has, in one state, the variance of the belief, and less in all others.

    If all states that it moves are known exactly, as the position of an actuator without noise, its effect is that on the states
    which these move; 0 without any.
    """
    for _ in belief:
        moved = np.flatnonzero((effect != 0.0) & (belief > 0.0))
        if len(moved):
            return float(np.min(belief[moved] / effect[moved] ** 2))
        effect = A @ effect
    return 0.0


def _size(noise: Floats) -> tuple[tuple[float, ...], int]:
    """Return the state with noise (-1 for all) and its standard deviation, and the number of fitted parameters."""
    states = np.flatnonzero(noise)
    alone = len(states) == 1
    return (float(states[0]) if alone else -1.0, float(noise[states[0]] ** 0.5)), 1 + alone


def _by_models(
    judge: Judge,
    kind: str,
    possible: list[_Fitted],
    recording: Recording | None = None,
) -> list[Explanation]:
    """Judge other models by their observers, without those whose observers diverge because too many samples are missing.

    `recording` is the judge's, by default itself, with the belief before the first sample of these models.
    """
    if not possible:
        return []
    numbers = len(judge.bank) * judge.recording.y.size * (1 + judge.model.states * len(judge.recording.begins))
    most = max(1, MOST_NUMBERS // numbers)
    if judge.recording.presence is not None:  # each has its own gains along the recording
        most = min(most, AT_ONCE)
    if len(possible) > most:
        parts = (possible[k : k + most] for k in range(0, len(possible), most))
        return [found for part in parts for found in _by_models(judge, kind, part, recording)]
    models, banks = [model for *_, model, _ in possible], [bank for *_, bank in possible]
    moved = np.array([(judge.recording.u @ model.matrix("B").T)[None] for model in models])
    with np.errstate(over="ignore", invalid="ignore"):
        whites, _ = innovations(models, banks, recording or judge.recording, moved)
    return [
        judge.of(kind, [values], judge.cost(white[:, :1], bank, judge.beginnings(white)), fitted)[0]
        for (values, fitted, _, bank), white in zip(possible, whites, strict=True)
        if np.isfinite(white).all()
    ]


def _pushed(judge: Judge) -> list[Explanation]:
    """Judge the explanations by pushes of the state: another gain, a load, other dynamics."""
    model, u = judge.model, judge.recording.u
    B, plant = model.matrix("B"), model.states - model.disturbances
    linear, curved = _features(judge)
    directions = np.eye(model.states)[:plant]
    p, each, first = len(B.T), plant, len(linear) * plant
    pushes = [u[:, j, None] * B[:, j] for j in range(p)] + [np.outer(np.ones(len(u)), b) for b in B.T]
    responses = judge.pushes(np.array(pushes + [np.outer(f, d) for f in linear + curved for d in directions]))
    results = [*judge.gains(responses[:, :p]), judge.fitted("load", responses[:, p : 2 * p])]
    effects, responses = responses[:, :p], responses[:, 2 * p :]
    for j in range(p):
        # Free all dynamics except control j's effect, which the fit gives; with and without nonlinear terms.
        effect_start = (1 + plant + j) * plant
        others = np.concatenate([responses[:, :effect_start], responses[:, effect_start + plant :]], axis=1)
        for last in {first - plant, others.shape[1]}:
            results += judge.flipped(np.concatenate([effects[:, j : j + 1], others[:, :last]], axis=1), j)
    results.append(judge.fitted("dynamics", responses[:, :first]))
    bent: list[Explanation] = []
    if not judge.recording.linear:
        terms = [responses[:, i : i + each] for i in range(first, responses.shape[1], each)]
        bent = [judge.fitted("nonlinear", some) for some in (*terms, responses[:, first:], responses)]
    # One linear term has as few numbers as a nonlinear one. Near one state they explain the same: then the nonlinear one counts.
    clear = max((x.total + NEARLY for x in bent), default=-np.inf)
    alone = [judge.fitted("dynamics", responses[:, i : i + each]) for i in range(each, first, each)]
    return [*results, *bent, *(x for x in alone if x.total > clear)]


def _features(judge: Judge) -> tuple[list[Floats], list[Floats]]:
    model, recording = judge.model, judge.recording
    plant = model.states - model.disturbances
    x, u = judge.states - recording.mean, recording.u - holding(model, recording.mean)
    rows = np.unique(model.quantities, axis=0)
    outputs = [x @ row for row in rows]
    linear = [np.ones(len(u)), *x[:, :plant].T, *u.T]
    if recording.linear:
        return linear, []
    both = [*outputs, *u.T]
    bent = [both[i] * both[j] for i in range(len(both)) for j in range(i + 1)] + [f**3 for f in outputs]
    return linear, bent


def _best(results: list[Explanation], kind: str, chosen: Callable[[Explanation], bool]) -> Explanation:
    return max((x for x in results if x.kind == kind and chosen(x)), key=lambda x: x.total)


def _late(judge: Judge, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return late controls, each alone and all: a coarse search, or a fine one about the best of `coarse`."""
    u, dt = judge.recording.u, float(judge.model.step)
    most = _most_steps(judge)
    before = holding(judge.model, judge.recording.mean)  # the plant was probably at rest where it starts
    slow = [] if coarse else [(most * f * dt, lagged(u, most * f, before)) for f in LAGS]
    results: list[Course] = []
    for which in _each_and_all(judge):
        if coarse is None:
            steps = _coarse(most)
        else:
            best = _best(coarse, "late", lambda x, which=which: x.values[1:] == (0.0, *which))  # type: ignore[misc]
            steps = _near(best.values[0] / dt, most)
        results += [("late", (seconds, 1.0, *which), _only(u, which, course)) for seconds, course in slow]
        results += [("late", (k * dt, 0.0, *which), _only(u, which, delayed(u, k, before))) for k in steps]
    return results


def _early(judge: Judge, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return controls that act earlier than the delays of the model say, each alone and all: a coarse search, or a fine one."""
    possible, u, dt = judge.recording.late, judge.recording.u, float(judge.model.step)
    results: list[Course] = []
    for which in _each_and_all(judge):
        longest = max((late for j, late in enumerate(possible) if j in (which or range(len(possible)))), default=0)
        most = min(longest, 2 * len(u) // 3)
        if not most:
            continue
        if coarse is None:
            steps = _coarse(most)
        else:
            best = _best(coarse, "early", lambda x, which=which: x.values[1:] == which)  # type: ignore[misc]
            steps = [k for k in _near(best.values[0] / dt, most) if k <= most]
        courses = [(k, earlier(judge.recording, [min(k, late) for late in possible])) for k in steps]
        results += [("early", (k * dt, *which), _only(u, which, course)) for k, course in courses]
    return results


def _each_and_all(judge: Judge) -> list[tuple[float, ...]]:
    """Return the number of each of several controls, and none, for all of them."""
    p = judge.model.controls
    return [*((float(j),) for j in range(p) if p > 1), ()]


def _only(u: Floats, which: tuple[float, ...], changed: Floats) -> Floats:
    """Return controls of which only one is changed, or all."""
    return np.where(np.arange(u.shape[1]) == which[0], changed, u) if which else changed


def _most_steps(judge: Judge) -> int:
    """Return the longest delay to try, in samples."""
    return max(1, min(max(round(LATEST / float(judge.model.step)), LATEST_STEPS), 2 * len(judge.recording.u) // 3))


def _coarse(most: int) -> list[int]:
    """Return the samples of the coarse search, up to the largest number."""
    return sorted({max(1, round(k)) for k in np.linspace(1, most, COARSE)})


def _near(best: float, most: int) -> list[int]:
    """Return the samples of the fine search about the best of the coarse one."""
    width, middle, tried = -(-most // COARSE), round(best), _coarse(most)
    return [k for k in range(max(1, middle - width), middle + width + 1) if k not in tried]


def _in_place(u: Floats, j: int, column: Floats) -> Floats:
    """Return controls with another course of one of them."""
    course = u.copy()
    course[:, j] = column
    return course


def _limits(judge: Judge, j: int, tried: list[Explanation] | None = None) -> list[Course]:
    """Return controls limited on both sides, above or below: a coarse search, or a finer one about the best of those tried."""
    u = judge.recording.u
    if tried is None:
        levels = np.unique(np.quantile(np.abs(u[:, j]), LEVELS))
        least = levels[levels > 0.0][:1]
        levels = np.concatenate([np.outer(least, LOWER).ravel(), levels])
    else:
        best = _size_of_limit(_best(tried, "limit", lambda x: x.values[2] == j))
        known = np.unique([_size_of_limit(x) for x in tried if x.kind == "limit" and x.values[2] == j])
        i = int(np.searchsorted(known, best))
        levels = np.linspace(known[max(i - 1, 0)], known[min(i + 1, len(known) - 1)], 9)[1:-1]
    results: list[Course] = []
    for level in levels:
        both = [(-level, level)] if level >= LEAST_LIMIT * u[:, j].std() else []
        for low, high in (*both, (-np.inf, level), (-level, np.inf)):
            course = _in_place(u, j, np.clip(u[:, j], low, high))
            results.append(("limit", (float(low), float(high), float(j)), course))
    return results


def _rates(judge: Judge, j: int, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return controls that change no faster than a rate: a coarse search, or a finer one about the best."""
    u, before, dt = judge.recording.u, holding(judge.model, judge.recording.mean), float(judge.model.step)
    most = float(np.abs(np.diff(u[:, j], prepend=before[j])).max())
    if not most:
        return []
    if coarse is None:
        steps = most * np.array(RATES)
    else:
        steps = _best(coarse, "rate", lambda x: x.values[1] == j).values[0] * dt * np.array(BETWEEN)
    behind = slowed(u[:, j], steps, float(before[j]))
    return [
        ("rate", (float(step) / dt, float(j)), _in_place(u, j, column))
        for step, column in zip(steps, behind, strict=True)
    ]


def _exchanged(judge: Judge) -> list[Course]:
    """Return the controls with each two of them exchanged, each with the delay of the other one."""
    u, before = judge.recording.u, holding(judge.model, judge.recording.mean)
    late = judge.recording.late or (0,) * u.shape[1]
    results: list[Course] = []
    for i, j in combinations(range(u.shape[1]), 2):
        course, later = u.copy(), late[i] - late[j]
        for to, of, steps in ((i, j, later), (j, i, -later)):
            moved = delayed(u, steps, before) if steps >= 0 else earlier(judge.recording, [-steps] * u.shape[1])
            course[:, to] = moved[:, of]
        results.append(("exchanged", (float(i), float(j)), course))
    return results


def _bands(judge: Judge, j: int, coarse: list[Explanation] | None = None) -> list[Course]:
    """Return controls behind a play, and behind a dead zone about zero: a coarse search, or a finer one about the best."""
    u, before = judge.recording.u, float(holding(judge.model, judge.recording.mean)[j])
    low, high = np.percentile(u[:, j], (RARE, 100.0 - RARE))
    about_last, about_zero = (high - low) * np.array(WIDTHS), np.zeros(0)
    if low < 0.0 < high:  # of a control of one sign, a dead zone about zero is a load
        about_zero = 2.0 * max(-low, high) * np.array(WIDTHS)
    if coarse is not None:
        bands = [x for x in coarse if x.kind == "deadband" and x.values[1] == j]
        if not bands:
            return []
        width, _, last = max(bands, key=lambda x: x.total).values
        finer = width * np.array(BETWEEN)
        about_last, about_zero = (finer, finer[:0]) if last else (finer[:0], finer)
    elif not high > low:
        return []
    moved = [(w, 1.0, behind) for w, behind in zip(about_last, played(u[:, j], about_last, before), strict=True)]
    moved += [(w, 0.0, dead_zone(u[:, j], w)) for w in about_zero]
    return [("deadband", (float(width), float(j), last), _in_place(u, j, behind)) for width, last, behind in moved]


def _size_of_limit(limit: Explanation) -> float:
    low, high, _ = limit.values
    return high if np.isfinite(high) else -low


@lru_cache(maxsize=128)  # called again for each shorter part of a recording
def _faster(
    model: LinearModel, sets: tuple[tuple[int, ...], ...], factor: float
) -> tuple[LinearModel, Observers] | None:
    """Return the model of a plant that is `factor` times as fast, and its observers; None if they do not exist."""
    changed = faster(model, factor)
    bank = None if changed is None else observers(changed, sets)
    return None if changed is None or bank is None else (changed, bank)


def _times(judge: Judge) -> list[Explanation]:
    """Judge time scales, by a coarse and a fine search."""

    def tried(factors: Iterable[float]) -> list[Explanation]:
        found = {f: results for f in factors if (results := _faster(judge.model, judge.bank.sensors, f))}
        return _by_models(judge, "dt", [((f,), 1, *results) for f, results in found.items()])

    results = tried(FACTORS)
    results += tried(max(results, key=lambda x: x.total).values[0] * f for f in NEAR) if results else []
    if judge.model.effects.any():
        return results
    # Of a plant that nothing drives, a time scale is only another size of its noise, and fits any recording a little better.
    return [x for x in results if x.most_left < 1.0 - RELEVANT["dynamics"]]
