"""Files that are under their names whole or not at all, whenever the process is killed, the disk full or the power cut."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bayesftc.cosim.errors import StoreError

TEMPORARY = ".tmp"
"""How the names of files end that are being written; a writer that was killed may leave one, and the next one writes over it."""


def write_whole(path: Path, data: Any) -> int:
    """Write a file under another name, have it on the disk, and only then give it its own; return its size in bytes.

    Parameters
    ----------
    path : pathlib.Path
        Its name; a file that is there is replaced. Only one process may write it at a time.
    data : buffer
        What is in it.

    Raises
    ------
    OSError
        If it cannot be written; nothing stays behind.
    """
    temporary = path.with_name(path.name + TEMPORARY)
    try:
        with open(temporary, "wb", buffering=0) as file:
            view = memoryview(data).cast("B")
            written = 0
            while written < len(view):  # a full disk takes a part first, and refuses then
                written += file.write(view[written:]) or 0
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    return written


def sync_folder(path: Path) -> None:
    """Have the names of a folder's files on the disk: until then a power cut may take back the last that were given."""
    if os.name == "nt":  # which opens no folders, and needs none
        return
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems of other machines know no such thing
            raise
    finally:
        os.close(folder)


def sync_all(path: Path) -> None:
    """Have all that is in a folder on the disk."""
    for found in path.rglob("*"):
        if found.is_dir():
            sync_folder(found)
        else:
            with open(found, "rb") as file:
                os.fsync(file.fileno())
    sync_folder(path)


@contextmanager
def written_to(root: Path) -> Iterator[None]:
    """Turn an `OSError` inside into the sentence about a campaign that nothing more can be written to.

    Raises
    ------
    StoreError
        In its place.
    """
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"Nothing more can be written to the campaign {root} ({error.strerror or error}); see to that and resume it: "
            "what is done is kept."
        ) from None


__all__ = ["TEMPORARY", "sync_all", "sync_folder", "write_whole", "written_to"]
