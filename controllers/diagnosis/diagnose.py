"""Diagnosis of a wrong model from a recorded run: a comparison of explanations by their predictions of all sensors.

Observers of sets of sensors predict the samples under each explanation: the control has another sign or size, a delay, a lag, a
limit or a dead band; the plant is faster or slower than the model; a load acts all the time, or one or two begin during the
run; the plant has other dynamics, or nonlinear ones; noise moves it that the model does not have; all sensors of a quantity
have an offset. The measure is the likelihood, with a free scale of the innovations (so that noise of another size has no
effect), less the cost of the parameters (BIC). An explanation counts only with the evidence of *every* set: an error of one set
alone is a fault of its sensors. Stretches in which sensors of one quantity disagree are left out, and sensors that the others
contradict for long. The fault probabilities of the precision learner, which a wrong model spoils, are therefore not needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from bayesftc.controllers.bayesian.recorded import check_recorded, samples_of
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
from bayesftc.controllers.diagnosis.healthy_stretches import WINDOW, contradicted
from bayesftc.controllers.diagnosis.judge import EVIDENCE, EXPLAINED, Explanation, Judge
from bayesftc.controllers.diagnosis.operating_point import far_goal
from bayesftc.controllers.diagnosis.scatter import stated_too_large
from bayesftc.controllers.diagnosis.slow_sensors import Presence, presence_of
from bayesftc.controllers.diagnosis.starts import wrong_start
from bayesftc.controllers.diagnosis.words import faulty_sensors, inferred_fault, moved_at_times, sentence
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.delays import aligned
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.wiring import find_inference, inferring, is_linear
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.roles import signals_of
from bayesftc.cosim.judging.signals import ALARM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.cosim.diagram.roles import LoopRoles
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

COMPARING = "Comparing the samples with the model, for seconds to a minute."

SIMPLE = frozenset({"sign", "gain", "gains", "dt", "late", "early", "limit", "deadband", "offset"})
"""Kinds with few parameters; one that explains a shorter run fully ranks above others that fit a longer run partly."""

FLEXIBLE = frozenset({"dynamics", "nonlinear"})
"""Kinds with many parameters."""

UNJUDGED = "Faults of several sensors may look the same: this controller does not infer them."
"""What is said where no fault probabilities tell a fault of each set of sensors from a wrong model."""

OF_FAULTS = {"offset", "noise"}
"""Kinds that several faulty sensors look like."""

OPEN = {*FLEXIBLE, "unknown"}
"""Kinds of findings that name no cause, or may fit to what happens at times only."""

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

RARELY = 0.01
"""Share of the samples up to which a sensor counts as never blamed, and in which all may be while some are said to be faulty."""

MOSTLY = 0.5
"""Share of a run from which on a blamed sensor is left out of all of it."""

OFTEN = 0.2
"""Least share of the time for which the most blamed sensor is blamed, for another one to be faulty as well."""

LEAST_SAMPLES = 8
"""Least number of samples for a diagnosis."""

LARGEST = 1e50
"""Size from which on a sample counts as missing: products of larger ones overflow, as after a run that ended infinite."""


@dataclass(frozen=True)
class ModelFinding:
    """A way in which a model is wrong.

    Attributes
    ----------
    kind : str
        ``"sign"`` or ``"gain"`` of a column of B, ``"gains"`` of all its columns, each by its own factor, ``"dt"`` (the plant is
        faster or slower), ``"late"`` (a delay or a lag of the control), ``"early"`` (the model's delays are too long),
        ``"limit"`` (of the control), ``"deadband"`` (of the actuator: stiction or play, or a dead zone about zero),
        ``"nonlinear"`` (far from the point of linearisation; never in a closed loop with a linear plant), ``"dynamics"``
        (another A), ``"load"`` (a constant load), ``"onset"`` (a load or an offset of the actuator that begins
        during the run), ``"loss"`` (a control of which the effect changes during the run), ``"offset"``
        (all sensors of a quantity have a constant offset), ``"noise"``
        (more process noise than in the model, or a load that changes all the time; only if another kind would be reported
        without it, or `model_suspect` was raised),
        ``"sensors"`` (one or several sensors failed: without the samples for which the controller blames them there is no
        evidence against the model; the explanation for healthy sensors is among the `others`),
        ``"start"`` (the belief starts where the samples exclude it),
        ``"unknown"``.
    sentence : str
        What is wrong, and what to do.
    values : tuple of float
        ``sign`` and ``gain``: the control's effect relative to the model's, and its number; ``gains``: that of each control, and
        then the standard deviation of each; ``dt``: the plant's speed relative to the model's; ``late``: seconds, and 1 for a
        lag; ``early``: seconds; ``limit``: low, high, and the control's number;
        ``deadband``: its whole width in the unit of the control, the control's number, and 1 if it is about where the actuator
        stands, 0 if about zero; ``load``: a value for each control, in its unit; ``onset``: begin and end in seconds after the
        first sample (infinity: to the last one), then as ``load``; the same of a second load, if there is one; ``loss``: begin,
        end, effect relative to the model's, number of the control, and for a stuck actuator (effect near 0) the control at
        which it is stuck; ``offset``: a value for each sensor, in its unit, 0 for those without; ``noise``: number of the state
        (-1 for each of the plant's; that of a disturbance is a load on a control) and standard deviation in a sample; or -2 and
        a factor of the standard deviations of the model's noise; or, for a load that the model does not have: the number that
        its disturbance would get, the standard deviation of its change in a sample, its mean (0 if there is no evidence for a
        mean), and the share of the model's process covariance that remains beside the load; ``start``: the belief, the first
        sample, and the sensor; else empty.
    evidence : float
        Log-likelihood ratio to the unchanged model. Each set of sensors that can observe the plant on its own has one; this is
        the least.
    others : tuple of str
        Kinds that explain the run nearly as well; the sentence has them as well.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> rng = np.random.default_rng(0)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> u, x = np.repeat(rng.choice([-5.0, 5.0], (40, 1)), 5, axis=0), np.zeros((200, 1))
    >>> for k in range(2, 199):
    ...     x[k + 1] = 0.9 * x[k] + 0.1 * u[k - 2]  # two samples late
    >>> finding = controllers.diagnose_recording(model, x + 0.1 * rng.standard_normal((200, 2)), u)
    >>> finding.kind, finding.values[0]  # the control is late, by 0.2 s
    ('late', 0.2)
    """

    kind: str
    sentence: str
    values: tuple[float, ...] = ()
    evidence: float = float("nan")
    others: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return short(self)

    def __str__(self) -> str:
        return self.sentence

    def _repr_html_(self) -> str:
        """Return the sentence and what it is based on, for notebooks."""
        rows: list[tuple[str, object]] = [("kind", self.kind), ("finding", self.sentence)]
        if self.values:
            rows.append(("values", ", ".join(f"{value:.6g}" for value in self.values)))
        if np.isfinite(self.evidence):
            rows.append(("evidence (log-likelihood ratio)", f"{self.evidence:.4g}"))
        if self.others:
            rows.append(("nearly as likely", ", ".join(self.others)))
        return table("The model", rows)


@reported(COMPARING)
def diagnose(
    signals: Mapping[str, Any], controller: Any, *, y: str | None = None, name: str = "controller"
) -> ModelFinding | None:
    """Diagnose the model of a controller or estimator from a recorded run; None without enough evidence against it.

    Parameters
    ----------
    signals : Result
        Must contain the samples and the controls at every step (decimation 1).
    controller : controller, StateEstimator or Diagram
        The block that ran, for its model and its initial belief; or the closed loop that contains it. For a nonlinear model only
        `model_suspect` is used.
    y : str, optional
        Name of the signal that was connected to the input ``y`` of the block; not needed for a closed loop.
    name : str
        The block's name in the diagram; not needed for a closed loop.

    Returns
    -------
    ModelFinding or None
        The best explanation of the run. Without one, but with a recorded `model_suspect` above one half, the kind is
        ``"unknown"``. None does not show that the model is right: a longer run may have enough evidence.

    Raises
    ------
    ModelError
        If the block has no model, or not every step is recorded.
    UnknownNameError
        If a signal is not recorded.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[-0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)  # B has the wrong sign
    >>> controller = controllers.LQGController(model, controllers.FixedPrecision())
    >>> sensors = cosim.Sensors(2, 0.1)
    >>> loop = cosim.closed_loop(plant, controller, control="u", measured="y", sensors=sensors, reference=1.0)
    >>> run = loop.simulate(10.0, engine="interpreted")
    >>> controllers.diagnose(run, controller).kind
    'sign'
    """
    linear = isinstance(controller, Diagram) and is_linear(controller)
    if isinstance(controller, Diagram):
        node = find_inference(controller)
        controller, name = inferring(node.block), node.name
    model = checked_model(controller)
    if model is None:
        raise ModelError(f"A diagnosis needs a model, but this {type(controller).__name__} has none.")
    suspect, reader = f"{name}.model_suspect", "The diagnosis"
    roles = getattr(signals, "roles", None)
    roles = None if roles is None or roles.controller != name else roles
    sent = [f"{name}.u"] if roles is None else sorted({x.sent[0] if x.sent else f"{name}.u" for x in roles.controls})
    check_recorded(signals, reader, *([suspect] if isinstance(model, NonlinearModel) else sent))
    if getattr(signals, "decimation", 1) != 1:
        raise ModelError("The diagnosis needs every step, but the run has a decimation; run with decimation=1.")
    raised = suspect in signals and np.nanmax(np.append(signals[suspect], 0.0)) >= ALARM
    if isinstance(model, NonlinearModel):
        words = sentence("suspect", (), model.linearised(controller.initial_mean, controller.control_mean))
        return ModelFinding("unknown", words) if raised else None
    samples = samples_of(signals, y, name, reader)
    inferred = _inferred(signals, controller, name)
    u = signals[f"{name}.u"] if roles is None else _applied(signals, roles)
    units = ([x.unit for x in roles.sensors], [x.unit for x in roles.controls]) if roles is not None else ((), ())

    def found(samples: Floats, each: bool = False, alone: bool = False) -> ModelFinding | None:
        noise = alone or (each and raised)
        return _finding(
            model,
            samples,
            u,
            controller.initial_mean,
            alone=noise,
            each=each,
            linear=linear,
            inferred=inferred,
            units=units,
        )

    result = found(samples, alone=raised)
    if nothing := result is None and raised:
        result = ModelFinding("unknown", sentence("unknown", (), model))
    if result is not None:
        probability = np.asarray(signals.get(f"{name}.fault_probability", np.zeros(0)), float)
        left = _of_faults(result, model, samples, probability, found, faulty_sensors)
        if left is not None and result.kind != "unknown":
            otherwise = f"{left.sentence} With all samples, as if no sensor had failed: {result.sentence}"
            left = replace(left, sentence=otherwise)
        result = left or result
        unjudged = getattr(getattr(controller, "precision", None), "why_no_probability", "")
        if result.kind in {"unknown", "onset", *OF_FAULTS} and unjudged and model.sensors > 1:
            result = replace(result, sentence=f"{result.sentence} {UNJUDGED}")
    if result is None or (nothing and result.kind == "unknown"):
        started = wrong_start(model, controller, samples, units[0])
        result = result if started is None else ModelFinding("start", *started)
    if result is None or roles is None:
        return result
    its = signals_of(roles, signals, drawn=result.kind in OPEN)  # type: ignore[arg-type]
    pushed = moved_at_times(its.time, its.process)
    far = "" if linear or result.kind == "nonlinear" else far_goal(model, its)
    acting = inferred_fault(inferred, model)
    acting = "" if acting in result.sentence else acting
    loud = stated_too_large(samples, np.sqrt(np.diag(model.matrix("sensor_covariance"))), model.alike)
    return replace(result, sentence=f"{loud}{far}{result.sentence}{pushed}{acting}")


def _of_faults(
    result: ModelFinding,
    model: LinearModel,
    samples: Floats,
    probability: Floats,
    found: Callable[..., ModelFinding | None],
    words: Callable[..., str],
) -> ModelFinding | None:
    """Return the finding without the samples of blamed sensors, where these may be all that is wrong; else None.

    `probability` has the fault probability of each sensor, if it was recorded; `words` are those of `faulty_sensors`.
    """
    blamed = _blamed(model, probability, samples, together=result.kind in {"unknown", *OF_FAULTS})
    left = None if blamed is None else _without_blamed(model, samples, blamed, found, words)
    if left is None or (result.kind != "unknown" and left.kind != "sensors"):
        return None
    return left if result.kind == "unknown" else replace(left, others=(result.kind, *result.others))


def _applied(signals: Mapping[str, Any], roles: LoopRoles) -> Floats:
    """Return the controls, a column for each: outputs of the controller, or what an estimator received."""
    places = [role.sent or (f"{roles.controller}.u", j) for j, role in enumerate(roles.controls)]
    columns = [np.reshape(signals[signal], (len(signals[signal]), -1))[:, j] for signal, j in places]
    return np.stack(columns, axis=1)


def _blamed(model: LinearModel, probability: Floats, samples: Floats, *, together: bool) -> NDArray[np.bool_] | None:
    """Return which samples the controller blames, if of several sensors, but hardly ever of all; else None.

    One faulty sensor beside others of its quantity is no evidence against the model, because the others agree with it. The only
    one of its quantity is, because each set needs it. Without all sensors there is no evidence at all. Several sensors count if
    another one is hardly ever blamed, or, with `together`, also if several are blamed at once.
    `_without_blamed` decides whether they are all that is wrong.
    """
    if not len(probability):
        return None
    blamed = probability.reshape(len(probability), -1) >= ALARM
    if blamed.shape != np.shape(samples):
        return None
    count = blamed.sum(axis=1)
    every = count == blamed.shape[1]
    often = blamed.mean(axis=0) > RARELY
    several = 1 < np.sum(often) < len(often) or (together and np.any((count > 1) & ~every))
    return blamed if (several or _only(model, blamed) is not None) and np.mean(every) < RARELY else None


def _only(model: LinearModel, blamed: NDArray[np.bool_]) -> int | None:
    """Return the sensor that alone is blamed for long, if no other one measures its quantity."""
    often = tuple(np.flatnonzero(blamed.mean(axis=0) > RARELY).tolist())
    return often[0] if len(often) == 1 and often in model.proportional else None


def _without_blamed(
    model: LinearModel,
    samples: Floats,
    blamed: NDArray[np.bool_],
    found: Callable[..., ModelFinding | None],
    words: Callable[..., str],
) -> ModelFinding | None:
    """Return the finding without the samples of the sensors that are blamed for long, or else of all; None if it is no better.

    Sensors that are blamed for a moment beside one that is blamed for long may be healthy: they are not named. Without the only
    sensor of a quantity, all samples of the others must count while it is blamed: else a load that acts then would be hidden.
    Its own are left out for a `WINDOW` more on both sides: it is blamed only after some faulty samples.
    """
    only = {} if _only(model, blamed) is None else {"each": True}
    margin = WINDOW if only else 0
    shares = blamed.mean(axis=0)
    named = np.flatnonzero(shares > OFTEN * shares.max()).tolist()
    for chosen in dict.fromkeys((tuple(named), tuple(np.flatnonzero(shares).tolist()))):
        trusted = _trusted(model, samples, _wider(blamed, margin) & np.isin(np.arange(len(shares)), chosen))
        left = None if trusted is None else found(trusted, **only)
        if trusted is not None and left is None:
            count = blamed[:, named].sum(axis=1)
            together = int(np.median(count[count > 0]))
            partner = not any(group == tuple(named) for group in model.alike)
            others = bool(np.count_nonzero(shares) > len(named))
            times = _times(model, blamed[:, named[0]]) if only else ()
            alone = len(chosen) == len(named)
            said = words(
                named, together=together, alone=alone, partner=partner, others=others, times=times, names=model.names
            )
            return ModelFinding("sensors" if len(named) > 1 or not partner else "unknown", said)
        if left is not None and left.kind != "unknown":
            return left
    return None


def _times(model: LinearModel, blamed: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return from when to when a sensor is blamed for long, in seconds after the first sample; infinity: to the last one."""
    found = periods(blamed)
    least = OFTEN * max(end - begin for begin, end in found)
    step = float(model.step)
    return [(begin * step, end * step if end < len(blamed) else np.inf) for begin, end in found if end - begin >= least]


def _wider(flags: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Return flags (T x m) that are also true up to `margin` samples before and after each true one."""
    wider = flags.copy()
    for j, column in enumerate(flags.T):
        for begin, end in periods(column):
            wider[max(begin - margin, 0) : end + margin, j] = True
    return wider


def _trusted(model: LinearModel, samples: Floats, blamed: NDArray[np.bool_]) -> Floats | None:
    """Return the samples that the controller does not blame; None if the sensors that are left cannot be compared with the model.

    A sensor that is blamed for most of the run is left out of all of it, because a few samples would leave its set no evidence;
    but not if the others do not see the plant.
    """
    bank = observers(model)
    if bank is None:
        return None
    gone = np.flatnonzero(blamed.mean(axis=0) > MOSTLY).tolist()
    if observers(model, _sets_without(bank.sensors, gone)) is None:
        gone = []
    return np.where(blamed | np.isin(np.arange(blamed.shape[1]), gone), np.nan, samples)


def _inferred(signals: Mapping[str, Any], controller: Any, name: str) -> list[float] | None:
    """Return the largest fault probability of each actuator; nothing if none is recorded, None if the controller infers none."""
    signal = f"{name}.actuator_fault_probability"
    if not getattr(controller, "actuator_kinds", ()):
        return None
    values = np.nan_to_num(signals[signal]) if signal in signals else np.zeros(0)
    if not len(values):
        return []
    largest: list[float] = values.reshape(len(values), -1).max(axis=0).tolist()
    return largest


def checked_model(controller: Any) -> LinearModel | NonlinearModel | None:
    """Return the model in the consistency check of a controller or estimator; None if there is none."""
    model = getattr(controller, "watched_model", getattr(controller, "model", None))
    return model if isinstance(model, LinearModel | NonlinearModel) else None


def compared_samples(model: LinearModel | NonlinearModel, samples: int) -> int:
    """Return how many of a run's samples, from its start, `diagnose` compares with a model; 0 if it compares none."""
    if isinstance(model, NonlinearModel):
        return samples
    return 0 if samples < LEAST_SAMPLES or observers(model) is None else min(samples, MOST_SAMPLES)


@reported(COMPARING)
def diagnose_recording(
    model: LinearModel, y: ArrayLike, u: ArrayLike, initial_mean: ArrayLike = 0.0
) -> ModelFinding | None:
    """Diagnose a model from recorded samples and controls; None without enough evidence against it.

    Parameters
    ----------
    model : LinearModel
        The model.
    y : array, steps x m
        Samples; one that is not finite is missing.
    u : array, steps x p
        Controls from each sample to the next.
    initial_mean : number or vector
        Approximate state at the first sample, the origin of nonlinear explanations.

    Returns
    -------
    ModelFinding or None
        The best explanation of the recording.

    Raises
    ------
    ModelError
        If the number of sensors or controls is not that of the model.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> rng = np.random.default_rng(0)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> u, x = rng.choice([-5.0, 5.0], (200, 1)), np.zeros((200, 1))
    >>> for k in range(199):
    ...     x[k + 1] = 0.9 * x[k] - 0.1 * u[k]  # against the model
    >>> finding = controllers.diagnose_recording(model, x + 0.1 * rng.standard_normal((200, 2)), u)
    >>> finding.kind, np.round(finding.values, 1).tolist()
    ('sign', [-1.0, 0.0])
    """
    return _finding(model, y, u, initial_mean, alone=False)


@reported(COMPARING)
def diagnose_inputs(
    model: LinearModel,
    y: Floats,
    u: Floats,
    initial_mean: Floats,
    probability: Floats | None = None,
    first_sample: datetime | None = None,
) -> ModelFinding | None:
    """Return the finding of `diagnose_recording` in the words of a monitor, whose recorded inputs may be measured.

    `probability` (steps x m) has the fault probabilities of the monitor, if it has run; `first_sample` is the date of the first
    row, if known.
    """

    def found(samples: Floats, each: bool = False) -> ModelFinding | None:
        return _finding(
            model, samples, u, initial_mean, alone=False, each=each, recorded=True, first_sample=first_sample
        )

    result = found(y)
    if result is None or probability is None:
        return result
    words = partial(faulty_sensors, recorded=model.names, first_sample=first_sample)
    return _of_faults(result, model, y, probability, found, words) or result


def _finding(
    model: LinearModel,
    y: ArrayLike,
    u: ArrayLike,
    initial_mean: ArrayLike,
    *,
    alone: bool,
    each: bool = False,
    inferred: Sequence[float] | None = None,
    units: tuple[Sequence[str | None], Sequence[str | None]] = ((), ()),
    recorded: bool = False,
    first_sample: datetime | None = None,
    linear: bool = False,
) -> ModelFinding | None:
    """Return the finding of `diagnose_recording`; noise counts where no other kind does only if it may stand `alone`.

    With `each`, a set has evidence also while only some of its sensors have samples. `units` are those of the sensors and of the
    controls; these may be the `recorded` inputs of a monitor, with the date of their `first_sample`, if known. `linear`: the
    plant is known to be linear.
    """
    for kind, values_given, columns in (("sensors", y, model.sensors), ("controls", u, model.controls)):
        if (given := 1 if np.ndim(values_given) == 1 else np.shape(values_given)[-1]) != columns:
            raise ModelError(
                f"The recording has {given} {kind}, but the model has {columns}. Give the samples and controls of the sensors "
                "and actuators in the model."
            )
    result = best_explanations(model, y, u, initial_mean, alone=alone, each=each, linear=linear)
    if not result:
        return None
    best = result[0]
    load = next((x for x in result if x.kind == "onset"), best)
    text = sentence(
        best.kind,
        best.values,
        model.undelayed,
        [(x.kind, x.values) for x in result[1:]],
        inferred,
        *units,
        recorded=recorded,
        elsewhere=load.elsewhere,
        state=load.state,
        first_sample=first_sample,
        linear=linear,
    )
    values = () if best.kind in ("dynamics", "nonlinear") else best.values
    return ModelFinding(best.kind, text, values, min(best.support), tuple(x.kind for x in result[1:]))


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
    """Return the best explanation of a recording, then those nearly as good; see `_finding` for the arguments."""
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
    """
    if counting and min(counting[0].support) > CLEAR * max(judge.rows):
        return counting
    every = tuple(sorted({i for chosen in judge.bank.sensors for i in chosen}))
    bank = observers(judge.model, (every,)) if counting and len(judge.bank) > 1 else None
    if bank is None:
        return counting
    whole = Judge(judge.model, bank, judge.recording)
    if float(whole.first_squares.max()) > FITS:
        return counting
    found = explanations(whole)
    supported = {x.kind for x in (*_with_fitted_noise(whole, found), *(x for x in found if x.counts))}
    return [x for x in counting if x.kind in supported]


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
    """Return the explanations that count, noise among them, from the best one on."""
    noises = noisier(judge, found)
    return moved_at_random(judge, ranked(x for x in (*found, *noises) if x.counts), (found, noises))


def _without(model: LinearModel, bank: Observers, samples: Floats) -> tuple[Observers, Floats]:
    """Return observers and samples without sensors that others contradict for long; all if the rest does not see the plant."""
    absent = np.flatnonzero(~np.isfinite(samples).any(axis=0)).tolist()
    faulty = sorted({*contradicted(model, samples), *absent})
    rest = observers(model, _sets_without(bank.sensors, faulty)) if faulty else None
    if rest is None:
        return bank, samples
    return rest, np.where(np.isin(np.arange(model.sensors), faulty), np.nan, samples)


def _sets_without(sets: Sequence[tuple[int, ...]], faulty: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Return sets without faulty sensors; what remains of a set joins the smallest other one, if there are two.

    Alone, a noisy sensor could hide what all others see, because every set must have evidence for an explanation.
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
