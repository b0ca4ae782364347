"""Whole numbers of 64 bits that no double holds: where nothing is connected to them, a run goes on with the nearest double."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.fmi.binaries.groups import MAY_ROUND, ROUNDED, Group
from bayesftc.cosim.fmi.reading.description import FMUVariable


class Roundable(Protocol):
    """What an instance says of such outputs."""

    @property
    def wide_outputs(self) -> tuple[str, ...]:
        """Names of the outputs that are whole numbers of 64 bits."""

    def let_round(self, names: Collection[str]) -> None:
        """Let these be rounded from now on, where no double holds them."""

    def rounded_outputs(self) -> tuple[str, ...]:
        """Return the names of those that were."""


class Rounding:
    """See `Roundable`, of an instance in this process.

    Parameters
    ----------
    outputs : sequence of Group
        Its outputs.
    elements : sequence of (str, FMUVariable)
        Name and variable of each of their elements.
    """

    def __init__(self, outputs: Sequence[Group], elements: Sequence[tuple[str, FMUVariable]]):
        self._groups = [(g, [v.name for _, v in elements[g.mine]]) for g in outputs if g.kind.is_wide]

    @property
    def wide_outputs(self) -> tuple[str, ...]:
        """See `Roundable.wide_outputs`."""
        return tuple(dict.fromkeys(name for _, names in self._groups for name in names))

    def let_round(self, names: Collection[str]) -> None:
        """See `Roundable.let_round`."""
        for group, own in self._groups:
            for i, name in enumerate(own):
                if name in names:
                    group.rounding[i] = MAY_ROUND

    def rounded_outputs(self) -> tuple[str, ...]:
        """See `Roundable.rounded_outputs`."""
        marked = (name for g, own in self._groups for i, name in enumerate(own) if g.rounding[i] == ROUNDED)
        return tuple(dict.fromkeys(marked))


def warn_of_rounding(outputs: Roundable, name: str) -> None:
    """Warn that outputs of a block were rounded in a run that ends."""
    found = [repr(output) for output in outputs.rounded_outputs()]
    if found:
        warn_user(
            f"{' and '.join(found)} of {name!r} reached whole numbers that no double holds exactly (2**53 or more): the result "
            "has the nearest ones. Nothing is connected to them; leave them out by outputs=[...] if nobody needs them."
        )
