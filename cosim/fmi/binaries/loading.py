"""Binaries of FMUs: selected or compiled, and loaded once per process."""

from __future__ import annotations

import ctypes
import os
import re
import threading
from pathlib import Path, PurePosixPath

from bayesftc.cosim.errors import FMUError, FMUPlatformError
from bayesftc.cosim.fmi.binaries.library import Library, Library2, Library3
from bayesftc.cosim.fmi.binaries.surroundings import Surroundings
from bayesftc.cosim.fmi.reading.archive import Archive, extract
from bayesftc.cosim.fmi.reading.description import FMUDescription
from bayesftc.cosim.fmi.reading.messages import logger
from bayesftc.cosim.fmi.reading.sources import compiled, read_sources

_SHOWN = 3
_NAMED = 5
"""Largest number of missing functions in a message."""

_lock = threading.RLock()
_loaded: dict[tuple[str, bool], Library] = {}


def binary_entry(archive: Archive, description: FMUDescription) -> tuple[str, str]:
    """Return this platform's name in the FMU's version of FMI, and the entry of its binary (present or not).

    On ARM, FMI 2.0.4 has the folders of FMI 3.0. Many exporters use those of x86, so these are searched, too. A binary whose
    name is not the model identifier is used if it is the only one.
    """
    import fmpy

    usual, exact = fmpy.platform, fmpy.platform_tuple
    folders = (exact,) if description.fmi_major == 3 else (exact, usual) if fmpy.architecture == "aarch64" else (usual,)
    file = f"{description.identifier}{fmpy.sharedLibraryExtension}"
    platform = next((folder for folder in folders if f"binaries/{folder}/{file}" in archive.names), "")
    if platform:
        return platform, f"binaries/{platform}/{file}"
    for folder in folders:
        others = _binaries(archive, folder)
        if len(others) == 1:
            return folder, f"binaries/{folder}/{others[0]}"
    return folders[-1], f"binaries/{folders[-1]}/{file}"


def _binaries(archive: Archive, platform: str) -> list[str]:
    """Return the names of the libraries in the folder of a platform."""
    import fmpy

    paths = [PurePosixPath(name) for name in archive.names]
    folder = PurePosixPath("binaries", platform)
    return sorted({p.name for p in paths if p.parent == folder and p.suffix == fmpy.sharedLibraryExtension})


def misnamed(description: FMUDescription, entry: str) -> str:
    """Return the end of a sentence about a binary whose name is not the model identifier; nothing if it is."""
    name = PurePosixPath(entry)
    if name.stem == description.identifier:
        return ""
    return (
        f"is named {name.name} instead of {description.identifier}{name.suffix} (modelIdentifier), but is the only one"
    )


def load_library(archive: Archive, description: FMUDescription, *, exchange: bool = False) -> Library:
    """Unpack an FMU and load its binary, both only once; for model exchange with `exchange`, else for co-simulation.

    Raises
    ------
    FMUError
        If there is no binary for this platform and its sources cannot be compiled, or the binary cannot be loaded.
    """
    with _lock:
        if (archive.digest, exchange) not in _loaded:
            platform, entry = binary_entry(archive, description)
            if entry in archive.names:
                if other := misnamed(description, entry):
                    logger.warning(
                        "The binary of the FMU %s for %s %s, and is used.", archive.path.name, platform, other
                    )
                folder = extract(archive, entry)
            else:
                sources = read_sources(archive, description, exchange=exchange)
                if sources is None:
                    platforms = ", ".join(archive.platforms()) or "no binaries at all"
                    what = f"binary for this platform, {platform} (it has: {platforms})"
                    if platform in archive.platforms():
                        others = " and ".join(_binaries(archive, platform)[:_SHOWN]) or "no binary at all"
                        what = f"binary {PurePosixPath(entry).name} for this platform, {platform} (but {others} there)"
                    raise FMUPlatformError(
                        f"The FMU {archive.path} has no {what}, and no C sources that can be compiled here. Export it for "
                        f"{platform}, or with its sources."
                    )
                folder = compiled(archive, sources, platform, entry)
            _loaded[archive.digest, exchange] = _load(archive, description, folder, entry, exchange)
        return _loaded[archive.digest, exchange]


def _load(archive: Archive, description: FMUDescription, folder: Path, entry: str, exchange: bool) -> Library:
    from fmpy.fmi1 import FMU1Model, FMU1Slave
    from fmpy.fmi2 import FMU2Model, FMU2Slave
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    from bayesftc.cosim.fmi.binaries.library1 import Library1
    from bayesftc.cosim.fmi.binaries.model_library import ModelLibrary2, ModelLibrary3
    from bayesftc.cosim.fmi.binaries.model_library1 import ModelLibrary1

    binding, library_type = {
        (1, False): (FMU1Slave, Library1),
        (1, True): (FMU1Model, ModelLibrary1),
        (2, False): (FMU2Slave, Library2),
        (2, True): (FMU2Model, ModelLibrary2),
        (3, False): (FMU3Slave, Library3),
        (3, True): (FMU3Model, ModelLibrary3),
    }[description.fmi_major, exchange]
    settings = {
        "guid": description.token,
        "modelIdentifier": description.identifier,
        "unzipDirectory": str(folder),
        "instanceName": description.name,
        "libraryPath": str(folder / entry),
    }
    if description.fmi_major == 3:  # fmpy derives the path from the identifier, and uses it for nothing else
        settings["modelIdentifier"] = PurePosixPath(entry).stem
    folder_before = os.getcwd()
    try:
        with Surroundings():
            slave = binding(**settings)
            keep = ctypes.CDLL(str(folder / entry))
    except AttributeError as error:  # of ctypes
        name = re.search(r"\w*fmi\d?[A-Z]\w*", str(error))
        names = _missing(binding, description.fmi_major, folder / entry) or ([name[0]] if name else [])
        what, required = f"the function {names[0]}" if names else "a function", "it, even if it only returns an error"
        if len(names) > 1:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            what = f"{len(names)} functions: {', '.join(names[:_NAMED])}{more}"
            required = "all, even if they only return an error"
        raise FMUError(
            f"The binary of the FMU {archive.path} cannot be loaded: it lacks {what}. FMI {description.fmi_version} requires "
            f"{required}. Ask the maker of the FMU for a complete binary."
        ) from None
    except Exception as error:  # noqa: BLE001 - fmpy raises plain Exception
        raise FMUError(
            f"The binary of the FMU {archive.path} cannot be loaded: {_reason(error, folder)}. Install the libraries that it "
            "needs, or ask its maker for a binary for this system."
        ) from None
    finally:
        os.chdir(folder_before)  # fmpy changes to the binary's folder, and does not return if loading fails
    return library_type(description, slave, keep)


def _missing(binding: type, major: int, binary: Path) -> list[str]:
    """Return the functions of FMI that a binary lacks; of FMI 1, where they have other names, none."""
    library = ctypes.CDLL(str(binary))
    names = [name for name in dir(binding) if name.startswith(f"fmi{major}") and major > 1]
    return [name for name in names if not hasattr(library, name)]


def _reason(error: Exception, folder: Path) -> str:
    text = str(error).replace(str(folder), "<fmu>").strip().removesuffix(".")
    return text.removeprefix("Failed to load shared library ") or type(error).__name__
