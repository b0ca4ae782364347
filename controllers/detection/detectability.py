"""Smallest faults, delays and false alarms of the beta residual (the paper's open question)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.linear import BayesianController
from bayesftc.controllers.detection.beta_law import BetaLaw, beta_law, loop_law
from bayesftc.controllers.models.checks import as_number
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.gamma import GammaPrecision
from bayesftc.cosim.base.numbers import with_article
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats

Kind = Literal["offset", "drift", "noise"]
KINDS: tuple[Kind, ...] = ("offset", "drift", "noise")
HOUR = 3600.0
SAMPLES = 50
"""Default number of samples within which a fault must be detected."""

LARGEST = 2.0**60
"""Largest size to try, in standard deviations of the innovation."""


@dataclass(frozen=True)
class Detectability:
    """The faults that a threshold on a sensor's beta detects. Made by `detectability`; it prints as a table.

    Attributes
    ----------
    form : str
        ``"stream"`` (independent innovations), ``"fixed filter"`` (a Kalman filter with fixed precisions) or ``"loop"`` (the
        filter with learned precisions).
    dt : float
        Sample time in seconds.
    innovation_variance : float
        Variance of the sensor's innovation without a fault, in squared units of the sensor.
    mean_beta : float
        Mean of beta without a fault, in squared units of the sensor.
    threshold : float
        There is an alarm at each sample at which beta exceeds it; in squared units of the sensor.
    false_alarm_probability : float
        Share of samples with an alarm, without a fault.
    false_alarms_per_hour : float
        Number of alarms that begin in an hour without a fault; each lasts for several samples.
    detection_probability, within : float
        A fault is detectable if there is an alarm among the samples of its first `within` seconds with at least this
        probability, given no alarm just before.
    offset, drift, noise : float
        The smallest detectable fault of each kind: a constant offset in the sensor's units, the growth of an offset per second,
        and the standard deviation of additional noise in the sensor's units.
    offset_delay, drift_delay, noise_delay : float
        Expected delay in seconds from the first faulty sample to the first alarm, for the smallest detectable fault.
    law : object
        The distributions behind `probability`, `delay` and `exceedance`.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> found = controllers.detectability(sensor_variance=0.04, dt=0.1, false_alarms_per_hour=1.0)
    >>> round(found.threshold, 2), round(found.offset, 2), round(found.offset_delay, 1)
    (0.97, 0.25, 2.7)
    """

    form: str
    dt: float
    innovation_variance: float
    mean_beta: float
    threshold: float
    false_alarm_probability: float
    false_alarms_per_hour: float
    detection_probability: float
    within: float
    offset: float
    drift: float
    noise: float
    offset_delay: float
    drift_delay: float
    noise_delay: float
    law: BetaLaw = field(repr=False, compare=False)

    def probability(self, kind: Kind, sizes: ArrayLike, within: float | None = None) -> Floats:
        """Return the probability of an alarm within a time after the onset.

        Parameters
        ----------
        kind : {"offset", "drift", "noise"}
            Kind of the fault.
        sizes : number or array
            Sizes of the fault, in the units of the attributes of the same names.
        within : float, optional
            The time in seconds; by default that of the result.
        """
        header = self.within if within is None else as_number("detectability has within", within, above=0)
        steps = _samples(header, self.dt)
        return np.array([self.law.detected(kind, size, steps) for size in _sizes(kind, sizes)])

    def delay(self, kind: Kind, sizes: ArrayLike) -> Floats:
        """Return the expected delay, in seconds, from the first faulty sample to the first alarm, for a lasting fault.

        Parameters
        ----------
        kind : {"offset", "drift", "noise"}
            Kind of the fault.
        sizes : number or array
            Sizes of the fault, in the units of the attributes of the same names.
        """
        return np.array([self.law.mean_delay(kind, size) for size in _sizes(kind, sizes)]) * self.dt

    def exceedance(self, thresholds: ArrayLike) -> Floats:
        """Return the probability that beta exceeds each of some thresholds at a sample, without a fault.

        Parameters
        ----------
        thresholds : number or array
            Thresholds in squared units of the sensor.
        """
        return np.array([self.law.exceedance(float(b)) for b in np.atleast_1d(np.asarray(thresholds, float))])

    def plot(self, others: Mapping[str, Detectability] | None = None) -> Figure:
        """Return a figure: the tail of beta's distribution without a fault, and the expected delay for each kind of fault.

        Parameters
        ----------
        others : mapping of str to Detectability, optional
            Further results to draw, by their names in the legend.
        """
        from bayesftc.controllers.detection.figure import draw
        from bayesftc.cosim.judging.figures.panels import shown_figure

        return draw({self.form: self, **(others or {})}, shown_figure())

    def __str__(self) -> str:
        rows = [
            ("innovation's standard deviation", self.innovation_variance**0.5, ""),
            ("mean of beta without a fault", self.mean_beta, ""),
            ("threshold on beta", self.threshold, ""),
            ("false alarms per sample", self.false_alarm_probability, ""),
            ("false alarms per hour", self.false_alarms_per_hour, "(onsets of alarms)"),
        ]
        header = f"smallest fault detected within {self.within:g} s with probability {self.detection_probability:g}"
        faults = [
            ("offset", self.offset, self.offset_delay),
            ("drift, per second", self.drift, self.drift_delay),
            ("noise, standard deviation", self.noise, self.noise_delay),
        ]
        lines = [f"Detectability of beta ({self.form}, sample time {self.dt:g} s)"]
        lines += [f"  {name:<34}{value:>10.4g} {note}".rstrip() for name, value, note in rows]
        lines += [header, f"  {'':<34}{'size':>10}{'mean delay (s)':>18}"]
        lines += [f"  {name:<34}{size:>10.4g}{delay:>18.3g}" for name, size, delay in faults]
        return "\n".join(lines)


def detectability(
    precision: GammaPrecision | None = None,
    model: LinearModel | BayesianController | StateEstimator | None = None,
    *,
    sensor: int = 0,
    sensor_variance: float | None = None,
    innovation_variance: float | None = None,
    dt: float | None = None,
    false_alarm_probability: float | None = None,
    false_alarms_per_hour: float | None = None,
    detection_probability: float = 0.9,
    within: float | None = None,
    learning: bool = True,
    runs: int = 10_000,
    seed: int = 0,
) -> Detectability:
    """Return the threshold on a sensor's beta for a false-alarm rate, with the smallest detectable faults and their delays.

    Without a model, the innovations are an independent normal stream, of which a fault changes mean or variance. With a model,
    they are those of a filter, which attributes a part of an offset to the state. By default it is the filter in the loop, which
    reduces the sensor's weight while it learns; with ``learning=False`` it is the filter at fixed precision.
    ``docs/reports/detectability.md`` has the derivations and the checks of each number.

    Parameters
    ----------
    precision : GammaPrecision, optional
        The learner of beta, with forgetting; by default that of the controller, else ``GammaPrecision()``.
    model : LinearModel, BayesianController or StateEstimator, optional
        Plant and sensors, or a controller or estimator with its model. Controls, goals and limits have no effect.
    sensor : int
        Number of the faulty sensor of the model.
    sensor_variance : float, optional
        Without a model: the nominal variance of the sensor, expected by the prior; by default 1.
    innovation_variance : float, optional
        Without a model: the variance of the innovations; by default that of the sensor.
    dt : float, optional
        Without a model: the sample time in seconds. By default 1, so that all times are in samples.
    false_alarm_probability : float, optional
        Probability that beta exceeds the threshold at a sample, without a fault; by default 0.001.
    false_alarms_per_hour : float, optional
        In place of it: how often an alarm may begin without a fault.
    detection_probability : float
        A fault counts as detectable if there is an alarm in time with at least this probability.
    within : float, optional
        Seconds after the onset in which an alarm is in time, at least two samples; by default 50 samples.
    learning : bool
        Whether the filter uses the learned precision, as in the loop.
    runs, seed : int
        Number and seed of the simulated runs for times without a closed form: in the loop, and with a look-back window. The
        probabilities have a standard error of at most 0.5 / sqrt(runs).

    Returns
    -------
    Detectability
        The result; print it, or use its fields.

    Raises
    ------
    ModelError
        If a setting is not valid, the learner never forgets, the filter has no steady state, or false alarms alone are as
        frequent as the requested detections.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> print(controllers.detectability(sensor_variance=0.04, dt=0.1, false_alarm_probability=1e-4))
    Detectability of beta (stream, sample time 0.1 s)
      innovation's standard deviation          0.2
      mean of beta without a fault            0.48
      threshold on beta                     0.9472
      false alarms per sample               0.0001
      false alarms per hour                  1.621 (onsets of alarms)
    smallest fault detected within 5 s with probability 0.9
                                              size    mean delay (s)
      offset                                0.2416              2.72
      drift, per second                    0.07574              4.13
      noise, standard deviation             0.2455              2.58
    """
    learner, linear_model = _learner_and_model(precision, model)
    probability = as_number("detectability has detection_probability", detection_probability, above=0, below=1)
    count = int(as_number("detectability has runs", runs, least=100, whole=True))
    start = int(as_number("detectability has seed", seed, least=0, whole=True))
    if not isinstance(learning, bool):
        raise ModelError(f"detectability has learning={learning!r}; give True or False.")
    if linear_model is None:
        step = 1.0 if dt is None else as_number("detectability has dt", dt, above=0)
        nominal = (
            1.0 if sensor_variance is None else as_number("detectability has sensor_variance", sensor_variance, above=0)
        )
        variance_given = innovation_variance
        variance = (
            nominal
            if variance_given is None
            else as_number("detectability has innovation_variance", variance_given, above=0)
        )
        law, form = beta_law(learner, nominal, variance, step, count, start), "stream"
    else:
        for name, value in (
            ("dt", dt),
            ("sensor_variance", sensor_variance),
            ("innovation_variance", innovation_variance),
        ):
            if value is not None:
                raise ModelError(
                    f"detectability has {name}={value!r} and a model, which already determines it; leave {name} out."
                )
        index = int(as_number("detectability has sensor", sensor, least=0, most=linear_model.sensors - 1, whole=True))
        step, form = float(linear_model.step), "loop" if learning else "fixed filter"
        law = loop_law(learner, linear_model, index, learning, count, start)
    law.set_threshold(_false_alarms(false_alarm_probability, false_alarms_per_hour, step))
    time = SAMPLES * step if within is None else as_number("detectability has within", within, above=0)
    steps = _samples(time, step)
    if steps < 2:
        raise ModelError(
            f"detectability has within={time:g} s at a sample time of {step:g} s; give at least two samples."
        )
    smallest = {kind: _smallest(law, kind, steps, probability) for kind in KINDS}
    return Detectability(
        form=form,
        dt=step,
        innovation_variance=law.variance,
        mean_beta=law.mean_beta,
        threshold=law.threshold,
        false_alarm_probability=law.exceedance(law.threshold),
        false_alarms_per_hour=law.onset_of_alarms * HOUR / step,
        detection_probability=probability,
        within=time,
        **smallest,
        **{f"{kind}_delay": law.mean_delay(kind, size) * step for kind, size in smallest.items()},
        law=law,
    )


def _learner_and_model(
    precision: GammaPrecision | None, model: LinearModel | BayesianController | StateEstimator | None
) -> tuple[GammaPrecision, LinearModel | None]:
    learner: object = precision
    if isinstance(precision, LinearModel | BayesianController | StateEstimator):
        raise ModelError(
            f"detectability has {with_article(type(precision).__name__)} as its precision. The learner comes first: "
            "detectability(precision, model), or detectability(model=...)."
        )
    if isinstance(model, BayesianController | StateEstimator):
        if isinstance(model, BayesianController) and model.belief != "filtered":
            raise ModelError(
                f"detectability has a controller with belief={model.belief!r}, in whose innovations the goals have an effect; "
                "give one with belief='filtered'."
            )
        learner, model = (model.precision if precision is None else precision), model.model
    learner = GammaPrecision() if learner is None else learner
    if not isinstance(learner, GammaPrecision):
        raise ModelError(
            f"detectability is for GammaPrecision only, not for {type(learner).__name__}; give a GammaPrecision."
        )
    if learner.window is None and (learner.forgetting is None or learner.forgetting == 1.0):
        raise ModelError(
            "GammaPrecision without forgetting has a beta that grows without bound, so that no constant threshold exists. Give a "
            "forgetting factor below 1, or a window."
        )
    if not (model is None or isinstance(model, LinearModel)):
        raise ModelError(f"detectability needs a LinearModel, or a controller that has one, not {model!r}.")
    return learner, model


def _false_alarms(per_sample: float | None, per_hour: float | None, dt: float) -> tuple[bool, float]:
    """Return True and the probability of an alarm's onset at a sample, or False and that of an alarm."""
    if per_hour is None:
        header = 1e-3 if per_sample is None else per_sample
        return False, as_number("detectability has false_alarm_probability", header, least=1e-12, most=0.4)
    if per_sample is not None:
        raise ModelError("detectability has both false_alarm_probability and false_alarms_per_hour; give one of them.")
    rate = as_number("detectability has false_alarms_per_hour", per_hour, above=0) * dt / HOUR
    return True, as_number(
        f"detectability has false_alarms_per_hour={per_hour!r}, which is a sample's", rate, least=1e-12, most=0.1
    )


def _smallest(law: BetaLaw, kind: Kind, steps: int, probability: float) -> float:
    from scipy.optimize import brentq

    def gap(size: float) -> float:
        return law.detected(kind, size, steps) - probability

    if gap(0.0) >= 0:
        raise ModelError(
            f"Without any fault there is an alarm within {steps} samples with a probability of {gap(0.0) + probability:.3g}, not "
            f"below detection_probability={probability:g}; allow fewer false alarms, or less time."
        )
    unit = law.variance**0.5 / (law.dt * steps if kind == "drift" else 1.0)
    size = unit
    while gap(size) < 0:
        size *= 2.0
        if size > LARGEST * unit:
            raise ModelError(
                f"No {kind} is detected within {steps} samples with a probability of {probability:g}; allow more time."
            )
    return float(brentq(gap, 0.0, size, xtol=1e-4 * size, rtol=1e-4))


def _samples(seconds: float, dt: float) -> int:
    """Return the number of faulty samples in the first seconds, the immediate one included."""
    return int(np.ceil(seconds / dt - 1e-9))


def _sizes(kind: str, sizes: ArrayLike) -> list[float]:
    if kind not in KINDS:
        raise ModelError(f"The kind of fault {kind!r} is unknown; give one of {', '.join(map(repr, KINDS))}.")
    values = np.atleast_1d(np.asarray(sizes, float))
    if not np.isfinite(values).all() or (values < 0).any():
        raise ModelError(f"The sizes of faults are {values.tolist()}; they must be finite and not negative.")
    return [float(v) for v in values.ravel()]
