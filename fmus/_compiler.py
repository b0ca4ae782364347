"""Find a C compiler and call it."""

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from bayesftc.fmus._platforms import Platform, host

# No contraction to fused multiply-adds and C99 arithmetic: the same digits from every compiler and on every platform.
FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared", "-s")


class CompilerError(RuntimeError):
    """No compiler was found, or it refused the sources."""


def compiler_command(target: Platform) -> list[str]:
    """Return the command that compiles for a platform.

    For this machine's own platform: what the environment variable ``CC`` names, else ``cc``, ``gcc`` or ``clang`` from
    the search path, else the compiler in the Python package ``ziglang``. For other platforms ``ziglang`` only.

    Parameters
    ----------
    target : Platform
        The platform to compile for.

    Returns
    -------
    list of str
        Program and first arguments.

    Raises
    ------
    CompilerError
        If there is none.
    """
    if target == host():
        chosen = shlex.split(os.environ.get("CC", ""))
        if chosen:
            if shutil.which(chosen[0]) is None:
                raise CompilerError(
                    f"The environment variable CC names the compiler '{chosen[0]}', which cannot be run; "
                    "correct or unset CC."
                )
            return chosen
        for name in ("cc", "gcc", "clang"):
            if shutil.which(name) is not None:
                return [name]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", target.zig_target]
    raise CompilerError(
        f"No C compiler for {target.fmi3} was found (looked at CC, cc, gcc, clang and ziglang); install one, "
        "for example with 'pip install ziglang'."
    )


def compile_library(
    folder: Path, sources: Sequence[str], library: Path, target: Platform, libraries: Sequence[str] = ()
) -> None:
    """Compile sources into a shared library.

    Parameters
    ----------
    folder : pathlib.Path
        Folder with the sources and all headers; the compiler runs in it, so that no path of this machine gets into the
        library.
    sources : sequence of str
        Names of the C files in the folder.
    library : pathlib.Path
        Absolute path of the library to write.
    target : Platform
        The platform to compile for.
    libraries : sequence of str
        System libraries to link.

    Raises
    ------
    CompilerError
        If there is no compiler or it fails; the message ends with what it said.
    """
    command = [
        *compiler_command(target),
        *FLAGS,
        "-I.",
        *sources,
        "-o",
        str(library),
        *(f"-l{name}" for name in libraries),
    ]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise CompilerError(f"The C compiler '{command[0]}' could not be started: {error}.") from error
    if done.returncode != 0:
        raise CompilerError(f"The C compiler '{command[0]}' refused {', '.join(sources)}:\n{done.stderr.strip()}")
