"""Build FMUs: sources, description and library of one model, in one reproducible zip file."""

import hashlib
import importlib.util
import os
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from bayesftc.fmus import _description2, _description3, _xml
from bayesftc.fmus._catalogue import FMI_VERSIONS, check_version, file_name
from bayesftc.fmus._compiler import CompilerError, compile_library
from bayesftc.fmus._header import config_header
from bayesftc.fmus._platforms import Platform, host
from bayesftc.fmus.spec import Model

__all__ = ["FMI_VERSIONS", "CompilerError", "build_fmu", "own_files"]

_C_FOLDER = Path(__file__).resolve().parent / "c"
_FMI_HEADERS = {
    "2.0": ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h"),
}
_NO_TOKEN = "{00000000-0000-0000-0000-000000000000}"


def _fmi_headers(fmi: str) -> dict[str, bytes]:
    """Read the standard's own headers, licence included, from the installed fmpy, without importing it."""
    found = importlib.util.find_spec("fmpy")
    if found is None or not found.submodule_search_locations:
        raise RuntimeError("The FMI headers come with the package 'fmpy', which is not installed; 'pip install fmpy'.")
    folder = Path(found.submodule_search_locations[0]) / "c-code"
    missing = [name for name in _FMI_HEADERS[fmi] if not (folder / name).is_file()]
    if missing:
        raise RuntimeError(f"The installed fmpy lacks the FMI header {missing[0]}; upgrade fmpy.")
    return {f"sources/{name}": (folder / name).read_bytes() for name in _FMI_HEADERS[fmi]}


def _with_token(model: Model, fmi: str, token: str) -> dict[str, bytes]:
    if fmi == "2.0":
        model = model.flat()
    own, compiled = _own_sources(model), _compiled_sources(model, fmi)
    needed = [compiled[0], "instance.h", "model.h"]
    needed += ["runge_kutta.h"] * any(b'"runge_kutta.h"' in text for text in own.values())
    files = {
        **{f"sources/{name}": text for name, text in own.items()},
        **{f"sources/{name}": (_C_FOLDER / name).read_bytes() for name in needed},
        "sources/model_config.h": config_header(model, token, time_variable=fmi == "3.0").encode(),
    }
    if fmi == "2.0":
        files["modelDescription.xml"] = _description2.model_description(model, token, compiled)
    else:
        files["modelDescription.xml"] = _description3.model_description(model, token)
        files["sources/buildDescription.xml"] = _xml.build_description(model, compiled)
    return files


def _own_sources(model: Model) -> dict[str, bytes]:
    """Return the model's own C files and headers by name."""
    if isinstance(model.source, Path):
        return {f"{model.name}.c": model.source.read_bytes()}
    return {name: text.encode() for name, text in model.source.items()}


def _compiled_sources(model: Model, fmi: str) -> tuple[str, ...]:
    """Return the names of the files to compile, the wrapper's first."""
    return f"fmi{fmi[0]}.c", *(name for name in _own_sources(model) if name.endswith(".c"))


def own_files(model: Model, *, fmi: str) -> dict[str, bytes]:
    """Write everything of an FMU but the standard's headers and the libraries.

    The token is a hash of these files, so that a library refuses to run with the description of other sources.

    Parameters
    ----------
    model : Model
        The model.
    fmi : {"2.0", "3.0"}
        Version of the standard.

    Returns
    -------
    dict
        Name in the FMU to content.
    """
    check_version(fmi)
    digest = hashlib.sha256()
    for name, content in sorted(_with_token(model, fmi, _NO_TOKEN).items()):
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return _with_token(model, fmi, "{" + str(uuid.UUID(bytes=digest.digest()[:16], version=5)) + "}")


def _compiled(model: Model, files: Mapping[str, bytes], fmi: str, target: Platform) -> dict[str, bytes]:
    folder_name = target.fmi2 if fmi == "2.0" else target.fmi3
    with tempfile.TemporaryDirectory(prefix="bayesftc-") as scratch:
        folder = Path(scratch)
        for name, content in files.items():
            (folder / Path(name).name).write_bytes(content)
        library = folder / f"{model.name}{target.suffix}"
        compile_library(folder, _compiled_sources(model, fmi), library, target, model.libraries)
        return {f"binaries/{folder_name}/{library.name}": library.read_bytes()}


def _write_zip(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip whose bytes depend on the content only, and put it in place at once."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name, content in sorted(files.items()):
                entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3  # unix, also where this runs elsewhere: the permissions below are unix ones
                entry.external_attr = 0o100644 << 16
                archive.writestr(entry, content, compresslevel=9)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def build_fmu(model: Model, folder: Path, *, fmi: str = "2.0", platforms: Sequence[Platform] | None = None) -> Path:
    """Build one FMU.

    Parameters
    ----------
    model : Model
        The model.
    folder : pathlib.Path
        Folder to write to; created if it is not there.
    fmi : {"2.0", "3.0"}
        Version of the standard.
    platforms : sequence of Platform, optional
        Platforms to compile for; this machine's by default.

    Returns
    -------
    pathlib.Path
        The FMU, ``<name>.fmu`` for FMI 2.0 and ``<name>_fmi3.fmu`` for FMI 3.0.

    Raises
    ------
    ValueError
        If the version is not known.
    CompilerError
        If no C compiler is found or it fails.
    """
    files = {**own_files(model, fmi=fmi), **_fmi_headers(fmi)}
    sources = {name: content for name, content in files.items() if name.startswith("sources/")}
    for target in platforms if platforms is not None else (host(),):
        files.update(_compiled(model, sources, fmi, target))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / file_name(model.name, fmi)
    _write_zip(path, files)
    return path
