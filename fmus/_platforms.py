"""The platforms that FMUs are built for. One more is one more row here, where ``ziglang`` can compile for it."""

import platform
from dataclasses import dataclass

__all__ = ["PLATFORMS", "Platform", "host"]


@dataclass(frozen=True)
class Platform:
    """How one platform is called by us, by the standards and by the compiler, and what a shared library is there.

    Parameters
    ----------
    name : str
        As users write it.
    system, machine : str
        As :func:`platform.system` and :func:`platform.machine` say.
    fmi2, fmi3 : str
        Folder below ``binaries/`` in FMI 2.0, by section 2.3 of its version 2.0.4, and in FMI 3.0.
    usual : str
        Folder in which importers of FMI 2.0 look on this platform, whatever its processor (fmpy, and fmi4c in OMSimulator).
    suffix : str
        Suffix of shared libraries.
    zig_target : str
        Target of ``zig cc``; the C library or system is an old one on purpose, so that the binary runs on old systems.
    """

    name: str
    system: str
    machine: str
    fmi2: str
    fmi3: str
    usual: str
    suffix: str
    zig_target: str


PLATFORMS = (
    Platform(
        "linux-x86_64", "Linux", "x86_64", "linux64", "x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"
    ),
    Platform(
        "linux-aarch64", "Linux", "aarch64", "aarch64-linux", "aarch64-linux", "linux64", ".so", "aarch64-linux-gnu.2.17"
    ),
    Platform(
        "windows-x86_64", "Windows", "AMD64", "win64", "x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"
    ),
    Platform(
        "macos-x86_64", "Darwin", "x86_64", "darwin64", "x86_64-darwin", "darwin64", ".dylib", "x86_64-macos.11.0"
    ),
    Platform(
        "macos-aarch64", "Darwin", "arm64", "aarch64-darwin", "aarch64-darwin", "darwin64", ".dylib", "aarch64-macos.11.0"
    ),
)  # fmt: skip


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
    names = ", ".join(known.name for known in PLATFORMS)
    raise RuntimeError(f"FMUs cannot be built on {system} {machine}; build them on one of: {names}.")
