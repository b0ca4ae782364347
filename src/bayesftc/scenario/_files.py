"""Finding and reading scenario files: a path, or the name of a scenario that is shipped; and the other files that are shipped."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from bayesftc.cosim.base.paths import expanded, is_file, is_folder
from bayesftc.cosim.errors import ScenarioError, did_you_mean

KINDS = {
    "scenario": "*/*.toml",
    "campaign": "*/campaigns/*.toml",
    "monitor's model": "*/data/*.toml",
    "recording": "*/data/*.csv",
}
"""Where the files of each kind lie in the examples."""


def shipped_files(kind: str) -> dict[str, Path]:
    """Return the files of one of `KINDS` that come with the package: name to file."""
    import bayesftc.examples

    folders = [Path(folder) for folder in bayesftc.examples.__path__]
    return {file.stem: file for folder in folders for file in sorted(folder.glob(KINDS[kind]))}


def shipped_scenarios() -> dict[str, Path]:
    """Return the scenarios that come with the package: name to file."""
    return shipped_files("scenario")


def find_scenario(path: str | os.PathLike[str]) -> Path:
    """Return the scenario file that is meant: a file, or else the shipped scenario of that name.

    Raises
    ------
    ScenarioError
        If there is neither.
    """
    file = expanded(path)
    if is_file(file):
        return file
    name, shipped = os.fspath(path), shipped_scenarios()
    if name in shipped:
        return shipped[name]
    if is_folder(file):
        raise ScenarioError(f"{path} is a folder; give the scenario file in it.")
    if file.suffix == ".toml" or file.parent != Path("."):
        folder = file.parent.absolute()
        if not is_folder(folder):
            raise ScenarioError(
                f"There is no scenario file {path}: the folder {folder} does not exist; check the path."
            )
        near = did_you_mean(file.name, [f.name for f in folder.glob("*.toml")])
        raise ScenarioError(f"There is no scenario file {path}; {near}")
    raise ScenarioError(f"There is no scenario {name!r}, neither as a file nor shipped; {did_you_mean(name, shipped)}")


def read_toml(file: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    ScenarioError
        If it cannot be read, or is no TOML: with line and column.
    """
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise ScenarioError(
            f"The file {file} cannot be read ({error.strerror}); check its path and permissions."
        ) from None
    except UnicodeDecodeError:
        raise ScenarioError(f"The scenario {file} is no text in UTF-8; save it as UTF-8.") from None
    except tomllib.TOMLDecodeError as error:
        problem = str(error)[0].lower() + str(error)[1:]
        raise ScenarioError(f"{file} is no valid TOML: {problem}; texts need quotes, and a key stands once.") from None
    except ValueError:  # of Python's whole numbers
        raise ScenarioError(f"{file} is no valid scenario: it has a number of thousands of digits; round it.") from None
    except RecursionError:
        raise ScenarioError(
            f"{file} is no valid scenario: its lists are nested too deeply; check the brackets."
        ) from None
