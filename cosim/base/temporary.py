"""Temporary folders that are locked as long as their process lives: the next one sweeps what a killed one has left.

The lock is the system's, on the folder itself, and ends with the process however that ends. A number of the process in the name
would not do: numbers are used again, and mean something else in a container or on another machine that shares the folder.
"""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType

from bayesftc.cosim.base.cache import is_own

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows, which cannot lock a folder: there the leftovers of killed processes stay
    fcntl = None

BESIDE = ".bayesftc-"
"""How the names of those begin that stand beside what they become."""

_RANDOM = 8
"""Letters that `tempfile` puts behind a prefix."""


@contextmanager
def temporary_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """Give an empty folder that only this user can open, and remove it at the end; sweep those of processes that were killed.

    Parameters
    ----------
    prefix : str
        How its name begins, and those of the folders to sweep: nothing of a user's may begin so.
    parent : pathlib.Path, optional
        Where; by default where the system has temporary files.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    parent = parent or Path(tempfile.gettempdir())
    _sweep(prefix, parent)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        lock = _locked(folder, wait=True)
        if folder.exists():  # else someone else has swept it before it was locked
            break
        _unlock(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)


def _sweep(prefix: str, parent: Path) -> None:
    with suppress(OSError):  # it is someone else's, or gone: whatever is there hurts nobody
        for folder in parent.glob(glob.escape(prefix) + "?" * _RANDOM):
            if not folder.is_symlink() and folder.is_dir() and is_own(folder):
                lock = _locked(folder, wait=False)
                if lock is not None:
                    shutil.rmtree(folder, ignore_errors=True)
                    _unlock(lock)


def _locked(folder: Path, *, wait: bool) -> int | None:
    """Return the descriptor of a folder that is locked now; None where it is another's, or nothing can be locked there."""
    if fcntl is None:
        return None
    descriptor = None
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return descriptor
    _unlock(descriptor)
    return None


def _unlock(descriptor: int | None) -> None:
    if descriptor is not None:
        os.close(descriptor)


__all__ = ["BESIDE", "temporary_folder"]
