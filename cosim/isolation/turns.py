"""Which processors host and isolated FMU use, which run alternately."""

from __future__ import annotations

from bayesftc.cosim.isolation import protocol

OFTEN = 0.1
"""Share of commands with a sleep from which on host and FMU rather share a processor."""

FIRST_AGAIN, LAST_AGAIN = 16, 1024
"""Thousands of commands until processors of their own are tried again, at first and at last."""


class Turns:
    """Where an FMU's process runs for its next `protocol.PAUSE` commands: ANYWHERE, TOGETHER with the host, or APART from it.

    Apart, both look at the memory that they share, and need not wake each other. On a busy machine they often wait so long for a
    processor that they sleep all the same: then they are better together, and are apart again for a try, ever more rarely.

    Parameters
    ----------
    processors : int
        How many the process may use.
    """

    def __init__(self, processors: int):
        self._can_part, self._home = processors > 1, protocol.ANYWHERE
        self._rest, self._again = 0, FIRST_AGAIN

    def next(self, is_quick: bool, slept: int) -> int:
        """Return where to run next, from whether the last commands were quick and how often one of both slept meanwhile."""
        if not is_quick:
            self._home = protocol.ANYWHERE
        elif self._home == protocol.APART and slept > OFTEN * protocol.PAUSE:
            self._home, self._rest, self._again = protocol.TOGETHER, self._again, min(2 * self._again, LAST_AGAIN)
        elif not self._can_part or self._rest > 0:
            self._home, self._rest = protocol.TOGETHER, self._rest - 1
        else:
            self._home = protocol.APART
        return self._home
