"""Errors about arguments that a class or function does not have, or lacks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from functools import lru_cache, wraps
from typing import Any, NamedTuple, Self, TypeVar

from bayesftc.cosim.errors import did_you_mean

_WORDS = {
    "after": ("start",),
    "amount": ("magnitude",),
    "begin": ("start",),
    "count": ("sensors",),
    "end": ("stop", "duration"),
    "from": ("start",),
    "factors": ("grid",),
    "goal": ("reference",),
    "grid": ("factors",),
    "length": ("duration",),
    "n": ("count",),
    "onset": ("start",),
    "params": ("parameters",),
    "seconds": ("duration",),
    "setpoint": ("reference",),
    "sigma": ("std",),
    "size": ("magnitude", "count"),
    "time": ("start",),
    "until": ("stop",),
    "value": ("at", "magnitude"),
}
"""Words that users try, with the arguments that they may mean."""


_F = TypeVar("_F", bound=Callable[..., Any])


class _Arguments(NamedTuple):
    """The names of all arguments, of those without a default, and of those that may be given without a name."""

    known: tuple[str, ...]
    required: tuple[str, ...]
    unnamed: tuple[str, ...]


def hint_at(name: str, known: Collection[str]) -> str:
    """Return the end of a message about an unknown argument or key: those that a user means by the word, else similar ones."""
    meant = [repr(word) for word in _WORDS.get(name, ()) if word in known]
    return f"did you mean {' or '.join(meant)}?" if meant else did_you_mean(name, known)


def check_arguments(called: Callable[..., Any], unnamed: int, named: Collection[str]) -> None:
    """Refuse arguments that a function or the constructor of a class does not have, and a call without those that it needs.

    Raises
    ------
    TypeError
        With the names that were meant, or all.
    """
    found = _arguments(called)
    if found is None:
        return
    known, title = found.known, called.__name__
    for name in named:
        if name not in known:
            raise TypeError(f"{title} has no argument {name!r}; {hint_at(name, known)}")
    if unnamed > len(found.unnamed):
        most = f"at most {len(found.unnamed)}" if found.unnamed else "none"
        raise TypeError(
            f"{title} has {unnamed} argument{'s' if unnamed > 1 else ''} without a name, but takes {most}; "
            f"write {_call(title, found.required if len(found.required) > 1 else known[:2])}."
        )
    if lacking := [name for name in found.required if name not in (*found.unnamed[:unnamed], *named)]:
        *others, last = map(repr, lacking)
        names = f"{', '.join(others)} and {last}" if others else last
        raise TypeError(
            f"{title} lacks the argument{'s' if others else ''} {names}; write {_call(title, found.required)}."
        )


def _call(title: str, names: Collection[str]) -> str:
    return f"{title}({', '.join(f'{name}=...' for name in names)})"


class NamedArguments:
    """Base of classes that name the right argument in place of one that they do not have, and those that are missing."""

    def __new__(cls, *args: Any, **settings: Any) -> Self:
        """Make the object; refuse arguments that the class does not have, with the names of those that it has."""
        if args or settings:  # a copy is made without any
            check_arguments(cls, len(args), settings)
        return super().__new__(cls)


def with_named_arguments(function: _F) -> _F:
    """Let a function or a method refuse arguments as classes do; see `NamedArguments`."""
    bound = int(next(iter(inspect.signature(function).parameters), "") == "self")

    @wraps(function)
    def checked(*args: Any, **settings: Any) -> Any:
        check_arguments(function, len(args) - bound, settings)
        return function(*args, **settings)

    return checked  # type: ignore[return-value]


@lru_cache(maxsize=1024)
def _arguments(called: Callable[..., Any]) -> _Arguments | None:
    """Return the arguments of a function or of a class's constructor; None if it takes any."""
    is_class = isinstance(called, type)
    parameters = list(inspect.signature(called.__init__ if is_class else called).parameters.values())  # type: ignore[misc]
    parameters = parameters[is_class or (bool(parameters) and parameters[0].name == "self") :]
    if not parameters or any(each.kind in {each.VAR_KEYWORD, each.VAR_POSITIONAL} for each in parameters):
        return None
    return _Arguments(
        tuple(each.name for each in parameters),
        tuple(each.name for each in parameters if each.default is each.empty),
        tuple(each.name for each in parameters if each.kind in {each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD}),
    )


__all__ = ["NamedArguments", "check_arguments", "hint_at", "with_named_arguments"]
