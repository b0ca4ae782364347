"""Names and paths of the shipped FMUs."""

import difflib
from pathlib import Path

__all__ = ["FMI_VERSIONS", "check_version", "file_name", "names", "path"]

FMI_VERSIONS = ("2.0", "3.0")
_FOLDER = Path(__file__).resolve().parent


def check_version(fmi: str) -> None:
    """Raise ValueError unless FMUs are built for this version of the standard."""
    if fmi not in FMI_VERSIONS:
        raise ValueError(f"There are no FMUs for fmi={fmi!r}. Use fmi='2.0' or fmi='3.0'.")


def file_name(name: str, fmi: str) -> str:
    """Return the file name of a model's FMU; the plain name is FMI 2.0, which more tools support."""
    return f"{name}.fmu" if fmi == "2.0" else f"{name}_fmi{fmi[0]}.fmu"


def names() -> tuple[str, ...]:
    """List the plants that are shipped as FMUs.

    Returns
    -------
    tuple of str
        Their names, for :func:`path`.

    Examples
    --------
    >>> from bayesftc import fmus
    >>> fmus.names()[:2]
    ('CartPendulum', 'CruiseControl')
    """
    from bayesftc.fmus.plants import PLANTS

    return tuple(sorted(plant.name for plant in PLANTS))


def check_name(name: str) -> None:
    """Raise ValueError, with similar names, unless a plant of this name is shipped."""
    shipped = names()
    if name in shipped:
        return
    by_lower = {other.lower(): other for other in shipped}
    near = [by_lower[match] for match in difflib.get_close_matches(str(name).lower(), by_lower, n=3)]
    hint = f"; did you mean {' or '.join(repr(other) for other in near)}?" if near else "."
    raise ValueError(f"No FMU named {name!r} is shipped{hint} Shipped FMUs: {', '.join(shipped)}.")


def path(name: str, *, fmi: str = "2.0") -> Path:
    """Find a shipped FMU.

    Parameters
    ----------
    name : str
        Name of the plant, one of :func:`names`.
    fmi : {"2.0", "3.0"}
        Version of the standard.

    Returns
    -------
    pathlib.Path
        Absolute path of the FMU.

    Raises
    ------
    ValueError
        If no plant has this name, or there is no such version.
    FileNotFoundError
        If the file of the plant is missing.

    Examples
    --------
    >>> from bayesftc import fmus
    >>> fmus.path("CruiseControl").name
    'CruiseControl.fmu'
    >>> fmus.path("CruiseControl", fmi="3.0").name
    'CruiseControl_fmi3.fmu'
    """
    check_version(fmi)
    check_name(name)
    file = _FOLDER / file_name(name, fmi)
    if not file.is_file():
        raise FileNotFoundError(f"The FMU {file} is missing. Build it with 'python -m bayesftc.fmus build {name}'.")
    return file
