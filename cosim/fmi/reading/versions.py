"""Which versions of FMI can be used, and what their functions are called."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import FMUVersionError

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.reading.archive import Archive

VERSIONS = ("1.0", "2.0", "3.0")

_DRAFT = re.compile(r"\d+(\.\d+)+[-_. ]?[a-zA-Z]")
_SHOWN = 40


def check_version(archive: Archive, version: str) -> None:
    """Check that an FMU is of a version of FMI that can be used.

    Raises
    ------
    FMUVersionError
        If it is of another one, or of a draft, whose functions are not those of the standard that came of it.
    """
    if version in VERSIONS:
        return
    what = f"FMI {version[:_SHOWN]}" if version else "FMI without a version"
    if _DRAFT.match(version):
        what += ", a draft that differs from the standard that came of it"
    raise FMUVersionError(
        f"{archive.path} is an FMU of {what}, and only FMI 1.0, 2.0 and 3.0 can be used: export the model as FMI 2.0 or 3.0."
    )


def prefix(major: int) -> str:
    """Return how the names of FMI's functions begin in a version: only those of FMI 1 have no number."""
    return "fmi" if major == 1 else f"fmi{major}"
