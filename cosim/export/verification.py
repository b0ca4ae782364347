"""Check that an FMU does what its blocks do: both run on the same inputs, then the FMU runs in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import ModelError, SimulationError, brief
from bayesftc.cosim.export.deviations import Deviation, deviation
from bayesftc.cosim.export.stand_in import PLACED, Place, StandIn
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

_SHORT = 200
"""Most steps for which the loop around an FMU is faster in Python than its compilation."""


@dataclass(frozen=True, repr=False)
class Verification:
    """The comparison of an FMU with the blocks that it replaces; its text is a table.

    Attributes
    ----------
    path : pathlib.Path
        The FMU.
    blocks : tuple of str
        The blocks that it replaces.
    steps : int
        Number of compared steps.
    step : Fraction
        The sample time in seconds.
    seed : int
        Seed of noise and faults.
    beside : tuple of Deviation
        For each output, with the inputs of the blocks, including random ones.
    in_loop : tuple of Deviation or None
        For each signal of the diagram, with the FMU in place of the blocks; None if that is not possible.
    notes : tuple of str
        Sentences about signals that are not compared.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise, limit = diagram.add(cosim.Gaussian(std=1.0)), diagram.add(cosim.Saturation(-1.0, 1.0), "limit")
    >>> diagram.connect(noise["y"], limit["u"])
    >>> with TemporaryDirectory() as folder:
    ...     fmu = cosim.export_fmu(diagram, f"{folder}/limit.fmu", blocks="limit")
    ...     verification = cosim.verify_fmu(fmu, diagram, duration=10.0)
    >>> verification.agrees(), verification.steps, verification.worst_in_loop.relative
    (True, 101, 0.0)
    """

    path: Path
    blocks: tuple[str, ...]
    steps: int
    step: Fraction
    seed: int
    beside: tuple[Deviation, ...]
    in_loop: tuple[Deviation, ...] | None
    notes: tuple[str, ...] = field(default=())

    def agrees(self, tolerance: float = 0.0) -> bool:
        """Return whether all differences, relative to the largest value of their signal, are at most `tolerance`.

        Parameters
        ----------
        tolerance : float
            0 for the same numbers. Use 1e-9 for an FMU of another tool whose ``exp`` or ``sin`` are those of a C library.
        """
        return all(each.relative <= tolerance for each in self._all)

    @property
    def worst_in_loop(self) -> Deviation | None:
        """The largest relative deviation with the FMU in the loop."""
        return max(self.in_loop or (), key=_relative, default=None)

    def verdict(self, tolerance: float = 0.0) -> str:
        """Return, in one or two sentences, whether the FMU does what the blocks do.

        Parameters
        ----------
        tolerance : float
            As for `agrees`.
        """
        first, last = ", ".join(self.blocks[:-1]), self.blocks[-1]
        what = f"what {first} and {last} do" if first else f"what {last} does"
        if all(each.largest == 0.0 for each in self._all):
            return f"{self.path.name} does {what}: the same numbers at {self._at_all}."
        worst = max(self._all, key=_relative)
        if self.agrees(tolerance):
            return f"{self.path.name} does {what}, to the tolerance of {tolerance:g}: {_difference(worst)} at most."
        usual = (
            ""
            if worst.relative > 1e-9
            else " Such differences are usual for FMUs of other tools, whose exp, log and sin are those of a C library."
        )
        # The first output of a controller is its control, which matters most; a covariance may differ by a larger factor.
        different = [each for each in self._all if each.relative > tolerance]
        headline = next((each for each in self.beside if each in different and isfinite(each.relative)), worst)
        others = len({each.signal for each in different}) - 1
        more = f", and {others} more signal{' differs' if others == 1 else 's differ'}" if others else ""
        return f"{self.path.name} does NOT do {what}: {_difference(headline)}{more}.{usual}"

    @property
    def _all(self) -> tuple[Deviation, ...]:
        return (*self.beside, *(self.in_loop or ()))

    @property
    def _at_all(self) -> str:
        return "the only step" if self.steps == 1 else f"all {self.steps} steps"

    def __repr__(self) -> str:
        return self.report()

    def report(self, tolerance: float = 0.0) -> str:
        """Return the differences as a table, with the verdict below.

        Parameters
        ----------
        tolerance : float
            As for `agrees`.
        """
        rows = [("output", "largest difference", "at t in s", "units in the last place")]
        rows += [
            (d.signal, _number(d.largest, ".3g"), "" if d.time is None else f"{d.time:g}", _number(d.ulps, ".6g"))
            for d in self.beside
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join([r[0].ljust(widths[0]), *map(str.rjust, r[1:], widths[1:])]).rstrip() for r in rows]
        if self.in_loop:
            lines.append(f"In a run with the FMU in place of these blocks: {_in_loop(self.in_loop)}.")
        return "\n".join([*lines, "", *self.notes, self.verdict(tolerance)])


def verify_fmu(
    path: str | PathLike[str],
    diagram: Diagram,
    blocks: Sequence[str] | str | None = None,
    *,
    duration: float | str | Fraction,
    seed: int = 0,
    timing: Literal["plant", "sampled"] | None = None,
    isolate: bool = False,
    engine: Literal["auto", "compiled", "interpreted"] = "auto",
) -> Verification:
    """Run an FMU beside the blocks that it replaces in a diagram, and then in their place.

    First the diagram runs, with its noise and faults. Then the FMU runs with the recorded inputs of the blocks, including random
    numbers, and its outputs are compared with theirs. At last it replaces the blocks in the diagram, with the same random
    numbers, and all signals are compared. A NaN (a missing sample) equals a NaN.

    Parameters
    ----------
    path : str or path
        The FMU: one of `export_fmu`, or of any tool with inputs and outputs of the same names.
    diagram : Diagram
        The diagram; it is built and frozen if it is not yet.
    blocks : sequence of str, optional
        The blocks that the FMU replaces. By default those from which it was exported, else the only one with its inputs and
        outputs.
    duration : float, str or Fraction
        Seconds.
    seed : int
        Seed of all random numbers.
    timing : {"plant", "sampled"}, optional
        When the FMU's outputs hold, see `FMU`; by default from its description.
    isolate : bool
        Run the FMU in a separate process: a crash ends that process, not yours, and raises `FMUCrashed`.
    engine : {"auto", "compiled", "interpreted"}
        The engine for the diagram. Short runs with the FMU are interpreted; the numbers are the same.

    Returns
    -------
    Verification
        The differences; printed, it is a table with a verdict.

    Raises
    ------
    FMUError
        If the FMU cannot be used.
    UnknownNameError
        If there is no such block, or the FMU has inputs that the blocks do not have.
    ModelError
        If it is not clear which blocks the FMU replaces, or `diagram` is no diagram.
    StepSizeError
        If the FMU has another step size.
    SimulationError
        If a run stops with an error.

    Examples
    --------
    >>> import tempfile
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise, limit = diagram.add(cosim.Gaussian(std=1.0)), diagram.add(cosim.Saturation(-1.0, 1.0), "limit")
    >>> diagram.connect(noise["y"], limit["u"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fmu = cosim.export_fmu(diagram, f"{folder}/limit.fmu", blocks="limit")
    ...     print(cosim.verify_fmu(fmu, diagram, duration=10.0))
    output   largest difference  at t in s  units in the last place
    limit.y                   0                                   0
    In a run with the FMU in place of these blocks: largest difference 0.
    <BLANKLINE>
    limit.fmu does what limit does: the same numbers at all 101 steps.
    """
    if not isinstance(diagram, Diagram):
        raise ModelError(
            f"verify_fmu() needs the diagram whose blocks the FMU replaces, such as the loop of closed_loop(). It is "
            f"{brief(diagram)}. Put a single block into a cosim.Diagram, with sources at its inputs."
        )
    fmu = FMU(path, timing=timing, isolate=isolate)
    stand_in = StandIn(fmu, diagram, blocks)
    settings: dict[str, Any] = {"duration": duration, "seed": seed}
    # A fault after the end changes nothing here: both runs lack it.
    with (
        noted_elsewhere(),
        reported(f"Comparing {Path(path).name} with {', '.join(stand_in.blocks)}, for some seconds."),
    ):
        reference = diagram.simulate(**settings, engine=engine, record=_recorded(diagram, stand_in))
        if reference.stopped:
            raise SimulationError(reference.stopped, reference)
        recorded_inputs = np.column_stack(
            [np.zeros(len(reference.time)), *(_column(reference, place) for place in stand_in.into)]
        )
        open_loop = Diagram(diagram.step)
        stand_in.place(open_loop, recorded_inputs)
        beside = _deviations(reference, _placed(open_loop.simulate(duration, engine="interpreted"), stand_in))
        notes = list(stand_in.notes)
        in_loop = None
        if missing := stand_in.unheard():
            notes.append(f"It cannot run in their place: the diagram uses {missing}, which the FMU does not have.")
        else:
            loop_engine: Literal["auto", "interpreted"] = "interpreted" if len(reference.time) <= _SHORT else "auto"
            run = stand_in.in_loop(recorded_inputs).simulate(**settings, engine=loop_engine)
            in_loop = _deviations(reference, _placed(run, stand_in) | _others(run, diagram, stand_in))
    return Verification(
        Path(path), stand_in.blocks, len(reference.time), diagram.step, seed, beside, in_loop, tuple(notes)
    )


def _recorded(diagram: Diagram, stand_in: StandIn) -> list[str]:
    """Return the names of all outputs, and of what the blocks get."""
    compared = [f"{block}.{port}" for block, port, _ in (*stand_in.into, *stand_in.out)]
    return [*dict.fromkeys([*compared, *(f"{n.name}.{p.name}" for n in diagram.nodes for p in n.block.outputs)])]


def _difference(worst: Deviation) -> str:
    if not isfinite(worst.largest):
        return (
            f"at t = {worst.time:g} s, {worst.signal} is NaN or infinite in one run, and has another value in the other"
        )
    if not isfinite(worst.relative):
        return f"{worst.signal} is always 0 in the diagram, but differs from it by {worst.largest:.2g} with the FMU"
    return f"{worst.signal} differs by {_share(worst)}"


def _share(worst: Deviation) -> str:
    return f"{worst.relative:.2g}{' times' if worst.relative > 1.0 else ' of'} its largest value"


def _in_loop(deviations: Sequence[Deviation]) -> str:
    """Return the difference that is the largest share of its signal, and the first signal that is no number in one run."""
    finite = [each for each in deviations if isfinite(each.largest)]
    parts = []
    if finite:
        worst = max(finite, key=_relative)
        at = "" if worst.time is None else f", of {worst.signal} at t = {worst.time:g} s"
        share = f" ({_share(worst)})" if worst.largest and isfinite(worst.relative) else ""
        parts.append(f"largest difference {worst.largest:.3g}{at}{share}")
    if len(finite) < len(deviations):
        parts.append(_difference(next(each for each in deviations if each not in finite)))
    return "; ".join(parts)


def _number(value: float, form: str) -> str:
    return format(value, form) if isfinite(value) else "not finite"


def _relative(each: Deviation) -> float:
    return each.relative


def _placed(run: Result, stand_in: StandIn) -> dict[Place, Floats]:
    """Return the outputs of the FMU by the elements of the blocks that they replace."""
    return {place: _column(run, (PLACED, *at)) for place, at in stand_in.out.items()}


def _others(run: Result, diagram: Diagram, stand_in: StandIn) -> dict[Place, Floats]:
    """Return the outputs of all other blocks."""
    return {
        (node.name, port.name, i): _column(run, (node.name, port.name, i))
        for node in diagram.nodes
        if node.name not in stand_in.blocks
        for port in node.block.outputs
        for i in range(port.size)
    }


def _column(result: Result, place: Place) -> Floats:
    values = np.asarray(result[f"{place[0]}.{place[1]}"], dtype=np.float64)
    return values.reshape(len(values), -1)[:, place[2]]


def _deviations(reference: Result, values: Mapping[Place, Floats]) -> tuple[Deviation, ...]:
    signals: dict[str, list[Place]] = {}
    for place in values:
        signals.setdefault(f"{place[0]}.{place[1]}", []).append(place)
    result = []
    for name, places in signals.items():
        expected, actual = (
            np.column_stack(columns)
            for columns in zip(*((_column(reference, p), values[p]) for p in places), strict=True)
        )
        result.append(deviation(name, reference.time, expected, actual))
    return tuple(result)


__all__ = ["Deviation", "Verification", "verify_fmu"]
