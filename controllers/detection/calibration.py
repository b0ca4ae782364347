"""Calibration of beta to a fault probability: a logistic map fitted on simulated faults (paper, section 4.2)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.linear import BayesianController, UnstableLoopWarning
from bayesftc.controllers.models.disturbances import loads_of
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.gamma import GammaPrecision
from bayesftc.controllers.precision.rate import Calibration, RateLearner
from bayesftc.controllers.registry import LEARNERS
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.numbers import reals, short
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
from bayesftc.cosim.diagram.wiring import find_controller
from bayesftc.cosim.errors import ModelError, SimulationError, brief
from bayesftc.cosim.judging.metrics import LIMITED, NAN
from bayesftc.cosim.judging.probabilities import Reliability, reliability

if TYPE_CHECKING:
    from bayesftc.controllers.precision.base import PrecisionLearner
    from bayesftc.cosim.block import Block
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.types import Floats

TRAINING_SHARE = 0.8
"""Share of each simulated run for the fit, at its start; the rest is for the test."""

SKIPPED = 200
"""Steps at the start that are left out, until the belief has settled."""

PARTS = 20
"""Parts of the test, one after the other. Their scatter shows the noise of the calibration error, since samples of a fault depend
on each other. In each part at least one fault of each sensor begins on average, so there are fewer parts where faults are few."""

USUAL_STEPS, MOST_STEPS = 80_000, 1_000_000
"""Least and largest default of steps."""


class Hazards(NamedTuple):
    """How often faults begin and end: mean times in seconds (the paper's third experiment).

    Parameters
    ----------
    mean_time_to_fault : float
        Mean time in seconds from the end of a fault to the onset of the next one.
    mean_time_to_recovery : float
        Mean duration of a fault in seconds.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> hazards = controllers.Hazards(mean_time_to_fault=9.0, mean_time_to_recovery=1.0)
    >>> report = controllers.calibrate(model, hazards, steps=5000)
    >>> round(report.fault_share, 1)
    0.1
    """

    mean_time_to_fault: float = 2.8
    mean_time_to_recovery: float = 0.4

    @classmethod
    def usual(cls, step: Fraction) -> Hazards:
        """Return the default for a sample time in seconds: no shorter than 28 and 4 samples."""
        return cls(*(_longer(step) * seconds for seconds in cls()))


def needed_steps(hazards: tuple[float, float], step: Fraction) -> int:
    """Return the steps of a run whose test has enough faults for a verdict: half as many more, since their number is random."""
    return SKIPPED + round(1.5 * PARTS * sum(hazards) / float(step) / (1.0 - TRAINING_SHARE))


def _longer(step: Fraction) -> float:
    """Return the factor by which faults last longer with a sample time above 0.1 s."""
    return max(1.0, float(step) / 0.1)


@dataclass(frozen=True)
class CalibrationReport:
    """A fitted map and its quality on the part of the run that was not used for the fit.

    Attributes
    ----------
    calibration : Calibration or None
        The map for the learner; None for a learner that gives a probability itself.
    auc : float
        Area under the receiver operating characteristic; guessing gives 0.5.
    brier, brier_of_constant : float
        Mean squared error of the probability, and that of a constant probability which equals the share of faults.
    calibration_error : float
        Expected calibration error: mean distance between predicted probability and observed share over ten bins of equal width.
    fault_share : float
        Share of faulty samples.
    samples : int
        Number of samples in the test: those of all sensors in the last fifth of the run.
    faults : int
        Number of faults of all sensors that begin in the test. With less than 20 for each sensor on average the numbers are no
        basis for a verdict.
    reliability : Reliability or None
        The probability's reliability in ten bins of equal width; ``report.reliability.plot()`` draws its diagram.
    calibration_error_interval : tuple of float
        The 95 % interval of the calibration error, by the scatter of at most twenty parts of the test, in each of which one fault
        of each sensor begins on average. It is wide enough for misjudged faults so rare that the test has none. NaN with less
        than two parts.
    sensors : tuple of Reliability
        The reliability of each sensor's probability.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> report = controllers.calibrate(model, steps=5000)
    >>> report.samples, round(report.auc, 1), report.brier < report.brier_of_constant
    (1922, 0.6, True)
    """

    calibration: Calibration | None
    auc: float
    brier: float
    brier_of_constant: float
    calibration_error: float
    fault_share: float
    samples: int
    faults: int = 0
    reliability: Reliability | None = field(default=None, repr=False, compare=False)
    calibration_error_interval: tuple[float, float] = field(default=(NAN, NAN), repr=False, compare=False)
    sensors: tuple[Reliability, ...] = field(default=(), repr=False, compare=False)

    def __repr__(self) -> str:
        return short(self)


def calibrate(
    model: LinearModel,
    hazards: tuple[float, float] | None = None,
    magnitudes: Mapping[str, float | Sequence[float]] | None = None,
    *,
    precision: PrecisionLearner | None = None,
    reference: Block | float | Sequence[Block | float] | None = None,
    feature: Literal["log", "linear"] = "log",
    steps: int | None = None,
    seed: int = 0,
    **controller: Any,
) -> CalibrationReport:
    """Fit the map from a sensor's beta to the probability that the sensor is faulty, on a simulated closed loop.

    The simulated plant is the model. Every sensor freezes, jumps and drifts at random, and the controller gets the faulty
    samples. The map is therefore valid for faults of these kinds, rates and magnitudes and for this learner's settings. Fit it
    anew when one of them changes.

    Parameters
    ----------
    model : LinearModel
        Plant and sensors.
    hazards : (float, float), optional
        Mean time to fault and mean time to recovery in seconds; by default those of `Hazards`. With sample times above 0.1 s,
        they are 28 and 4 samples, as many as with 0.1 s.
    magnitudes : mapping
        ``injection`` (constant offset) and ``drift`` (offset per second), in the units of the sensors: a number for all sensors,
        or a sequence with one for each. By default they are 3 and 5 standard deviations of the noise of each sensor. With sample
        times above 0.1 s the default drift is slower by the factor by which the faults last longer. Freezes have no magnitude.
    precision : PrecisionLearner, optional
        The learner to calibrate, a `RateLearner`; by default ``GammaPrecision()``. An existing calibration is ignored.
    reference : source, number, or one for each goal, optional
        By default a sine over 400 steps for each goal. Its amplitude is five standard deviations of the best sensor of that goal,
        or the median of all sensors if none measures the goal. On a constant reference a frozen sensor looks healthier than a
        healthy one.
    feature : {"log", "linear"}
        Whether the map is linear in log(beta) or in beta.
    steps : int, optional
        Length of the simulated run in steps. By default 80 000, or for rare or long faults as many as the test needs for 30
        faults of each sensor, but at most 1 000 000. An estimated load (`LinearModel.with_disturbance`) does not move in it if
        the control has limits: a random walk would leave them.
    seed : int
        Seed of noise and faults.
    **controller : Any
        Further settings of `BayesianController`, or of the class ``kind=`` (such as `LQGController`).

    Returns
    -------
    CalibrationReport
        The report; give ``report.calibration`` to the learner as ``calibration=``.

    Raises
    ------
    ModelError
        If the learner has no rate, the loop is unstable, or the run is too short or without faults. For a learner that gives a
        probability itself nothing is fitted. ``bayesftc calibrate`` measures its probability on such a run, and
        `bayesftc.cosim.reliability` measures it on runs of your own.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> report = controllers.calibrate(model, steps=5000)
    >>> learner = controllers.GammaPrecision(calibration=report.calibration)
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for _ in range(10):
    ...     out = step(y=[0.1, 3.0], u=0.0)
    >>> out.fault_probability.round(1).tolist()
    [0.0, 0.8]
    """
    from sklearn.linear_model import LogisticRegression

    from bayesftc.controllers.detection.classifier import FaultClassifier

    chosen = GammaPrecision() if precision is None else precision
    if not isinstance(chosen, RateLearner):
        candidates = " or ".join(cls.__name__ for cls in LEARNERS if issubclass(cls, RateLearner))
        note = " and gives a fault probability itself" if getattr(chosen, "why_no_probability", "") is None else ""
        raise ModelError(
            f"calibrate cannot calibrate {type(chosen).__name__}, which has no rate{note}; "
            f"give a learner with one: {candidates}."
        )
    learner: RateLearner = replace(chosen, calibration=None)  # type: ignore[call-arg]
    beta, faulty = _simulated("beta", model, hazards, magnitudes or {}, learner, reference, steps, seed, controller)
    ratio = beta / learner.prior_rates(model)
    x = np.log(ratio) if feature == "log" else ratio
    cut = int(TRAINING_SHARE * len(x))
    _check_labels(faulty[:cut], faulty[cut:])
    classifier = FaultClassifier(LogisticRegression(C=np.inf, max_iter=1000))
    classifier.fit(x[:cut].reshape(-1, 1), faulty[:cut].ravel())
    return judge(replace(classifier.calibration(), feature=feature), x[cut:], faulty[cut:])


def judge(calibration: Calibration, x: Floats, faulty: np.ndarray[Any, np.dtype[np.bool_]]) -> CalibrationReport:
    """Return the quality of a map on features `x` (log or linear, as for the map; steps x sensors) with known labels."""
    return _judged(calibration, x, 1.0 / (1.0 + np.exp(-(calibration.slope * x + calibration.intercept))), faulty)


def judge_own_probability(
    model: LinearModel,
    hazards: tuple[float, float] | None = None,
    magnitudes: Mapping[str, float | Sequence[float]] | None = None,
    *,
    precision: PrecisionLearner,
    reference: Block | float | Sequence[Block | float] | None = None,
    steps: int | None = None,
    seed: int = 0,
    **controller: Any,
) -> CalibrationReport:
    """Return the quality of a learner's own probability, on the test part of the run of `calibrate`.

    Parameters
    ----------
    model, hazards, magnitudes, reference, steps, seed, **controller
        See `calibrate`.
    precision : PrecisionLearner
        A learner whose ``why_no_probability`` is None.

    Returns
    -------
    CalibrationReport
        The report, without a ``calibration``.

    Raises
    ------
    ModelError
        If the loop is unstable, or the run is too short or without faults.
    """
    output_values, faulty = _simulated(
        "fault_probability", model, hazards, magnitudes or {}, precision, reference, steps, seed, controller
    )
    cut = int(TRAINING_SHARE * len(output_values))
    probability, faulty = output_values[cut:], faulty[cut:]
    _check_labels(faulty)
    return _judged(None, probability, probability, faulty)


def _check_labels(*parts: np.ndarray[Any, np.dtype[np.bool_]]) -> None:
    if not all(0 < faulty.mean() < 1 for faulty in parts):
        raise ModelError(
            "The simulated run has no faults, or nothing but faults; give more steps, or another mean time to fault or recovery."
        )


def _judged(
    calibration: Calibration | None, score: Floats, probability: Floats, faulty: np.ndarray[Any, np.dtype[np.bool_]]
) -> CalibrationReport:
    from sklearn.metrics import roc_auc_score

    probability, faulty = probability.reshape(len(probability), -1), faulty.reshape(len(faulty), -1)
    quality = reliability(probability, faulty, equal="widths")
    faults = int(np.count_nonzero(faulty[1:] & ~faulty[:-1]))
    return CalibrationReport(
        calibration=calibration,
        auc=float(roc_auc_score(faulty.ravel(), score.ravel())),
        brier=quality.brier,
        brier_of_constant=quality.brier_of_constant,
        calibration_error=quality.calibration_error,
        fault_share=float(faulty.mean()),
        samples=probability.size,
        faults=faults,
        reliability=quality,
        calibration_error_interval=_interval(probability, faulty, faults / faulty.shape[1]),
        sensors=tuple(reliability(*sensor, equal="widths") for sensor in zip(probability.T, faulty.T, strict=True)),
    )


def _interval(probability: Floats, faulty: np.ndarray[Any, np.dtype[np.bool_]], faults: float) -> tuple[float, float]:
    """Return the 95 % interval of the calibration error, given the mean number of faults of a sensor.

    The parts do not show faults that are seldom misjudged, and of which the test has none. Their share may be that of an event
    that did not occur in so many faults (Clopper and Pearson 1934). While such a fault lasts, the probability of its sensor may
    be 0, and that of a healthy sensor 1. The faults of several sensors count as one, because sensors are misjudged together.
    """
    from bayesftc.cosim import statistics

    parts = min(PARTS, int(faults))
    if parts < 2:
        return NAN, NAN
    found = statistics.calibration(np.array_split(probability, parts), np.array_split(faulty, parts), equal="widths")
    (low, high), error = found.calibration_error_interval, found.pooled.calibration_error
    unseen = (1.0 - 0.025 ** (1.0 / faults)) * 2.0 * float(faulty.mean())
    return max(min(low, error - unseen), 0.0), min(max(high, error + unseen), 1.0)


def _simulated(
    output: str,
    model: LinearModel,
    hazards: tuple[float, float] | None,
    magnitudes: Mapping[str, float | Sequence[float]],
    learner: PrecisionLearner,
    reference: Block | float | Sequence[Block | float] | None,
    steps: int | None,
    seed: int,
    controller: Mapping[str, Any],
) -> tuple[Floats, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Simulate a run; return an output of the controller for each sensor, and whether the sensor was faulty."""
    if not isinstance(model, LinearModel):
        raise ModelError(f"calibrate needs a LinearModel, such as controller.model, not {brief(model)}.")
    if steps is not None and steps < 5_000:
        raise ModelError(f"calibrate has steps={steps}; give at least 5000, for enough faults.")
    unknown = set(magnitudes) - {"injection", "drift"}
    if unknown:
        raise ModelError(f"calibrate has the unknown magnitude {sorted(unknown)[0]!r}; give 'injection' and 'drift'.")
    hazards = Hazards.usual(model.step) if hazards is None else hazards
    _check_hazards(hazards, model)
    if steps is None:
        steps = min(max(USUAL_STEPS, needed_steps(hazards, model.step)), MOST_STEPS)
    sizes = simulated_sizes(model, magnitudes)
    record = [f"controller.{output}", *(f"{_fault_name(i)}.active" for i in range(model.sensors))]
    # The plant's outputs are all its states, of which the sensors may leave some out.
    with reported(f"Simulating {steps} steps with random faults."), noted_elsewhere():
        loop = _loop(model, hazards, sizes, learner, reference, controller)
        try:
            result = loop.simulate(steps * model.step, seed=seed, record=[*record, "controller.u"])
        except SimulationError as error:
            lasted = "" if error.result is None else f" after {error.result.time[-1]:.6g} s"
            raise ModelError(
                f"calibrate simulates the model of the controller with random faults, and the simulated plant ran away{lasted}: "
                "the controller does not hold it with such faults and limits. Give smaller faults "
                "(magnitudes), wider limits, or a calmer model."
            ) from None
    _warn_if_lost(np.asarray(result["controller.u"]), find_controller(loop).block)
    faulty = np.column_stack([result[name] for name in record[1:]])[SKIPPED:] > 0.5
    return result[record[0]][SKIPPED:], faulty


def default_sizes(step: Fraction) -> dict[str, float]:
    """Return the default sizes of the simulated faults, in standard deviations of the noise of each sensor."""
    return {"injection": 3.0, "drift": 5.0 / _longer(step)}


def simulated_sizes(model: LinearModel, magnitudes: Mapping[str, float | Sequence[float]]) -> dict[str, list[float]]:
    """Return the sizes of the simulated faults of each sensor: the given ones, else the defaults of `calibrate`."""
    deviations = _deviations(model)
    sizes = {name: (size * deviations).tolist() for name, size in default_sizes(model.step).items()}
    return sizes | {name: _for_each_sensor(name, given, model.sensors) for name, given in magnitudes.items()}


def _for_each_sensor(name: str, given: float | Sequence[float], sensors: int) -> list[float]:
    sizes = reals(given)
    if sizes.shape not in {(), (sensors,)}:
        raise ModelError(
            f"calibrate has {name}={brief(given)} for {sensors} sensors; give one number, or one for each."
        )
    return np.broadcast_to(sizes, sensors).tolist()  # type: ignore[no-any-return]


def _deviations(model: LinearModel) -> Floats:
    """Return the standard deviation of the noise of each sensor."""
    return np.sqrt(np.diag(model.matrix("sensor_covariance")))


def _default_amplitudes(model: LinearModel, goals: Floats) -> list[float]:
    """Return the amplitude of the default reference of each goal, a row of `goals`: what it is of the state."""
    C, deviations = model.matrix("C"), _deviations(model)
    amplitudes = []
    for goal in goals:
        scale = C @ goal / (goal @ goal)  # a sensor that measures the goal has this multiple of it
        measures = (scale != 0) & np.isclose(C, np.outer(scale, goal), atol=0.0).all(axis=1)
        of_goal = deviations[measures] / np.abs(scale[measures])
        amplitudes.append(5.0 * float(of_goal.min() if measures.any() else np.median(deviations)))
    return amplitudes


def _check_hazards(hazards: tuple[float, float], model: LinearModel) -> None:
    for name, seconds in zip(Hazards._fields, hazards, strict=True):
        if not np.isfinite(seconds) or seconds < float(model.step):
            raise ModelError(
                f"calibrate has {name}={seconds:g}, but a step of the model takes {float(model.step):g} s. Give a finite number "
                f"of seconds, at least {float(model.step):g}."
            )


def _limits(controller: Any, size: int) -> tuple[Floats, Floats]:
    """Return the limits of each control; infinite for a controller without."""
    low, high = (getattr(controller, name, inf) for name, inf in (("u_min", -np.inf), ("u_max", np.inf)))
    return np.broadcast_to(np.asarray(low), size), np.broadcast_to(np.asarray(high), size)


def _process_noise(model: LinearModel, controller: Any) -> Floats:
    """Return the process noise of the simulated plant: of a control with limits, an estimated load does not move.

    A load is a random walk, which in so many steps would leave any limits, and an unstable plant would be lost.
    """
    noise = model.matrix("process_covariance").copy()
    if np.isfinite(_limits(controller, model.controls)).any():
        loads = loads_of(model)
        noise[loads], noise[:, loads] = 0.0, 0.0
    return noise


def _warn_if_lost(controls: Floats, controller: Any) -> None:
    """Warn if the control of a simulated run is at its limits for long: the plant is then hardly held."""
    low, high = _limits(controller, controls.shape[1])
    share = float(((controls <= low) | (controls >= high)).mean(axis=0).max(initial=0.0))
    if share >= LIMITED:
        warn_user(
            f"In the simulated run a control is at its limits for {share:.0%} of the time, so the plant is hardly held, and its "
            "figures say little of the learner. Give wider limits (u_min, u_max), a smaller reference, or a calmer model."
        )


def _loop(
    model: LinearModel,
    hazards: tuple[float, float],
    sizes: Mapping[str, Sequence[float]],
    learner: PrecisionLearner,
    reference: Block | float | Sequence[Block | float] | None,
    settings: Mapping[str, Any],
) -> Diagram:
    from bayesftc import cosim
    from bayesftc.cosim.blocks.linear_system import LinearSystem, as_rows

    n, p = model.states, model.controls
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnstableLoopWarning)
        try:
            kind = settings.get("kind", BayesianController)
            controller = kind(model, precision=learner, **{k: v for k, v in settings.items() if k != "kind"})
        except UnstableLoopWarning as warning:
            raise ModelError(f"calibrate cannot simulate this loop. {warning}") from None
    inputs, outputs = tuple(f"u{i}" for i in range(p)), tuple(f"x{i}" for i in range(n))
    A, B, C, D = map(as_rows, (model.matrix("A"), model.matrix("B"), np.eye(n), np.zeros((n, p))))
    system = LinearSystem(A, B, C, D, float(model.step), inputs, outputs)  # python-control takes a second to import
    plant = cosim.StateSpace(system, process_noise=_process_noise(model, controller), initial=controller.initial_mean)
    if reference is None:
        amplitudes = _default_amplitudes(model, controller.goal_matrix[:, :n])
        reference = [cosim.Sine(amplitude=each, period=float(400 * model.step)) for each in amplitudes]
    faults = [
        cosim.RandomFaults(
            kinds=(cosim.Freeze(), cosim.Injection(magnitude=injection), cosim.Drift(slope=drift)),
            sensor=i,
            mean_time_to_fault=hazards[0],
            mean_time_to_recovery=hazards[1],
            name=_fault_name(i),
        )
        for i, (injection, drift) in enumerate(zip(sizes["injection"], sizes["drift"], strict=True))
    ]
    sensors = cosim.Sensors(
        count=model.sensors,
        signals=n,
        matrix=model.matrix("C").tolist(),
        covariance=model.matrix("sensor_covariance").tolist(),
    )
    loop: Diagram = cosim.closed_loop(
        plant=plant,
        controller=controller,
        control=inputs,
        measured=outputs,
        reference=reference,
        sensors=sensors,
        faults=faults,
    )
    return loop


def _fault_name(sensor: int) -> str:
    return f"fault_{sensor}"
