"""FMUs with C sources but no binary for this platform: their sources are compiled, once per machine."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.errors import FMUPlatformError
from bayesftc.cosim.fmi.reading.archive import DESCRIPTION, Archive, extract, read_entry
from bayesftc.cosim.fmi.reading.description import FMUDescription
from bayesftc.cosim.fmi.reading.messages import logger

BUILD = "sources/buildDescription.xml"
_LONGEST = 300.0
_SHOWN = 1000


@dataclass(frozen=True)
class Sources:
    """The sources that an FMU lists for its binary.

    Attributes
    ----------
    files : tuple of str
        C files, relative to the folder ``sources``.
    includes : tuple of str
        Folders with headers, relative to the same folder.
    definitions : tuple of str
        Macros, as ``NAME`` or ``NAME=value``.
    libraries : tuple of str
        Libraries of the system.
    major : int
        2 or 3: the version of FMI.
    """

    files: tuple[str, ...]
    includes: tuple[str, ...] = ()
    definitions: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    major: int = 2


def read_sources(archive: Archive, description: FMUDescription, *, exchange: bool = False) -> Sources | None:
    """Return the sources of an FMU, or None if it has none that can be compiled here.

    Parameters
    ----------
    archive : Archive
        The FMU.
    description : FMUDescription
        Its model description.
    exchange : bool
        Whether it is used for model exchange.
    """
    if BUILD in archive.names:
        sources = _from_build(ElementTree.fromstring(read_entry(archive, BUILD)), description.identifier)
    else:
        root = ElementTree.fromstring(read_entry(archive, DESCRIPTION))
        kind = "ModelExchange" if exchange else "CoSimulation"
        sources = Sources(tuple(f.get("name", "") for f in root.findall(f"{kind}/SourceFiles/File")))
    if sources is None or not sources.files or not all(f"sources/{name}" in archive.names for name in sources.files):
        return None
    return (
        replace(sources, major=description.fmi_major) if all(_stays_inside(name) for name in sources.includes) else None
    )


def _from_build(root: ElementTree.Element, identifier: str) -> Sources | None:
    for configuration in root.findall("BuildConfiguration"):
        sets = configuration.findall("SourceFileSet")
        if configuration.get("modelIdentifier") != identifier or configuration.get("platform"):
            continue
        if not all(
            (s.get("language") or "C99").startswith("C") and "++" not in (s.get("language") or "") for s in sets
        ):
            continue
        return Sources(
            tuple(f.get("name", "") for s in sets for f in s.findall("SourceFile")),
            tuple(d.get("name", "") for s in sets for d in s.findall("IncludeDirectory")),
            tuple(
                _definition(d) for s in sets for d in s.findall("PreprocessorDefinition") if d.get("optional") != "true"
            ),
            tuple(b.get("name", "") for b in configuration.findall("Library") if b.get("external") == "true"),
        )
    return None


def _definition(element: ElementTree.Element) -> str:
    value = element.get("value")
    return element.get("name", "") + ("" if value is None else f"={value}")


def _stays_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


def compiled(archive: Archive, sources: Sources, platform: str, entry: str) -> Path:
    """Compile an FMU's sources for this machine, unless that was done before.

    Parameters
    ----------
    archive : Archive
        The FMU.
    sources : Sources
        What to compile.
    platform, entry : str
        The platform's name, and the path of the binary in the FMU.

    Returns
    -------
    pathlib.Path
        The folder with the FMU's content and the new binary.

    Raises
    ------
    FMUPlatformError
        If there is no compiler, or the sources cannot be compiled.
    """
    from filelock import FileLock

    folder = extract(archive, f"sources/{sources.files[0]}")
    with FileLock(cache_directory("fmus") / f"{archive.digest}.compile.lock"):
        if not (folder / entry).exists():
            _compile(archive, folder, sources, platform, entry)
    return folder


def _compile(archive: Archive, folder: Path, sources: Sources, platform: str, entry: str) -> None:
    from bayesftc.fmus._compiler import CompilerError, compile_foreign

    logger.warning("The FMU %s has no binary for %s: compiling its sources.", archive.path.name, platform)
    target = folder / entry
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=target.parent, suffix=".tmp")
    os.close(handle)
    libraries = [*sources.libraries, *(["m"] if os.name == "posix" else [])]
    try:
        for options in _attempts(sources):
            compile_foreign(folder / "sources", sources.files, Path(temporary), options, libraries, _LONGEST)
            if _has_functions(Path(temporary), sources.major):
                break
        else:
            raise CompilerError("they do not define the functions of FMI")
        os.replace(temporary, target)
    except CompilerError as error:
        text = str(error).replace(str(folder), "<fmu>")
        raise FMUPlatformError(
            f"The FMU {archive.path} has no binary for this platform, {platform}, and its sources cannot be compiled: "
            f"{text[:_SHOWN].rstrip().removesuffix('.')}. Export it for {platform}, or correct these errors."
        ) from None
    finally:
        Path(temporary).unlink(missing_ok=True)


def _attempts(sources: Sources) -> Iterator[list[str]]:
    """Yield compiler options that give the functions the names of a binary's functions.

    In sources, the standard puts the model's name before the functions' names. A macro removes it, except in the headers of FMI
    2 before 2.0.4. For these, a newer header is included first and takes their place.
    """
    import fmpy

    headers = Path(fmpy.__file__).parent / "c-code"  # the standard's headers, for FMUs that contain none
    common = [
        *(f"-D{name}" for name in sources.definitions),
        *(f"-I{name}" for name in sources.includes),
        "-I.",
        "-idirafter",
        str(headers),
        f"-DFMI{sources.major}_OVERRIDE_FUNCTION_PREFIX",
    ]
    yield common
    yield [*common, "-include", str(headers / f"fmi{sources.major}Functions.h")]


def _has_functions(library: Path, major: int) -> bool:
    """Whether a library exports the functions of FMI without a prefix; names in it are between zero bytes."""
    return re.search(rb"\0_?fmi%dGetVersion\0" % major, library.read_bytes()) is not None
