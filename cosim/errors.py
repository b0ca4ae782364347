"""All errors of this package. Each message states what is wrong, where, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from os.path import splitext
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.run.result import Result


FILES = (".toml", ".csv", ".fmu", ".parquet")
"""Endings of files, which say nothing of their names."""


class BayesFTCError(Exception):
    """Base of all errors of this package; the command line ends with its ``exit_code``."""

    exit_code = 1


class ScenarioError(BayesFTCError):
    """A scenario file that cannot be read, or whose content is wrong or incomplete."""

    exit_code = 3
    unknown: tuple[str, tuple[str, ...]] | None = None
    """An unknown key, and those that its table can have; None for other errors."""


class FMUError(BayesFTCError):
    """An FMU that cannot be used: missing, corrupt, or used against its model description."""

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
    """A connection that cannot be made: sizes, units or direction do not fit, or there are two sources."""

    exit_code = 6


class UnconnectedInputError(ConnectionError):
    """An input that has neither a source nor a start value."""

    exit_code = 15


class AlgebraicLoopError(BayesFTCError):
    """Blocks whose outputs depend on each other at the same instant."""

    exit_code = 7


class StepSizeError(BayesFTCError, ValueError):
    """A duration or sample time that is not a whole number of base steps."""

    exit_code = 8


class ModelError(BayesFTCError, ValueError):
    """A model or setting whose numbers cannot be right (dimensions, covariances, ranges)."""

    exit_code = 9


class KernelError(BayesFTCError, TypeError):
    """A step function that breaks the contract of blocks and cannot be compiled."""

    exit_code = 10


class SimulationError(BayesFTCError):
    """A run that had to stop; the signals recorded until then are kept.

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
    """An isolated FMU whose process died, or was ended because a call did not return.

    Attributes
    ----------
    result : Result or None
        The signals up to the last good step; None if the process died before the run.
    step : int or None
        The step at which the process died.
    time : float or None
        The simulated time at which the process died, in seconds.
    log : tuple of str
        The last messages of the FMU.
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
    """A result file that cannot be written, or was not written by this package."""

    exit_code = 12


class RecordingError(BayesFTCError, ValueError):
    """A recording that cannot be read, or whose samples do not fit together."""

    exit_code = 16


class StoreError(BayesFTCError):
    """A stored campaign that cannot be read or written, or that differs from the campaign to continue."""

    exit_code = 20


def brief(value: object, length: int = 60) -> str:
    """Return the text of a given value, short enough for a message."""
    if isinstance(value, type):  # a forgotten pair of parentheses
        return f"the class {value.__name__} (make an object of it: {value.__name__}(...))"
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not write out whole numbers of more than 4300 digits
        return "a number of thousands of digits"
    return text if len(text) <= length else f"{text[: length - 3]}..."


LAX = "try it all the same with validate=False (bayesftc inspect: --no-validate)."
"""The remedy for a file that breaks the rules of FMI or SSP."""


def _alike(name: str, other: str) -> bool:
    """Return whether names of files are similar without the ending that they share, such as ``.toml``; True of other names."""
    (stem, ending), (other_stem, other_ending) = splitext(name), splitext(other)
    shared = ending in FILES and ending == other_ending
    return not shared or bool(get_close_matches(stem, [other_stem], cutoff=0.6))


def _close(name: str, names: Sequence[str]) -> list[str]:
    """Return up to three similar names; of the signals of a known block those of similar ends: all begin alike."""
    block, dot, end = name.rpartition(".")
    of_block = {n.rpartition(".")[2]: n for n in names if n.rpartition(".")[0] == block}
    if dot and of_block:
        return [of_block[n] for n in _close(end, sorted(of_block))] or (
            [*of_block.values()] if len(of_block) == 1 else []
        )
    return [n for n in get_close_matches(name, names, n=3, cutoff=0.6) if _alike(name, n)]


def did_you_mean(name: object, names: Iterable[str], before: str = "", others: Iterable[str] = ()) -> str:
    """Return the end of a message about an unknown name: similar names if there are any, else all names (of the block).

    `before` stands before each name in the message. Of `others` only similar ones are named.
    """
    listed = sorted(names)
    names = sorted({*listed, *others})
    wrong = str(name).lower()
    near = [n for n in names if n.lower() == wrong] or [n for n in names if n.lower().endswith(f".{wrong}")][:3]
    near = near or _close(str(name), names)
    near = near or [n for n in names if len(wrong) > 2 and n.lower().startswith(wrong)][:3]
    if near:
        return f"did you mean {' or '.join(repr(before + n) for n in near)}?"
    if not listed:
        return "there are none."
    block, dot, _ = str(name).rpartition(".")
    listed = [n for n in listed if dot and n.rpartition(".")[0] == block] or listed
    shown = ", ".join(before + n for n in listed[:12]) + (f", and {len(listed) - 12} more" if len(listed) > 12 else "")
    return f"known names: {shown}."
