"""Alarms that are none: sensors that are blamed together, all at once, or often while they are healthy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.metrics import false_alarm_rate, periods
from bayesftc.cosim.judging.signals import REMEMBERED, Flags, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.run.result import ESTIMATE_A_LOAD
from bayesftc.cosim.types import Floats

AT_ONCE = 20
"""Number of samples within which an alarm begins with the run."""

AGREE = 1.5
"""Largest root mean square of the difference of two sensors that agree, in multiples of its noise."""

LEAST = 10
"""Least number of samples, one after the other, with an alarm of all sensors."""

MOST = 100
"""Number of samples from the begin of the alarms in which they must agree; one may fail later."""

MANY_FALSE_ALARMS = 0.05
"""Share of a sensor's fault-free time in alarm from which a run has a note."""

LOUDER = 1.5
"""Ratio of the noise of sensors to the expected one from which this is the reason why all of them are blamed."""

LOOK_AT_MODEL = (
    "Look at the model first. The plant may have another gain, time constant or delay, or an input that the model lacks. The "
    "plant's noise may be larger than the model says, many times smaller, or act elsewhere (process_covariance; noise in "
    "design). The sensors' noise may be larger (sensor_covariance; sensor_std in design). Other sensors may have an offset, or "
    "an error that they share (with_sensor_errors). After a longer run without faults, controllers.diagnose(result, controller) "
    f"may name the error, if several sets of redundant sensors show it. {ESTIMATE_A_LOAD}"
)
"""What to do where a healthy sensor is blamed often, and nothing else says why."""

LITTLE = 0.005
"""Share of a fault below which no percentage is named."""

QUIET = 0.7
"""Ratio of the distance of samples from the belief to its standard deviation, below which the plant moves less than stated."""


def blamed_together(signals: LoopSignals, decimation: int = 1) -> dict[str, list[str]]:
    """Return notes on quantities of which all sensors, or all but one, have an alarm, without a fault, although they agree.

    The reason is named (``"named"``) if all are called noisier, or if the alarms begin with the run, and no fault of an input has
    begun: then it is the belief at the start; or if one sensor is believed against the others. Else it is some error of the model
    (``"model"``).
    """
    notes: dict[str, list[str]] = {"named": [], "model": []}
    begun = [int(i.faulty.argmax()) for i in signals.inputs if i.faulty is not None and i.faulty.any()]
    for quantity in signals.quantities:
        if not quantity.sensors:
            continue
        group = [signals.sensors[i] for i in quantity.sensors]
        alarms = [s.alarm & ~s.faulty for s in group if s.alarm is not None and s.faulty is not None]
        samples = [s.samples for s in group if s.samples is not None]
        if len(samples) < len(group) or len(alarms) < len(group):
            continue
        first = alarms_of_all(samples, alarms)
        if first is None:
            for of, note in _outvoted(quantity, signals, samples, alarms, decimation):
                notes[of].append(note)
            continue
        of, wrong = "model", _unlike(signals, first, decimation)
        sensors, t = "both" if len(group) == 2 else f"all {len(group)}", signals.time[first]
        noise = float(np.median([_noise(one - other) for one, other in combinations(samples, 2)]))
        if all(_noisier(s, first, noise) for s in group):
            notes["named"].append(
                f"{sensors} sensors of {quantity.name} are blamed from t = {t:g} s because they are noisier than the model says: "
                f"by their differences, each has noise with a standard deviation of about {noise:.2g}{behind(quantity.unit)}. "
                "State that in the controller's model (sensor_std in design, or sensor_covariance)"
            )
            continue
        if first * decimation < AT_ONCE and min(begun, default=first + 1) > first:
            of, wrong = (
                "named",
                "the controller's belief at the start (initial_mean, initial_spread) or its model is wrong",
            )
        notes[of].append(f"{sensors} sensors of {quantity.name} agree but are blamed from t = {t:g} s: {wrong}")
    return notes


def _outvoted(
    quantity: QuantitySignals,
    signals: LoopSignals,
    samples: Sequence[Floats],
    alarms: Sequence[Flags],
    decimation: int,
) -> Iterator[tuple[str, str]]:
    """Yield a note where all sensors of a quantity but one are blamed though they agree, two or more, with what it is about.

    The other one is believed, or it is faulty as well, and the model alone is believed.
    """
    for k, other in enumerate(quantity.sensors):
        first = alarms_of_all(*([*each[:k], *each[k + 1 :]] for each in (samples, alarms)))
        if first is None:
            continue
        *most, last = (str(i) for i in quantity.sensors if i != other)
        who = f"sensors {', '.join(most)} and {last} of {quantity.name} agree but are blamed from t = {signals.time[first]:g} s"
        if _missed(signals, other)[first : first + MOST].mean() > 0.5:
            yield (
                "named",
                f"{who}, and sensor {other}, which has a fault, is believed: where the model is not exact, a slow fault of the "
                "most accurate sensor may look like one of the others. Improve the model (docs/explanation/wrong-models.md)",
            )
        else:
            yield "model", f"{who}: {_unlike(signals, first, decimation)}"
        return


def _unlike(signals: LoopSignals, row: int, decimation: int) -> str:
    """Return why sensors that agree may be blamed from a row on: the model, or faults of several that misled the belief."""
    before = slice(max(row - REMEMBERED // decimation, 0), row + 1)
    failed = sum(s.faulty is not None and bool(s.faulty[before].any()) for s in signals.sensors)
    misled = ", or faults of several sensors have misled the belief" if failed > 1 else ""
    return f"the plant behaves unlike the controller's model{misled}"


def _missed(signals: LoopSignals, index: int) -> Flags:
    """Return the steps at which a sensor has a sample and a fault without an alarm; none if that is not known."""
    sensor = signals.sensors[index]
    missed: Flags = np.zeros(len(signals.time), dtype=bool)
    if sensor.samples is not None and sensor.alarm is not None and sensor.faulty is not None:
        missed = sensor.faulty & ~sensor.alarm & np.isfinite(sensor.samples)
    return missed


def _little_blamed(signals: LoopSignals, index: int) -> str:
    """Return how little of its fault a sensor is blamed for."""
    sensor, missed = signals.sensors[index], _missed(signals, index)
    assert sensor.faulty is not None
    assert sensor.samples is not None
    share = 1.0 - float(missed.sum() / (sensor.faulty & np.isfinite(sensor.samples)).sum())
    name = signals.sensor_name(index)
    if share == 0.0:
        return f"{name} has a fault and is not blamed"
    return f"{name} is blamed for only {f'{share:.0%}' if share >= LITTLE else 'a moment'} of its fault"


def often_blamed(signals: LoopSignals) -> tuple[int, str] | None:
    """Return the sensor with most false alarms, and a note on it and on others with many; None if it has few."""
    rates = {sensor.index: false_alarm_rate(sensor) for sensor in signals.sensors}
    worst = max(rates, key=lambda i: np.nan_to_num(rates[i]), default=None)
    if worst is None or not rates[worst] >= MANY_FALSE_ALARMS:
        return None
    others = [i for i, rate in rates.items() if i != worst and rate >= MANY_FALSE_ALARMS]
    also = "".join(f", {signals.sensor_name(i)} for {rates[i]:.0%}" for i in others)
    return worst, f"{signals.sensor_name(worst)} is blamed for {rates[worst]:.0%} of its fault-free time{also}"


def advice_on(signals: LoopSignals, sensor: int) -> str:
    """Return what to do about a healthy sensor that is blamed often.

    Without a sensor that it blames, the belief is uncertain by the process noise. If the samples are much closer to it, that
    noise is stated too large.
    """
    of, quantity = signals.sensors[sensor], next((q for q in signals.quantities if sensor in q.sensors), None)
    if of.samples is None or of.alarm is None or of.faulty is None or quantity is None:
        return LOOK_AT_MODEL
    wrongly = of.alarm & ~of.faulty
    unseen = [i for i in quantity.sensors if 2 * _missed(signals, i)[wrongly].sum() > wrongly.sum()]
    if unseen:
        third = "a third sensor, or " if len(quantity.sensors) == 2 else ""
        return (
            f"Meanwhile {' and '.join(_little_blamed(signals, i) for i in unseen)}. A slow fault of one sensor may look like one "
            f"of another: {third}a better model of the plant tells (docs/explanation/inference.md)."
        )
    if quantity.belief is None or quantity.spread is None:
        return LOOK_AT_MODEL
    blamed = wrongly & np.isfinite(of.samples)
    with np.errstate(over="ignore"):  # of a loop that diverges
        apart, expected = (
            float(np.sqrt(np.mean(values[blamed] ** 2))) if blamed.any() else np.nan
            for values in (of.samples - quantity.belief, quantity.spread)
        )
    if not apart < QUIET * expected:
        return LOOK_AT_MODEL
    unit = of.unit or ""
    return (
        f"While it is blamed, its samples differ from the belief by {f'{apart:.3g} {unit}'.rstrip()} (root mean square), less "
        f"than the model expects ({f'{expected:.3g} {unit}'.rstrip()} or more). The process noise of the model (noise= in "
        "design, process_covariance) is probably too large. State it as it is."
    )


def alarms_of_all(samples: Sequence[Floats], alarms: Sequence[Flags]) -> int | None:
    """Return the first sample from which on all sensors of a quantity have an alarm for a while although they agree, or None.

    Parameters
    ----------
    samples : sequence of ndarray, shape (steps,)
        The samples of each sensor; NaN is a missing one.
    alarms : sequence of ndarray of bool, shape (steps,)
        Where each sensor counts as faulty, and has no fault.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim.judging.blame import alarms_of_all
    >>> rng = np.random.default_rng(0)
    >>> first, second = 3.0 + 0.1 * rng.standard_normal((2, 100))
    >>> late = np.arange(100) >= 40
    >>> alarms_of_all([first, second], [late, late])
    40
    >>> alarms_of_all([first, second + 0.5 * late], [late, late])  # they do not agree
    """
    blamed = np.all(alarms, axis=0)
    if len(samples) < 2 or not blamed.any():
        return None
    differences = [one - other for one, other in combinations(samples, 2)]
    for begin, end in periods(blamed):
        if end - begin >= LEAST and all(_agree(d, begin, min(end, begin + MOST)) for d in differences):
            return begin
    return None


def _agree(difference: Floats, begin: int, end: int) -> bool:
    """Return whether a difference of two sensors is no more than their noise in a stretch.

    Its noise is estimated from its changes, so that offsets and drifts do not count for it.
    """
    finite = difference[np.isfinite(difference)]
    there = difference[begin:end][np.isfinite(difference[begin:end])]
    if len(there) < LEAST:
        return False
    return bool(np.sqrt(np.mean(there * there)) <= AGREE * 2.0**0.5 * _noise(finite))


def _noise(difference: Floats) -> float:
    """Return the standard deviation of the noise of each of two sensors, from the changes of their difference."""
    finite = difference[np.isfinite(difference)]
    return float(np.median(np.abs(np.diff(finite)))) * MAD / 2.0


def _noisier(sensor: SensorSignals, first: int, noise: float) -> bool:
    """Return whether a sensor is mostly called noisier while it is blamed, from a sample on, and has more noise than expected.

    Errors that all sensors share, as those of a plant that moves more than its model, do not count in their own `noise`.
    """
    if sensor.kind is None or sensor.alarm is None or sensor.precision is None or "Noisier" not in sensor.kinds:
        return False
    if not noise * noise * sensor.precision[0] > LOUDER**2:
        return False
    blamed = np.flatnonzero(sensor.alarm[first : first + MOST]) + first
    return bool(np.mean(sensor.kind[blamed] == 1 + sensor.kinds.index("Noisier")) > 0.5)


__all__ = ["advice_on", "alarms_of_all", "blamed_together", "often_blamed"]
