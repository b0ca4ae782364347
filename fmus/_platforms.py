"""The platforms that FMUs are built for. To add one for which ``ziglang`` can compile, add a row here."""

import platform
from dataclasses import dataclass

__all__ = ["PLATFORMS", "Platform", "host"]


@dataclass(frozen=True)
class Platform:
    """The names of a platform for users, the standards and the compiler, and the suffix of its shared libraries.

    Parameters
    ----------
    name : str
        Name for users.
    system, machine : str
        Values of :func:`platform.system` and :func:`platform.machine`.
    fmi2, fmi3 : str
        Folder below ``binaries/`` in FMI 2.0, by section 2.3 of its version 2.0.4, and in FMI 3.0.
    usual : str
        Folder that importers of FMI 2.0 use on this platform, for any processor (fmpy, and fmi4c in OMSimulator).
    suffix : str
        Suffix of shared libraries.
    zig_target : str
        Target of ``zig cc``. Its C library or system is old on purpose, so that the binary runs on old systems.
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
    Platform("linux-x86_64", "Linux", "x86_64", "linux64", "x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
    Platform(
        "linux-aarch64",
        "Linux",
        "aarch64",
        "aarch64-linux",
        "aarch64-linux",
        "linux64",
        ".so",
        "aarch64-linux-gnu.2.17",
    ),
    Platform("windows-x86_64", "Windows", "AMD64", "win64", "x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
    Platform(
        "macos-x86_64", "Darwin", "x86_64", "darwin64", "x86_64-darwin", "darwin64", ".dylib", "x86_64-macos.11.0"
    ),
    Platform(
        "macos-aarch64",
        "Darwin",
        "arm64",
        "aarch64-darwin",
        "aarch64-darwin",
        "darwin64",
        ".dylib",
        "aarch64-macos.11.0",
    ),
)


def host() -> Platform:
    """Return the platform of this process.

    Raises
    ------
    RuntimeError
        If FMUs are not built for it.
    """
    system, machine = platform.system(), platform.machine()
    for candidate in PLATFORMS:
        if (candidate.system, candidate.machine) == (system, machine):
            return candidate
    names = ", ".join(candidate.name for candidate in PLATFORMS)
    raise RuntimeError(f"FMUs cannot be built on {system} {machine}. Build them on one of: {names}.")
