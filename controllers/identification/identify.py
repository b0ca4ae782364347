"""Identification of a linear model with noise from a recording, and its test on the held-out part."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.identification.excitation import moved_by_outputs, nearly_sines, order_of_excitation
from bayesftc.controllers.identification.gaps import identify_with_gaps
from bayesftc.controllers.identification.independent_noise import independent_noise
from bayesftc.controllers.identification.same_quantity import quantities_of, similar
from bayesftc.controllers.identification.subspace import PASTS, identify_innovations, samples_needed
from bayesftc.controllers.models.checks import as_number
from bayesftc.controllers.models.delays import whole_delays
from bayesftc.controllers.models.linear import LinearModel, SignalNames
from bayesftc.controllers.models.pulse_responses import PoorFitWarning
from bayesftc.cosim.base.html import Lines, Printed
from bayesftc.cosim.base.recordings.rows import rows_at_steps
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.run.tables import named_columns, read_table
from bayesftc.cosim.statistics._whiteness import FEW, LAGS, whiteness
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORSE = 1.2
"""Ratio of errors on held-out data to those of a long autoregression from which on there is a warning."""

GAPS = 0.5
"""If less than this share of the stretches for a prediction is complete, gaps are bridged and not left out."""

CORRELATED = 0.2
"""Autocorrelation of the residuals from which on there is a warning, unless within four standard deviations of white noise."""


@dataclass(frozen=True, eq=False)
class Identification(Printed):
    """A model identified from a recording, and its quality on the held-out part.

    `LinearModel.identify` makes it; `design` accepts it as a plant.

    Attributes
    ----------
    model : LinearModel
        The model, in the recording's values.
    inputs, outputs : tuple of str
        Names of the columns.
    fit : ndarray
        Share of each output's standard deviation that the prediction one sample ahead explains, in percent
        (``100 (1 - rms error / std)``), on held-out data.
    simulated_fit : ndarray
        The same for a simulation from the inputs alone; it has little meaning for noisy or integrating plants. NaN if unstable.
    whiteness : ndarray
        p-value, for each output, of the test for white residuals: the probability that white residuals are at least as correlated
        in time as these (Ljung and Box, 20 lags). A small one says that the residuals are not white.
    correlations : ndarray
        Canonical correlations between past and future: those of the states, and the remaining ones. With bridged gaps they are
        those of the recording with straight lines in the gaps, and the order is that of the best information criterion.
    poor : tuple of str
        Deficiencies of the model, as sentences; empty if there are none.
    time, measured, predicted, simulated, residuals : ndarray
        Held-out data in seconds and in the outputs' units.
    quantities : mapping of str to tuple of str
        The columns of each quantity with a name of its own, as given to `identify`.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from bayesftc import controllers
    >>> rng = np.random.default_rng(0)
    >>> u, y = rng.choice([-1.0, 1.0], 600), np.zeros(600)
    >>> for k in range(599):
    ...     y[k + 1] = 0.9 * y[k] + 0.5 * u[k] + 0.02 * rng.standard_normal()
    >>> table = pd.DataFrame({"u": u, "y": y + 0.01 * rng.standard_normal(600)})
    >>> found = controllers.LinearModel.identify(table, inputs="u", outputs="y", order=1, dt=0.1)
    >>> round(float(found.model.A[0, 0]), 2), found.simulated_fit.round().tolist(), found.poor
    (0.9, [95.0], ())
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
    quantities: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __str__(self) -> str:
        return str(self.describe())

    def describe(self) -> str:
        """Return a description of the model and its quality as text; ``print`` shows it, too."""
        order = self.model.plant_states
        poles = np.linalg.eigvals(self.model.matrix("A")[:order, :order])
        lines = [f"Order {order}, poles {', '.join(f'{p:.4g}' for p in poles)}."]
        shared = ((name, columns) for name, columns in self.quantities.items() if len(columns) > 1)
        lines += [f"Sensors of {name}: {', '.join(columns)}." for name, columns in shared]
        for i, name in enumerate(self.outputs):
            simulated = "no simulation, because the model is unstable"
            if np.isfinite(self.simulated_fit[i]):
                simulated = f"{self.simulated_fit[i]:.1f} % by simulation"
            lines.append(
                f"{name}: {self.fit[i]:.1f} % explained one sample ahead, {simulated}; test for white residuals: "
                f"p-value {self.whiteness[i]:.2g}."
            )
        alike = similar(self.model, self.outputs)
        return Lines("\n".join([*lines, *self.poor, *[alike] * bool(alike)]))

    def plot(self) -> Figure:
        """Return a figure: held-out data, predictions and residuals of each output, and the choice of the order."""
        from bayesftc.controllers.identification.figure import draw
        from bayesftc.cosim.judging.figures.panels import shown_figure

        return draw(self, shown_figure())


def identify(
    data: Any,
    *,
    inputs: str | Sequence[str],
    outputs: str | Sequence[str] | Mapping[str, str | Sequence[str]],
    order: int | None,
    dt: float | str | Fraction | None,
    time: str | None,
    held_out: float,
    past: int | None,
    input_delays: int | Sequence[int] = 0,
    sensor_delays: int | Sequence[int] = 0,
) -> Identification:
    """Identify the model of a recording; see `LinearModel.identify`."""
    table = read_table(data, "identify()")
    names_in, quantities = named_columns(table, inputs, "input"), quantities_of(table, outputs)
    names_out = quantities.columns
    at_steps = rows_at_steps(table, time, dt, {*names_in, *names_out})
    step, u = at_steps.step, at_steps.held(table[names_in].to_numpy(dtype=np.float64))
    y = at_steps.placed(table[names_out].to_numpy(dtype=np.float64))
    late = whole_delays("identify() has input_delays", input_delays, len(names_in), "input", step)
    old = whole_delays("identify() has sensor_delays", sensor_delays, len(names_out), "output", step)
    u, y = _undelayed(u, y, late, old)
    share = as_number("identify() has held_out", held_out, above=0, below=1)
    for name, value in (("order", order), ("past", past)):
        if value is not None:
            as_number(f"identify() has {name}", value, least=1, whole=True)
    split = round(len(y) * (1 - share))
    centre = [_centre(rows[:split], names) for rows, names in ((u, names_in), (y, names_out))]
    (u_mean, u_size), (y_mean, y_size) = centre
    if quantities.shared:
        _refuse_alike((y[:split] - y_mean) / y_size, names_out)
    noise = quantities.noise(y[:split])
    weights, of = quantities.weights(noise), quantities.of
    read, fused = quantities.fused(y, weights), quantities.fused_noise(y[:split], noise)
    longest = _enough(read, len(names_in), split, share, order, past, quantities.names)
    _refuse_few(y, split, names_out)
    v = (u[:split] - u_mean) / u_size
    _refuse_alike(v, names_in)
    y_mean, y_size = _centre(read[:split], quantities.names)
    z = (read[:split] - y_mean) / y_size
    _refuse_alike(z, quantities.names)
    if _whole(v, z, past) >= GAPS:
        identified = identify_innovations(v, z, order, past, longest)
        C, K, S = y_size[:, None] * identified.C, identified.K / y_size, identified.S * np.outer(y_size, y_size)
        if quantities.shared:
            K, S = quantities.innovations(K, S, noise, fused)
            C = C[of]
        Q, R = independent_noise(identified.A, C, K, S)
        A, B, drift, offset, past, correlations = (
            identified.A,
            identified.B,
            identified.drift,
            identified.offset,
            identified.past,
            identified.correlations,
        )
        yardstick = np.sqrt(np.diag(identified.yardstick)) * y_size
        if quantities.shared:
            yardstick = np.sqrt(np.maximum(yardstick[of] ** 2 + noise - fused[of], 0.0))
    else:
        _refuse_gaps(u[:split], names_in)
        noisy, correlations, past = identify_with_gaps(v, z, order, past, longest)
        A, B, drift, offset, C = noisy.A, noisy.B, noisy.drift, noisy.offset, (y_size[:, None] * noisy.C)[of]
        Q, R = noisy.Q, np.diag(np.where(quantities.alone, (noisy.R * y_size**2)[of], noise))
        yardstick = np.full(len(names_out), np.inf)
    names = SignalNames(tuple(names_in), tuple(names_out), tuple(f"x[{i}]" for i in range(len(A))))
    moving = LinearModel(A, B / u_size, C, (Q + Q.T) / 2, R, step, names=names)
    model = moving.about(np.zeros(moving.states), u_mean, (y_mean + y_size * offset)[of], following=drift)
    doubts = _doubts(v, z, (u[split:] - u_mean) / u_size, len(A), past, names_in)
    apart = quantities.deviations(y, split, weights, noise)
    doubts += [sentence for sentences in apart.values() for sentence in sentences]
    identification = _validated(
        model,
        u[split:],
        y[split:],
        split,
        2 * past,
        yardstick,
        inputs=tuple(names_in),
        outputs=tuple(names_out),
        correlations=correlations,
        doubts=doubts,
        apart={column: name for name in apart for column in quantities.shared[name]},
    )
    model = model.with_delays(input_delays, sensor_delays)
    return replace(identification, model=model, quantities=quantities.named)


def _undelayed(u: Floats, y: Floats, late: Sequence[int], old: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the inputs as they act, and the outputs as they are, without the rows for which one of them is unknown."""
    first, last = max(late), len(y) - max(old)
    if first >= last:
        raise ModelError(
            f"identify() has delays up to {first + max(old)}, but the recording has only {len(y)} samples; record more."
        )
    acting = [u[first - steps : last - steps, j] for j, steps in enumerate(late)]
    return np.column_stack(acting), np.column_stack([y[first + steps : last + steps, i] for i, steps in enumerate(old)])


def _enough(
    y: Floats, inputs: int, split: int, share: float, order: int | None, past: int | None, names: Sequence[str]
) -> int:
    """Return the longest autoregression that the recording's length allows; refuse too short a recording.

    Raises
    ------
    ModelError
        With the required length.
    """
    learn, least = samples_needed(inputs, len(names), order, past)
    held = 2 * least + 5 * LAGS
    request = f"{len(names)} output{'s' * (len(names) > 1)} and {inputs} input{'s' * (inputs > 1)}"
    request += "" if order is None else f", with order={order}"
    request += "" if past is None else f", with past={past}"
    if split < learn or len(y) - split < held:
        needed = max(int((learn - 1) / (1 - share)), int((held - 1) / share))
        while round(needed * (1 - share)) < learn or needed - round(needed * (1 - share)) < held:
            needed += 1
        other = "" if order is None and past is None else " , or give a smaller order or past"
        raise ModelError(
            f"The recording has {len(y)} samples. {request} need at least {needed}: {learn} for learning, and {held} for tests "
            f"in the last {100 * share:.3g} % of them. Record more{other}."
        )
    return (len(y) - split - 5 * LAGS) // 2


def _refuse_few(y: Floats, split: int, names: Sequence[str]) -> None:
    for name, first, last in zip(
        names, np.isfinite(y[:split]).sum(axis=0), np.isfinite(y[split:]).sum(axis=0), strict=True
    ):
        if first < FEW or last < FEW:
            raise ModelError(
                f"The column {name!r} has {first} samples in the part of the recording for learning and {last} samples in the "
                f"held-out part. Both need {FEW}; record more, or leave the column out."
            )


def _whole(u: Floats, y: Floats, past: int | None) -> float:
    """Return the share of the stretches of the shortest autoregression that have no gap."""
    whole = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    length = 1 + (past or PASTS[0])
    return float(np.mean(np.convolve(whole, np.ones(length), "valid") > length - 0.5))


def _refuse_gaps(u: Floats, names: Sequence[str]) -> None:
    for name, column in zip(names, u.T, strict=True):
        if not np.isfinite(column).all():
            raise ModelError(
                f"The outputs have gaps nearly everywhere, which can be bridged, but the input {name!r} has gaps as well, which "
                "cannot. Fill an input that is held until the next sample with its last value (ffill() of pandas)."
            )


def _doubts(u: Floats, y: Floats, held: Floats, order: int, past: int, names: Sequence[str]) -> list[str]:
    """Return deficiencies of the inputs' motion, as sentences."""
    message = []
    needed = 2 * order
    order_found, weak = order_of_excitation(u, needed)
    how = "Move the inputs at random all the time, by a random binary signal or noise."
    if weak:
        message.append(
            f"{_listed(names, weak)}: the order of excitation is {order_found}, but a model of order {order} needs "
            f"{needed} (a step has the order 1, each sine 2), so that other models explain the recording as well. {how}"
        )
    if sines := [i for i in nearly_sines(u) if i not in weak]:
        message.append(
            f"{_listed(names, sines)}: moves nearly as a single sine, which does not show how the plant answers other motion. "
            f"{how}"
        )
    still = [i for i in range(len(names)) if np.nanstd(held[:, i]) < 1e-2]
    if still:
        text = (
            f"{_listed(names, still)}: nearly constant in the held-out part, which therefore hardly tests its effect."
        )
        message.append(text if message else f"{text} {how}")
    led = moved_by_outputs(u, y, past)
    if led:
        message.append(
            f"{_listed(names, led)}: follows from the outputs, so that its effect cannot be separated from the controller's. "
            "During the recording move it by something else too: a changing goal, or a small random signal added to it."
        )
    return message


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
    apart: Mapping[str, str],
) -> Identification:
    """Test the model on held-out samples; warn about deficiencies.

    `apart` has the columns of quantities whose sensors differ, each with its quantity. No order explains such a difference.
    """
    predicted, simulated = _run(model, u, y, begin)
    measured, residuals = y[begin:], (y - predicted)[begin:]
    spread = np.nanstd(measured, axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    errors = np.sqrt(np.nanmean(residuals**2, axis=0))
    if np.abs(np.linalg.eigvals(model.moving.matrix("A"))).max() > 1 + 1e-3:
        simulated[:] = np.nan
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # about means without numbers
        simulated_fit = 100 * (1 - np.sqrt(np.nanmean((measured - simulated[begin:]) ** 2, axis=0)) / spread)
    tests = [whiteness(residuals[:, i]) for i in range(len(outputs))]
    poor = list(doubts)
    for i, name in enumerate(outputs):
        floor = 1e-9 * spread[i]
        higher, other = "Try a higher order.", "Try a higher order; else the plant is not linear, or has changed."
        moved = "Check whether the inputs move it."
        if name in apart:
            higher = other = moved = f"The difference between the sensors of {apart[name]} may be the cause."
        if errors[i] > WORSE * yardstick[i] + floor:
            poor.append(
                f"{name}: on held-out data the errors are {errors[i] / max(yardstick[i], floor):.2g} times those of a long "
                f"autoregression. {other}"
            )
        limit = max(CORRELATED, 4 / np.sqrt(np.isfinite(residuals[:, i]).sum()))
        if errors[i] > floor and tests[i][1] > limit:
            poor.append(f"{name}: residuals have an autocorrelation of {tests[i][1]:.2g}. {higher}")
        if errors[i] > 0.9 * spread[i]:
            poor.append(f"{name}: the model explains {100 * (1 - errors[i] / spread[i]):.0f} % of it. {moved}")
    if poor:
        warnings.warn("The identified model may be poor. " + " ".join(poor), PoorFitWarning, stacklevel=4)
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
    """Return predictions one sample ahead by the steady Kalman filter, and a simulation from its state after `begin` samples.

    Raises
    ------
    ModelError
        If no steady filter exists in double precision.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    moving = model.moving
    A, B, C = (model.matrix(name) for name in "ABC")
    n = moving.states
    Q, R = moving.matrix("process_covariance"), moving.matrix("sensor_covariance")
    try:
        P = solve_discrete_are(A[:n, :n].T, C[:, :n].T, Q + 1e-12 * (np.trace(Q) + 1e-12) * np.eye(n), R)
        steady = _gain(C[:, :n], P, R)
    except (LinAlgError, ValueError):
        raise ModelError(
            "The identified model has no steady Kalman filter in double precision: its signals differ too much in size, or a "
            "few samples are far beyond all others. Choose units in which the signals have similar sizes, take such samples out "
            "of the recording, or give a lower order=."
        ) from None
    present = np.isfinite(y)
    # The first state is the one that explains the first samples best, given the inputs.
    x = _first_state(A, B, C, u[:begin], y[:begin])
    free = x
    predicted, simulated = np.empty_like(y), np.empty_like(y)
    with np.errstate(all="ignore"):
        for k in range(len(y)):
            if k == begin:
                free = x
            predicted[k], simulated[k] = C @ x, C @ free
            if present.all():
                gain = steady
            else:
                rows = present[k]
                gain = np.zeros((n, len(R)))
                gain[:, rows] = _gain(C[rows, :n], P, R[np.ix_(rows, rows)])
                P = A[:n, :n] @ (P - gain @ C[:, :n] @ P) @ A[:n, :n].T + Q
                P = (P + P.T) / 2
            x = x.copy()
            x[:n] += gain @ np.where(present[k], y[k] - predicted[k], 0.0)
            push = B @ np.where(np.isfinite(u[k]), u[k], 0.0)
            x, free = A @ x + push, A @ free + push
    return predicted, simulated


def _gain(C: Floats, P: Floats, R: Floats) -> Floats:
    """Return the gain of a Kalman filter."""
    return np.asarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T)


def _first_state(A: Floats, B: Floats, C: Floats, u: Floats, y: Floats) -> Floats:
    rows, free_response, power = [], [], np.eye(len(A))
    forced = np.eye(len(A))[-1]  # the response to the constant and the inputs alone
    for k in range(len(y)):
        rows.append((C @ power)[:, :-1])
        free_response.append(y[k] - C @ forced)
        power, forced = A @ power, A @ forced + B @ np.where(np.isfinite(u[k]), u[k], 0.0)
    order_found = np.isfinite(np.concatenate(free_response))
    state = np.linalg.lstsq(np.vstack(rows)[order_found], np.concatenate(free_response)[order_found], rcond=None)[0]
    return np.append(state, 1.0)


# --- the recording ---------------------------------------------------------------------------------------------------


def _centre(rows: Floats, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of each column."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mean, size = np.nanmean(rows, axis=0), np.nanstd(rows, axis=0)
    for name, value, spread in zip(names, mean, size, strict=True):
        if not np.isfinite(value):
            raise ModelError(
                f"The column {name!r} has no numbers in the part of the recording for learning; leave it out."
            )
        if spread <= 1e-12 * max(abs(value), 1e-300):
            raise ModelError(
                f"The column {name!r} is constant in the part of the recording for learning; leave it out."
            )
    return mean, size


def _refuse_alike(rows: Floats, names: Sequence[str]) -> None:
    """Refuse columns of which one follows from the others, because their effects cannot be separated."""
    _, sizes, directions = np.linalg.svd(rows[np.isfinite(rows).all(axis=1)], full_matrices=False)
    if len(sizes) == len(names) and sizes[-1] <= 1e-9 * sizes[0]:
        alike = [name for name, weight in zip(names, directions[-1], strict=True) if abs(weight) > 1e-3]
        raise ModelError(
            f"The columns {', '.join(map(repr, alike[:-1]))} and {alike[-1]!r} follow from each other in the part of the "
            "recording for learning, so that their effects cannot be separated; leave one of them out."
        )
