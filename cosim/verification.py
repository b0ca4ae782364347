"""Whether an FMU does what its blocks do: both run side by side, then the FMU runs in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from bayesftc.cosim._export.stand_in import PLACED, Place, StandIn
from bayesftc.cosim.block import Floats
from bayesftc.cosim.diagram import Diagram
from bayesftc.cosim.fmu import FMU
from bayesftc.cosim.result import Result

_SHORT = 20_000
"""Steps up to which the loop around an FMU takes less time in plain Python than to be compiled."""


@dataclass(frozen=True)
class Deviation:
    """How far a signal of the FMU is from that of the blocks.

    Attributes
    ----------
    signal : str
        Its name in the diagram.
    largest : float
        The largest absolute difference of any element at any step; infinite where one of the two is NaN and the other is not.
    time : float or None
        When it is met first, in seconds; None where there is no difference.
    ulps : float
        That difference in units in the last place: how many doubles lie between the two, plus one.
    relative : float
        It, by the largest absolute value of the signal.
    """

    signal: str
    largest: float
    time: float | None
    ulps: float
    relative: float


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
        return all(deviation.relative <= tolerance for deviation in (*self.beside, *(self.in_loop or ())))

    @property
    def worst_in_loop(self) -> Deviation | None:
        """The largest relative deviation with the FMU in the loop."""
        return max(self.in_loop, key=lambda deviation: deviation.relative, default=None) if self.in_loop else None

    def verdict(self, tolerance: float = 0.0) -> str:
        """Return in a sentence or two whether the FMU does what the blocks do.

        Parameters
        ----------
        tolerance : float
            As of `agrees`.
        """
        first, last = ", ".join(self.blocks[:-1]), self.blocks[-1]
        what = f"what {first} and {last} do" if first else f"what {last} does"
        if all(d.largest == 0.0 for d in (*self.beside, *(self.in_loop or ()))):
            return f"{self.path.name} does {what}: the same numbers at {self._at_all}."
        worst = max((*self.beside, *(self.in_loop or ())), key=lambda deviation: deviation.relative)
        times = " times" if worst.relative > 1.0 else " of"
        size = f"{worst.relative:.2g}{times} the largest value of {worst.signal}"
        if self.agrees(tolerance):
            return f"{self.path.name} does {what}, to the tolerance of {tolerance:g}: it differs by {size} at most."
        usual = (
            "" if worst.relative > 1e-9 else " So little is usual where exp, log or sin come from another C library."
        )
        return f"{self.path.name} does NOT do {what}: it differs by {size}.{usual}"

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
    recorded = [*dict.fromkeys(f"{block}.{port}" for block, port, _ in (*stands.into, *stands.out))]
    shown = [f"{n.name}.{p.name}" for n in diagram.nodes for p in n.block.outputs]
    real = diagram.simulate(duration, seed=seed, engine=engine, record=[*dict.fromkeys([*recorded, *shown])])
    around: Literal["auto", "interpreted"] = "interpreted" if len(real.time) <= _SHORT else "auto"
    fed = np.column_stack([np.zeros(len(real.time)), *(_column(real, place) for place in stands.into)])

    alone = Diagram(diagram.step)
    stands.place(alone, fed)
    run = alone.simulate(duration, engine="interpreted")
    beside = _deviations(real, {place: _column(run, (PLACED, *at)) for place, at in stands.out.items()})

    notes = list(stands.notes)
    deaf = stands.unheard()
    in_loop = None
    if deaf:
        notes.append(f"It cannot be put in their place: the diagram hears {deaf}, which the FMU does not have.")
    else:
        run = stands.in_loop(fed).simulate(duration, seed=seed, engine=around)
        placed = {place: _column(run, (PLACED, *at)) for place, at in stands.out.items()}
        others = {
            (node.name, port.name, i): _column(run, (node.name, port.name, i))
            for node in diagram.nodes
            if node.name not in stands.blocks
            for port in node.block.outputs
            for i in range(port.size)
        }
        in_loop = _deviations(real, placed | others)
    return Verification(Path(path), stands.blocks, len(real.time), diagram.step, seed, beside, in_loop, tuple(notes))


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


def deviation(signal: str, time: Floats, expected: Floats, got: Floats) -> Deviation:
    """Return how far apart two recordings of a signal are, with a row for each time."""
    with np.errstate(invalid="ignore"):  # the difference of infinities
        apart = np.abs(got - expected)
    apart[np.isnan(apart)] = np.inf
    apart[(got == expected) | (np.isnan(got) & np.isnan(expected))] = 0.0
    row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
    largest = float(apart[row, column])
    if largest == 0.0:
        return Deviation(signal, 0.0, None, 0.0, 0.0)
    size = float(np.max(np.abs(expected[np.isfinite(expected)]), initial=0.0))
    ulps = np.inf if not np.isfinite(largest) else float(_between(got[row, column], expected[row, column]))
    return Deviation(signal, largest, float(time[row]), ulps, largest / size if size else np.inf)


def _between(one: float, other: float) -> int:
    """Return how many steps from a double to the next one lead from one number to another."""
    first, second = (int(np.float64(abs(x)).view(np.int64)) * (-1 if x < 0.0 else 1) for x in (one, other))
    return abs(first - second)


__all__ = ["Deviation", "Verification", "verify_fmu"]
