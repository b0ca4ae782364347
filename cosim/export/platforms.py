"""Names of platforms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean

if TYPE_CHECKING:
    from bayesftc.fmus._platforms import Platform

ALL = "all"


def platforms_of(given: Sequence[str] | str | None) -> tuple[Platform, ...] | None:
    """Return the platforms of some names, each once, in the package's order; None for None.

    Parameters
    ----------
    given : sequence of str or str or None
        Names as ``"linux-x86_64"``, or folder names of FMI 3.0 and 2.0, as ``"x86_64-linux"`` and ``"linux64"``; or ``"all"``.

    Raises
    ------
    UnknownNameError
        If there is no such platform.
    ModelError
        If these are no names, or there are none.
    """
    from bayesftc.fmus._platforms import PLATFORMS

    if given is None:
        return None
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Sequence) else [given]
    by_name = {platform.name: platform for platform in PLATFORMS}
    by_any_name = {name: platform for platform in PLATFORMS for name in (platform.fmi2, platform.fmi3)} | by_name
    for name in names:
        if not isinstance(name, str):
            raise ModelError(f"platforms={given!r} contains {name!r}, which is no name; {did_you_mean('', by_name)}")
        if name != ALL and name not in by_any_name:
            raise UnknownNameError(
                f"Binaries for the platform {name!r} are not supported; {did_you_mean(name, [*by_name, ALL])}"
            )
    if not names:
        raise ModelError(
            f"platforms={given!r} is empty; leave it out for this machine's platform, or choose from {', '.join(by_name)}."
        )
    selected = PLATFORMS if ALL in names else {by_any_name[name] for name in names}
    return tuple(platform for platform in PLATFORMS if platform in selected)
