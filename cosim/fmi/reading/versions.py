"""The supported versions of FMI, and the prefixes of their functions' names."""

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
    """Check that the FMI version of an FMU is supported.

    Raises
    ------
    FMUVersionError
        If it is not. Drafts are not supported: their functions differ from those of the final standard.
    """
    if version in VERSIONS:
        return
    what = f"FMI {version[:_SHOWN]}" if version else "FMI without a version"
    if _DRAFT.match(version):
        what += ", a draft that differs from the final standard"
    raise FMUVersionError(
        f"{archive.path} is an FMU of {what}, but only FMI 1.0, 2.0 and 3.0 can be used. Export the model as FMI 2.0 or 3.0."
    )


def prefix(major: int) -> str:
    """Return the prefix of the names of FMI's functions in a version; that of FMI 1 has no number."""
    return "fmi" if major == 1 else f"fmi{major}"
