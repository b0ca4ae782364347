"""Where this package keeps compiled code and extracted FMUs: one directory per user."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

from bayesftc.cosim.errors import BayesFTCError


@cache
def _directory(root: str | None, kind: str) -> Path:
    path = (Path(root) if root else user_cache_path("bayesftc", appauthor=False)) / kind
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()  # mkdir does not tell whether an existing folder can be written
    except OSError as error:
        raise BayesFTCError(
            f"The cache folder {path} cannot be written ({error.strerror}); set BAYESFTC_CACHE to a folder that can be written."
        ) from None
    return path


def cache_directory(kind: str) -> Path:
    """Return the folder for ``compiled`` code or ``fmus``, made if need be; ``BAYESFTC_CACHE`` moves it."""
    return _directory(os.environ.get("BAYESFTC_CACHE"), kind)
