"""Errors about arguments that a class does not have."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Self

from bayesftc.cosim.errors import did_you_mean

_WORDS = {
    "after": ("start",),
    "amount": ("magnitude",),
    "begin": ("start",),
    "count": ("sensors",),
    "end": ("stop", "duration"),
    "from": ("start",),
    "length": ("duration",),
    "n": ("count",),
    "onset": ("start",),
    "params": ("parameters",),
    "seconds": ("duration",),
    "sigma": ("std",),
    "size": ("magnitude", "count"),
    "time": ("start",),
    "until": ("stop",),
    "value": ("at", "magnitude"),
}
"""Words that users try, with the arguments that they may mean."""


def check_arguments(cls: type, unnamed: int, named: Iterable[str]) -> None:
    """Refuse arguments that the constructor of a class does not have.

    Raises
    ------
    TypeError
        With the names that were meant, or all.
    """
    known, positional = _arguments(cls)
    for name in named if known else ():
        if name not in known:
            meant = [repr(word) for word in _WORDS.get(name, ()) if word in known]
            hint = f"did you mean {' or '.join(meant)}?" if meant else did_you_mean(name, known)
            raise TypeError(f"{cls.__name__} has no argument {name!r}; {hint}")
    if known and unnamed > positional:
        example = f"{cls.__name__}({', '.join(f'{name}=...' for name in known[:2])})"
        most = f"at most {positional}" if positional else "none"
        raise TypeError(
            f"{cls.__name__} has {unnamed} argument{'s' if unnamed > 1 else ''} without a name, but takes {most}; "
            f"write {example}."
        )


class NamedArguments:
    """Base of classes that name the right argument in place of one that they do not have."""

    def __new__(cls, *args: Any, **settings: Any) -> Self:
        """Make the object; refuse arguments that the class does not have, with the names of those that it has."""
        if args or settings:
            check_arguments(cls, len(args), settings)
        return super().__new__(cls)


@lru_cache(maxsize=1024)
def _arguments(cls: type) -> tuple[tuple[str, ...], int]:
    """Return the names of all arguments, and how many may be given without a name; none if the constructor takes any."""
    parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]  # type: ignore[misc]
    if any(each.kind in {each.VAR_KEYWORD, each.VAR_POSITIONAL} for each in parameters):
        return (), 0
    positional = sum(each.kind in {each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD} for each in parameters)
    return tuple(each.name for each in parameters), positional


__all__ = ["NamedArguments", "check_arguments"]
