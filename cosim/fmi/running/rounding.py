"""Whole numbers of 64 bits that a double cannot represent: if they are not connected, a run uses the nearest double."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.fmi.binaries.groups import MAY_ROUND, ROUNDED, Group
from bayesftc.cosim.fmi.reading.description import FMUVariable


class Roundable(Protocol):
    """An instance with such outputs."""

    @property
    def wide_outputs(self) -> tuple[str, ...]:
        """Names of the outputs that are whole numbers of 64 bits."""

    def let_round(self, names: Collection[str]) -> None:
        """Allow these to be rounded from now on."""

    def rounded_outputs(self) -> tuple[str, ...]:
        """Return the names of the outputs that were rounded."""


class Rounding:
    """The `Roundable` of an instance in this process.

    Parameters
    ----------
    outputs : sequence of Group
        The instance's outputs.
    elements : sequence of (str, FMUVariable)
        Name and variable of each of their elements.
    """

    def __init__(self, outputs: Sequence[Group], elements: Sequence[tuple[str, FMUVariable]]):
        self._groups = [(g, [v.name for _, v in elements[g.span]]) for g in outputs if g.kind.is_wide]

    @property
    def wide_outputs(self) -> tuple[str, ...]:
        """See `Roundable.wide_outputs`."""
        return tuple(dict.fromkeys(name for _, names in self._groups for name in names))

    def let_round(self, names: Collection[str]) -> None:
        """See `Roundable.let_round`."""
        for group, group_names in self._groups:
            for i, name in enumerate(group_names):
                if name in names:
                    group.rounding[i] = MAY_ROUND

    def rounded_outputs(self) -> tuple[str, ...]:
        """See `Roundable.rounded_outputs`."""
        marked = (
            name for g, group_names in self._groups for i, name in enumerate(group_names) if g.rounding[i] == ROUNDED
        )
        return tuple(dict.fromkeys(marked))


def warn_of_rounding(outputs: Roundable, name: str) -> None:
    """Warn at the end of a run that outputs of a block were rounded."""
    rounded = [repr(output) for output in outputs.rounded_outputs()]
    if rounded:
        warn_user(
            f"{' and '.join(rounded)} of {name!r} reached whole numbers of 2**53 or more, which a double cannot represent "
            "exactly. The result contains the nearest doubles. Leave these outputs out by outputs=[...] if you do not need them."
        )
