"""Before a run: does the model answer a step of each control as the plant does? Sign, size and delay."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.block import extended_mean
from bayesftc.controllers.diagnosis.explanations import holding
from bayesftc.controllers.models.checks import as_vector
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import BayesFTCError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.block import Block
    from bayesftc.cosim.types import Floats

SAMPLES = 50
"""Samples of a step response."""

STANDARD_DEVIATIONS = 10.0
"""How far the model's response to the step goes, in standard deviations of the sensor that sees it best."""

GROWTH = 100.0
"""A response that has grown by this since its fifth sample is long enough: an unstable plant is soon where no model holds."""

SIZE = 0.25
"""Relative difference of the responses' sizes from which on there is a warning."""

SHOWN = 1e-3
"""Responses of less than this share of the largest one are not compared."""

RUNAWAY = 1e6
"""A plant's answer that is larger than the model's by this is no matter of a gain."""

LATER = 0.25
"""A delay must lessen what the scaled response leaves to this share of it."""


class ModelMismatchWarning(UserWarning):
    """A model answers a control otherwise than the plant: the sign, the size or a delay is wrong."""


@dataclass(frozen=True)
class Mismatch:
    """How the plant's answer to one control differs from the model's.

    Attributes
    ----------
    control, output : str
        Names.
    ratio : float
        Size of the plant's answer over the model's; negative for the other sign.
    delay : int
        Samples by which it comes later.
    runs_away : bool
        Whether the plant's answer grows without bound where the model's does not.
    """

    control: str
    output: str
    ratio: float
    delay: int
    runs_away: bool = False

    def sentence(self, dt: float) -> str:
        """Return what differs and what to do."""
        where = f"A step of {self.control} moves {self.output}"
        if self.runs_away:
            return (
                f"With a step of {self.control}, {self.output} runs away in the plant, and not in the model. An FMU's own solver "
                f"may be unstable at communication steps of {dt:.3g} s: give a shorter dt, or use kind='model exchange' where it "
                "can be; else look for an instability that the model lacks."
            )
        if self.delay:
            return (
                f"{where} {self.delay * dt:.3g} s later in the plant than in the model. Make the delay part of the model, or "
                "weaken the control."
            )
        if self.ratio < 0:
            return f"{where} the other way in the plant than in the model. Is the sign of B right? Is that of C?"
        if self.ratio == 0:
            return f"{where} in the model, but not in the plant. Is it the right control?"
        return (
            f"{where} {self.ratio:.3g} times as far in the plant as in the model. Check B, dt, and the masses and gains "
            "behind A and B."
        )


def compare_with_plant(
    model: LinearModel,
    plant: Block,
    *,
    control: str | Sequence[str],
    measured: str | Sequence[str],
    at: ArrayLike = 0.0,
    u_min: ArrayLike = -np.inf,
    u_max: ArrayLike = np.inf,
) -> tuple[Mismatch, ...]:
    """Compare a model's answers to short steps of its controls with those of the plant, and warn where they differ.

    The plant is run on its own, a fresh instance for each step, from its own start values; its further inputs have theirs. A
    plant that cannot be run so is not compared.

    Parameters
    ----------
    model : LinearModel
        The model. Its first sensors read the measured outputs, in their order.
    plant : Block
        The plant.
    control, measured : str or sequence of str
        The plant's inputs and outputs, as of `bayesftc.cosim.closed_loop`.
    at : number or vector
        The model's state about which to step: controls begin at what holds the plant there.
    u_min, u_max : number or vector
        Limits of the controls, which the steps keep to.

    Returns
    -------
    tuple of Mismatch
        What differs; empty if nothing does.

    Warns
    -----
    ModelMismatchWarning
        For each of them.
    """
    p = model.controls
    names = [control] if isinstance(control, str) else list(control)
    outputs = [measured] if isinstance(measured, str) else list(measured)
    low, high = as_vector("u_min", u_min, p, finite=False), as_vector("u_max", u_max, p, finite=False)
    given = np.atleast_1d(np.asarray(at, dtype=np.float64))
    mean = np.array(np.broadcast_to(np.asarray(extended_mean(model, given, given), np.float64), model.states))
    start = np.clip(holding(model, mean), low, high)
    rest = _answer(model, plant, names, outputs, start)
    if rest is None or rest.shape[1] > model.sensors:
        return ()
    found: list[Mismatch] = []
    for j in range(p):
        expected = _steps(model, j)[:, : rest.shape[1]]
        deviations = np.sqrt(np.diag(model.matrix("sensor_covariance")))[: rest.shape[1]]
        expected = expected[: _useful(expected)]
        reach = float((np.abs(expected) / deviations).max())
        size = STANDARD_DEVIATIONS / reach if reach > 0.0 else 0.0
        room = max(high[j] - start[j], start[j] - low[j])
        size = min(size, room) * (1.0 if high[j] - start[j] >= start[j] - low[j] else -1.0)
        moved = start.copy()
        moved[j] += size
        seen = _answer(model, plant, names, outputs, moved) if size else None
        if seen is None:
            continue
        name = names[j] if len(names) == p else f"control {j} ({', '.join(names)})"
        used = slice(len(expected))
        found += _differences(seen[used] - rest[used], expected * size, name, outputs)
    for mismatch in found:
        warnings.warn(mismatch.sentence(float(model.step)), ModelMismatchWarning, stacklevel=2)
    return tuple(found)


def _differences(seen: Floats, expected: Floats, control: str, outputs: Sequence[str]) -> list[Mismatch]:
    """Return where answers (samples x outputs) differ from those expected."""
    found = []
    largest = np.abs(expected).max(axis=0)
    for i in range(expected.shape[1]):
        name = outputs[i] if len(outputs) == expected.shape[1] else f"output {i} ({', '.join(outputs)})"
        if largest[i] <= SHOWN * largest.max() or not np.isfinite(seen[:, i]).all():
            continue
        if np.abs(seen[:, i]).max() > RUNAWAY * largest[i]:
            found.append(Mismatch(control, name, float("inf"), 0, runs_away=True))
            continue
        ratio, left = _scaled(seen[:, i], expected[:, i])
        late = [(_scaled(seen[:, i], _shifted(expected[:, i], k)), k) for k in range(1, len(expected) // 2)]
        (later, least), delay = min(late, key=lambda each: each[0][1])
        if least < LATER * left and later > 0 and delay > 1:
            found.append(Mismatch(control, name, later, delay))
        elif not seen[:, i].any() or ratio < 0 or abs(ratio - 1.0) > SIZE:
            found.append(Mismatch(control, name, ratio if seen[:, i].any() else 0.0, 0))
    return found


def _scaled(seen: Floats, expected: Floats) -> tuple[float, float]:
    """Return by how much the expected answer must be scaled, and the sum of squares that leaves."""
    ratio = float(seen @ expected / (expected @ expected)) if expected.any() else 0.0
    return ratio, float(((seen - ratio * expected) ** 2).sum())


def _shifted(values: Floats, steps: int) -> Floats:
    return np.concatenate([np.zeros(steps), values[:-steps]])


def _steps(model: LinearModel, j: int) -> Floats:
    """Return the model's answer of each sensor to a unit step of one control (samples x m)."""
    A, b, C = model.matrix("A"), model.matrix("B")[:, j], model.matrix("C")
    x, answers = np.zeros(len(A)), np.zeros((SAMPLES, len(C)))
    for k in range(SAMPLES):
        answers[k] = C @ x
        x = A @ x + b
    return answers


def _useful(answers: Floats) -> int:
    """Return how many samples of an answer are compared: all, unless it runs away."""
    size = np.abs(answers).max(axis=1)
    first = float(size[:6].max())
    beyond = np.flatnonzero(size > GROWTH * first) if first > 0.0 else np.empty(0)
    return max(int(beyond[0]), 6) if len(beyond) else len(answers)


def _answer(
    model: LinearModel, plant: Block, control: Sequence[str], measured: Sequence[str], u: Floats
) -> Floats | None:
    """Return the plant's measured outputs (samples x outputs) under constant controls; None if it cannot be run so."""
    try:
        diagram = Diagram(model.step)
        node = diagram.add(plant, "plant")
        ports: list[Any] = [node[name] for name in control]
        first = 0
        for number, target in enumerate(ports):
            values = tuple(float(v) for v in u[first : first + len(target)])
            diagram.connect([diagram.add(Constant(v), f"u{number}_{i}")["y"] for i, v in enumerate(values)], target)
            first += len(target)
        duration = SAMPLES * model.step
        seen = [node[name] for name in measured]
        result = diagram.build().simulate(
            duration, record=[f"plant.{ref.port.name}" for ref in seen], engine="interpreted"
        )
        rows = len(result.time)
        columns = [result[f"plant.{ref.port.name}"].reshape(rows, -1)[:, list(ref.elements)] for ref in seen]
    except BayesFTCError:  # an input without a start value, a sample time that does not fit: the run itself will say so
        return None
    return np.concatenate(columns, axis=1)[:SAMPLES]
