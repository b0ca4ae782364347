"""A linear model of a plant of which only inputs and outputs are seen: short experiments, and the eigensystem realisation."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from types import TracebackType

import numpy as np

from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import External
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats

SAMPLES = 100
"""Samples of each response; half of them are rows of the Hankel matrix."""

DECADES = 8
"""Pulses of 1, 0.1, 0.01, ... of an input's scale are tried; the sizes that agree best tell the derivative."""

GROWTH = 1e3
"""A response that has grown by this is long enough: beyond, an unstable mode hides the others."""

STEADY = 1e-7
"""Outputs that change by less than this of their size in a response's length are steady."""

WAIT = 200
"""Responses' lengths to wait for a steady state."""

ENOUGH = 1e-12
"""Relative difference of the answers to two sizes of pulses at which no further size is tried."""

BENDS = 0.05
"""Relative difference of the answers up and down above which it is said."""

AGREES = 1e-3
"""Relative error of the model's own responses above which it is said."""


RECORD = (
    "If its outputs are rounded or noisy, identify a model from a recording (LinearModel.identify), whose inputs are as large "
    "as they may be."
)
"""What to do about outputs that are too coarse for pulses."""


class PoorFitWarning(UserWarning):
    """A model that was made from samples does not explain them well."""


class Experiments:
    """The same plant from the same state, as often as one likes: restored where it can be, else made anew and brought there."""

    def __init__(self, fmu: FMU, step: Fraction, held: Floats, rows: Sequence[int]):
        self._fmu, self._step, self.held, self._rows = fmu, step, held, list(rows)
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
    def waited(self) -> Fraction:
        """How long it took the plant to come to rest, in seconds."""
        return self._step * self._waited

    def respond(self, pulse: Floats | None = None, samples: int = SAMPLES) -> Floats:
        """Return the outputs at ``samples`` instants; the inputs are held, but for a `pulse` in the first step."""
        plant = self._begin()
        seen = []
        for k in range(samples):
            inputs = self.held + pulse if k == 0 and pulse is not None else self.held.copy()
            seen.append(self._advance(plant, inputs, self._waited + k))
        return np.array(seen)

    def settle(self) -> tuple[Floats, Floats]:
        """Wait until the outputs stay where they are; return them, and the first samples on the way there.

        Raises
        ------
        ModelError
            If they never do.
        """
        plant, size, k = self._begin(), 0.0, 0
        first = np.empty((0, 0))
        for part in range(WAIT):
            seen = np.empty((SAMPLES, len(self._rows)))
            for i in range(SAMPLES):
                seen[i], k = self._advance(plant, self.held.copy(), k), k + 1
            first = seen if part == 0 else first
            size = max(size, float(np.abs(seen).max()), 1e-6)
            if not np.isfinite(size):
                break
            if np.ptp(seen, axis=0).max() <= STEADY * size:
                self._close()
                self._waited = part * SAMPLES
                return np.array(seen[-1]), first
        raise ModelError(
            f"The plant {self._fmu.default_name!r} finds no steady state: with its inputs held at {self.held.tolist()} its "
            f"outputs still change after {show(self._step * k)} s. Give start values at which it rests (FMU(parameters=...)), or "
            "other inputs (at=...); of a plant that never rests identify a model from a recording (LinearModel.identify)."
        )

    def _begin(self) -> External:
        if self._plant is not None and self._saved is not None:
            self._plant.restore(self._saved)
            return self._plant
        self._close()
        plant = self._plant = self._fmu.instantiate(self._step, self._fmu.default_name)
        for k in range(self._waited):
            self._advance(plant, self.held.copy(), k)
        if plant.can_save:
            self._saved = plant.save()
        return plant

    def _advance(self, plant: External, inputs: Floats, k: int) -> Floats:
        """Make a step; return the outputs before it."""
        t, outputs = float(k * self._step), self._outputs
        status = plant.output(inputs, outputs, t) or plant.update(inputs, outputs, t)
        if status:
            why = plant.explain(status)
            self._close()
            raise ModelError(f"The plant {self._fmu.default_name!r} failed in an experiment, at t = {t:g} s: {why}")
        return np.array(outputs[self._rows])

    def _close(self) -> None:
        plant, self._plant, self._saved = self._plant, None, None
        if plant is not None:
            plant.close()


@dataclass(frozen=True, eq=False)
class Realisation:
    """A balanced model of deviations from the outputs y.

    ``start`` is the state in which the plant starts, ``waited`` how many seconds it took it to come to rest, ``error`` is that of
    the model's own pulse responses, relative to their size.
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
    """Return a model of an FMU's inputs and outputs about the steady state that belongs to the inputs `held`.

    Parameters
    ----------
    fmu : FMU
        Of its ports' elements the model is; it is run as a plant.
    step : Fraction
        Sample time in seconds.
    held : ndarray
        The inputs at the operating point.
    scale : mapping of int to float
        The largest pulse of each input, by its place; inputs without one are held, and not in the model.
    rows : sequence of int
        Places of the outputs that are in the model.
    order : int or None
        How many states; None for as many as stand out of the responses' own errors.

    Raises
    ------
    ModelError
        If there is no steady state, an output follows an input at once, or no input moves any output.
    """
    with Experiments(replace(fmu, timing="plant"), step, held, rows) as plant:
        y, first = plant.settle()
        markov, error = _markov(plant, scale)
        waited = plant.waited
    direct = np.abs(markov[0]).max()
    if direct > 1e-9 * np.abs(markov).max():
        raise ModelError(
            "An output of the FMU follows an input at once, which the model y = C x cannot express; measure another output, or "
            "put a cosim.UnitDelay between them."
        )
    A, B, C, values, miss = _eigensystem(markov[1:], error[1:], order)
    seen = [C]
    for _ in first[1:]:
        seen.append(seen[-1] @ A)
    start = np.zeros(len(A))
    if waited:
        start[:] = np.linalg.lstsq(np.vstack(seen), (first - y).ravel(), rcond=None)[0]
    return Realisation(A, B, C, y, start, waited, values, miss)


def _markov(plant: Experiments, scale: Mapping[int, float]) -> tuple[Floats, Floats]:
    """Return the derivatives of the outputs by a pulse of each input (samples x outputs x inputs), and how uncertain they are."""
    found = [_derivative(plant, j, full, len(plant.held)) for j, full in scale.items()]
    markov, error = (np.stack([column[part] for column in found], axis=2) for part in (0, 1))
    useful = _useful(markov)
    return markov[:useful], error[:useful]


def _derivative(plant: Experiments, j: int, full: float, inputs: int) -> tuple[Floats, Floats]:
    """Return the derivative of the outputs by a pulse of one input (samples x outputs), and how uncertain it is.

    Central differences: the larger the pulse, the more it bends; the smaller, the more is lost to rounding.
    """
    best: tuple[Floats, Floats] | None = None
    previous, least, bend, deaf = None, np.inf, 0.0, 0.0
    rest = plant.respond()
    for decade in range(DECADES):
        pulse = np.zeros(inputs)
        pulse[j] = full * 10.0**-decade
        try:
            up, down = plant.respond(pulse) - rest, rest - plant.respond(-pulse)
        except ModelError:  # too large for this plant
            continue
        found = (up + down) / (2 * pulse[j])
        if not np.isfinite(found).all():
            continue
        if previous is not None and previous.any() and not found.any():
            deaf = abs(float(pulse[j]))
            break  # smaller pulses are lost as well: that they agree on nothing is no derivative
        if previous is not None:
            error, size = np.abs(found - previous), np.abs(found).max(axis=0)
            relative = float((error.max(axis=0) / np.where(size > 0, size, 1.0)).max())
            if relative < least:
                best, least = (found, error), relative
                bend = float(np.abs(up - down).max() / max(np.abs(up + down).max(), 1e-300))
            if relative < ENOUGH:
                break
        previous = found
    if deaf:
        lost = (
            f"The plant does not answer a pulse of {deaf:g} of {plant.names[j]!r}, but larger ones: it has a dead band there, or "
            "its outputs are rounded"
        )
        if best is None:
            raise ModelError(f"{lost}. Give an operating point beside it (at=...).")
        warnings.warn(
            f"{lost}; the model is that of the larger pulses, which it may fit badly.", PoorFitWarning, stacklevel=8
        )
    if best is None:
        raise ModelError(
            "The plant fails in every experiment from its steady state; give other inputs (at=...) or start values."
        )
    if bend > BENDS:
        warnings.warn(
            f"The plant answers a pulse of {plant.names[j]!r} down otherwise than up, by {100 * bend:.0f} %, however small: it "
            "rests at a limit or a kink, where a linear model is right on neither side; give a point beside it (at=...).",
            PoorFitWarning,
            stacklevel=8,
        )
    return best


def _useful(markov: Floats) -> int:
    """Return how many samples of a response are useful: not those in which an unstable mode has outgrown all others."""
    size = np.abs(markov).max(axis=(1, 2))
    first = size[: SAMPLES // 5].max()
    beyond = np.flatnonzero(size > GROWTH * first)
    return max(SAMPLES // 5, int(beyond[0])) if len(beyond) else len(markov)


def _eigensystem(markov: Floats, error: Floats, order: int | None) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Return the eigensystem realisation (Juang and Pappa, J. Guidance 8, 1985) of pulse responses, by python-control's `era`."""
    import control

    # In units in which each output's and each input's largest response is 1, so that no choice of units decides.
    rows = np.abs(markov).max(axis=(0, 2))
    rows = np.where(rows > 0, rows, 1.0)
    scaled = markov / rows[:, None]
    columns = np.abs(scaled).max(axis=(0, 1))
    if not columns.any():
        raise ModelError(
            f"No input moves any of the outputs: the plant is not controllable by them; actuate and measure others. {RECORD}"
        )
    columns = np.where(columns > 0, columns, 1.0)
    scaled, doubt = scaled / columns, error / rows[:, None] / columns
    half = (len(markov) - 1) // 2
    values = np.linalg.svd(_hankel(scaled, half), compute_uv=False)
    # No singular value moves by more than the norm of what disturbs the matrix (Weyl).
    floor = max(3 * float(np.linalg.norm(_hankel(doubt, half), 2)), 1e-11 * float(values[0]))
    count = int(np.sum(values > floor)) if order is None else order
    if order is None and not count:
        raise ModelError(
            f"The plant answers pulses of one size so differently from those of another that they tell nothing. {RECORD}"
        )
    if not 1 <= count <= len(values):
        raise ModelError(
            f"An order of {count} is asked of responses that tell at most {len(values)}; give from 1 to that."
        )
    impulse = np.concatenate([np.zeros((1, *scaled.shape[1:])), scaled]).transpose(1, 2, 0)
    system, _ = control.era(impulse, r=count, m=half, n=half)
    A, B, C = np.asarray(system.A), np.asarray(system.B) * columns, np.asarray(system.C) * rows[:, None]
    miss = _misfit(A, B / columns, C / rows[:, None], scaled)
    if miss > AGREES:
        warnings.warn(
            f"The linear model of order {count} misses the plant's pulse responses by {100 * miss:.2g} % of their size: give a "
            "higher order=, or another operating point if the plant is not smooth here.",
            PoorFitWarning,
            stacklevel=6,
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
