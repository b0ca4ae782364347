"""Write files that appear complete or not at all, even if the process is killed, the disk is full or the power fails."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bayesftc.cosim.errors import StoreError

TEMPORARY = ".tmp"
"""Suffix of files that are being written. A killed writer may leave such a file, and the next writer overwrites it."""


def write_whole(path: Path, data: Any, temporary: Path | None = None) -> int:
    """Write a file under a temporary name, flush it to the disk, and then rename it; return its size in bytes.

    Parameters
    ----------
    path : pathlib.Path
        The file; an existing one is replaced. Only one process may write it at a time.
    data : buffer
        Its content.
    temporary : pathlib.Path, optional
        The temporary name, in the same folder.

    Raises
    ------
    OSError
        If it cannot be written; the temporary file is removed.
    """
    temporary = temporary or path.with_name(path.name + TEMPORARY)
    try:
        with open(temporary, "wb", buffering=0) as file:
            view = memoryview(data).cast("B")
            written = 0
            while written < len(view):  # a full disk accepts a part first, and then refuses
                written += file.write(view[written:]) or 0
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    return written


def sync_folder(path: Path) -> None:
    """Flush the names of a folder's files to the disk; without this, a power failure may undo the last renamings."""
    if os.name == "nt":  # Windows cannot open folders, and need not
        return
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network file systems do not support it
            raise
    finally:
        os.close(folder)


def sync_all(path: Path) -> None:
    """Flush everything in a folder to the disk."""
    for entry in path.rglob("*"):
        if entry.is_dir():
            sync_folder(entry)
        else:
            with open(entry, "rb") as file:
                os.fsync(file.fileno())
    sync_folder(path)


@contextmanager
def written_to(root: Path) -> Iterator[None]:
    """Convert an `OSError` in the body into a `StoreError` about a campaign that cannot be written.

    Raises
    ------
    StoreError
        In place of the `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"Nothing more can be written to the campaign {root} ({error.strerror or error}); remove the cause and resume it. "
            "Finished runs are kept."
        ) from None


__all__ = ["TEMPORARY", "sync_all", "sync_folder", "write_whole", "written_to"]
