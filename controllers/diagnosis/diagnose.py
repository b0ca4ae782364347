"""Diagnosis of a wrong model from a recorded run: a comparison of explanations by their predictions of all sensors.

Observers of sets of sensors predict the samples under each explanation: the control has another sign or size, a delay, a lag, a
limit, a limit of its rate or a dead band; two controls are exchanged; the plant is faster or slower than the model; a load acts
all the time, or one or two begin during the run; the plant has other dynamics, or nonlinear ones; noise moves it that the model
does not have; all sensors of a quantity have an offset, or are late. The measure is the likelihood, with a free scale of the
innovations (so that noise of another size has no effect), less the cost of the parameters (BIC). An explanation counts only
with the evidence of *every* set that can tell: an error of one set alone is a fault of its sensors. Stretches in which sensors
of one quantity disagree are left out, and sensors that the others contradict for long. The fault probabilities of the precision
learner, which a wrong model spoils, are therefore not needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.recorded import check_recorded, sampled_rows, samples_of
from bayesftc.controllers.diagnosis.best import FLEXIBLE, LEAST_SAMPLES, MOST_SAMPLES, best_explanations
from bayesftc.controllers.diagnosis.blamed import OF_FAULTS, of_faults
from bayesftc.controllers.diagnosis.finding import ModelFinding
from bayesftc.controllers.diagnosis.operating_point import far_goal
from bayesftc.controllers.diagnosis.scatter import stated_too_large
from bayesftc.controllers.diagnosis.starts import wrong_start
from bayesftc.controllers.diagnosis.words.sentences import faulty_sensors, inferred_fault, moved_at_times, sentence
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.wiring import find_inference, inferring, is_linear
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.lost import loss_in, rows_before
from bayesftc.cosim.judging.roles import signals_of
from bayesftc.cosim.judging.signals import ALARM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bayesftc.cosim.diagram.roles import LoopRoles
    from bayesftc.cosim.types import Floats

COMPARING = "Comparing the samples with the model, for seconds to a minute."

UNJUDGED = "Faults of several sensors may look the same: this controller does not infer them."
"""What is said where no fault probabilities tell a fault of each set of sensors from a wrong model."""

NO_ERROR = "The samples before do not have enough evidence against the model to name an error."
"""What is said of a loop that is lost with what may be the right model."""

OPEN = {*FLEXIBLE, "unknown"}
"""Kinds of findings that name no cause, or may fit to what happens at times only."""


@reported(COMPARING)
def diagnose(
    signals: Mapping[str, Any], controller: Any, *, y: str | None = None, name: str = "controller"
) -> ModelFinding | None:
    """Diagnose the model of a controller or estimator from a recorded run; None without enough evidence against it.

    Parameters
    ----------
    signals : Result
        Must contain every sample of the block, and the controls.
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
        The best explanation of the run; of a loop that is lost, of the samples before. Without one, but with a recorded
        `model_suspect` above one half, the kind is ``"unknown"``. None does not show that the model is right: a longer run may
        have enough evidence.

    Raises
    ------
    ModelError
        If the block has no model, or not every sample is recorded.
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
    if (loss := loss_in(signals)) is not None:
        earlier = _diagnosed(rows_before(signals, loss), controller, y, name)  # type: ignore[arg-type]
        if earlier is None:
            return ModelFinding("lost", f"{loss.sentence} {NO_ERROR} {loss.todo}")
        return replace(earlier, sentence=f"{loss.sentence} Of the samples before: {earlier.sentence}")
    return _diagnosed(signals, controller, y, name)


def _diagnosed(signals: Mapping[str, Any], controller: Any, y: str | None, name: str) -> ModelFinding | None:
    """Diagnose a run whose loop is not lost."""
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
    rows = sampled_rows(signals, model.step, reader)
    raised = suspect in signals and np.nanmax(np.append(signals[suspect], 0.0)) >= ALARM
    if isinstance(model, NonlinearModel):
        words = sentence("suspect", (), model.linearised(controller.initial_mean, controller.control_mean))
        return ModelFinding("unknown", words) if raised else None
    samples = samples_of(signals, y, name, reader)[rows]
    inferred = _inferred(signals, controller, name)
    u = (np.asarray(signals[f"{name}.u"]) if roles is None else _applied(signals, roles))[rows]
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
        probability = np.asarray(signals.get(f"{name}.fault_probability", np.zeros(0)), float)[rows]
        left = of_faults(result, model, samples, probability, found, faulty_sensors)
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


def _applied(signals: Mapping[str, Any], roles: LoopRoles) -> Floats:
    """Return the controls, a column for each: outputs of the controller, or what an estimator received."""
    places = [role.sent or (f"{roles.controller}.u", j) for j, role in enumerate(roles.controls)]
    columns = [np.reshape(signals[signal], (len(signals[signal]), -1))[:, j] for signal, j in places]
    return np.stack(columns, axis=1)


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


def compared_samples(model: LinearModel | NonlinearModel, signals: Mapping[str, Any]) -> int:
    """Return how many of a run's samples, from its start, `diagnose` compares with a model; 0 if it compares none."""
    samples = len(signals.time[sampled_rows(signals, model.step, "The diagnosis")])  # type: ignore[attr-defined]
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
    return of_faults(result, model, y, probability, found, words) or result


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
    return ModelFinding(best.kind, text, values, best.least, tuple(x.kind for x in result[1:]))


__all__ = ["checked_model", "compared_samples", "diagnose", "diagnose_inputs", "diagnose_recording"]
