"""Learning from recorded runs, without labels: how often faults come and go, how large they are, how coarse sensors are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.recorded import SHORT, estimate, innovation_covariances
from bayesftc.controllers.learning import kernels
from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.controllers.models.checks import Matrix, as_number, as_numbers
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.switching.fault_modes import FaultMode, Frozen, Noisier, Offset
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.controllers.switching.sensor_kernels import LEAST
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

PRIOR_FAULTS = 0.5
"""How many faults what is believed before counts for, as Jeffreys' prior of a rate does: a mode that never shows keeps a time to
a fault of twice the recordings' length and what was believed before."""

SETTLED = 0.01
"""Learning ends when no setting changes by more than this share of it."""

SETTINGS = ("time_to_fault", "time_to_recovery", "jump", "slope", "scale")
"""What is learned of modes that have it."""


class RecordedRun(NamedTuple):
    """Samples and inputs of a run.

    Attributes
    ----------
    y : array_like, steps x sensors
        Samples; NaN where there is none.
    u : array_like, steps x controls, optional
        Known inputs, each acting until the next sample; by default 0.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.
    """

    y: ArrayLike
    u: ArrayLike | None = None
    initial_mean: float | tuple[float, ...] = 0.0
    initial_covariance: Matrix | None = None


@dataclass(frozen=True)
class LearnedModes:
    """What `learn_modes` has learned.

    Attributes
    ----------
    precision : SwitchingPrecision
        With the learned modes, of which all durations are exponential, as they were learned (an infinite `duration_shape`).
    onsets, recoveries : tuple of float
        Expected numbers of them in the recordings, of each mode.
    faulty : tuple of float
        Seconds that sensors were in each mode, all sensors together.
    healthy : float
        Seconds that sensors were healthy, all together.
    log_likelihood : tuple of float
        Logarithm of the recordings' density before each iteration, in nats.
    settled : bool
        Whether the last one changed no setting by more than a hundredth.
    """

    precision: SwitchingPrecision
    onsets: tuple[float, ...]
    recoveries: tuple[float, ...]
    faulty: tuple[float, ...]
    healthy: float
    log_likelihood: tuple[float, ...]
    settled: bool


def learn_modes(
    recordings: Sequence[RecordedRun],
    model: LinearModel,
    precision: SwitchingPrecision | None = None,
    *,
    iterations: int = 20,
    compiled: bool | None = None,
) -> LearnedModes:
    """Learn from recorded runs how often each fault mode begins and ends, how large its faults are, and how coarse sensors are.

    By expectation-maximisation (Dempster, Laird and Rubin 1977; for hidden Markov models Baum and Welch): the learner runs over
    the recordings, and backward; then each mode gets the times to a fault and to recovery, an `Offset` and `Drifting` the sizes
    ``jump`` and ``slope``, and a `Noisier` the ``scale``, for which what was expected is most probable; and so on until
    nothing changes. Nobody need say when there was a fault. What was believed before counts as half a fault: a mode that does
    not show gets rare, never impossible. A size of 0 stays 0.

    It is an approximation: moments of offsets are merged, and sensors are judged by their innovations one by one. Faults that
    cannot be told apart, such as small offsets and slow drifts, are shared out between their modes.

    Parameters
    ----------
    recordings : sequence of RecordedRun
        With faults and without, as they come.
    model : LinearModel
        Of plant and sensors.
    precision : SwitchingPrecision, optional
        Where to begin. A `Frozen` without a resolution gets each sensor's by `find_resolution`.
    iterations : int
        At most how many.
    compiled : bool, optional
        False to step through the plain Python form; by default short recordings do.

    Raises
    ------
    ModelError
        If there is no recording, or one does not fit the model.
    """
    start = SwitchingPrecision() if precision is None else precision
    if not isinstance(start, SwitchingPrecision):
        raise ModelError(f"learn_modes learns the modes of a SwitchingPrecision, not of a {type(start).__name__}.")
    given = _listed(recordings, model)
    as_number("learn_modes has iterations", iterations, least=1, whole=True)
    StateEstimator(model, start)  # a model or settings that do not fit are named here, not after the first recording
    runs = [_checked(number, run, model) for number, run in enumerate(given)]
    if not runs:
        raise ModelError("learn_modes has no recording to learn from; give at least one RecordedRun.")
    # How probable it is that all sensors jump alike is believed, not learned, and would be shared out over their offsets.
    alike = start.alike
    start = replace(start, modes=[_resolved(mode, runs) for mode in start.modes], alike=0.0, duration_shape=inf)
    start = start.paced(float(model.step))
    now, settled, step = start, False, float(model.step)
    likelihood: list[float] = []
    while len(likelihood) < iterations and not settled:
        densities, tables = zip(*(_expect(run, model, now, compiled) for run in runs), strict=True)
        likelihood.append(sum(densities))
        expected = np.sum(tables, axis=0)
        modes = [_maximised(*of, step) for of in zip(start.modes, now.modes, expected, strict=True)]
        settled = max(map(_change, now.modes, modes)) <= SETTLED
        now = replace(now, modes=modes)
    onsets, recoveries, healthy, faulty = (tuple(map(float, of)) for of in expected.T[: kernels.FAULTY + 1])
    return LearnedModes(
        replace(now, alike=alike),
        onsets,
        recoveries,
        tuple(step * s for s in faulty),
        step * max(healthy),
        tuple(likelihood),
        settled,
    )


def _listed(recordings: object, model: object) -> list[RecordedRun]:
    """Return the recordings, or say by its type what was given in place of them or of the model: numbers would fill a page."""
    if not isinstance(model, LinearModel):
        raise ModelError(
            f"learn_modes needs a LinearModel after the recordings, not something of the type {type(model).__name__}."
        )
    several = isinstance(recordings, Iterable) and not isinstance(recordings, RecordedRun)
    runs: list[RecordedRun] = []
    for run in recordings if several else [recordings]:  # type: ignore[attr-defined]
        if not several or not isinstance(run, RecordedRun):
            what = "a recording" if several else "recordings"
            raise ModelError(
                f"learn_modes has {what} of the type {type(run).__name__}; give a list of RecordedRun, as [RecordedRun(y, u)]."
            )
        runs.append(run)
    return runs


def _checked(number: int, run: RecordedRun, model: LinearModel) -> RecordedRun:
    """Return a recording with arrays, or say what does not fit."""
    title = f"Recording {number}"
    y = as_numbers(f"{title}: y", run.y, "give a row of samples for each step")
    if y.ndim != 2 or y.shape[1] != model.sensors or not len(y):
        raise ModelError(f"{title} has y of shape {y.shape}; it must be steps x {model.sensors} sensors.")
    shape = (len(y), model.controls)
    u = np.zeros(shape) if run.u is None else as_numbers(f"{title}: u", run.u, "give a row of inputs for each step")
    if u.ndim == 1 and model.controls == 1:
        u = u[:, np.newaxis]
    if u.shape != shape:
        raise ModelError(f"{title} has u of shape {u.shape}; it must be {shape[0]} steps x {shape[1]} controls.")
    return run._replace(y=y, u=u)


def _resolved(mode: FaultMode, runs: Sequence[RecordedRun]) -> FaultMode:
    """Return a mode; one that must know the sensors' resolution and does not gets it."""
    if not isinstance(mode, Frozen) or np.any(mode.resolution):
        return mode
    y = np.vstack([np.asarray(run.y) for run in runs])  # the changes from one to the next are too few to count
    return replace(mode, resolution=tuple(find_resolution(samples) for samples in y.T))


def _expect(
    run: RecordedRun, model: LinearModel, precision: SwitchingPrecision, compiled: bool | None
) -> tuple[float, Floats]:
    """Return the logarithm of the samples' density, and what is expected of each mode: a row of counts and sizes for each."""
    estimator = StateEstimator(model, precision, run.initial_mean, run.initial_covariance)
    y, u = np.asarray(run.y), np.asarray(run.u)
    found = estimate(estimator, y, u, ("mode_probability", "innovation", "P", "log_density"), compiled)
    filtered, e = found["mode_probability"], found["innovation"]
    variance = np.ascontiguousarray(np.diagonal(innovation_covariances(estimator, found["P"]), axis1=1, axis2=2))
    nominal = np.ascontiguousarray(np.diag(model.matrix("sensor_covariance")))
    modes, step = precision.modes, float(model.step)
    smooth, offsets, scatter = _passes(len(y) > SHORT if compiled is None else compiled)
    begun, lasts = np.empty((2, *y.shape, len(modes)))
    counts, sizes = np.zeros((kernels.FAULTY + 1, len(modes))), np.zeros((len(modes), 3))
    smooth(
        filtered, np.array([step / m.time_to_fault for m in modes]), np.array([step / m.time_to_recovery for m in modes]),
        begun, lasts, counts,
    )  # fmt: skip
    for k, mode in enumerate(modes):
        if isinstance(mode, Offset):
            squares = (float(size) * float(size) for size in (mode.jump, mode.slope, mode.walk))
            offsets(begun, lasts, e, variance, nominal, k, *squares, sizes[k])
        elif isinstance(mode, Noisier):
            gamma = float(mode.shape), float(mode.shape * mode.scale**2), float(mode.forgetting)
            scatter(begun, lasts, e, variance, k, *gamma, sizes[k])
    seen = filtered[:, :, 1:].max(axis=(0, 1)) > LEAST  # others take no part in this form
    return float(found["log_density"].sum()), np.where(seen[:, np.newaxis], np.column_stack([counts.T, sizes]), 0.0)


@cache
def _passes(compiled: bool) -> tuple[Any, Any, Any]:
    """Return the passes backward through a recording, compiled or as they stand."""
    passes: list[tuple[Any, str]] = [
        (kernels.smooth, kernels.SMOOTH), (kernels.measure_offsets, kernels.OFFSETS), (kernels.measure_scatter, kernels.SCATTER),
    ]  # fmt: skip
    if not compiled:
        return tuple(function for function, _ in passes)  # type: ignore[return-value]
    from bayesftc.cosim.stepping.compiler import compile_function

    return tuple(compile_function(function, signature) for function, signature in passes)  # type: ignore[return-value]


def _maximised(start: FaultMode, now: FaultMode, expected: Floats, step: float) -> FaultMode:
    """Return a mode with the settings that are most probable after what was expected of it, and was believed at the start."""
    onsets, recoveries, healthy, faulty, times, first, second = expected
    if not healthy:
        return now
    c = PRIOR_FAULTS
    learned = {
        "time_to_fault": (step * healthy + c * start.time_to_fault) / (onsets + c),
        "time_to_recovery": (step * faulty + c * start.time_to_recovery) / (recoveries + c),
    }
    if isinstance(start, Offset):
        learned["jump"] = ((first + c * start.jump**2) / (times + c)) ** 0.5
        learned["slope"] = ((second + c * start.slope**2) / (times + c)) ** 0.5
    elif isinstance(start, Noisier):
        learned["scale"] = ((times + c) / (first + c * start.scale**-2)) ** 0.5
    return replace(now, **{name: float(value) for name, value in learned.items()})


def _change(before: FaultMode, after: FaultMode) -> float:
    """Return by which share the setting has changed that has changed most."""
    pairs = [(getattr(before, name), getattr(after, name)) for name in SETTINGS if hasattr(before, name)]
    return float(max(abs(new - old) / old for old, new in pairs if old))
