"""Pickle a campaign for other processes; with cloudpickle, including functions of scripts and notebooks."""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from types import CodeType, FunctionType, ModuleType
from typing import Any

from bayesftc.cosim.errors import ModelError, brief

Reduced = tuple[Callable[..., Any], tuple[Any, ...]]
Substitute = Callable[[Any], Reduced | None]
"""Returns a function and its arguments that are pickled in place of an object, or None for the object itself."""


def pickled(work: object, substitute: Substitute = lambda value: None) -> bytes:
    """Return an object as bytes that another process can read.

    Parameters
    ----------
    work : object
        The object, such as a job.
    substitute : callable, optional
        Called with each object in it.

    Raises
    ------
    ModelError
        If it cannot be pickled; the message names the part, with the remedy.
    """
    try:
        return _bytes(work, substitute)
    except _Unknown as error:
        reason = str(error)
    except Exception as error:  # noqa: BLE001 - a user's object may raise anything
        culprit = next(_culprits(work, substitute), "a part of it")
        reason = (
            f"{culprit} cannot be pickled ({brief(str(error), 120)}); use plain settings in it, or create it in the "
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
        def reducer_override(self, value: Any) -> Any:
            other = substitute(value)
            if other is not None:
                return other
            if isinstance(value, ModuleType) and sys.modules.get(value.__name__) is value:
                return import_module, (value.__name__,)  # modules of any kind; cloudpickle supports only plain ones
            if cloudpickle and isinstance(value, CodeType):
                return _with_file(value, *self.dispatch_table[CodeType](value))
            if cloudpickle:
                return super().reducer_override(value)
            _check_importable(value)
            return NotImplemented

    pickler: pickle.Pickler = Pickler(file, protocol=pickle.HIGHEST_PROTOCOL)
    return pickler


def _with_file(code: CodeType, make: Any, arguments: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    """Keep the file's name, which cloudpickle 3.1.3 drops: the reason of a failed run names the line."""
    return make, tuple(code.co_filename if item == "<dynamic-code>" else item for item in arguments)


def _cloudpickle() -> ModuleType | None:
    try:
        import cloudpickle
    except ImportError:
        return None
    module: ModuleType = cloudpickle
    return module


class _Unknown(Exception):
    """A function or class that another process cannot import."""


def _check_importable(value: Any) -> None:
    """Refuse functions and classes that another process cannot import."""
    if not isinstance(value, FunctionType | type):
        return
    name = value.__qualname__
    if value.__module__ == "__main__" or "<" in name:
        where = "this script or notebook" if value.__module__ == "__main__" else "another function"
        raise _Unknown(
            f"{name} is defined in {where}, from where they cannot import it; define it at the top of a separate module, or "
            "install cloudpickle (pip install 'bayesftc[campaign]')"
        )


def _culprits(work: object, substitute: Substitute) -> Iterator[str]:
    """Yield names of the parts of a job that cannot be pickled, as narrowly as is easily possible."""
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
        except Exception:  # noqa: BLE001 - any error means that this part cannot be pickled
            yield name


__all__ = ["Reduced", "pickled"]
