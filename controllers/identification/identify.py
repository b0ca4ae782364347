"""The linear model, noise included, of a plant known by a recording alone, and how well it explains what it has not seen."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.identification.excitation import moved_by_outputs, order_of_excitation
from bayesftc.controllers.identification.gaps import identify_with_gaps
from bayesftc.controllers.identification.independent_noise import independent_noise
from bayesftc.controllers.identification.subspace import PASTS, identify_innovations, samples_needed
from bayesftc.controllers.models.checks import as_number
from bayesftc.controllers.models.linear import LinearModel, SignalNames
from bayesftc.controllers.models.pulse_responses import PoorFitWarning
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, did_you_mean
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

LAGS = 20
"""Lags up to which residuals are looked through for what they still know of each other."""

WORSE = 1.2
"""Errors on held-out data that are larger than those of a long autoregression by this are said."""

FEW = 2 * LAGS
"""Samples of each output that are needed at least to judge the model by."""

GAPS = 0.5
"""Where less than this share of the stretches that tell of a prediction are whole, gaps are bridged and not left out."""

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
        Canonical correlations between past and future: those of the states, and what is left. Where gaps were bridged: of the
        recording with straight lines in them, and the order is that of the best information criterion.
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
        from bayesftc.controllers.identification.figure import draw
        from bayesftc.cosim.judging.panels import shown_figure

        return draw(self, shown_figure())


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
    longest = _enough(y, len(names_in), split, share, order, past, names_out)
    v, z = (u[:split] - u_mean) / u_size, (y[:split] - y_mean) / y_size
    _refuse_alike(v, names_in)
    _refuse_alike(z, names_out)
    if _whole(v, z, past) >= GAPS:
        found = identify_innovations(v, z, order, past, longest)
        C, K, S = y_size[:, None] * found.C, found.K / y_size, found.S * np.outer(y_size, y_size)
        Q, R = independent_noise(found.A, C, K, S)
        A, B, drift, offset, past, correlations = (
            found.A,
            found.B,
            found.drift,
            found.offset,
            found.past,
            found.correlations,
        )
        yardstick = np.sqrt(np.diag(found.yardstick)) * y_size
    else:
        _refuse_gaps(u[:split], names_in)
        noisy, correlations, past = identify_with_gaps(v, z, order, past, longest)
        A, B, drift, offset, C = noisy.A, noisy.B, noisy.drift, noisy.offset, y_size[:, None] * noisy.C
        Q, R = noisy.Q, np.diag(noisy.R * y_size**2)
        yardstick = np.full(len(names_out), np.inf)
    names = SignalNames(tuple(names_in), tuple(names_out), tuple(f"x[{i}]" for i in range(len(A))))
    moving = LinearModel(A, B / u_size, C, (Q + Q.T) / 2, R, step, names=names)
    model = moving.about(np.zeros(moving.states), u_mean, y_mean + y_size * offset, following=drift)
    doubts = _doubts(v, z, (u[split:] - u_mean) / u_size, len(A), past, names_in)
    return _validated(
        model, u[split:], y[split:], split, 2 * past, yardstick,
        inputs=tuple(names_in), outputs=tuple(names_out), correlations=correlations, doubts=doubts,
    )  # fmt: skip


def _enough(
    y: Floats, inputs: int, split: int, share: float, order: int | None, past: int | None, names: Sequence[str]
) -> int:
    """Return the longest autoregression that the recording's length admits; refuse one that is too short.

    Raises
    ------
    ModelError
        That tells the length which is needed, and for what.
    """
    learn, least = samples_needed(inputs, len(names), order, past)
    held = 2 * least + 5 * LAGS
    asked = f"{len(names)} output{'s' * (len(names) > 1)} and {inputs} input{'s' * (inputs > 1)}"
    asked += "" if order is None else f", with order={order}"
    asked += "" if past is None else f", with past={past}"
    if split < learn or len(y) - split < held:
        needed = max(int((learn - 1) / (1 - share)), int((held - 1) / share))
        while round(needed * (1 - share)) < learn or needed - round(needed * (1 - share)) < held:
            needed += 1
        other = "" if order is None and past is None else ", or ask for less"
        raise ModelError(
            f"The recording has {len(y)} samples; of {asked}, at least {needed} are needed: {learn} to learn from, and in the "
            f"last {100 * share:.3g} % of them {held} to judge the model by. Record more{other}."
        )
    for name, first, last in zip(
        names, np.isfinite(y[:split]).sum(axis=0), np.isfinite(y[split:]).sum(axis=0), strict=True
    ):
        if first < FEW or last < FEW:
            raise ModelError(
                f"The column {name!r} has {first} samples in the part of the recording that is learned from and {last} samples "
                f"in what is held out to judge the model by; of each {FEW} are needed: record more, or leave it out."
            )
    return (len(y) - split - 5 * LAGS) // 2


def _whole(u: Floats, y: Floats, past: int | None) -> float:
    """Return which share of the stretches of the shortest autoregression has no gap."""
    whole = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    length = 1 + (past or PASTS[0])
    return float(np.mean(np.convolve(whole, np.ones(length), "valid") > length - 0.5))


def _refuse_gaps(u: Floats, names: Sequence[str]) -> None:
    for name, column in zip(names, u.T, strict=True):
        if not np.isfinite(column).all():
            raise ModelError(
                f"The outputs have gaps nearly everywhere, which can be bridged; the input {name!r} has gaps as well, which "
                "cannot. An input that stays what it is until the next sample is filled with its last value (ffill() of pandas)."
            )


def _doubts(u: Floats, y: Floats, held: Floats, order: int, past: int, names: Sequence[str]) -> list[str]:
    """Return in sentences why the inputs may not have moved as they should."""
    said = []
    needed = 2 * order
    known, weak = order_of_excitation(u, needed)
    how = "Move the inputs all the time, at random: by a random binary signal, or a noise."
    if weak:
        said.append(
            f"{_listed(names, weak)}: exciting of order {known}, where {needed} is wanted for a model of {order} "
            f"state{'s' * (order > 1)} (a step has the order 1, each sine 2), so that others explain the recording as well. {how}"
        )
    still = [i for i in range(len(names)) if np.nanstd(held[:, i]) < 1e-2]
    if still:
        text = f"{_listed(names, still)}: nearly still in the held-out data, which so say little of what it does."
        said.append(text if weak else f"{text} {how}")
    led = moved_by_outputs(u, y, past)
    if led:
        said.append(
            f"{_listed(names, led)}: follows from the outputs, so that nothing tells what it does from what the controller does; "
            "while recording let something else move it too: a changing goal, or a small random signal added to it."
        )
    return said


def _listed(names: Sequence[str], places: Sequence[int]) -> str:
    return ", ".join(names[i] for i in places)


def _validated(
    model: LinearModel,
    u: Floats,
    y: Floats,
    split: int,
    begin: int,
    yardstick: Floats,
    *,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    correlations: Floats,
    doubts: list[str],
) -> Identification:
    """Return the model with what held-out samples say of it; warn where that is not good."""
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
    poor = list(doubts)
    for i, name in enumerate(outputs):
        floor = 1e-9 * spread[i]
        if errors[i] > WORSE * yardstick[i] + floor:
            poor.append(
                f"{name}: on held-out data the errors are {errors[i] / max(yardstick[i], floor):.2g} times those of a long "
                "autoregression; a higher order may do, or the plant is not linear, or has changed."
            )
        limit = max(CORRELATED, 4 / np.sqrt(np.isfinite(residuals[:, i]).sum()))
        if errors[i] > floor and tests[i][1] > limit:
            poor.append(f"{name}: residuals have an autocorrelation of {tests[i][1]:.2g}; a higher order may do.")
        if errors[i] > 0.9 * spread[i]:
            poor.append(
                f"{name}: the model explains {100 * (1 - errors[i] / spread[i]):.0f} % of it; do the inputs move it at all?"
            )
    if poor:
        warnings.warn("The identified model is in doubt. " + " ".join(poor), PoorFitWarning, stacklevel=4)
    return Identification(
        model=model,
        inputs=inputs,
        outputs=outputs,
        fit=100 * (1 - errors / spread),
        simulated_fit=simulated_fit,
        whiteness=np.array([p for p, _ in tests]),
        correlations=correlations,
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
    steady = _gain(C[:, :n], P, R)
    seen = np.isfinite(y)
    # The first state: what explains the first samples best, the inputs being what they were.
    x = _first_state(A, B, C, u[:begin], y[:begin])
    free = x
    predicted, simulated = np.empty_like(y), np.empty_like(y)
    with np.errstate(all="ignore"):
        for k in range(len(y)):
            if k == begin:
                free = x
            predicted[k], simulated[k] = C @ x, C @ free
            if seen.all():
                gain = steady
            else:
                rows = seen[k]
                gain = np.zeros((n, len(R)))
                gain[:, rows] = _gain(C[rows, :n], P, R[np.ix_(rows, rows)])
                P = A[:n, :n] @ (P - gain @ C[:, :n] @ P) @ A[:n, :n].T + Q
                P = (P + P.T) / 2
            x = x.copy()
            x[:n] += gain @ np.where(seen[k], y[k] - predicted[k], 0.0)
            push = B @ np.where(np.isfinite(u[k]), u[k], 0.0)
            x, free = A @ x + push, A @ free + push
    return predicted, simulated


def _gain(C: Floats, P: Floats, R: Floats) -> Floats:
    """Return what a Kalman filter makes of a reading."""
    return np.asarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T)


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

    correlations, pairs = autocorrelation(residual)
    n, there = int(np.isfinite(residual).sum()), pairs > 0
    statistic = (n + 2) / n * float(np.sum(pairs[there] * correlations[there] ** 2))
    return float(chi2.sf(statistic, there.sum())), float(np.abs(correlations[pairs >= FEW]).max(initial=0.0))


def autocorrelation(residual: Floats) -> tuple[Floats, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return the autocorrelations at the lags 1 to `LAGS`, and from how many pairs of samples each is; 0 where there are none."""
    there = np.isfinite(residual)
    e = np.where(there, residual - np.nanmean(residual), 0.0)
    power = float(e @ e) / max(there.sum(), 1)
    products = np.array([float(e[lag:] @ e[:-lag]) for lag in range(1, LAGS + 1)])
    pairs = np.array([int((there[lag:] & there[:-lag]).sum()) for lag in range(1, LAGS + 1)])
    return products / np.maximum(pairs, 1) / (power if power > 0 else 1.0), pairs


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
        said = getattr(error, "strerror", None) or str(error).strip().rstrip(".")
        raise ModelError(f"The recording {data} cannot be read: {said}; give a CSV file with a header.") from None


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
