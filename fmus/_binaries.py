"""The binaries of an FMU: compiled in parallel, and put into the folders that importers use."""

import struct
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bayesftc.fmus._compiler import compile_library
from bayesftc.fmus._platforms import Platform, host
from bayesftc.fmus._processes import Processes

__all__ = ["binaries"]

_UNIVERSAL, _PAGE_BITS = 0xCAFEBABE, 14  # magic number of Mach-O files for several processors; pages of the larger kind


def binaries(
    name: str,
    sources: Mapping[str, bytes],
    compiled: Sequence[str],
    libraries: Sequence[str],
    fmi: str,
    platforms: Sequence[Platform] | None,
) -> dict[str, bytes]:
    """Compile an FMU's sources.

    Parameters
    ----------
    name : str
        Stem of the libraries' file names.
    sources : mapping of str to bytes
        The C files and headers by name.
    compiled : sequence of str
        Names of the files to compile.
    libraries : sequence of str
        System libraries to link.
    fmi : {"2.0", "3.0"}
        Version of the standard.
    platforms : sequence of Platform or None
        Platforms to compile for, with ``ziglang``; None for this machine's, with its own compiler if it has one.

    Returns
    -------
    dict
        Name in the FMU to content.

    Raises
    ------
    CompilerError
        If there is no compiler or it fails.
    """
    targets = tuple(dict.fromkeys(platforms)) if platforms is not None else (host(),)
    compilers = Processes()

    def library(target: Platform) -> bytes:
        # A folder for each: compilers also write import libraries and symbol files beside their output.
        with tempfile.TemporaryDirectory(prefix="bayesftc-") as scratch:
            folder = Path(scratch)
            for file, content in sources.items():
                (folder / file).write_bytes(content)
            path = folder / f"{name}{target.suffix}"
            portable = platforms is not None
            compile_library(folder, compiled, path, target, libraries, portable=portable, processes=compilers)
            return path.read_bytes()

    with ThreadPoolExecutor(max_workers=len(targets) or 1) as pool:
        try:
            built = dict(zip(targets, pool.map(library, targets), strict=True))
        except BaseException:  # an error of one, or Ctrl-C: the others are not needed any more
            compilers.end()
            raise
    return {f"binaries/{folder}/{name}{suffix}": content for (folder, suffix), content in _placed(built, fmi).items()}


def _placed(built: Mapping[Platform, bytes], fmi: str) -> dict[tuple[str, str], bytes]:
    """Return the libraries by folder and suffix.

    FMI 2.0 has folders only for x86; version 2.0.4 (section 2.3) uses those of FMI 3.0 for other processors. But importers on ARM
    use the folder of x86. So the one of macOS has a library for both processors. Linux has no such libraries: its folder has the
    library for ARM if there is none for x86.
    """
    if fmi != "2.0":
        return {(target.fmi3, target.suffix): content for target, content in built.items()}
    placed = {(target.fmi2, target.suffix): content for target, content in built.items()}
    for target in built:
        together = [content for other, content in built.items() if other.usual == target.usual]
        if target.system == "Darwin" and len(together) > 1:
            placed[target.usual, target.suffix] = _universal(together)
        else:
            placed.setdefault((target.usual, target.suffix), built[target])
    return placed


def _universal(libraries: Sequence[bytes]) -> bytes:
    """Return one Mach-O file made of several for different processors."""
    page = 1 << _PAGE_BITS
    head, body, end = struct.pack(">2I", _UNIVERSAL, len(libraries)), b"", page
    for library in libraries:
        processor = struct.unpack_from("<2I", library, 4)
        head += struct.pack(">5I", *processor, end, len(library), _PAGE_BITS)
        body += library + bytes(-len(library) % page)
        end = page + len(body)
    return head.ljust(page, b"\0") + body
