"""The settings of an isolated FMU, checked where a block is made; what runs it (`instance`) loads with the run."""

from __future__ import annotations

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

DEFAULT_LIMIT = 10.0
"""Seconds that a call of an isolated FMU may take unless said otherwise."""


def check_isolation(isolate: object, time_limit: object) -> None:
    """Check the settings of an FMU.

    Raises
    ------
    ModelError
        If one is none, or a time limit is given for an FMU in process, which nothing can end.
    """
    if not isinstance(isolate, bool):
        raise ModelError(f"FMU has isolate={isolate!r}; it must be True or False.")
    if time_limit is None:
        return
    if not real(time_limit) > 0:
        raise ModelError(f"FMU has time_limit={time_limit!r}; it must be a positive number of seconds, or None.")
    if not isolate:
        raise ModelError(
            f"FMU has time_limit={time_limit!r}, but a call of an FMU in this process cannot be ended: give isolate=True as "
            "well, or give the run the time limit, simulate(..., time_limit=...), which is looked at between steps."
        )
