"""The figures of a run: errors of tracking and belief, and quality of the fault detection.

A figure is NaN if it is not defined (no fault, no detection, no probability), never an invented 0 or 1. It is also NaN if an
estimate, a true value or a probability in it is not finite, so that a run that diverges cannot look good. The detection figures
follow river's ``drift/evaluate.py`` (delay, misses, blame of healthy sensors), in seconds and with alarms that last:

- a *fault* is an unbroken sequence of samples in which it is present. A sample has an *alarm* if its probability is at least 0.5.
  For a controller without probabilities, it has one if the controller reports a detected fault. A fault that acts at times,
  as `Spikes`, is present between these, too: there it delays the detection, and lowers the AUC, of one that is right;
- a *missing* sample (NaN) needs no detector, because the controller leaves it out immediately, and contains no information for
  a detector. It counts in none of the figures below. A fault whose samples are all missing is *seen as missing*, neither
  detected nor missed;
- a fault is *missed* if no sample of it has an alarm; else its *delay* is the time from its first sample to its first alarm;
- a sensor is *blamed while healthy* in a fault-free step with an alarm, also between two samples of a slow sensor, where others
  may blame it. The share of these steps (`false_alarm_rate`) counts also those directly after a fault, while the posterior still
  returns, and those of an alarm that began during the fault and was right. It is not the number of false alarms of
  `bayesftc.cosim.judging.alarms`, which begin without a fault;
- the *AUC* is the probability that a sample with the fault has a higher score than a sample without it (equal scores count
  half). The score is the fault probability, or beta if there is no probability. The AUC needs no calibration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.signals import (
    ALARM,
    SCORES,
    ActuatorSignals,
    ControlSignals,
    Flags,
    InputSignals,
    LoopSignals,
    QuantitySignals,
    SensorSignals,
)
from bayesftc.cosim.types import Floats

NAN = float("nan")

OF_SIGNAL, SECONDS, PRECISION = {"unit": "{unit}"}, {"unit": "s"}, {"unit": "1/({unit})^2"}
"""Units of figures, as metadata of their fields: ``{unit}`` is that of the record, of errors that of the quantity."""

LIMITED, SWINGS = 0.3, 0.1
"""Share of a run at the limits of a control from which the run has a note; share at each of two between which it swings."""

REACH = "Is the goal within its reach?"
AGGRESSIVE = (
    "The controller is too aggressive for these limits. Give a larger goal_covariance or a smaller control_covariance (in design "
    "a larger acceptable_error or a smaller acceptable_control), or larger limits if the actuator allows them."
)
MISLED = (
    "Meanwhile the belief is wrong by far more than the controller expects, and moves the control: look first at the sensors "
    "that are faulty and not seen, and at the model."
)
"""Advice on controls at their limits."""
LOST = 10.0
"""Root mean square of a belief's errors, relative to its standard deviations, from which it is lost."""


@dataclass(frozen=True)
class Errors:
    """Root-mean-square errors of a signal, in its unit.

    A fault is here one of any sensor or input of the plant.

    Attributes
    ----------
    overall : float
        Over the whole run.
    before : float
        Before the first fault.
    during : float
        While at least one fault is present.
    after : float
        After the first fault has begun, while none is present: after or between faults.
    """

    overall: float = field(metadata=OF_SIGNAL)
    before: float = field(metadata=OF_SIGNAL)
    during: float = field(metadata=OF_SIGNAL)
    after: float = field(metadata=OF_SIGNAL)


@dataclass(frozen=True)
class Detection:
    """The detection of the faults of one sensor; the docstring of the module has the definitions.

    Attributes
    ----------
    sensor : int
        Number of the sensor.
    unit : str or None
        The unit of its samples.
    fault_share : float
        Share of time with a fault.
    missing_share : float
        Share of the samples that were due and are missing; NaN if the samples were not recorded (then none counts as missing).
    faults : float
        Number of faults.
    seen_as_missing : float
        Number of faults whose samples were all missing; NaN if the samples were not recorded.
    missed : float
        Number of the other faults that were missed.
    delay : float
        Mean delay of the detected faults, in seconds.
    false_alarm_rate : float
        Share of the fault-free steps in which the sensor is blamed.
    auc : float
        Area under the receiver operating characteristic.
    ranked_by : str or None
        The score of the AUC: ``"fault_probability"`` or ``"beta"``.
    precision_healthy : float
        Mean precision without a fault, in one over the unit squared.
    precision_faulty : float
        Mean precision with a fault, in one over the unit squared.
    title : str
        What tables call the sensor: its number, and of several quantities the one that it measures.
    """

    sensor: int
    unit: str | None
    fault_share: float
    missing_share: float
    faults: float
    seen_as_missing: float
    missed: float
    delay: float = field(metadata=SECONDS)
    false_alarm_rate: float
    auc: float
    ranked_by: str | None
    precision_healthy: float = field(metadata=PRECISION)
    precision_faulty: float = field(metadata=PRECISION)
    title: str = ""


@dataclass(frozen=True)
class InputFaults:
    """The faults of one input of the plant: those of an actuator, or of the process.

    Attributes
    ----------
    name : str
        The plant's variable.
    unit : str or None
        Its unit.
    fault_share : float
        Share of time with a fault.
    faults : float
        Number of faults.
    deviation : float
        Root mean square of the received minus the sent signal, while a fault was present.
    """

    name: str
    unit: str | None
    fault_share: float
    faults: float
    deviation: float = field(metadata=OF_SIGNAL)


@dataclass(frozen=True)
class ActuatorFaults:
    """The controller's inference about one actuator, compared with the truth; `Detection` has the definitions.

    Attributes
    ----------
    name : str
        The plant's variable that the control feeds.
    unit : str or None
        Its unit.
    mean_probability : float
        Mean fault probability over the run.
    alarm_share : float
        Share of time with an alarm.
    missed : float
        Number of faults between the control and the plant that were missed.
    delay : float
        Mean delay of the detected ones, in seconds.
    false_alarm_rate : float
        Share of the fault-free steps in which the actuator is blamed.
    auc : float
        Area under the receiver operating characteristic of the fault probability.
    kind : str or None
        The mode that was most often the most probable during alarms; None without alarms.
    size : float
        Mean size of its fault at these times.
    """

    name: str
    unit: str | None
    mean_probability: float
    alarm_share: float
    missed: float
    delay: float = field(metadata=SECONDS)
    false_alarm_rate: float
    auc: float
    kind: str | None
    size: float


@dataclass(frozen=True)
class Figures:
    """All figures of a run: errors by quantity, detection by sensor, faults by plant input, and inferred actuator faults."""

    tracking: dict[str, Errors]
    belief: dict[str, Errors]
    sensors: tuple[Detection, ...]
    inputs: tuple[InputFaults, ...] = ()
    actuators: tuple[ActuatorFaults, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file; NaN becomes None."""
        plain: dict[str, Any] = without_nan(asdict(self))
        return plain


def rmse(error: ArrayLike, where: Flags | None = None) -> float:
    """Return the root mean square of `error` where `where` is true; NaN if one of the errors is not finite."""
    values = np.asarray(error, dtype=np.float64)
    values = values if where is None else values[where]
    if not len(values) or not np.isfinite(values).all():
        return NAN
    scale = float(np.abs(values).max()) or 1.0  # the square of an error of 1e200 would be infinite
    return scale * float(np.sqrt(np.mean(np.square(values / scale))))


def auc(truth: ArrayLike, score: ArrayLike) -> float:
    """Return the area under the receiver operating characteristic, as ``sklearn.metrics.roc_auc_score`` does.

    Parameters
    ----------
    truth : array of bool, of any shape
        Whether the fault was present.
    score : array of the same shape
        A score that should be higher with the fault; samples without a score (NaN) are left out.
    """
    present, values = np.asarray(truth, dtype=bool), np.asarray(score, dtype=np.float64)
    valid = ~np.isnan(values)
    healthy, faulty = np.sort(values[valid & ~present]), np.sort(values[valid & present])
    if not len(healthy) or not len(faulty):
        return NAN
    # Mann and Whitney's U, computed here because scipy.stats and sklearn take half a second and more to import.
    below, upto = (np.searchsorted(healthy, faulty, side=side) for side in ("left", "right"))  # type: ignore[call-overload]
    return float((below.sum() + upto.sum()) / (2.0 * len(healthy) * len(faulty)))


def periods(flags: Flags) -> list[tuple[int, int]]:
    """Return the first index and the index after the last of each unbroken sequence of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def samples_in_faults(faulty: Flags, present: Flags) -> list[Any]:
    """Return for each fault the indices of its samples that are not missing: none for a fault that is seen as missing."""
    return [a + np.flatnonzero(present[a:b]) for a, b in periods(faulty)]


def errors_by_phase(error: Floats | None, faulty: Flags | None) -> Errors:
    """Return the root-mean-square errors of the phases of a run; NaN if a necessary signal is None."""
    if error is None or faulty is None:
        return Errors(NAN if error is None else rmse(error), NAN, NAN, NAN)
    begun = np.logical_or.accumulate(faulty)
    return Errors(rmse(error), rmse(error, ~begun), rmse(error, faulty), rmse(error, begun & ~faulty))


def detection(signals: SensorSignals, time: Floats) -> Detection:
    """Return the detection of the faults of one sensor, from its signals and the time of each row in seconds."""
    faulty, probability = signals.faulty, signals.probability
    if faulty is None:
        return Detection(
            signals.index, signals.unit, NAN, signals.missing_share, NAN, NAN, NAN, NAN, NAN, NAN, None, NAN, NAN
        )
    present = np.ones(len(faulty), dtype=bool) if signals.missing is None else ~signals.missing
    samples_of_faults = samples_in_faults(faulty, present)
    visible = [samples for samples in samples_of_faults if len(samples)]
    missed = delay = NAN
    alarm = signals.alarm
    if alarm is not None:
        delays = [time[s[np.argmax(alarm[s])]] - time[s[0]] for s in visible if alarm[s].any()]
        missed = float(len(visible) - len(delays)) if visible else NAN
        delay = float(np.mean(delays)) if delays else NAN
    candidates = dict(zip(SCORES, (probability, signals.beta), strict=True))
    scores = {name: score for name, score in candidates.items() if score is not None and not np.isnan(score).all()}
    ranked_by = next(iter(scores), None)
    return Detection(
        sensor=signals.index,
        unit=signals.unit,
        fault_share=_share(faulty),
        missing_share=signals.missing_share,
        faults=float(len(samples_of_faults)),
        seen_as_missing=NAN if signals.missing is None else float(len(samples_of_faults) - len(visible)),
        missed=missed,
        delay=delay,
        false_alarm_rate=false_alarm_rate(signals),
        auc=auc(faulty[present], scores[ranked_by][present])
        if ranked_by and not np.isnan(scores[ranked_by][present]).any()
        else NAN,
        ranked_by=ranked_by,
        precision_healthy=_mean(signals.precision, ~faulty & present),
        precision_faulty=_mean(signals.precision, faulty & present),
    )


def false_alarm_rate(signals: SensorSignals) -> float:
    """Return the share of a sensor's fault-free steps with an alarm; NaN if its faults or alarms are not known."""
    faulty, alarm, lost = signals.faulty, signals.alarm, signals.lost
    if faulty is None or alarm is None:
        return NAN
    return _share(alarm[~faulty if lost is None else ~(faulty | lost)])


def input_faults(signals: InputSignals) -> InputFaults:
    """Return the number and the size of the faults of an input of the plant."""
    faulty, difference = signals.faulty, _difference(signals.received, signals.sent)
    if faulty is None:
        return InputFaults(signals.name, signals.unit, NAN, NAN, NAN)
    deviation = NAN if difference is None else rmse(difference, faulty)
    return InputFaults(signals.name, signals.unit, _share(faulty), float(len(periods(faulty))), deviation)


def actuator_faults(signals: ActuatorSignals, time: Floats) -> ActuatorFaults:
    """Return the inference about one actuator, from its signals and the time of each row in seconds."""
    p = signals.probability
    detected = detection(SensorSignals(0, None, signals.faulty, None, None, p), time)
    alarm = p >= ALARM
    kind, size = None, NAN
    if signals.kind is not None and len(kinds := signals.kind[alarm & (signals.kind > 0)]):
        number = int(np.bincount(kinds.astype(np.int64)).argmax())
        kind = signals.kinds[number - 1]
        size = _mean(signals.size, alarm & (signals.kind == number))
    return ActuatorFaults(
        signals.name,
        signals.unit,
        float(p.mean()) if len(p) else NAN,
        _share(alarm),
        detected.missed,
        detected.delay,
        detected.false_alarm_rate,
        detected.auc,
        kind,
        size,
    )


def figures(signals: LoopSignals) -> Figures:
    """Return all figures of a run.

    Tracking is the true value minus the reference at the same instant. Belief is the controller's estimate minus the true
    value. The true value is the reading of an ideal sensor.
    """
    faulty = signals.faulty
    return Figures(
        tracking={q.name: errors_by_phase(_difference(q.truth, q.reference), faulty) for q in signals.quantities},
        belief={q.name: errors_by_phase(_difference(q.belief, q.truth), faulty) for q in signals.quantities},
        sensors=tuple(
            replace(detection(sensor, signals.time), title=signals.sensor_name(sensor.index))
            for sensor in signals.sensors
        ),
        inputs=tuple(input_faults(each) for each in signals.inputs),
        actuators=tuple(actuator_faults(each, signals.time) for each in signals.actuators),
    )


def limited(signals: LoopSignals) -> Iterator[tuple[str, str]]:
    """Yield a note and advice on each control that is at its limits for a large part of a run."""
    for control in signals.controls:
        if not len(control.sent):  # the run stopped at its first step
            continue
        low = 0.0 if control.low is None else _share(control.sent <= control.low)
        high = 0.0 if control.high is None else _share(control.sent >= control.high)
        fast, name = _at_rate(control, signals.time), f"control {control.name}"
        unit = behind(control.unit)
        per_second = f"{unit}/s" if unit else " per second"
        rate = f", and changes at its limit of {control.rate:g}{per_second} for {fast:.0%}" if fast >= LIMITED else ""
        if min(low, high) >= SWINGS and low + high >= LIMITED:
            swings, turns = _swings(control), max(map(_turns, signals.quantities), default=0)
            follows = turns // 2 <= swings <= turns + 1  # a noisy reference turns far more often
            yield (
                f"{name} swings between its limits, {control.low:g}{unit} ({low:.0%} of the run) and {control.high:g}{unit} "
                f"({high:.0%}){rate}",
                MISLED if any(map(_is_lost, signals.quantities)) else REACH if follows else AGGRESSIVE,
            )
        elif max(low, high) >= LIMITED:
            limit = control.low if low > high else control.high
            where = rate or ", where it cannot do more"
            yield f"{name} is at its limit of {limit:g}{unit} for {max(low, high):.0%} of the run{where}", REACH


def _is_lost(quantity: QuantitySignals) -> bool:
    """Return whether the belief about a quantity is wrong by far more than it expects."""
    if quantity.truth is None or quantity.belief is None or quantity.spread is None:
        return False
    errors = np.abs(quantity.belief - quantity.truth)
    with np.errstate(all="ignore"):  # of a loop that diverges
        return bool(np.mean(errors**2) > LOST**2 * np.mean(np.square(quantity.spread)))


def _swings(control: ControlSignals) -> int:
    """Return how often a control goes from one limit to the other."""
    at = 1 * (control.sent >= control.high) - 1 * (control.sent <= control.low)  # type: ignore[operator]
    return _changes(at)


def _turns(quantity: QuantitySignals) -> int:
    """Return how often a reference turns between up and down."""
    return 0 if quantity.reference is None else _changes(np.sign(np.diff(quantity.reference)))


def _changes(signs: NDArray[Any]) -> int:
    """Return how often the sign changes, zeros and NaN left out."""
    return int(np.count_nonzero(np.diff(signs[np.nan_to_num(signs) != 0.0])))


def _at_rate(control: ControlSignals, time: Floats) -> float:
    """Return the share of a control's values at the limit of its rate, as the one before; 0 if not every value is recorded.

    A control that follows noise changes at this limit as well, but up and down.
    """
    rows = time[1] - time[0] if len(time) > 1 else 0.0
    if control.rate is None or control.dt is None or not 0.0 < rows <= 1.001 * control.dt:
        return 0.0
    every = round(control.dt / rows)
    values, largest = control.sent[::every], control.rate * control.dt
    change = np.diff(values)
    at = np.sign(change) * (np.abs(change) >= largest - 1e-9 * (largest + np.abs(values[1:])))
    return _share((at[1:] != 0.0) & (at[1:] == at[:-1]))


def _difference(one: Floats | None, other: Floats | None) -> Floats | None:
    if one is None or other is None:
        return None
    with np.errstate(invalid="ignore", over="ignore"):  # the figures become NaN
        return one - other


def _share(flags: Flags) -> float:
    return float(flags.mean()) if len(flags) else NAN


def _mean(values: Floats | None, where: Flags) -> float:
    if values is None:
        return NAN
    chosen = values[where]
    return float(chosen.mean()) if len(chosen) else NAN


def without_nan(value: Any) -> Any:
    """Return plain data with None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


__all__ = [
    *(cls.__name__ for cls in (ActuatorFaults, Detection, Errors, Figures, InputFaults)),
    "actuator_faults",
    "auc",
    "detection",
    "errors_by_phase",
    "figures",
    "input_faults",
    "periods",
    "rmse",
    "without_nan",
]
