"""The best explanation of a recording: which of them count, which are nearly as good, and how much of a run to compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from bayesftc.controllers.diagnosis.candidates import (
    EFFECT,
    NEARLY,
    explanations,
    moved_at_random,
    noisier,
    quieter,
    ranked,
)
from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.diagnosis.healthy_stretches import contradicted
from bayesftc.controllers.diagnosis.judge import EVIDENCE, EXPLAINED, Explanation, Judge
from bayesftc.controllers.diagnosis.slow_sensors import Presence, presence_of
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.delays import aligned
from bayesftc.controllers.models.linear import LinearModel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.cosim.types import Floats

MOST_SAMPLES = 5_000
"""Largest number of samples, from the start of a run."""

CUTS = (1e6, 300.0, 100.0, 30.0, 10.0, 6.0)
"""Errors of every observer, in standard deviations, at which the rest of a run is cut off, for several trials.

After a loss of the plant, such as a fallen pendulum, no linear model holds; the cause shows before."""

CLEAR = 0.05
"""Evidence for each sample from which on an explanation needs no further one: of a right model, what the control tells of the
others' noise made up to .015."""

FITS = 1.5
"""Mean square of the innovations of all sensors, relative to the expected one, up to which they fit the model."""

SIMPLE = frozenset(
    {"sign", "gain", "gains", "dt", "late", "early", "limit", "rate", "exchanged", "deadband", "offset", "late_sensors"}
)
"""Kinds with few parameters; one that explains a shorter run fully ranks above others that fit a longer run partly."""

FLEXIBLE = frozenset({"dynamics", "nonlinear"})
"""Kinds with many parameters."""

WHOLE = {"loss": EFFECT, "onset": {"load"}}
"""What begins during a run, and what acts all the time: where both explain it about as well, the latter does."""

WHOLLY = 0.9
"""Share of the evidence for a lasting loss from which on an effect that is other all the time is named beside it.

A mass that differs from the model's is more than another effect of the control. While the control hardly moves, as before the
first step of its goal, this shows, and looks as if the effect changed later."""

SIMPLEST = 4
"""Rank of a full explanation with one parameter, which ends the search."""

MUCH = 0.8
"""Share of a flexible explanation's evidence from which more noise counts as an alternative to it.

A force that wanders, and to which the controls react, looks like other dynamics, which have more parameters than the noise."""

LEAST_SAMPLES = 8
"""Least number of samples for a diagnosis."""

LARGEST = 1e50
"""Size from which on a sample counts as missing: products of larger ones overflow, as after a run that ended infinite."""


@np.errstate(all="ignore")  # of a plant that is lost, or a model that is far off: what is not finite explains nothing
@threadpool_limits.wrap(limits=1, user_api="blas")  # matrices this small take several times as long on several threads
def best_explanations(
    model: LinearModel,
    y: ArrayLike,
    u: ArrayLike,
    initial_mean: ArrayLike = 0.0,
    *,
    alone: bool = False,
    each: bool = False,
    linear: bool = False,
) -> list[Explanation]:
    """Return the best explanation of a recording, then those nearly as good; see `diagnose._finding` for the arguments."""
    samples = np.asarray(y, float).reshape(-1, model.sensors)[:MOST_SAMPLES]
    samples = np.where(np.abs(samples) < LARGEST, samples, np.nan)
    controls = np.nan_to_num(np.asarray(u, float).reshape(-1, model.controls)[: len(samples)]).clip(-LARGEST, LARGEST)
    mean = np.array(np.broadcast_to(np.asarray(initial_mean, float), model.states))
    delays, (samples, controls) = model.delays, aligned(model, samples, controls)
    if delays is not None:
        model, mean = model.undelayed, mean[delays.others(model.states)]
    bank = observers(model)
    if bank is None:
        return []
    last = int(np.flatnonzero(np.isfinite(samples).any(axis=1)).max(initial=-1)) + 1
    if last < LEAST_SAMPLES:
        return []
    bank, samples = _without(model, bank, samples)
    seen = sorted({i for chosen in bank.sensors for i in chosen})
    recording = Recording(
        samples[:last],
        controls[:last],
        mean,
        beyond=controls[last:],
        presence=Presence(np.isfinite(samples[:last])) if each else presence_of(samples[:last], seen),
        late=() if delays is None else tuple(late + min(delays.sensors) for late in delays.inputs),
        linear=linear,
    )
    moved = recording.u @ model.matrix("B").T
    base = innovations([model], [bank], recording, moved[None, None])[0][0][:, 0]
    missed = np.nan_to_num(np.abs(base), nan=np.inf).max(axis=2).min(axis=0)
    fallback: list[Explanation] = []
    best = -1
    tried: set[int] = set()
    for cut in CUTS:
        end = int(np.argmax(missed > cut)) if (missed > cut).any() else len(recording.y)
        if end in tried or end < LEAST_SAMPLES:
            continue
        tried.add(end)
        judge = Judge(model, bank, recording.until(end))
        if min(judge.rows) < LEAST_SAMPLES:
            continue
        found = explanations(judge)
        counting = _with_fitted_noise(judge, found) if alone or any(x.counts for x in found) else []
        counting = _of_all_sensors(judge, counting)
        near = [x for x in counting if _near(x, counting[0])]
        kinds = {x.kind for x in near}
        near = [x for x in near if not WHOLE.get(x.kind, set()) & kinds]
        near += [x for x in counting if x not in near and _holds_all_the_time(x, counting[0])]
        if near and near[0].kind == "dynamics":  # the simple ones are special cases of it
            near.sort(key=lambda x: x.kind not in SIMPLE)
        rank = max(map(_rank, near), default=-1)
        if len(tried) == 1 and any(x.kind in WHOLE and np.inf in x.values and _rank(x) for x in near):
            return near  # it begins and lasts; a shorter run may end before
        if len(tried) == 1 and near and near[0].kind == "noise" and _rank(near[0]):
            return near  # a short run has little noise, and may be explained by less
        if rank == SIMPLEST:
            return near
        if rank > best:
            fallback, best = near, rank
    return fallback


def _of_all_sensors(judge: Judge, counting: list[Explanation]) -> list[Explanation]:
    """Return the explanations that all sensors together support, too; all if the best is clear, or the sensors fit badly.

    The control follows all sensors. To the filter of some of them it therefore tells something about the plant that this filter
    does not know. Beside a constant goal nothing else moves the control, and a slower plant, for example, explains it better than
    the right model. The filter of all sensors knows what the control knows, as far as the controller weights them alike.

    For the same reason a control without any effect looks reversed to some sensors. All together decide on its sign.
    """
    clear = bool(counting) and counting[0].least > CLEAR * max(judge.rows)
    if clear and all(x.kind != "sign" for x in counting):
        return counting
    every = tuple(sorted({i for chosen in judge.bank.sensors for i in chosen}))
    bank = observers(judge.model, (every,)) if counting and len(judge.bank) > 1 else None
    if bank is None:
        return counting
    whole = Judge(judge.model, bank, judge.recording)
    if float(whole.first_squares.max()) > FITS:
        return counting
    found = explanations(whole)
    of_all = [*_with_fitted_noise(whole, found), *(x for x in found if x.counts)]
    supported, effects = {x.kind for x in of_all}, {x.values[1]: x for x in of_all if x.kind == "gain"}
    if "sign" not in supported:
        counting = [
            replace(x, kind="gain", values=effects[x.values[1]].values)
            if x.kind == "sign" and x.values[1] in effects
            else x
            for x in counting
        ]
    return counting if clear else [x for x in counting if x.kind in supported]


def _with_fitted_noise(judge: Judge, found: list[Explanation]) -> list[Explanation]:
    """Return the explanations that count beside less process noise of all states, if the run has less than the model states."""
    calmer = quieter(judge) if any(x.counts for x in found) else judge
    if calmer is judge:
        return _counting(judge, found)
    counting = _counting(calmer, explanations(calmer))
    if not counting or counting[0].kind != "noise":
        # Noise to add to the quieter model is no noise that the user's model lacks: it may have more already.
        return [x for x in counting if x.kind != "noise"]
    # Less noise of all states, and more of some, explains the run: no finding, unless the model as it is lacks noise, or another
    # cause explains more.
    gained = counting[0].total + float(np.sum(judge.first - calmer.first))
    counting = _counting(judge, found)
    lacking = counting and (counting[0].kind == "noise" or counting[0].total > gained)
    return counting if lacking else []


def _counting(judge: Judge, found: list[Explanation]) -> list[Explanation]:
    """Return the explanations that count, noise among them, from the best one on.

    Other dynamics with a small effect are no reason to call a model wrong. But if it lacks noise by this run, and they explain
    more, as another growth rate of an unstable plant may, then they are it.
    """
    noises = noisier(judge, found)
    counting = ranked(x for x in (*found, *noises) if x.counts)
    if counting and counting[0].kind == "noise":
        more = [x for x in found if x.kind in FLEXIBLE and x.evident and x.total > counting[0].total]
        counting = ranked([*more, *(x for x in counting if x not in more)])
    return moved_at_random(judge, counting, (found, noises))


def _without(model: LinearModel, bank: Observers, samples: Floats) -> tuple[Observers, Floats]:
    """Return observers and samples without sensors that others contradict for long; all if the rest does not see the plant."""
    absent = np.flatnonzero(~np.isfinite(samples).any(axis=0)).tolist()
    faulty = sorted({*contradicted(model, samples), *absent})
    rest = observers(model, sets_without(bank.sensors, faulty)) if faulty else None
    if rest is None:
        return bank, samples
    return rest, np.where(np.isin(np.arange(model.sensors), faulty), np.nan, samples)


def sets_without(sets: Sequence[tuple[int, ...]], faulty: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Return sets without faulty sensors; what remains of a set joins the smallest other one, if there are two.

    Alone, a noisy sensor could hide what all others see, because each set that can tell must have evidence for an explanation.
    """
    whole = [each for each in sets if not set(each) & set(faulty)]
    parts = [tuple(i for i in each if i not in faulty) for each in sets if set(each) & set(faulty)]
    for part in filter(None, parts):
        if len(whole) >= 2:
            smallest = min(range(len(whole)), key=lambda k: len(whole[k]))
            whole[smallest] = tuple(sorted({*whole[smallest], *part}))
        else:
            whole.append(part)
    return tuple(whole)


def _near(x: Explanation, best: Explanation) -> bool:
    """Return whether an explanation counts as nearly as good as the best one."""
    if x.kind == "noise" and best.kind in FLEXIBLE and x.total > MUCH * best.total:
        return True
    return x.total > best.total - (EVIDENCE if x.kind in SIMPLE else NEARLY)


def _holds_all_the_time(x: Explanation, best: Explanation) -> bool:
    """Return whether another effect of a control explains all of a run, of which the best explanation is a loss of effect."""
    lasting = best.kind == "loss" and best.values[1] == np.inf
    return lasting and x.kind in WHOLE["loss"] and x.total > WHOLLY * best.total and max(x.square) < EXPLAINED


def _rank(x: Explanation) -> int:
    """Return the rank of an explanation of a part of a run; 0 if it leaves something unexplained.

    Before a loss of the plant the linear model still holds, so a linear explanation of a shorter run ranks above a nonlinear one.
    """
    if max(x.square) >= EXPLAINED:
        return 0
    if x.kind in SIMPLE:
        return SIMPLEST if x.parameters == 1 else SIMPLEST - 1
    return 1 if x.kind == "nonlinear" else 2


__all__ = ["FLEXIBLE", "LEAST_SAMPLES", "MOST_SAMPLES", "best_explanations", "sets_without"]
