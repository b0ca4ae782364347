"""Warnings that show the user's line, however deep in this package they are raised."""

from __future__ import annotations

import dataclasses
import os
import sys
import warnings
from types import FrameType

import bayesftc

_PACKAGE = os.path.dirname(os.path.abspath(bayesftc.__file__)) + os.sep


def warn_user(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line outside this package, or at the outermost line if there is none."""
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and (frame.f_code.co_filename.startswith(_PACKAGE) or _made(frame) or _imports(frame)):
        level += not _imports(frame)
        frame = frame.f_back
    warnings.warn(text, category, stacklevel=level)


def _made(frame: FrameType) -> bool:
    """Return whether a frame belongs to the constructor that Python makes for a dataclass, or to `dataclasses.replace`."""
    code = frame.f_code
    return code.co_filename == dataclasses.__file__ or (code.co_filename, code.co_name) == ("<string>", "__init__")


def _imports(frame: FrameType) -> bool:
    """Return whether a frame belongs to the import of a module. `warnings.warn` does not count such frames."""
    name = frame.f_code.co_filename
    return "importlib" in name and "_bootstrap" in name


__all__ = ["warn_user"]
