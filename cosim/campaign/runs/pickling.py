"""A campaign as bytes, for other processes: with functions of scripts and notebooks where cloudpickle is installed."""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from types import FunctionType, ModuleType
from typing import Any

from bayesftc.cosim.errors import ModelError, brief

Reduced = tuple[Callable[..., Any], tuple[Any, ...]]
Substitute = Callable[[Any], Reduced | None]
"""What is pickled in an object's place: a function and its arguments that make it, or None for the object itself."""


def pickled(work: object, substitute: Substitute = lambda thing: None) -> bytes:
    """Return an object as bytes that another process can read.

    Parameters
    ----------
    work : object
        A job, say.
    substitute : callable, optional
        Asked for each object.

    Raises
    ------
    ModelError
        If it cannot be pickled; the sentence says what in it, and what to do.
    """
    try:
        return _bytes(work, substitute)
    except _Unknown as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - what users have in their objects raises what it likes
        culprit = next(_culprits(work, substitute), "a part of it")
        reason = (
            f"{culprit} cannot be pickled ({brief(str(error), 120)}); make it of plain settings, or make it in the "
            "function that returns the loop"
        )
    raise ModelError(f"The campaign cannot run in other processes: {reason}; or use executor=Threads().") from None


def _bytes(work: object, substitute: Substitute) -> bytes:
    file = io.BytesIO()
    _pickler(file, substitute).dump(work)
    return file.getvalue()


def _pickler(file: io.BytesIO, substitute: Substitute) -> pickle.Pickler:
    cloudpickle = _cloudpickle()
    base: Any = cloudpickle.Pickler if cloudpickle else pickle.Pickler

    class Pickler(base):  # type: ignore[misc, unused-ignore]
        def reducer_override(self, thing: Any) -> Any:
            other = substitute(thing)
            if other is not None:
                return other
            if isinstance(thing, ModuleType) and sys.modules.get(thing.__name__) is thing:
                return import_module, (thing.__name__,)  # of which kind ever: cloudpickle knows plain ones alone
            if cloudpickle:
                return super().reducer_override(thing)
            _check_importable(thing)
            return NotImplemented

    made: pickle.Pickler = Pickler(file, protocol=pickle.HIGHEST_PROTOCOL)
    return made


def _cloudpickle() -> ModuleType | None:
    try:
        import cloudpickle
    except ImportError:
        return None
    found: ModuleType = cloudpickle
    return found


class _Unknown(Exception):
    """Something that another process would not find."""


def _check_importable(thing: Any) -> None:
    """Refuse functions and classes that another process cannot import."""
    if not isinstance(thing, FunctionType | type):
        return
    name = thing.__qualname__
    if thing.__module__ == "__main__" or "<" in name:
        where = "this script or notebook" if thing.__module__ == "__main__" else "another function"
        raise _Unknown(
            f"{name} is defined in {where}, where they do not find it: define it at the top of a module of its own, a file that "
            "is imported, or install cloudpickle (pip install 'bayesftc[campaign]')"
        )


def _culprits(work: object, substitute: Substitute) -> Iterator[str]:
    """Yield what of a job cannot be pickled, as narrowly as it is easily told."""
    plan = getattr(work, "plan", None)
    parts = [
        *((f"the factor {name!r}", value) for point in getattr(plan, "points", ()) for name, value in point.items()),
        *((f"the metric {brief(metric)}", metric) for metric in getattr(work, "metrics", ())),
    ]
    loop = getattr(work, "loop", None)
    for node in getattr(loop, "nodes", ()):
        parts.append((f"the block {node.name!r}", node.block))
    if loop is not None:
        parts.append(("the function that makes the loop" if callable(loop) else "the loop", loop))
    for name, part in parts:
        try:
            _bytes(part, substitute)
        except Exception:  # noqa: BLE001 - this one it is
            yield name


__all__ = ["Reduced", "pickled"]
