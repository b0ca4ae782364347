"""Files of compiled code in the user's cache folder: written completely or not at all, and read only if the user owns them."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from bayesftc.cosim.base.cache import is_own
from bayesftc.cosim.errors import BayesFTCError

STATISTICS = {"compiled": 0, "loaded": 0}
"""How many functions this process has compiled, and how many it has loaded from the disk."""


def write_whole(path: Path, content: bytes, stamp: float | None = None) -> None:
    """Write a complete file, with a fixed time stamp if given.

    Raises
    ------
    BayesFTCError
        If the folder cannot be written.
    """
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        if stamp is not None:
            os.utime(temporary, (stamp, stamp))
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise unwritable(path, error) from None


def read_own(path: Path) -> bytes | None:
    """Return the content of a file; None if it does not exist or belongs to another user."""
    try:
        return path.read_bytes() if is_own(path) else None
    except OSError:
        return None


def unwritable(path: Path, error: OSError) -> BayesFTCError:
    """Return the error for a cache folder that cannot be written."""
    return BayesFTCError(
        f"The cache folder {path.parent} cannot be written ({error.strerror}); set BAYESFTC_CACHE to a writable folder, or make "
        "room there."
    )
