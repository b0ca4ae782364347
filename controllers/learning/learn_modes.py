"""Learn rates and sizes of faults, and the sensors' resolution, from recorded runs without labels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.recorded import estimate, innovation_covariances, is_short
from bayesftc.controllers.learning import kernels
from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.controllers.models.checks import Matrix, as_number, as_numbers
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.switching.fault_modes import FaultMode, Frozen, Noisier, Offset
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.controllers.switching.sensor_kernels import LEAST
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import sqrt, square
from bayesftc.cosim.types import Floats

PRIOR_FAULTS = 0.5
"""Weight of the initial settings in faults, as of Jeffreys' prior of a rate. A mode that never occurs gets a time to a fault of
twice the recordings' length plus the initial one."""

SETTLED = 0.01
"""Learning ends when no setting has a larger relative change."""

SETTINGS = ("time_to_fault", "time_to_recovery", "jump", "slope", "scale")
"""Settings that are learned, for modes that have them."""


class RecordedRun(NamedTuple):
    """Samples and inputs of a run.

    Attributes
    ----------
    y : array_like, steps x sensors
        Samples; NaN where there is none.
    u : array_like, steps x controls, optional
        Known inputs, each held until the next sample; by default 0.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> y = 20.0 + 0.1 * np.random.default_rng(0).standard_normal((100, 2))
    >>> y[50:, 1] += 2.0
    >>> run = controllers.RecordedRun(y, initial_mean=20.0)
    >>> learned = controllers.learn_modes([run], model, iterations=1, compiled=False)
    >>> {type(m).__name__: round(n, 1) for m, n in zip(learned.precision.modes, learned.onsets)}
    {'Frozen': 0.0, 'Offset': 1.0, 'Drifting': 0.0, 'Ramping': 0.0, 'Unmodelled': 0.0, 'Noisier': 0.0, 'DroppedOut': 0.0}
    """

    y: ArrayLike
    u: ArrayLike | None = None
    initial_mean: float | tuple[float, ...] = 0.0
    initial_covariance: Matrix | None = None


@dataclass(frozen=True)
class LearnedModes:
    """The result of `learn_modes`.

    Attributes
    ----------
    precision : SwitchingPrecision
        The learner with the learned modes. All durations are exponential, as in learning (an infinite `duration_shape`).
    onsets, recoveries : tuple of float
        Expected numbers of onsets and recoveries of each mode in the recordings.
    faulty : tuple of float
        Seconds in each mode, summed over all sensors.
    healthy : float
        Healthy seconds, summed over all sensors.
    log_likelihood : tuple of float
        Logarithm of the recordings' density before each iteration, in nats. It is that of samples without a second fault of a
        faulty sensor, so it prefers rare faults a little.
    settled : bool
        Whether the last iteration changed no setting by more than a hundredth.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> y = 20.0 + 0.1 * np.random.default_rng(0).standard_normal((100, 2))
    >>> y[20:40, 0] = y[20, 0]  # the first sensor freezes for two seconds
    >>> learner = controllers.SwitchingPrecision([controllers.Frozen(), controllers.Offset()])
    >>> run = controllers.RecordedRun(y, initial_mean=20.0)
    >>> learned = controllers.learn_modes([run], model, learner, iterations=2, compiled=False)
    >>> np.round(learned.onsets, 1).tolist(), np.round(learned.faulty, 1).tolist()  # frozen, offset
    ([1.0, 0.0], [1.9, 0.0])
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
    """Learn from recorded runs how often each fault mode begins and ends, its faults' sizes, and the sensors' resolution.

    The method is expectation-maximisation (Dempster, Laird and Rubin 1977; for hidden Markov models Baum and Welch). The learner
    runs forward and backward over the recordings. Then each mode gets the most probable settings: the times to a fault and to
    recovery, for `Offset` and `Drifting` the sizes ``jump`` and ``slope``, for `Noisier` the ``scale``. This repeats until
    nothing changes. Labels are not needed. The initial settings count as half a fault: a mode that does not occur becomes rare,
    but not impossible. A size of 0 remains 0.

    The result is approximate, because moments of offsets are merged and innovations are judged sensor by sensor. Faults that
    cannot be distinguished, such as small offsets and slow drifts, are shared between their modes.

    Parameters
    ----------
    recordings : sequence of RecordedRun
        Recordings with and without faults.
    model : LinearModel
        The model of plant and sensors.
    precision : SwitchingPrecision, optional
        Initial settings. A `Frozen` without a resolution gets that of each sensor by `find_resolution`.
    iterations : int
        Largest number of iterations.
    compiled : bool, optional
        False for interpreted runs, which a debugger can step through; by default for short recordings.

    Returns
    -------
    LearnedModes
        The learner with the learned modes, and what they have in the recordings.

    Raises
    ------
    ModelError
        If there is no recording, or one does not fit the model.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> y = 20.0 + 0.1 * np.random.default_rng(0).standard_normal((100, 2))
    >>> y[20:40, 0], y[60:80, 1] = y[20, 0], y[60, 1]  # each sensor freezes for two seconds
    >>> learner = controllers.SwitchingPrecision([controllers.Frozen(), controllers.Offset()])
    >>> run = controllers.RecordedRun(y, initial_mean=20.0)
    >>> learned = controllers.learn_modes([run], model, learner, iterations=3, compiled=False)
    >>> frozen, offset = learned.precision.modes
    >>> round(frozen.time_to_fault), round(frozen.time_to_recovery, 1), round(offset.time_to_fault)
    (306, 11.5, 776)
    """
    start = SwitchingPrecision() if precision is None else precision
    if not isinstance(start, SwitchingPrecision):
        raise ModelError(f"learn_modes learns the modes of a SwitchingPrecision, not of a {type(start).__name__}.")
    listed_runs = _listed(recordings, model)
    as_number("learn_modes has iterations", iterations, least=1, whole=True)
    StateEstimator(model, start)  # raises now, not after the first recording, if model and settings do not fit
    runs = [_checked(number, run, model) for number, run in enumerate(listed_runs)]
    if not runs:
        raise ModelError("learn_modes has no recording; give at least one RecordedRun.")
    # The probability that all sensors jump alike is not learned; left in, it would change the sensors' offsets.
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
    """Return the recordings; refuse other types with the type's name, because numbers would fill a page."""
    if not isinstance(model, LinearModel):
        raise ModelError(
            f"learn_modes needs a LinearModel after the recordings, not something of the type {type(model).__name__}."
        )
    several = isinstance(recordings, Iterable) and not isinstance(recordings, RecordedRun)
    runs: list[RecordedRun] = []
    for run in recordings if several else [recordings]:  # type: ignore[attr-defined]
        if not several or not isinstance(run, RecordedRun):
            received = "a recording" if several else "recordings"
            raise ModelError(
                f"learn_modes has {received} of the type {type(run).__name__}; give a list of RecordedRun: [RecordedRun(y, u)]."
            )
        runs.append(run)
    return runs


def _checked(number: int, run: RecordedRun, model: LinearModel) -> RecordedRun:
    """Return a recording with arrays; refuse one that does not fit the model."""
    title = f"Recording {number}"
    y = as_numbers(f"{title}: y", run.y, "give a row of samples for each step")
    if y.ndim != 2 or y.shape[1] != model.sensors or not len(y):
        raise ModelError(f"{title} has y of shape {y.shape}; give steps x {model.sensors} sensors.")
    shape = (len(y), model.controls)
    u = np.zeros(shape) if run.u is None else as_numbers(f"{title}: u", run.u, "give a row of inputs for each step")
    if u.ndim == 1 and model.controls == 1:
        u = u[:, np.newaxis]
    if u.shape != shape:
        raise ModelError(f"{title} has u of shape {u.shape}; give {shape[0]} steps x {shape[1]} controls.")
    return run._replace(y=y, u=u)


def _resolved(mode: FaultMode, runs: Sequence[RecordedRun]) -> FaultMode:
    """Return a mode, with the sensors' resolution if it needs one and has none."""
    if not isinstance(mode, Frozen) or np.any(mode.resolution):
        return mode
    y = np.vstack([np.asarray(run.y) for run in runs])  # the few changes between runs have no effect
    return replace(mode, resolution=tuple(find_resolution(samples) for samples in y.T))


def _expect(
    run: RecordedRun, model: LinearModel, precision: SwitchingPrecision, compiled: bool | None
) -> tuple[float, Floats]:
    """Return the log density of the samples, and a row of expected counts and sizes for each mode."""
    estimator = StateEstimator(model, precision, run.initial_mean, run.initial_covariance)
    y, u = np.asarray(run.y), np.asarray(run.u)
    estimates = estimate(estimator, y, u, ("mode_probability", "innovation", "P", "log_density"), compiled)
    filtered, e = estimates["mode_probability"], estimates["innovation"]
    variance = np.ascontiguousarray(np.diagonal(innovation_covariances(estimator, estimates["P"]), axis1=1, axis2=2))
    units = np.array(precision.offset_units(model))  # a copy: compiled functions accept no read-only arrays
    modes = precision.modes
    smooth, offsets, scatter = _passes(not is_short(len(y), precision) if compiled is None else compiled)
    begun, lasts = np.empty((2, *y.shape, len(modes)))
    counts, sizes = np.zeros((kernels.FAULTY + 1, len(modes))), np.zeros((len(modes), 3))
    smooth(filtered, precision.chances(model), begun, lasts, counts)
    for k, mode in enumerate(modes):
        if isinstance(mode, Offset):
            squares = (float(size) * float(size) for size in (mode.jump, mode.slope, mode.walk))
            offsets(begun, lasts, e, variance, units, k, *squares, sizes[k])
        elif isinstance(mode, Noisier):
            gamma = float(mode.shape), float(mode.shape * square(mode.scale)), float(mode.forgetting)
            scatter(begun, lasts, e, variance, k, *gamma, sizes[k])
    occurring = filtered[:, :, 1:].max(axis=(0, 1)) > LEAST  # other modes have no part in this form
    return float(estimates["log_density"].sum()), np.where(
        occurring[:, np.newaxis], np.column_stack([counts.T, sizes]), 0.0
    )


@cache
def _passes(compiled: bool) -> tuple[Any, Any, Any]:
    """Return the backward passes through a recording, compiled or not."""
    passes: list[tuple[Any, str]] = [
        (kernels.smooth, kernels.SMOOTH),
        (kernels.measure_offsets, kernels.OFFSETS),
        (kernels.measure_scatter, kernels.SCATTER),
    ]
    if not compiled:
        return tuple(function for function, _ in passes)  # type: ignore[return-value]
    from bayesftc.cosim.stepping.compiler import compile_function

    return tuple(compile_function(function, signature) for function, signature in passes)  # type: ignore[return-value]


def _maximised(start: FaultMode, now: FaultMode, expected: Floats, step: float) -> FaultMode:
    """Return a mode with the most probable settings, given the expected counts and the initial settings."""
    onsets, recoveries, healthy, faulty, times, first, second = expected
    if not healthy:
        return now
    c = PRIOR_FAULTS
    learned = {
        "time_to_fault": (step * healthy + c * start.time_to_fault) / (onsets + c),
        "time_to_recovery": (step * faulty + c * start.time_to_recovery) / (recoveries + c),
    }
    if isinstance(start, Offset):
        learned["jump"] = sqrt((first + c * square(start.jump)) / (times + c))
        learned["slope"] = sqrt((second + c * square(start.slope)) / (times + c))
    elif isinstance(start, Noisier):
        learned["scale"] = sqrt((times + c) / (first + c / square(start.scale)))
    return replace(now, **{name: float(value) for name, value in learned.items()})


def _change(before: FaultMode, after: FaultMode) -> float:
    """Return the largest relative change of a setting."""
    pairs = [(getattr(before, name), getattr(after, name)) for name in SETTINGS if hasattr(before, name)]
    return float(max(abs(new - old) / old for old, new in pairs if old))
