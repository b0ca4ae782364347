"""The lock of a campaign's single writer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesftc.cosim.errors import StoreError


def locked(path: Path) -> Any:
    """Take and return the lock of the campaign's writer; the system releases it when the process ends in any way."""
    from filelock import FileLock, Timeout

    lock = FileLock(path / ".lock", timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        raise StoreError(
            f"Another process is writing the campaign in {path}; wait until it has ended, or stop it."
        ) from None
    except OSError as error:
        raise StoreError(f"The campaign in {path} cannot be written: {error.strerror or error}.") from None
    return lock


__all__ = ["locked"]
