"""Temporary folders that are locked while their process runs; the next process removes folders of killed processes.

The system's lock on the folder ends with the process, however that ends. The process's number in the name would not be enough:
numbers are reused, and differ in containers and on other machines that share the folder.
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
except ImportError:  # Windows cannot lock a folder: folders of killed processes stay
    fcntl = None

BESIDE = ".bayesftc-"
"""Prefix of temporary folders beside their targets."""

_RANDOM = 8
"""Characters that `tempfile` adds to a prefix."""


@contextmanager
def temporary_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """Provide an empty folder that only this user can open; remove it at the end, and those of killed processes, too.

    Parameters
    ----------
    prefix : str
        Prefix of its name, and of the folders to remove; no user's files may begin with it.
    parent : pathlib.Path, optional
        Its parent folder; by default the system's folder for temporary files.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    parent = parent or Path(tempfile.gettempdir())
    _sweep(prefix, parent)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        lock = _locked(folder, wait=True)
        if folder.exists():  # else another process has removed it before it was locked
            break
        _unlock(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)


def _sweep(prefix: str, parent: Path) -> None:
    with suppress(OSError):  # another user's folder, or already removed: leftovers are harmless
        for folder in parent.glob(glob.escape(prefix) + "?" * _RANDOM):
            if not folder.is_symlink() and folder.is_dir() and is_own(folder):
                lock = _locked(folder, wait=False)
                if lock is not None:
                    shutil.rmtree(folder, ignore_errors=True)
                    _unlock(lock)


def _locked(folder: Path, *, wait: bool) -> int | None:
    """Lock a folder and return its descriptor; None if another process has locked it, or locks are not supported."""
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
