"""Paths from users, which may be any text: these checks return False where pathlib raises an error."""

from __future__ import annotations

import os
from os.path import exists, isdir as is_folder, isfile as is_file
from pathlib import Path


def expanded(path: str | os.PathLike[str]) -> Path:
    """Return a path with the home folder in place of ``~``; unchanged if there is no such user."""
    return Path(os.path.expanduser(path))


__all__ = ["exists", "expanded", "is_file", "is_folder"]
