"""Every error a user can meet: a sentence that says what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.run.result import Result


class BayesFTCError(Exception):
    """Base of all errors of this package; ``exit_code`` is what the command line returns for it."""

    exit_code = 1


class ScenarioError(BayesFTCError):
    """A scenario file that cannot be read or does not say what it must."""

    exit_code = 3


class FMUError(BayesFTCError):
    """An FMU that cannot be used: missing, corrupt, or used against what it says of itself."""

    exit_code = 4


class FMUPlatformError(FMUError):
    """An FMU without a binary for this platform."""

    exit_code = 13


class FMUVersionError(FMUError):
    """An FMU of a version or kind of FMI that cannot be used."""

    exit_code = 14


class SSPError(FMUError):
    """An SSP that cannot be used, or a diagram that cannot be one."""

    exit_code = 18


class UnknownNameError(BayesFTCError, KeyError):
    """A variable, port, block or signal that does not exist."""

    exit_code = 5

    def __str__(self) -> str:  # KeyError would print the repr
        return str(self.args[0])


class ConnectionError(BayesFTCError):
    """A connection that cannot be made: sizes, units, direction, or a doubled source."""

    exit_code = 6


class UnconnectedInputError(ConnectionError):
    """An input that has neither a source nor a start value."""

    exit_code = 15


class AlgebraicLoopError(BayesFTCError):
    """Blocks whose outputs depend on each other at the same instant."""

    exit_code = 7


class StepSizeError(BayesFTCError, ValueError):
    """A duration or sample time that is no whole number of base steps."""

    exit_code = 8


class ModelError(BayesFTCError, ValueError):
    """A model or setting whose numbers cannot be right (dimensions, covariances, ranges)."""

    exit_code = 9


class KernelError(BayesFTCError, TypeError):
    """A step function that breaks the block contract and so cannot be compiled."""

    exit_code = 10


class SimulationError(BayesFTCError):
    """A run that had to stop; what was recorded up to there is kept.

    Attributes
    ----------
    result : Result or None
        The signals up to the last good step.
    """

    exit_code = 11

    def __init__(self, message: str, result: Result | None = None):
        super().__init__(message)
        self.result = result


class FMUCrashed(SimulationError, FMUError):
    """An isolated FMU whose process died, or had to be ended because a call did not come back.

    Attributes
    ----------
    result : Result or None
        The signals up to the last good step; None if it happened before the run.
    step : int or None
        The step at which it happened.
    time : float or None
        The simulated time at which it happened, in seconds.
    log : tuple of str
        What the FMU logged last.
    """

    exit_code = 17

    def __init__(
        self,
        message: str,
        result: Result | None = None,
        *,
        step: int | None = None,
        time: float | None = None,
        log: Iterable[str] = (),
    ):
        super().__init__(message, result)
        self.step, self.time, self.log = step, time, tuple(log)


class ResultFileError(BayesFTCError):
    """A result file that cannot be written, or is no result of ours."""

    exit_code = 12


class RecordingError(BayesFTCError, ValueError):
    """A recording that cannot be read, or whose samples do not fit together."""

    exit_code = 16


class StoreError(BayesFTCError):
    """A stored campaign that cannot be read or written, or is another than the one that is to go on."""

    exit_code = 20


def brief(value: object, length: int = 60) -> str:
    """Return what someone has given, short enough for a sentence."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write out whole numbers of more than 4300 digits
        return "a number of thousands of digits"
    return text if len(text) <= length else f"{text[: length - 3]}..."


LAX = "try it all the same with validate=False (bayesftc inspect: --no-validate)."
"""What can be done about a file that breaks the rules of FMI or SSP."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the tail of a sentence about an unknown name: the near names, else all of them."""
    known = sorted(known)
    near = [k for k in known if k.lower() == str(name).lower()] or get_close_matches(str(name), known, n=3, cutoff=0.6)
    if near:
        return f"did you mean {' or '.join(repr(n) for n in near)}?"
    if not known:
        return "there are none."
    shown = ", ".join(known[:12]) + (f", and {len(known) - 12} more" if len(known) > 12 else "")
    return f"known names: {shown}."
