"""The linear model, noise included, of a plant known by a recording alone, and how well it explains what it has not seen."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers._checks import as_number
from bayesftc.controllers._independent_noise import independent_noise
from bayesftc.controllers._pulse_responses import PoorFitWarning
from bayesftc.controllers._subspace import Innovations, identify_innovations
from bayesftc.controllers.model import LinearModel
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, did_you_mean
from bayesftc.cosim.result import Result
from bayesftc.cosim.timebase import rational_step

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

LAGS = 20
"""Lags up to which residuals are looked through for what they still know of each other."""

WORSE = 1.2
"""Errors on held-out data that are larger than those of a long autoregression by this are said."""

CORRELATED = 0.2
"""So are autocorrelations of the residuals beyond this (or beyond four standard deviations of white ones')."""


@dataclass(frozen=True, eq=False)
class Identification:
    """A model that was identified from a recording, and how it does on the part of it that was held out.

    `LinearModel.identify` makes it; `design` takes it as a plant.

    Attributes
    ----------
    model : LinearModel
        The model, in the recording's own values.
    inputs, outputs : tuple of str
        The columns of which it is.
    fit : ndarray
        Of each output: share of its standard deviation that the prediction one sample ahead explains, in percent
        (``100 (1 - rms error / std)``), on held-out data.
    simulated_fit : ndarray
        The same of a simulation from the inputs alone; of a noisy or integrating plant it says little. NaN of an unstable one.
    whiteness : ndarray
        Of each output: probability that white residuals would be as correlated in time as these (Ljung and Box, 20 lags).
    correlations : ndarray
        Canonical correlations between past and future: those of the states, and what is left.
    poor : tuple of str
        What is not as it should be, in sentences; empty where nothing is.
    time, measured, predicted, simulated, residuals : ndarray
        Held-out data in seconds and in the outputs' units.
    """

    model: LinearModel
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    fit: Floats
    simulated_fit: Floats
    whiteness: Floats
    correlations: Floats
    poor: tuple[str, ...]
    time: Floats = field(repr=False)
    measured: Floats = field(repr=False)
    predicted: Floats = field(repr=False)
    simulated: Floats = field(repr=False)
    residuals: Floats = field(repr=False)

    def describe(self) -> str:
        """Return what was found, in sentences."""
        order = self.model.moving.states
        poles = np.linalg.eigvals(self.model.moving.matrix("A"))
        lines = [f"Order {order}, poles {', '.join(f'{p:.4g}' for p in poles)}."]
        for i, name in enumerate(self.outputs):
            simulated = "no simulation, for it is unstable"
            if np.isfinite(self.simulated_fit[i]):
                simulated = f"{self.simulated_fit[i]:.1f} % by simulation"
            lines.append(
                f"{name}: {self.fit[i]:.1f} % explained one sample ahead, {simulated}; residuals white with probability "
                f"{self.whiteness[i]:.2g}."
            )
        return "\n".join([*lines, *self.poor])

    def plot(self) -> Figure:
        """Return a figure: held-out data, predictions and residuals of each output, and what told the order."""
        from bayesftc.controllers._identification_figure import draw

        return draw(self)


def identify(
    data: Any,
    *,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str],
    order: int | None,
    dt: float | str | Fraction | None,
    time: str,
    held_out: float,
    past: int | None,
) -> Identification:
    """Return the model of a recording; see `LinearModel.identify`."""
    table = _table(data)
    names_in, names_out = _columns(table, inputs, "input"), _columns(table, outputs, "output")
    step = _step(table, time, dt)
    u, y = (table[names].to_numpy(dtype=np.float64) for names in (names_in, names_out))
    share = as_number("identify() has held_out", held_out, above=0, below=1)
    for name, value in (("order", order), ("past", past)):
        if value is not None:
            as_number(f"identify() has {name}", value, least=1, whole=True)
    split = round(len(y) * (1 - share))
    centre = [_centre(rows[:split], names) for rows, names in ((u, names_in), (y, names_out))]
    (u_mean, u_size), (y_mean, y_size) = centre
    _refuse_alike((u[:split] - u_mean) / u_size, names_in)
    _refuse_alike((y[:split] - y_mean) / y_size, names_out)
    found = identify_innovations((u[:split] - u_mean) / u_size, (y[:split] - y_mean) / y_size, order, past)
    C, K = y_size[:, None] * found.C, found.K / y_size
    S = found.S * np.outer(y_size, y_size)
    Q, R = independent_noise(found.A, C, K, S)
    moving = LinearModel(found.A, found.B / u_size, C, (Q + Q.T) / 2, R, step)
    offset = y_mean + y_size * found.offset
    model = moving.about(np.zeros(moving.states), u_mean, offset, following=found.drift)
    return _validated(model, found, tuple(names_in), tuple(names_out), u[split:], y[split:], split, y_size)


def _validated(
    model: LinearModel,
    found: Innovations,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    u: Floats,
    y: Floats,
    split: int,
    size: Floats,
) -> Identification:
    """Return the model with what held-out samples say of it; warn where that is not good."""
    begin = 2 * found.past
    if len(y) < begin + 5 * LAGS:
        raise ModelError(
            f"{len(y)} samples are held out, of which the first {begin} tell where the plant is; {begin + 5 * LAGS} are needed: "
            "record more, or hold out a larger share."
        )
    for name, seen in zip(outputs, np.isfinite(y[begin:]).sum(axis=0), strict=True):
        if seen < 5 * LAGS:
            raise ModelError(
                f"The column {name!r} has {seen} samples in what is held out to judge the model by; {5 * LAGS} are needed: hold "
                "out a larger share, or record more."
            )
    predicted, simulated = _run(model, u, y, begin)
    measured, residuals = y[begin:], (y - predicted)[begin:]
    spread = np.nanstd(measured, axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    errors = np.sqrt(np.nanmean(residuals**2, axis=0))
    if np.abs(np.linalg.eigvals(model.moving.matrix("A"))).max() > 1 + 1e-3:
        simulated[:] = np.nan
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of means of nothing
        simulated_fit = 100 * (1 - np.sqrt(np.nanmean((measured - simulated[begin:]) ** 2, axis=0)) / spread)
    tests = [_whiteness(residuals[:, i]) for i in range(len(outputs))]
    yardstick = np.sqrt(np.diag(found.yardstick)) * size
    poor = []
    for i, name in enumerate(outputs):
        floor = 1e-9 * spread[i]
        if errors[i] > WORSE * yardstick[i] + floor:
            poor.append(
                f"{name}: on held-out data the errors are {errors[i] / max(yardstick[i], floor):.2g} times those of a long "
                "autoregression; a higher order may do, or the plant is not linear, or has changed."
            )
        limit = max(CORRELATED, 4 / np.sqrt(len(residuals)))
        if errors[i] > floor and tests[i][1] > limit:
            poor.append(f"{name}: residuals have an autocorrelation of {tests[i][1]:.2g}; a higher order may do.")
        if errors[i] > 0.9 * spread[i]:
            poor.append(
                f"{name}: the model explains {100 * (1 - errors[i] / spread[i]):.0f} % of it; do the inputs move it at all?"
            )
    if poor:
        warnings.warn("The identified model fits poorly. " + " ".join(poor), PoorFitWarning, stacklevel=4)
    return Identification(
        model=model,
        inputs=inputs,
        outputs=outputs,
        fit=100 * (1 - errors / spread),
        simulated_fit=simulated_fit,
        whiteness=np.array([p for p, _ in tests]),
        correlations=found.correlations,
        poor=tuple(poor),
        time=np.asarray((split + begin + np.arange(len(measured))) * float(model.step), dtype=np.float64),
        measured=measured,
        predicted=predicted[begin:],
        simulated=simulated[begin:],
        residuals=residuals,
    )


def _run(model: LinearModel, u: Floats, y: Floats, begin: int) -> tuple[Floats, Floats]:
    """Return predictions one sample ahead by the steady Kalman filter, and a simulation that leaves it after `begin` samples."""
    from scipy.linalg import solve_discrete_are

    moving = model.moving
    A, B, C = (model.matrix(name) for name in "ABC")
    n = moving.states
    Q, R = moving.matrix("process_covariance"), moving.matrix("sensor_covariance")
    P = solve_discrete_are(A[:n, :n].T, C[:, :n].T, Q + 1e-12 * (np.trace(Q) + 1e-12) * np.eye(n), R)
    gain = np.vstack(
        [A[:n, :n] @ np.linalg.solve(C[:, :n] @ P @ C[:, :n].T + R, C[:, :n] @ P).T, np.zeros((1, len(R)))]
    )
    # The first state: what explains the first samples best, the inputs being what they were.
    x = _first_state(A, B, C, u[:begin], y[:begin])
    free = x
    predicted, simulated = np.empty_like(y), np.empty_like(y)
    with np.errstate(all="ignore"):
        for k in range(len(y)):
            if k == begin:
                free = x
            predicted[k], simulated[k] = C @ x, C @ free
            e = np.where(np.isfinite(y[k]), y[k] - predicted[k], 0.0)
            push = B @ np.where(np.isfinite(u[k]), u[k], 0.0)
            x, free = A @ x + push + gain @ e, A @ free + push
    return predicted, simulated


def _first_state(A: Floats, B: Floats, C: Floats, u: Floats, y: Floats) -> Floats:
    rows, rest, power = [], [], np.eye(len(A))
    forced = np.eye(len(A))[-1]  # the constant alone, and what the inputs do
    for k in range(len(y)):
        rows.append((C @ power)[:, :-1])
        rest.append(y[k] - C @ forced)
        power, forced = A @ power, A @ forced + B @ np.where(np.isfinite(u[k]), u[k], 0.0)
    known = np.isfinite(np.concatenate(rest))
    state = np.linalg.lstsq(np.vstack(rows)[known], np.concatenate(rest)[known], rcond=None)[0]
    return np.append(state, 1.0)


def _whiteness(residual: Floats) -> tuple[float, float]:
    """Return the probability of a residual that is as correlated in time if it is white, and its largest autocorrelation."""
    from scipy.stats import chi2

    correlations = autocorrelation(residual)
    n = len(residual)
    statistic = n * (n + 2) * float(np.sum(correlations**2 / (n - np.arange(1, LAGS + 1))))
    return float(chi2.sf(statistic, LAGS)), float(np.abs(correlations).max())


def autocorrelation(residual: Floats) -> Floats:
    """Return the autocorrelations at the lags 1 to `LAGS`; missing samples count as zero."""
    e = np.where(np.isfinite(residual), residual - np.nanmean(residual), 0.0)
    power = float(e @ e)
    return np.array([float(e[lag:] @ e[:-lag]) / power if power > 0 else 0.0 for lag in range(1, LAGS + 1)])


# --- the recording ---------------------------------------------------------------------------------------------------


def _table(data: Any) -> pd.DataFrame:
    import pandas as pd

    if isinstance(data, Result):
        return data.to_pandas().reset_index()
    if isinstance(data, pd.DataFrame):
        named = data.index.name is not None and data.index.name not in data.columns
        return data.reset_index() if named else data
    if not isinstance(data, str | PathLike):
        raise ModelError(
            f"identify() takes a Result, a table of pandas or the path of a CSV file, not {type(data).__name__}."
        )
    try:
        return pd.read_csv(data)
    except (OSError, ValueError) as error:
        raise ModelError(
            f"The recording {data} cannot be read: {str(error).strip().rstrip('.')}; give a CSV file with a header."
        ) from None


def _columns(table: pd.DataFrame, given: str | Sequence[str], what: str) -> list[str]:
    names = [given] if isinstance(given, str) else list(given)
    if not names or len(set(names)) < len(names):
        raise ModelError(f"{what}s={given!r}; name at least one column, each once.")
    found = []
    for name in names:
        several = [column for column in map(str, table.columns) if column.startswith(f"{name}[")]
        if name in table.columns:
            found.append(name)
        elif several:  # a signal of several elements
            found += several
        else:
            raise UnknownNameError(
                f"The recording has no {what} {name!r}; {did_you_mean(name, list(map(str, table.columns)))}"
            )
    if not len(table):
        raise ModelError("The recording has no rows.")
    for name in found:
        if list(table.columns).count(name) > 1:
            raise ModelError(f"The recording has several columns {name!r}; give each a name of its own.")
        if table[name].dtype.kind not in "fiub":
            raise ModelError(
                f"The column {name!r} holds text; it must be numbers, with empty cells where a sample is missing."
            )
        if np.isinf(table[name].to_numpy(dtype=np.float64)).any():
            raise ModelError(f"The column {name!r} holds infinite values; leave cells empty where a sample is missing.")
    return found


def _step(table: pd.DataFrame, time: str, dt: float | str | Fraction | None) -> Fraction:
    """Return the sample time: what is given, or what the column of times says."""
    if dt is not None:
        return rational_step(dt)
    if time not in table.columns:
        raise StepSizeError(
            f"The recording has no column {time!r}; name the one with the times (time=...), or give dt= in seconds."
        )
    if list(table.columns).count(time) > 1 or table[time].dtype.kind not in "fiu":
        raise StepSizeError(
            f"The column {time!r} is not one of numbers; it must hold the times in seconds. Convert them, or give dt= in seconds."
        )
    t = table[time].to_numpy(dtype=np.float64)
    steps = np.diff(t)
    if len(steps) == 0 or not np.isfinite(steps).all() or steps.min() <= 0:
        raise StepSizeError(
            f"The times in {time!r} do not rise from row to row; sort the recording, or give dt= in seconds."
        )
    mean = float(t[-1] - t[0]) / len(steps)
    if np.abs(steps - mean).max() > 0.01 * mean:
        raise StepSizeError(
            f"The times in {time!r} are not evenly spaced: steps from {steps.min():g} to {steps.max():g} s; resample the "
            "recording, with empty rows where nothing was recorded."
        )
    return Fraction(f"{mean:.6g}")


def _centre(rows: Floats, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of each column."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mean, size = np.nanmean(rows, axis=0), np.nanstd(rows, axis=0)
    for name, value, spread in zip(names, mean, size, strict=True):
        if not np.isfinite(value):
            raise ModelError(f"The column {name!r} has no numbers in the part of the recording that is learned from.")
        if spread <= 1e-12 * max(abs(value), 1e-300):
            raise ModelError(
                f"The column {name!r} does not move in the part of the recording that is learned from; leave it out."
            )
    return mean, size


def _refuse_alike(rows: Floats, names: Sequence[str]) -> None:
    """Refuse columns of which one follows from the others: nothing tells what each of them does."""
    _, sizes, directions = np.linalg.svd(rows[np.isfinite(rows).all(axis=1)], full_matrices=False)
    if len(sizes) == len(names) and sizes[-1] <= 1e-9 * sizes[0]:
        alike = [name for name, weight in zip(names, directions[-1], strict=True) if abs(weight) > 1e-3]
        raise ModelError(
            f"The columns {', '.join(map(repr, alike[:-1]))} and {alike[-1]!r} follow from each other in the part of the "
            "recording that is learned from, so that nothing tells them apart; leave one of them out."
        )
