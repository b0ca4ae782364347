"""The settings of an isolated FMU, checked when a block is made; `instance` is loaded only with a run."""

from __future__ import annotations

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

DEFAULT_LIMIT = 10.0
"""Default of `time_limit`: seconds that a call of an isolated FMU may take."""


def check_isolation(isolate: object, time_limit: object) -> None:
    """Check the settings of an FMU.

    Raises
    ------
    ModelError
        If one is not valid, or a time limit is given for an FMU in process, whose calls cannot be ended.
    """
    if not isinstance(isolate, bool):
        raise ModelError(f"FMU has isolate={isolate!r}; it must be True or False.")
    if time_limit is None:
        return
    if not real(time_limit) > 0:
        raise ModelError(f"FMU has time_limit={time_limit!r}; it must be a positive number of seconds, or None.")
    if not isolate:
        raise ModelError(
            f"FMU has time_limit={time_limit!r}, but a call of an FMU in this process cannot be ended. Give isolate=True as "
            "well, or limit the run by simulate(..., time_limit=...), which is checked between steps."
        )
