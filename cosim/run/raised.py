"""What a user's code has raised in a run, as the reason for which that run has failed."""

from __future__ import annotations

import traceback
from pathlib import Path

from bayesftc.cosim.errors import BayesFTCError


def reason_of(error: Exception, what: str) -> str:
    """Return a sentence: of this package's own errors theirs, of others `what` with the error and where it comes from.

    Parameters
    ----------
    error : Exception
        What was raised.
    what : str
        What could not be done, as a sentence without its end.
    """
    if isinstance(error, BayesFTCError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
    return f"{what}: {type(error).__name__}: {error}{where}"


__all__ = ["reason_of"]
