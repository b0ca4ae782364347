"""Build FMUs: sources, description and library of one model, in one reproducible zip file."""

import hashlib
import importlib.util
import secrets
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from bayesftc.fmus import _description2, _description3, _xml
from bayesftc.fmus._binaries import binaries
from bayesftc.fmus._catalogue import FMI_VERSIONS, check_version, file_name
from bayesftc.fmus._compiler import CompilerError
from bayesftc.fmus._header import config_header
from bayesftc.fmus._platforms import Platform
from bayesftc.fmus.spec import Model

__all__ = ["FMI_VERSIONS", "CompilerError", "build_fmu", "fmu_files", "own_files", "write_zip"]

_C_FOLDER = Path(__file__).resolve().parent / "c"
_SHARED = ("elementary.h", "runge_kutta.h")
"""Headers for models, which an FMU contains if its model includes them."""

_FMI_HEADERS = {
    "2.0": ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h"),
}
_NO_TOKEN = "{00000000-0000-0000-0000-000000000000}"


def _fmi_headers(fmi: str) -> dict[str, bytes]:
    """Read the standard's headers, including the licence, from the installed fmpy, without importing it."""
    spec = importlib.util.find_spec("fmpy")
    if spec is None or not spec.submodule_search_locations:
        raise RuntimeError("The FMI headers are in the package fmpy, which is not installed. Use: pip install fmpy")
    folder = Path(spec.submodule_search_locations[0]) / "c-code"
    missing = [name for name in _FMI_HEADERS[fmi] if not (folder / name).is_file()]
    if missing:
        raise RuntimeError(f"The installed fmpy lacks the FMI header {missing[0]}. Upgrade fmpy.")
    return {f"sources/{name}": (folder / name).read_bytes() for name in _FMI_HEADERS[fmi]}


def _with_token(model: Model, fmi: str, token: str) -> dict[str, bytes]:
    if fmi == "2.0":
        model = model.flat()
    sources, compiled = _own_sources(model), _compiled_sources(model, fmi)
    needed = [compiled[0], "instance.h", "model.h"]
    needed += [name for name in _SHARED if any(f'"{name}"'.encode() in text for text in sources.values())]
    files = {
        **{f"sources/{name}": text for name, text in sources.items()},
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
    """Write all files of an FMU except the standard's headers and the libraries.

    The token is a hash of these files, so a library returns an error if the description is of other sources.

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


def fmu_files(model: Model, *, fmi: str, platforms: Sequence[Platform] | None = None) -> dict[str, bytes]:
    """Return all files of an FMU, including the compiled ones.

    Parameters
    ----------
    model : Model
        The model.
    fmi : {"2.0", "3.0"}
        Version of the standard.
    platforms : sequence of Platform, optional
        Platforms to compile for, with ``ziglang``; by default this machine's, with its own compiler if it has one.

    Returns
    -------
    dict
        Name in the FMU to content.

    Raises
    ------
    ValueError
        If the version is not known.
    CompilerError
        If no C compiler is found or it fails.
    """
    files = {**own_files(model, fmi=fmi), **_fmi_headers(fmi)}
    sources = {Path(name).name: content for name, content in files.items() if name.startswith("sources/")}
    return files | binaries(model.name, sources, _compiled_sources(model, fmi), model.libraries, fmi, platforms)


def write_zip(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip file whose bytes depend only on the content, and put it in place at once."""
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}.tmp")
    try:
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name, content in sorted(files.items()):
                entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3  # Unix on every system, because the permissions below are Unix permissions
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
        Folder to write to; created if it does not exist.
    fmi : {"2.0", "3.0"}
        Version of the standard.
    platforms : sequence of Platform, optional
        Platforms to compile for, with ``ziglang``; by default this machine's, with its own compiler if it has one.

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
    files = fmu_files(model, fmi=fmi, platforms=platforms)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / file_name(model.name, fmi)
    write_zip(path, files)
    return path
