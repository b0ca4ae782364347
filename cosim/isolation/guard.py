"""What surrounds every piece of a run, whoever makes it: settings of this process that FMUs may change."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Self

from bayesftc.cosim.block import External
from bayesftc.cosim.fmi.binaries.surroundings import Surroundings
from bayesftc.cosim.fmi.reading import embedded


class Guard:
    """A ``with`` around the steps of a run without FMUs, which needs nothing; it can be used repeatedly, but not nested.

    Attributes
    ----------
    changed : bool
        Whether an FMU has changed this thread's arithmetic, which was restored.
    interrupted : bool
        Whether Ctrl-C arrived in an FMU's Python code.
    inside : int
        See `Surroundings`; 0 if only the ``with`` does all.
    """

    changed = False
    interrupted = False
    inside: int = 0

    def settle(self) -> None:
        """See `Surroundings`."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass


class _OfFMUs(Surroundings, Guard):
    """The guard of a run with FMUs in this process."""


class _OfPython(_OfFMUs):
    """The guard of a run with FMUs in this Python interpreter."""

    def __init__(self) -> None:
        super().__init__()
        self.inside = 0
        self._stack = ExitStack()
        self._interrupts: list[int] = []

    def __enter__(self) -> Self:
        super().__enter__()
        self._interrupts = self._stack.enter_context(embedded.interrupts())
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()
        super().__exit__()
        self.interrupted = bool(self._interrupts)


def guard_of(instances: Mapping[int, External]) -> Guard:
    """Return the guard of a run with these FMUs: most need little of it, and live runs enter it at every step."""
    if not instances:
        return Guard()
    return _OfPython() if embedded.in_use() else _OfFMUs()
