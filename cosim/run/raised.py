"""Messages for exceptions of a user's code in a run."""

from __future__ import annotations

import traceback
from pathlib import Path

from bayesftc.cosim.errors import BayesFTCError


def reason_of(error: Exception, what: str) -> str:
    """Return the message of an error: as it is for errors of this package, else `what` with type, message and place.

    Parameters
    ----------
    error : Exception
        The exception.
    what : str
        A sentence about what could not be done, without its full stop.
    """
    if isinstance(error, BayesFTCError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
    return f"{what}: {type(error).__name__}: {error}{where}"


__all__ = ["reason_of"]
