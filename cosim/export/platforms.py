"""The platforms that someone names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean

if TYPE_CHECKING:
    from bayesftc.fmus._platforms import Platform

ALL = "all"


def platforms_of(given: Sequence[str] | str | None) -> tuple[Platform, ...] | None:
    """Return the platforms of some names, each once and in the package's own order; None where none is named.

    Parameters
    ----------
    given : sequence of str or str or None
        Names as ``"linux-x86_64"``, or as the folders of FMI 3.0 and 2.0 are called, ``"x86_64-linux"`` and ``"linux64"``;
        ``"all"`` for all.

    Raises
    ------
    UnknownNameError
        If there is no such platform.
    ModelError
        If what is given are no names, or none.
    """
    from bayesftc.fmus._platforms import PLATFORMS

    if given is None:
        return None
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Sequence) else [given]
    known = {platform.name: platform for platform in PLATFORMS}
    found = {name: platform for platform in PLATFORMS for name in (platform.fmi2, platform.fmi3)} | known
    for name in names:
        if not isinstance(name, str):
            raise ModelError(f"platforms={given!r} has {name!r} in it, which is no name; {did_you_mean('', known)}")
        if name != ALL and name not in found:
            raise UnknownNameError(
                f"Binaries cannot be made for the platform {name!r}; {did_you_mean(name, [*known, ALL])}"
            )
    if not names:
        raise ModelError(
            f"platforms={given!r} names none; leave it away for this machine's, or name some of {', '.join(known)}."
        )
    wanted = PLATFORMS if ALL in names else {found[name] for name in names}
    return tuple(platform for platform in PLATFORMS if platform in wanted)
