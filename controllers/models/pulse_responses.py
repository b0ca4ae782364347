"""A linear model from a plant's inputs and outputs alone: pulse responses and the eigensystem realisation."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from types import TracebackType

import numpy as np

from bayesftc.controllers.models.checks import frozen
from bayesftc.controllers.models.steady_state import NEVER_RESTS
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import External
from bayesftc.cosim.control.differences import BENDS
from bayesftc.cosim.errors import BayesFTCError, ModelError, StepSizeError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.archive import open_archive
from bayesftc.cosim.fmi.running.instance import only_step
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats

SUBSTEPS = "if the FMU integrates in substeps of its own, shorter ones (max_substep of a shipped FMU)"
"""What else to make smaller where the integration of a plant diverges."""

SAMPLES = 100
"""Samples of each response; half of them are rows of the Hankel matrix."""

DECADES = 8
"""Number of pulse sizes: 1, 0.1, 0.01, ... of an input's scale. Those with the best agreement give the derivative."""

GROWTH = 1e3
"""Growth at which a response is cut, because an unstable mode then hides the others."""

STEADY = 1e-7
"""Outputs are steady if they change by less than this, relative to their size, in a response's length."""

WAIT, LONGEST_WAIT, SHRINKS = 200, 2000, 0.8
"""Wait for a steady state, in lengths of a response; the longest one, of a plant that can be saved and restored there; and the
largest change relative to that before as many lengths, of a plant that approaches such a state."""

ENOUGH = 1e-12
"""Relative difference of the responses to two pulse sizes at which the search for a size ends."""

AGREES = 1e-3
"""Relative error of the model's responses above which there is a warning."""


STARTS = "parameters= of the FMU, in a scenario those of [known.plant]"
"""Where the parameters and start values of an FMU are given for which a controller is designed."""

RECORD = (
    "If its outputs are rounded or noisy, identify a model from a recording (LinearModel.identify), with inputs as large "
    "as possible."
)
"""Advice for outputs that are too coarse for pulses."""

WITHOUT_BAND = f"If it has a dead band, design for the plant without it ({STARTS})."
"""Advice for a dead band."""


class PoorFitWarning(UserWarning):
    """A model from samples does not explain them well."""


class Experiments:
    """Repeated experiments with a plant from the same state, which is restored, or reached again by a new instance."""

    def __init__(self, fmu: FMU, step: Fraction, held: Floats, rows: Sequence[int]):
        self._fmu, self.step, self.held, self._rows = fmu, step, held, list(rows)
        self._parts = _parts(fmu, step)
        self._outputs = np.zeros(sum(port.size for port in fmu.outputs or ()))  # type: ignore[union-attr, misc]
        self._waited = 0
        self._plant: External | None = None
        self._saved: object = None

    def __enter__(self) -> Experiments:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs, element by element."""
        return tuple(name for port in self._fmu.inputs or () for name in labels(port.name, port.shape))  # type: ignore[union-attr]

    @property
    def default_step(self) -> Fraction | None:
        """The FMU's own step in seconds, if it names one."""
        own = self._fmu.description.default_experiment.get("stepSize")
        return None if own is None else rational_step(own)

    @property
    def waited(self) -> Fraction:
        """Seconds until the plant was steady."""
        return self.step * self._waited

    def respond(self, pulse: Floats | None = None, samples: int = SAMPLES) -> Floats:
        """Return the outputs at ``samples`` instants with held inputs, plus a `pulse` in the first step."""
        plant = self._begin()
        readings = []
        for k in range(samples):
            inputs = self.held + pulse if k == 0 and pulse is not None else self.held.copy()
            readings.append(self._advance(plant, inputs, self._waited + k))
        return np.array(readings)

    def settle(self) -> tuple[Floats, Floats]:
        """Wait until the outputs are constant; return them, and the first samples of the transient.

        Raises
        ------
        ModelError
            If they never are.
        """
        plant, size, k = self._begin(), 0.0, 0
        changes: list[float] = []
        first = np.empty((0, 0))
        for part in range(LONGEST_WAIT):
            if part >= WAIT and not (plant.can_save and _shrinks(changes)):
                break
            readings = np.empty((SAMPLES, len(self._rows)))
            for i in range(SAMPLES):
                readings[i], k = self._advance(plant, self.held.copy(), k), k + 1
            first = readings if part == 0 else first
            size = max(size, float(np.abs(readings).max()), 1e-6)
            if not np.isfinite(size):
                i = int(np.flatnonzero(~np.isfinite(readings).all(axis=1))[0])
                raise ModelError(
                    f"The plant {self._fmu.default_name!r} has no steady state: with its inputs held at {self.held.tolist()} an "
                    f"output is NaN or infinite at t = {show(self.step * (k - SAMPLES + i))} s. Give other inputs (at=...) or "
                    f"start values ({STARTS})."
                )
            changes.append(float(np.ptp(readings, axis=0).max()))
            if changes[-1] <= STEADY * size:
                self._close()
                self._waited = part * SAMPLES
                return np.array(readings[-1]), first
        longer = (
            " They change less and less, but this FMU cannot save its state (canGetAndSetFMUstate): each experiment would "
            "wait anew. Begin nearer to rest, or export the FMU with that ability."
            if not plant.can_save and _shrinks(changes)
            else ""
        )
        names = [name for port in self._fmu.outputs or () for name in labels(port.name, port.shape)]  # type: ignore[union-attr]
        sizes = np.maximum(np.abs(readings).max(axis=0), 1e-6)
        moving = [names[self._rows[i]] for i in np.flatnonzero(np.ptp(readings, axis=0) > STEADY * sizes)]
        raise ModelError(
            f"The plant {self._fmu.default_name!r} does not come to rest: with its inputs held at {self.held.tolist()}, "
            f"{', '.join(moving)} still change{'s' * (len(moving) == 1)} after {show(self.step * k)} s.{longer} Give start "
            f"values of a steady state ({STARTS}), or other inputs (at=...). {NEVER_RESTS} Or identify a model from a recording "
            "(LinearModel.identify)."
        )

    def _begin(self) -> External:
        if self._plant is not None and self._saved is not None:
            self._plant.restore(self._saved)
            return self._plant
        self._close()
        plant = self._plant = self._fmu.instantiate(self.step / self._parts, self._fmu.default_name)
        for k in range(self._waited):
            self._advance(plant, self.held.copy(), k)
        if plant.can_save:
            self._saved = plant.save()
        return plant

    def _advance(self, plant: External, inputs: Floats, k: int) -> Floats:
        """Make a step, in parts if the plant needs it; return the outputs before it."""
        outputs, seen = self._outputs, []
        for part in range(self._parts):
            t = float(k * self.step + part * self.step / self._parts)
            status = plant.output(inputs, outputs, t) or plant.update(inputs, outputs, t)
            if status:
                reason = plant.explain(status)
                self._close()
                raise ModelError(
                    f"The plant {self._fmu.default_name!r} failed in an experiment at t = {t:g} s: {reason}"
                )
            seen.append(outputs[self._rows])
        return np.array(seen[0])

    def _close(self) -> None:
        plant, self._plant, self._saved = self._plant, None, None
        if plant is not None:
            plant.close()


def _parts(fmu: FMU, step: Fraction) -> int:
    """Return the number of the plant's own steps in a step of the model: more than one if it makes steps of one size only."""
    own = only_step(fmu.description)
    if own is None:
        return 1
    if (step / own).denominator != 1:
        raise StepSizeError(
            f"The plant {fmu.default_name!r} makes steps of {show(own)} s only, but the model has dt = {show(step)} s. Give a dt "
            f"that is a multiple of {show(own)} s."
        )
    return int(step / own)


def _shrinks(changes: Sequence[float]) -> bool:
    """Return whether the changes of the outputs, in each length of a response, become smaller as those of a slow mode do."""
    before = changes[-1 - WAIT // 4] if len(changes) > WAIT // 4 else np.inf
    return bool(changes) and changes[-1] < SHRINKS * before


@dataclass(frozen=True, eq=False)
class Realisation:
    """A balanced model of deviations from the outputs y.

    ``start`` is the state in which the plant starts, ``waited`` the seconds until it was steady, ``error`` the relative error of
    the model's pulse responses.
    """

    A: Floats
    B: Floats
    C: Floats
    y: Floats
    start: Floats
    waited: Fraction
    singular_values: Floats
    error: float


def realise(
    fmu: FMU, step: Fraction, held: Floats, scale: Mapping[int, float], rows: Sequence[int], order: int | None
) -> Realisation:
    """Return a model of an FMU's inputs and outputs about the steady state at the inputs `held`.

    Parameters
    ----------
    fmu : FMU
        The plant, with the ports of the model.
    step : Fraction
        Sample time in seconds.
    held : ndarray
        The inputs at the operating point.
    scale : mapping of int to float
        The largest pulse of each input, by its index; inputs without one are held, and not in the model.
    rows : sequence of int
        Indices of the model's outputs.
    order : int or None
        Number of states; None for the number of singular values above the responses' errors.

    Raises
    ------
    ModelError
        If there is no steady state, an output depends directly on an input, or no input moves any output.
    """
    digest = open_archive(Path(fmu.path).absolute()).digest
    result, told = _realised(fmu, digest, step, tuple(held.tolist()), tuple(scale.items()), tuple(rows), order)
    _emit(told)
    return result


_Told = tuple[tuple[str, type[Warning]], ...]


def _emit(told: _Told) -> None:
    for text, category in told:
        warn_user(text, category)


@lru_cache(maxsize=32)  # a campaign designs the controller of each point anew; hundreds of experiments take seconds
def _realised(
    fmu: FMU,
    _digest: str,
    step: Fraction,
    held: tuple[float, ...],
    scale: tuple[tuple[int, float], ...],
    rows: tuple[int, ...],
    order: int | None,
) -> tuple[Realisation, _Told]:
    """Return the model of an FMU with this content, and the warnings about it."""
    failure: BayesFTCError | None = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = _experimented(fmu, step, np.array(held), dict(scale), rows, order)
        except BayesFTCError as error:
            failure = error
    told = tuple((str(each.message), each.category) for each in caught)
    if failure is not None:
        _emit(told)
        raise failure
    return result, told


def _experimented(
    fmu: FMU, step: Fraction, held: Floats, scale: Mapping[int, float], rows: Sequence[int], order: int | None
) -> Realisation:
    with Experiments(replace(fmu, timing="plant"), step, held, rows) as plant:
        y, first = plant.settle()
        markov, error, lost = _markov(plant, scale)
        waited = plant.waited
    direct = np.abs(markov[0]).max()
    if direct > 1e-9 * np.abs(markov).max():
        raise ModelError(
            "An output of the FMU depends directly on an input, which the model y = C x cannot represent. Measure another "
            "output, or put a cosim.UnitDelay between them."
        )
    A, B, C, values, miss = _eigensystem(markov[1:], error[1:], order, lost)
    for each in lost:
        warn_user(f"{each}; the model is that of the larger pulses, and may be inaccurate.", PoorFitWarning)
    readings = [C]
    for _ in first[1:]:
        readings.append(readings[-1] @ A)
    start = np.zeros(len(A))
    if waited:
        start[:] = np.linalg.lstsq(np.vstack(readings), (first - y).ravel(), rcond=None)[0]
    A, B, C, y, start, values = (frozen(each) for each in (A, B, C, y, start, values))
    return Realisation(A, B, C, y, start, waited, values, miss)


def _unusual(plant: Experiments) -> str:
    own = plant.default_step
    return f" (the FMU's own are of {show(own)} s)" if own is not None and own != plant.step else ""


def _markov(plant: Experiments, scale: Mapping[int, float]) -> tuple[Floats, Floats, list[str]]:
    """Return the derivatives of the outputs by a pulse of each input (samples x outputs x inputs), their errors, and sentences.

    The sentences are about small pulses without a response.
    """
    slope = [_derivative(plant, j, full, len(plant.held)) for j, full in scale.items()]
    markov, error = np.stack([each[0] for each in slope], axis=2), np.stack([each[1] for each in slope], axis=2)
    useful = _useful(markov)
    return markov[:useful], error[:useful], [lost for *_, lost in slope if lost]


def _derivative(plant: Experiments, j: int, full: float, inputs: int) -> tuple[Floats, Floats, str]:
    """Return the derivative of the outputs by a pulse of one input (samples x outputs), its error, and a sentence.

    The sentence, which may be empty, says that small pulses have no response.
    It uses central differences: large pulses suffer from nonlinearity, small ones from rounding.
    """
    best: tuple[Floats, Floats] | None = None
    previous, least, bend, lost = None, np.inf, 0.0, ""
    baseline = plant.respond()
    for decade in range(DECADES):
        pulse = np.zeros(inputs)
        pulse[j] = full * float(f"1e-{decade}")
        try:
            up, down = plant.respond(pulse) - baseline, baseline - plant.respond(-pulse)
        except ModelError:  # too large for this plant
            continue
        slope = (up + down) / (2 * pulse[j])
        if not np.isfinite(slope).all():
            continue
        if previous is not None and previous.any() and not slope.any():
            lost = (
                f"The plant responds to larger pulses of {plant.names[j]!r}, but not to one of {abs(float(pulse[j])):g}: it has "
                "a dead band there, or its outputs are rounded"
            )
            break  # smaller pulses are lost as well; their agreement on zero is no derivative
        if previous is not None:
            error, size = np.abs(slope - previous), np.abs(slope).max(axis=0)
            relative = float((error.max(axis=0) / np.where(size > 0, size, 1.0)).max())
            if relative < least:
                best, least = (slope, error), relative
                bend = float(np.abs(up - down).max() / max(np.abs(up + down).max(), 1e-300))
            if relative < ENOUGH:
                break
        previous = slope
    if lost and best is None:
        raise ModelError(f"{lost}. Give an operating point outside it (at=...). {WITHOUT_BAND}")
    if best is None:
        raise ModelError(
            f"The plant fails in every experiment from its steady state, in steps of {show(plant.step)} s"
            f"{_unusual(plant)}. Give a smaller dt (in seconds), other inputs (at=...) or start values; {SUBSTEPS}."
        )
    if bend > BENDS:
        warn_user(
            f"The plant's responses to pulses of {plant.names[j]!r} up and down differ by {100 * bend:.0f} %, however small: the "
            "operating point is at a limit or a kink, where no linear model fits both sides. Give another point (at=...).",
            PoorFitWarning,
        )
    return *best, lost


def _useful(markov: Floats) -> int:
    """Return the number of useful samples of a response, before an unstable mode hides all others."""
    size = np.abs(markov).max(axis=(1, 2))
    first = size[: SAMPLES // 5].max()
    beyond = np.flatnonzero(size > GROWTH * first)
    return max(SAMPLES // 5, int(beyond[0])) if len(beyond) else len(markov)


def _eigensystem(
    markov: Floats, error: Floats, order: int | None, lost: Sequence[str] = ()
) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Return the eigensystem realisation (Juang and Pappa, J. Guidance 8, 1985) of pulse responses.

    The sentences `lost` about small pulses without a response explain why there is no model.

    It is python-control's `era`, of which importing the package takes a hundred times as long as the computation.
    """
    reason = f"{'. '.join(lost)}. {WITHOUT_BAND} " if lost else ""
    # Scaled to largest responses of 1 for each output and input, the result does not depend on the user's units.
    rows = np.abs(markov).max(axis=(0, 2))
    rows = np.where(rows > 0, rows, 1.0)
    scaled = markov / rows[:, None]
    columns = np.abs(scaled).max(axis=(0, 1))
    if not columns.any():
        raise ModelError(
            f"No input moves any of the outputs; actuate other inputs or measure other outputs. {reason}{RECORD}"
        )
    columns = np.where(columns > 0, columns, 1.0)
    scaled, scaled_error = scaled / columns, error / rows[:, None] / columns
    half = (len(markov) - 1) // 2
    earlier, later = _hankel(scaled, half), _hankel(scaled[1:], half)
    left, values, right = np.linalg.svd(earlier)
    # An error of the matrix changes no singular value by more than the error's norm (Weyl).
    floor = max(3 * float(np.linalg.norm(_hankel(scaled_error, half), 2)), 1e-11 * float(values[0]))
    count = int(np.sum(values > floor)) if order is None else order
    if order is None and not count:
        raise ModelError(
            f"The plant's responses to pulses of different sizes differ too much for a linear model. {reason}{RECORD}"
        )
    if not 1 <= count <= len(values):
        raise ModelError(
            f"order={count} is given, but the responses allow at most {len(values)}; give from 1 to {len(values)}."
        )
    observed, reached, scale = left[:, :count], right[:count], np.diag(1.0 / np.sqrt(values[:count]))
    A = scale @ observed.T @ later @ reached.T @ scale
    B = scale @ observed.T @ earlier[:, : len(columns)] * columns
    C = earlier[: len(rows)] @ reached.T @ scale * rows[:, None]
    miss = _misfit(A, B / columns, C / rows[:, None], scaled)
    if miss > AGREES:
        warn_user(
            f"The linear model of order {count} misses the plant's pulse responses by {100 * miss:.2g} % of their size. Give a "
            "higher order=, or another operating point if the plant is not smooth here.",
            PoorFitWarning,
        )
    return A, B, C, np.asarray(values, dtype=np.float64), miss


def _hankel(markov: Floats, half: int) -> Floats:
    return np.block([[markov[i + j] for j in range(half)] for i in range(half)])


def _misfit(A: Floats, B: Floats, C: Floats, markov: Floats) -> float:
    state, total = B, 0.0
    for response in markov:
        total += float(((C @ state - response) ** 2).sum())
        state = A @ state
    return float(np.sqrt(total / float((markov**2).sum())))
