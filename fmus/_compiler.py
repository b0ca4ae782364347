"""Find a C compiler and call it."""

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bayesftc.fmus._platforms import Platform, host
from bayesftc.fmus._processes import Processes

FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared", "-s")
"""C99 arithmetic without fused multiply-adds: the same digits from every compiler and on every platform."""

FOREIGN_FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared", "-w")
"""Flags for sources of other tools, which have their own C dialect and exports."""

_LONGEST = 900.0
"""Time limit of a compiler in seconds: at its first use ziglang builds a C library."""


class CompilerError(RuntimeError):
    """No compiler was found, or it failed."""


def why_no_compiler() -> str:
    """Return a sentence on why nothing can be compiled for this machine; empty if there is a compiler."""
    try:
        compiler_command(None)
    except CompilerError as error:
        return str(error)
    return ""


def compiler_command(target: Platform | None) -> list[str]:
    """Return the command that compiles for a platform.

    For this machine's platform it is the first of: the environment variable ``CC``; ``cc``, ``gcc`` or ``clang`` from the search
    path; the compiler of the Python package ``ziglang``. For other platforms it is ``ziglang``.

    Parameters
    ----------
    target : Platform or None
        The platform to compile for; None for this machine, also if it is not in the list.

    Returns
    -------
    list of str
        Program and first arguments.

    Raises
    ------
    CompilerError
        If there is none.
    """
    if target is not None and target != host():
        return cross_command(target)
    chosen = shlex.split(os.environ.get("CC", ""))
    if chosen:
        if shutil.which(chosen[0]) is None:
            raise CompilerError(
                f"The environment variable CC names the compiler '{chosen[0]}', which cannot be run. Correct or unset CC."
            )
        return chosen
    for name in ("cc", "gcc", "clang"):
        if shutil.which(name) is not None:
            return [name]
    if _has_ziglang():
        return _ziglang(target)
    where = target.fmi3 if target else "this machine"
    raise CompilerError(
        f"No C compiler for {where} was found (tried CC, cc, gcc, clang and ziglang). Install one, for example with "
        "'pip install ziglang'."
    )


def cross_command(target: Platform) -> list[str]:
    """Return the command of ``ziglang`` that compiles for a platform, the same on every machine.

    Parameters
    ----------
    target : Platform
        The platform to compile for, this machine's or another.

    Returns
    -------
    list of str
        Program and first arguments.

    Raises
    ------
    CompilerError
        If ``ziglang`` is not installed.
    """
    if not _has_ziglang():
        raise CompilerError(
            f"Binaries for {target.name} need the package ziglang, which is not installed. Install it with: "
            "pip install 'bayesftc[export]'."
        )
    return _ziglang(target)


def _has_ziglang() -> bool:
    return importlib.util.find_spec("ziglang") is not None


def _ziglang(target: Platform | None) -> list[str]:
    return [sys.executable, "-m", "ziglang", "cc", *(["-target", target.zig_target] if target else [])]


def compile_library(
    folder: Path,
    sources: Sequence[str],
    library: Path,
    target: Platform,
    libraries: Sequence[str] = (),
    *,
    portable: bool = False,
    processes: Processes | None = None,
) -> None:
    """Compile sources into a shared library.

    Parameters
    ----------
    folder : pathlib.Path
        Folder with the sources and all headers. The compiler runs in it, so the library contains no path of this machine.
    sources : sequence of str
        Names of the C files in the folder.
    library : pathlib.Path
        Absolute path of the library to write.
    target : Platform
        The platform to compile for.
    libraries : sequence of str
        System libraries to link.
    portable : bool
        Whether to use ``ziglang`` also for this machine's platform: the library then runs on old systems, and has the same bytes
        on every machine.
    processes : Processes, optional
        The group of processes for the compiler.

    Raises
    ------
    CompilerError
        If there is no compiler or it fails; the message ends with the compiler's output.
    """
    command = [
        *(cross_command(target) if portable else compiler_command(target)),
        *FLAGS,
        "-I.",
        *sources,
        "-o",
        # Relative to the folder, if possible: libraries of macOS contain this path.
        str(library.relative_to(folder) if library.is_relative_to(folder) else library),
        *(f"-l{name}" for name in libraries),
    ]
    if "ziglang" in command:
        _check_cache()
    _run(command, folder, sources, _LONGEST, processes)


def _check_cache() -> None:
    """Raise an error if ziglang cannot write to its cache; it would wait for ever."""
    home = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    cache = Path(os.environ.get("ZIG_GLOBAL_CACHE_DIR") or Path(home, "zig"))
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache):
            pass
    except OSError as error:
        raise CompilerError(
            f"The cache of the C compiler 'ziglang' is {cache}, where nothing can be written ({error.strerror or error}). Set "
            "the environment variable ZIG_GLOBAL_CACHE_DIR to another folder."
        ) from None


def compile_foreign(
    folder: Path, sources: Sequence[str], library: Path, options: Sequence[str], libraries: Sequence[str], limit: float
) -> None:
    """Compile sources from other tools into a shared library for this machine.

    Parameters
    ----------
    folder : pathlib.Path
        Folder in which the compiler runs.
    sources : sequence of str
        Names of the C files, relative to the folder.
    library : pathlib.Path
        Absolute path of the library to write.
    options : sequence of str
        Macros and folders of headers.
    libraries : sequence of str
        System libraries to link.
    limit : float
        Seconds after which the compiler is stopped.

    Raises
    ------
    CompilerError
        If there is no compiler, it fails or takes too long; the message ends with the compiler's output.
    """
    files = [f"./{name}" for name in sources]  # otherwise a name that begins with a dash would be an option
    linked = [f"-l{name}" for name in libraries]
    command = [*compiler_command(None), *FOREIGN_FLAGS, *options, *files, "-o", str(library), *linked]
    _run(command, folder, sources, limit)


def _run(
    command: Sequence[str], folder: Path, sources: Sequence[str], limit: float, processes: Processes | None = None
) -> None:
    compiler = "ziglang" if "ziglang" in command else command[0]
    try:
        done = (processes or Processes()).run(command, folder, limit)
    except OSError as error:
        raise CompilerError(f"The C compiler '{compiler}' could not be started: {error}.") from error
    except subprocess.TimeoutExpired:
        raise CompilerError(
            f"The C compiler '{compiler}' did not finish {', '.join(sources)} in {limit:g} s."
        ) from None
    if done.returncode != 0:
        raise CompilerError(f"The C compiler '{compiler}' failed with {', '.join(sources)}:\n{done.stderr.strip()}")
