"""Whether an FMU does what its blocks do: both run side by side, then the FMU runs in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import SimulationError
from bayesftc.cosim.export.deviations import Deviation, deviation
from bayesftc.cosim.export.stand_in import PLACED, Place, StandIn
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

_SHORT = 20_000
"""Steps up to which the loop around an FMU takes less time in plain Python than to be compiled."""


@dataclass(frozen=True, repr=False)
class Verification:
    """What came out when an FMU ran beside the blocks that it stands for; its text is a table.

    Attributes
    ----------
    path : pathlib.Path
        The FMU.
    blocks : tuple of str
        The blocks that it stands for.
    steps : int
        How many steps were compared.
    step : Fraction
        The sample time in seconds.
    seed : int
        Seed of noise and faults.
    beside : tuple of Deviation
        Of each output, with the inputs of the blocks, random ones too.
    in_loop : tuple of Deviation or None
        Of each signal of the diagram, with the FMU in the place of the blocks; None where that cannot be.
    notes : tuple of str
        What is not compared, and why, in sentences.
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
            0 for the same numbers. Where ``exp``, ``log`` or ``sin`` come from another C library, 1e-9 is usual.
        """
        return all(each.relative <= tolerance for each in self._all)

    @property
    def worst_in_loop(self) -> Deviation | None:
        """The largest relative deviation with the FMU in the loop."""
        return max(self.in_loop or (), key=_relative, default=None)

    def verdict(self, tolerance: float = 0.0) -> str:
        """Return in a sentence or two whether the FMU does what the blocks do.

        Parameters
        ----------
        tolerance : float
            As of `agrees`.
        """
        first, last = ", ".join(self.blocks[:-1]), self.blocks[-1]
        what = f"what {first} and {last} do" if first else f"what {last} does"
        if all(each.largest == 0.0 for each in self._all):
            return f"{self.path.name} does {what}: the same numbers at {self._at_all}."
        worst = max(self._all, key=_relative)
        times = " times" if worst.relative > 1.0 else " of"
        size = f"{worst.relative:.2g}{times} the largest value of {worst.signal}"
        if self.agrees(tolerance):
            return f"{self.path.name} does {what}, to the tolerance of {tolerance:g}: it differs by {size} at most."
        usual = (
            "" if worst.relative > 1e-9 else " So little is usual where exp, log or sin come from another C library."
        )
        return f"{self.path.name} does NOT do {what}: it differs by {size}.{usual}"

    @property
    def _all(self) -> tuple[Deviation, ...]:
        return (*self.beside, *(self.in_loop or ()))

    @property
    def _at_all(self) -> str:
        return "the one step that was made" if self.steps == 1 else f"all {self.steps} steps"

    def __repr__(self) -> str:
        return self.report()

    def report(self, tolerance: float = 0.0) -> str:
        """Return the differences as a table, with the verdict below.

        Parameters
        ----------
        tolerance : float
            As of `agrees`.
        """
        rows = [("output", "largest difference", "at t in s", "units in the last place")]
        rows += [
            (d.signal, f"{d.largest:.3g}", "" if d.time is None else f"{d.time:g}", f"{d.ulps:.6g}")
            for d in self.beside
        ]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join([r[0].ljust(widths[0]), *map(str.rjust, r[1:], widths[1:])]).rstrip() for r in rows]
        worst = self.worst_in_loop
        if worst is not None:
            at = "" if worst.time is None else f", of {worst.signal} at t = {worst.time:g} s"
            lines.append(f"In the loop, in their place: {worst.largest:.3g} at most{at}.")
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
    """Run an FMU beside the blocks of a diagram that it stands for, and then in their place.

    The diagram runs first, with its noise and faults. Then the FMU gets what went into the blocks at each step, random numbers
    too, and its outputs are compared with theirs. At last it is put into the diagram instead of them, with the same random
    numbers, and all signals are compared. A NaN, a missing sample, equals a NaN.

    Parameters
    ----------
    path : str or path
        The FMU: one of `export_fmu`, or of any tool with inputs and outputs of the same names.
    diagram : Diagram
        The diagram; it is built and frozen if it is not yet.
    blocks : sequence of str, optional
        The blocks that the FMU stands for. By default those that it was exported from, else the only one with its inputs and
        outputs.
    duration : float, str or Fraction
        Seconds.
    seed : int
        Seed of all random numbers.
    timing : {"plant", "sampled"}, optional
        When the FMU's outputs hold, as `FMU` has it; by default what it says.
    isolate : bool
        Run the FMU in a process of its own: what would take this process down becomes `FMUCrashed`.
    engine : {"auto", "compiled", "interpreted"}
        What the diagram runs with. Around the FMU short runs are interpreted; the numbers are the same.

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
        If nobody says which blocks the FMU stands for.
    StepSizeError
        If the FMU makes steps of another size.
    SimulationError
        If a run has to stop.

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
    In the loop, in their place: 0 at most.
    <BLANKLINE>
    limit.fmu does what limit does: the same numbers at all 101 steps.
    """
    fmu = FMU(path, timing=timing, isolate=isolate)
    stands = StandIn(fmu, diagram, blocks)
    recorded = [f"{block}.{port}" for block, port, _ in (*stands.into, *stands.out)]
    shown = [f"{n.name}.{p.name}" for n in diagram.nodes for p in n.block.outputs]
    real = diagram.simulate(duration, seed=seed, engine=engine, record=[*dict.fromkeys([*recorded, *shown])])
    if real.stopped:
        raise SimulationError(real.stopped, real)
    fed = np.column_stack([np.zeros(len(real.time)), *(_column(real, place) for place in stands.into)])

    alone = Diagram(diagram.step)
    stands.place(alone, fed)
    beside = _deviations(real, _placed(alone.simulate(duration, engine="interpreted"), stands))

    notes = list(stands.notes)
    in_loop = None
    if deaf := stands.unheard():
        notes.append(f"It cannot be put in their place: the diagram hears {deaf}, which the FMU does not have.")
    else:
        around: Literal["auto", "interpreted"] = "interpreted" if len(real.time) <= _SHORT else "auto"
        run = stands.in_loop(fed).simulate(duration, seed=seed, engine=around)
        in_loop = _deviations(real, _placed(run, stands) | _others(run, diagram, stands))
    return Verification(Path(path), stands.blocks, len(real.time), diagram.step, seed, beside, in_loop, tuple(notes))


def _relative(each: Deviation) -> float:
    return each.relative


def _placed(run: Result, stands: StandIn) -> dict[Place, Floats]:
    """Return the outputs of the FMU by the elements of the blocks that they stand for."""
    return {place: _column(run, (PLACED, *at)) for place, at in stands.out.items()}


def _others(run: Result, diagram: Diagram, stands: StandIn) -> dict[Place, Floats]:
    """Return the outputs of all blocks that the FMU does not stand for."""
    return {
        (node.name, port.name, i): _column(run, (node.name, port.name, i))
        for node in diagram.nodes
        if node.name not in stands.blocks
        for port in node.block.outputs
        for i in range(port.size)
    }


def _column(result: Result, place: Place) -> Floats:
    values = np.asarray(result[f"{place[0]}.{place[1]}"], dtype=np.float64)
    return values.reshape(len(values), -1)[:, place[2]]


def _deviations(real: Result, values: Mapping[Place, Floats]) -> tuple[Deviation, ...]:
    signals: dict[str, list[Place]] = {}
    for place in values:
        signals.setdefault(f"{place[0]}.{place[1]}", []).append(place)
    found = []
    for name, places in signals.items():
        expected, got = (
            np.column_stack(columns) for columns in zip(*((_column(real, p), values[p]) for p in places), strict=True)
        )
        found.append(deviation(name, real.time, expected, got))
    return tuple(found)


__all__ = ["Deviation", "Verification", "verify_fmu"]
