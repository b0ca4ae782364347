"""Check before a run: compare sign, size and delay of model and plant in step responses of each control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.block import extended_mean
from bayesftc.controllers.diagnosis.explanations import holding
from bayesftc.controllers.models.checks import as_vector
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import BayesFTCError, ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.block import Block
    from bayesftc.cosim.types import Floats

SAMPLES = 50
"""Samples of a step response."""

STANDARD_DEVIATIONS = 10.0
"""Size of the model's step response, in standard deviations of the sensor with the best view of it."""

GROWTH = 100.0
"""Growth since the fifth sample at which a response is cut, because an unstable plant soon leaves the model's range."""

SIZE = 0.25
"""Relative difference of the responses' sizes from which on there is a warning."""

SHOWN = 1e-3
"""Least size of a response for a comparison, in standard deviations of its sensor, relative to the largest one."""

RUNAWAY = 1e6
"""Ratio of the plant's response to the model's from which on it is not a wrong gain."""

LATER = 0.25
"""Largest ratio of the squared errors with and without a delay for which there is a delay."""

SMALLER = 0.1
"""Relative size of a second step, where the first one shows a difference: far from the operating point, as a large step leads, a
plant may be another than its linear model."""


class ModelMismatchWarning(UserWarning):
    """The responses of model and plant to a control differ in sign, size or delay."""


@dataclass(frozen=True)
class Mismatch:
    """The difference between the plant's and the model's response to one control.

    Attributes
    ----------
    control, output : str
        Names of the signals.
    ratio : float
        Size of the plant's response relative to the model's; negative for the opposite sign.
    delay : int
        Delay of the plant's response in samples; negative if it comes earlier than the model's.
    runs_away : bool
        Whether the plant's response grows without bound and the model's does not.
    """

    control: str
    output: str
    ratio: float
    delay: int
    runs_away: bool = False

    def sentence(self, dt: float) -> str:
        """Return a sentence about the difference and what to do."""
        where = f"A step of {self.control} moves {self.output}"
        if self.runs_away:
            return (
                f"With a step of {self.control}, {self.output} grows without bound in the plant, but not in the model. The FMU's "
                f"solver may be unstable at communication steps of {dt:.3g} s: give a shorter dt, or use kind='model exchange' "
                "if possible. Otherwise the plant has an instability that the model lacks."
            )
        if self.delay < 0:
            return (
                f"{where} {-self.delay * dt:.3g} s earlier in the plant than in the model. The delays of the model are too long "
                "by this."
            )
        if self.delay:
            return (
                f"{where} {self.delay * dt:.3g} s later in the plant than in the model. Add the delay to the model, or weaken "
                "the control."
            )
        if self.ratio < 0:
            return f"{where} in opposite directions in the plant and in the model. Check the signs of B and C."
        if self.ratio == 0:
            return f"{where} in the model, but not in the plant. Check whether it is the right control."
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
    reads: Sequence[int | None] | None = None,
    at: ArrayLike = 0.0,
    u_min: ArrayLike = -np.inf,
    u_max: ArrayLike = np.inf,
) -> tuple[Mismatch, ...]:
    """Compare short step responses of a model and of the plant, and warn if they differ.

    The plant runs alone, in a new instance for each step, from its start values; other inputs keep theirs. A plant that cannot
    run in this way is not compared.

    Parameters
    ----------
    model : LinearModel
        The model.
    plant : Block
        The plant.
    control, measured : str or sequence of str
        The plant's inputs and outputs, as for `bayesftc.cosim.closed_loop`.
    reads : sequence of int or None, optional
        For each of the model's sensors the number of the measured output that it reads, as `bayesftc.cosim.Sensors.reads`;
        None for one that reads a mixture, which is not compared. An output is compared with the first sensor that reads it.
        By default the first sensors of the model's quantities read the outputs, in their order.
    at : number or vector
        The model's state for the steps; controls begin at the values that hold the plant there.
    u_min, u_max : number or vector
        Limits of the controls, also during the steps.

    Returns
    -------
    tuple of Mismatch
        The differences; empty if there are none.

    Warns
    -----
    ModelMismatchWarning
        For each difference.

    Examples
    --------
    >>> import control, warnings
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.2]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> with warnings.catch_warnings(action="ignore"):
    ...     differences = controllers.compare_with_plant(model, plant, control="u", measured="y")
    >>> [(difference.control, round(difference.ratio, 2)) for difference in differences]
    [('u', 2.0)]
    """
    p = model.controls
    names = [control] if isinstance(control, str) else list(control)
    outputs = [measured] if isinstance(measured, str) else list(measured)
    low, high = as_vector("u_min", u_min, p, finite=False), as_vector("u_max", u_max, p, finite=False)
    state = np.atleast_1d(np.asarray(at, dtype=np.float64))
    mean = np.array(np.broadcast_to(np.asarray(extended_mean(model, state, state), np.float64), model.states))
    start = np.clip(holding(model, mean), low, high)
    if reads is not None and len(reads) != model.sensors:
        raise ModelError(
            f"compare_with_plant has reads={tuple(reads)} for {counted(model.sensors, 'sensor')} of the model; give the number "
            "of an output, or None, for each sensor."
        )
    baseline = _response(model, plant, names, outputs, start)
    if baseline is None:
        return ()
    first = _first_sensors(model, reads, baseline.shape[1])
    if not first:
        return ()
    labels = outputs
    if len(outputs) != baseline.shape[1]:
        labels = [f"output {i} ({', '.join(outputs)})" for i in range(baseline.shape[1])]
    labels, columns, sensors = [labels[i] for i in first], list(first), list(first.values())
    differences: list[Mismatch] = []
    dead = 0 if model.delays is None else max(model.delays.inputs) + max(model.delays.sensors)
    for j in range(p):
        expected = _steps(model, j)[:, sensors]
        deviations = np.sqrt(np.diag(model.matrix("sensor_covariance")))[sensors]
        expected = expected[: _useful(expected, dead)]
        reaches = (np.abs(expected) / deviations).max(axis=0)
        reach, visible = float(reaches.max()), reaches > SHOWN * reaches.max()
        size = STANDARD_DEVIATIONS / reach if reach > 0.0 else 0.0
        room = max(high[j] - start[j], start[j] - low[j])
        size = min(size, room) * (1.0 if high[j] - start[j] >= start[j] - low[j] else -1.0)
        name = names[j] if len(names) == p else f"control {j} ({', '.join(names)})"
        used = slice(len(expected))
        found: list[Mismatch] = []
        for step in (size, SMALLER * size):
            moved = start.copy()
            moved[j] += step
            response = _response(model, plant, names, outputs, moved) if step else None
            if response is None:
                break
            change = (response[used] - baseline[used])[:, columns]
            found = _differences(change, expected * step, name, labels, visible, delayed=model.delays is not None)
            if not found:
                break
        differences += found
    for mismatch in differences:
        warn_user(mismatch.sentence(float(model.step)), ModelMismatchWarning)
    return tuple(differences)


def _first_sensors(model: LinearModel, reads: Sequence[int | None] | None, outputs: int) -> dict[int, int]:
    """Return the first sensor of each output to compare, by the number of the output."""
    if reads is not None:
        return {i: list(reads).index(i) for i in range(outputs) if i in reads}
    if outputs > model.sensors:
        return {}
    firsts = [group[0] for group in model.alike]
    return dict(enumerate(firsts if len(firsts) == outputs else range(outputs)))


def _differences(
    response: Floats, expected: Floats, control: str, outputs: Sequence[str], visible: Floats, *, delayed: bool
) -> list[Mismatch]:
    """Return the differences of the visible responses (samples x outputs) from those expected.

    A model with delays may be the later one.
    """
    differences = []
    largest = np.abs(expected).max(axis=0)
    for i in range(expected.shape[1]):
        name = outputs[i]
        if not visible[i] or not np.isfinite(response[:, i]).all():
            continue
        if np.abs(response[:, i]).max() > RUNAWAY * largest[i]:
            differences.append(Mismatch(control, name, float("inf"), 0, runs_away=True))
            continue
        ratio, left = _scaled(response[:, i], expected[:, i])
        shifts = range(1, len(expected) // 2)
        tries = [(_scaled(response[:, i], _shifted(expected[:, i], k)), k) for k in shifts]
        if delayed:
            tries += [(_scaled(_shifted(response[:, i], k), expected[:, i]), -k) for k in shifts]
        (later, least), delay = min(tries, key=lambda each: each[0][1])
        if least < LATER * left and later > 0 and (delay > 1 or delay < 0):
            differences.append(Mismatch(control, name, later, delay))
        elif not response[:, i].any() or ratio < 0 or abs(ratio - 1.0) > SIZE:
            differences.append(Mismatch(control, name, ratio if response[:, i].any() else 0.0, 0))
    return differences


def _scaled(response: Floats, expected: Floats) -> tuple[float, float]:
    """Return the best scale of the expected response, and the remaining sum of squares."""
    ratio = float(response @ expected / (expected @ expected)) if expected.any() else 0.0
    return ratio, float(((response - ratio * expected) ** 2).sum())


def _shifted(values: Floats, steps: int) -> Floats:
    return np.concatenate([np.zeros(steps), values[:-steps]])


def _steps(model: LinearModel, j: int) -> Floats:
    """Return the model's response of each sensor to a unit step of one control (samples x m)."""
    A, b, C = model.matrix("A"), model.matrix("B")[:, j], model.matrix("C")
    x, responses = np.zeros(len(A)), np.zeros((SAMPLES, len(C)))
    for k in range(SAMPLES):
        responses[k] = C @ x
        x = A @ x + b
    return responses


def _useful(responses: Floats, dead: int) -> int:
    """Return the number of samples to compare: all, unless the response runs away after its dead time."""
    size = np.abs(responses).max(axis=1)
    first = float(size[: 6 + dead].max())
    beyond = np.flatnonzero(size > GROWTH * first) if first > 0.0 else np.empty(0)
    return max(int(beyond[0]), 6 + dead) if len(beyond) else len(responses)


def _response(
    model: LinearModel, plant: Block, control: Sequence[str], measured: Sequence[str], u: Floats
) -> Floats | None:
    """Return the plant's measured outputs (samples x outputs) under constant controls; None if the run fails."""
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
        references = [node[name] for name in measured]
        result = diagram.build().simulate(
            duration, record=[f"plant.{ref.port.name}" for ref in references], engine="interpreted"
        )
        rows = len(result.time)
        columns = [result[f"plant.{ref.port.name}"].reshape(rows, -1)[:, list(ref.elements)] for ref in references]
    except BayesFTCError:  # such as an input without a start value; the actual run reports it
        return None
    return np.concatenate(columns, axis=1)[:SAMPLES]
