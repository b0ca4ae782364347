"""Explicit fault detection: precision is learned only while a residual exceeds its threshold (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.linalg.dense import cholesky
from bayesftc.controllers.models.checks import as_number, check_number
from bayesftc.controllers.precision.base import Learner, PrecisionLearner
from bayesftc.controllers.precision.gamma import GammaPrecision
from bayesftc.controllers.signals import port
from bayesftc.controllers.thresholds.chebyshev import ChebyshevThreshold, FittedThreshold
from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import both, maximum, minimum, select, sqrt, square

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

FURTHEST = 1e6
"""Largest error for a distance, in standard deviations, so that its square remains finite."""

INSTEAD = "leave out ExplicitDetection"
"""Advice for a learner that must infer faults together with the state."""

# The memory is a table whose rows are as long as the wrapped learner's memory. Its rows are that memory, the prior, and then, one
# after the other: for each group whether it is triggered, and for how many samples it has been quiet; for each sensor whether a
# fault is detected. The settings are a table of the wrapped learner's settings, then HOLD and, for each group, LEARNED, its
# squared BOUND, its members, their means and their covariance (m x m). A row of a table can be passed on; a slice cannot.
_PRIOR, _OWN_MEMORY, _OWN_SETTINGS = 1, 2, 1
_HOLD, _GROUPS = 0, 1
_LEARNED, _BOUND, _MEMBERS = 0, 1, 2


def _read(table, row, place):
    return table[row + place // table.shape[1], place % table.shape[1]]


def _write(table, row, place, value):
    table[row + place // table.shape[1], place % table.shape[1]] = value


def _exceeds(at, sample, settings, L, v):
    """Return whether the distance of a group's present sensors reaches its bound; the group's settings begin at `at`.

    In the matrix, other sensors are independent ones without an error.
    """
    m = sample.e.shape[0]
    means = at + _MEMBERS + m
    learned = _read(settings, _OWN_SETTINGS, at + _LEARNED) > 0.5
    here = 0.0 * sample.present[0]
    members = 0.0 * sample.present[0]
    for i in range(m):
        member = _read(settings, _OWN_SETTINGS, at + _MEMBERS + i) * sample.present[i] > 0.5
        members = members + _read(settings, _OWN_SETTINGS, at + _MEMBERS + i)
        here = here + select(member, 1.0, 0.0)
        for j in range(m):
            together = both(member, _read(settings, _OWN_SETTINGS, at + _MEMBERS + j) * sample.present[j] > 0.5)
            expected = select(
                learned,
                _read(settings, _OWN_SETTINGS, means + m + i * m + j),
                sample.spread[i, j] + sample.nominal[i, j],
            )
            L[i, j] = select(together, expected, 1.0 if i == j else 0.0)
        largest = FURTHEST * sqrt(L[i, i])
        error = maximum(minimum(sample.e[i] - _read(settings, _OWN_SETTINGS, means + i), largest), -largest)
        v[0, i] = select(member, error, 0.0)
    cholesky(L, L)
    squared = 0.0 * v[0, 0]
    for i in range(m):
        for k in range(i):
            v[0, i] = v[0, i] - L[i, k] * v[0, k]
        v[0, i] = v[0, i] / L[i, i]
        squared = squared + v[0, i] * v[0, i]
    part = select(learned, here / members, 1.0)
    return both(here > 0.5, squared >= part * _read(settings, _OWN_SETTINGS, at + _BOUND))


@cache
def _make_steps(
    learn: Callable[..., None], report: Callable[..., None], scratch: int, first_detected: int, groups: int
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the learning and reporting step functions that wrap those of a learner.

    The learner's work matrices end before `scratch`, its reports before `first_detected`.
    """

    def learn_while_detected(sample, trust, memory, settings, work):
        """Test for faults, call the wrapped learner, and use its result if there is a fault."""
        m = sample.y.shape[0]
        before = 0.0 * sample.nominal[0, 0]
        for g in range(groups):
            before = maximum(before, _read(memory, _OWN_MEMORY, g))
        for i in range(memory.shape[1]):
            memory[0, i] = select(before > 0.5, memory[0, i], memory[_PRIOR, i])
        for i in range(m):
            _write(memory, _OWN_MEMORY, 2 * groups + i, 0.0 * sample.nominal[0, 0])
        detected = 0.0 * sample.nominal[0, 0]
        for g in range(groups):
            at = _GROUPS + g * (_MEMBERS + 2 * m + m * m)
            any_present = 0.0 * sample.nominal[0, 0]  # a group without any sample remains as it is
            for i in range(m):
                any_present = maximum(
                    any_present, sample.present[i] * _read(settings, _OWN_SETTINGS, at + _MEMBERS + i)
                )
            exceeds = _exceeds(at, sample, settings, work[scratch], work[scratch + 1])
            quiet = _read(memory, _OWN_MEMORY, groups + g) + any_present
            quiet = select(exceeds, 0.0, quiet)
            recovered = quiet >= _read(settings, _OWN_SETTINGS, _HOLD)
            active = select(exceeds, 1.0, select(recovered, 0.0, _read(memory, _OWN_MEMORY, g)))
            _write(memory, _OWN_MEMORY, g, active)
            _write(memory, _OWN_MEMORY, groups + g, minimum(quiet, _read(settings, _OWN_SETTINGS, _HOLD)))
            detected = maximum(detected, active)
            for i in range(m):
                member = active * _read(settings, _OWN_SETTINGS, at + _MEMBERS + i)
                place = 2 * groups + i
                _write(memory, _OWN_MEMORY, place, maximum(member, _read(memory, _OWN_MEMORY, place)))
        learn(sample, trust, memory[0], settings[0], work)
        for i in range(m):
            for j in range(m):
                trust.R[i, j] = select(detected > 0.5, trust.R[i, j], sample.nominal[i, j])
            trust.used[i] = select(detected > 0.5, trust.used[i], sample.present[i])
            trust.precision[i] = select(detected > 0.5, trust.precision[i], 1.0 / sample.nominal[i, i])

    def report_detected(memory, settings, nominal, first, outputs):
        """Write the wrapped learner's outputs, then for each sensor whether a fault is detected."""
        report(memory[0], settings[0], nominal, first, outputs)
        for i in range(nominal.shape[0]):
            outputs[first + first_detected + i] = _read(memory, _OWN_MEMORY, 2 * groups + i)

    return learn_while_detected, report_detected


@dataclass(frozen=True)
class ExplicitDetection(PrecisionLearner):
    """Precision learning that a threshold triggers and recovery ends; implicit detection is the learner alone.

    While no fault is detected, every sensor has its nominal covariance, and the wrapped learner restarts from its prior at each
    sample. Its outputs (``beta``, ``fault_probability``, its moments) are then those of this one sample, and they are not used.
    The sample that triggers is the first one that the learner keeps, and the learned precision weights that sample. From then on
    it learns for all sensors, as it would alone.

    A group is triggered by the distance ``d_M`` of its innovation, and released after `hold` below the threshold. The learner
    stops when no group is triggered. Missing samples are left out of the distance; a group without any sample remains as it is.
    The learner's outputs are extended by ``detected`` (m; 1 while a group of the sensor is triggered).

    Parameters
    ----------
    learning : PrecisionLearner
        The wrapped learner; by default ``GammaPrecision()``.
    threshold : float, FittedThreshold or a sequence with one for each group
        A number is a bound on the distance by the model: from zero, with the covariance ``C P_t|t-1 C' + R``, for any number of
        missing samples. For one sensor it is in standard deviations of the innovation. The default is the usual 3, with frequent
        false alarms: each sensor of the shipped car is detected for 5 % of the time without a fault, one of the two for 10 % (at
        4 for 0.1 and 0.2 %). Chebyshev's inequality, for any distribution, gives 10 for one sensor and alpha = 0.01, at which
        only large faults are detected.

        A fitted threshold has its own moments, learned from healthy innovations (with their sign) of the group's sensors:
        ``ChebyshevThreshold().fit(healthy["controller.innovation"][:, [0, 1]])``. With missing samples its squared bound
        decreases with their number, as n / alpha does. Use a fitted one for `UnbiasedActiveInference`, whose belief has no
        covariance. A number is there in standard deviations of the sensor's noise alone, so that the belief's lag behind a
        motion counts as a fault: on the arm without a fault, 3 detects one all of the time, the fitted bound never.
    groups : sequence of sequences of int, optional
        Sensors that are tested together; by default each alone. For example ``((0, 1), (2, 3))``: the position encoders of two
        joints, and their velocity encoders.
    hold : float
        Seconds below the threshold after which a group has recovered, a whole number of the model's steps; the default is the
        paper's mean time to recovery (section 5.3).

    Raises
    ------
    ModelError
        If thresholds, groups and the model's sensors do not match.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> learner = controllers.ExplicitDetection(controllers.GammaPrecision(), threshold=4.0)
    >>> step = controllers.StateEstimator(model, learner, initial_covariance=0.01).online(compiled=False)
    >>> out = step(y=[0.1, 3.0], u=0.0)
    >>> out.detected.tolist(), out.precision.round(1).tolist()
    ([0.0, 1.0], [29.4, 0.5])
    """

    learning: PrecisionLearner = field(default_factory=GammaPrecision)
    threshold: float | FittedThreshold | Sequence[float | FittedThreshold] = 3.0
    groups: Sequence[Sequence[int]] | None = None
    hold: float = 0.4

    def __post_init__(self) -> None:
        if not isinstance(self.learning, PrecisionLearner) or isinstance(self.learning, ExplicitDetection):
            raise ModelError(
                f"ExplicitDetection has learning={brief(self.learning)}; it must be a precision learner such as GammaPrecision()."
            )
        if self.groups is not None:
            object.__setattr__(self, "groups", _groups(self.groups))
        if np.ndim(self.threshold) > 0:  # type: ignore[arg-type]
            object.__setattr__(self, "threshold", tuple(_threshold(one) for one in self.threshold))  # type: ignore[union-attr]
        else:
            _threshold(self.threshold)
        check_number(self, "hold", above=0)

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, wrapped = model.sensors, self.learning.apart("ExplicitDetection", INSTEAD).learner(model)
        groups = tuple((i,) for i in range(m)) if self.groups is None else self.groups
        further: list[Floats] = [
            np.array([whole_steps(self.hold, model.step, "ExplicitDetection's hold")], dtype=np.float64)
        ]
        for group, threshold in zip(groups, self._thresholds(len(groups)), strict=True):
            further += self._group_settings(group, threshold, m)
        reported = sum(port.size for port in wrapped.ports)
        step, report = _make_steps(wrapped.step, wrapped.report, wrapped.work, reported, len(groups))
        return Learner(
            step,
            _table([wrapped.memory, wrapped.memory], np.zeros(2 * len(groups) + m)),
            _table([wrapped.settings], np.concatenate(further)),
            work=wrapped.work + 2,
            ports=(*wrapped.ports, port("detected", (m,))),
            report=report,
        )

    def without_covariance(self) -> ExplicitDetection:
        """See `PrecisionLearner.without_covariance`."""
        return replace(self, learning=self.learning.without_covariance())

    def for_rates(self, every: Sequence[int], before: Sequence[int]) -> ExplicitDetection:
        """See `PrecisionLearner.for_rates`."""
        learning = self.learning.for_rates(every, before)
        return self if learning is self.learning else replace(self, learning=learning)

    def _thresholds(self, groups: int) -> tuple[float | FittedThreshold, ...]:
        if not isinstance(self.threshold, tuple):
            return (self.threshold,) * groups  # type: ignore[return-value]
        if len(self.threshold) != groups:
            raise ModelError(
                f"ExplicitDetection has {len(self.threshold)} thresholds for {groups} groups of sensors; give one for all, or "
                "one for each."
            )
        return self.threshold

    def _group_settings(self, group: Sequence[int], threshold: float | FittedThreshold, sensors: int) -> list[Floats]:
        members, mean, covariance = np.zeros(sensors), np.zeros(sensors), np.eye(sensors)
        if not group or len(set(group)) < len(group) or not set(group) <= set(range(sensors)):
            raise ModelError(
                f"ExplicitDetection has the group {tuple(group)} of sensors; it must name some of the model's {sensors} sensors, "
                f"numbered from 0 to {sensors - 1}, each once."
            )
        members[list(group)] = 1.0
        if not isinstance(threshold, FittedThreshold):
            return [np.array([0.0, square(threshold)]), members, mean, covariance.ravel()]
        if threshold.size != len(group):
            raise ModelError(
                f"The threshold is for {threshold.size} residual(s), but the group {tuple(group)} has {len(group)} sensor(s); "
                "fit one for each group, to the innovations of its sensors."
            )
        mean[list(group)] = threshold.mean
        covariance[np.ix_(list(group), list(group))] = threshold.covariance
        return [np.array([1.0, square(threshold.bound)]), members, mean, covariance.ravel()]

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return self.learning.why_no_probability


def _threshold(value: object) -> Any:
    if isinstance(value, FittedThreshold):
        return value
    if isinstance(value, ChebyshevThreshold):
        raise ModelError(
            f"ExplicitDetection has threshold={value!r}, which is not fitted; give {value!r}.fit(residuals) with healthy "
            "innovations."
        )
    as_number("ExplicitDetection has threshold", value, above=0, finite=False)
    return value


def _groups(value: object) -> tuple[tuple[int, ...], ...]:
    """Return groups of sensors as tuples of their numbers."""
    groups = [_members(group) for group in value] if isinstance(value, Sequence | np.ndarray) else []
    if not groups or None in groups:
        raise ModelError(
            f"ExplicitDetection has groups={value!r}; give a list of groups, each a list of sensors by their numbers, as [[0, "
            "1], [2]], or None to test each sensor alone."
        )
    return tuple(group for group in groups if group is not None)


def _members(group: object) -> tuple[int, ...] | None:
    if not isinstance(group, Sequence | np.ndarray) or isinstance(group, str):
        return None
    whole = all(isinstance(i, Integral) and not isinstance(i, bool) for i in group)
    return tuple(int(i) for i in group) if whole else None


def _table(rows: list[Floats], further: Floats) -> Floats:
    """Return a table of the given rows, followed by the rows that `further` needs."""
    width = len(rows[0])
    more = np.zeros(-(-len(further) // width) * width)
    more[: len(further)] = further
    return np.vstack([*rows, more.reshape(-1, width)])
