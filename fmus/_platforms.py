"""The platforms that FMUs are built for. One more is one more row here, where ``ziglang`` can compile for it."""

import platform
from dataclasses import dataclass

__all__ = ["PLATFORMS", "Platform", "host"]


@dataclass(frozen=True)
class Platform:
    """How one platform is called by the standards and by the compiler, and what a shared library is there.

    Parameters
    ----------
    system, machine : str
        As :func:`platform.system` and :func:`platform.machine` say.
    fmi2, fmi3 : str
        Folder below ``binaries/`` in FMI 2.0 and in FMI 3.0.
    suffix : str
        Suffix of shared libraries.
    zig_target : str
        Target of ``zig cc``; the glibc is an old one on purpose, so that the binary runs on old systems.
    """

    system: str
    machine: str
    fmi2: str
    fmi3: str
    suffix: str
    zig_target: str


PLATFORMS = (Platform("Linux", "x86_64", "linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),)


def host() -> Platform:
    """Return the platform that this process runs on.

    Raises
    ------
    RuntimeError
        If FMUs are not built for it.
    """
    system, machine = platform.system(), platform.machine()
    for known in PLATFORMS:
        if (known.system, known.machine) == (system, machine):
            return known
    names = ", ".join(f"{known.system} {known.machine}" for known in PLATFORMS)
    raise RuntimeError(f"FMUs cannot be built on {system} {machine}; build them on one of: {names}.")
