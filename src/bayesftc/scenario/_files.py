"""Find and read scenario files, given a path or the name of a shipped scenario; find the other shipped files."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Any

from bayesftc.cosim.base.paths import expanded, is_file, is_folder
from bayesftc.cosim.errors import ScenarioError, did_you_mean

KINDS = {
    "scenario": "*/*.toml",
    "campaign": "*/campaigns/*.toml",
    "wires": "*/wires/*.toml",
    "monitor's model": "*/data/*.toml",
    "recording": "*/data/*.csv",
    "faulty recording": "*/faulty/wheel_speed.csv",
}
"""The pattern of the paths of each kind of file in the examples."""

USES = {
    "scenario": "bayesftc run {name}",
    "campaign": "bayesftc campaign {file}",
    "wires": "bayesftc live live_car --bridge {file}",
    "monitor's model": "bayesftc monitor . --model {file}",
    "recording": "bayesftc monitor . --model model.toml",
    "faulty recording": "bayesftc monitor {name}.csv --fit",
}
"""The command that uses a file of each kind, once the file is in the current folder."""

MARKS = {"scenario": "plant", "campaign": "scenario", "wires": "bridge", "monitor's model": "dt"}
"""A key that every file of a kind has, and no other file."""

TOGETHER = ("monitor's model", "recording")
"""Kinds of files that are used together, those of one folder."""

NOUNS = {"wires": "file of wires", "monitor's model": "model file"}
"""The names in messages of files whose kind is no word before "file"."""

OTHERS = {
    ".fmu": "an FMU, not a TOML file. bayesftc inspect {file} shows what it has; a scenario names it as fmu = ... in [plant].",
    ".csv": "a recording, not a TOML file. bayesftc monitor {file} --fit finds faults in it.",
    ".parquet": "a recording, not a TOML file. bayesftc fit reads it.",
    ".ssp": "an SSP file, not a TOML file. bayesftc inspect {file} shows what it has.",
}
"""What files of other kinds are, and what to do with them."""


def shipped_files(kind: str) -> dict[str, Path]:
    """Return the shipped files of one of `KINDS`, by name; a faulty recording has the name of the other one with a prefix."""
    import bayesftc.examples

    folders = [Path(folder) for folder in bayesftc.examples.__path__]
    prefix = "faulty_" if kind == "faulty recording" else ""
    return {prefix + file.stem: file for folder in folders for file in sorted(folder.glob(KINDS[kind]))}


def shipped_scenarios() -> dict[str, Path]:
    """Return the shipped scenario files, by name."""
    return shipped_files("scenario")


def use_of(kind: str, name: str, file: Path) -> str:
    """Return the command that uses a shipped file, once it is in the current folder."""
    return USES[kind].format(name=name, file=file.name)


def used_with(name: str) -> list[str]:
    """Return the names of the shipped files that are used together with one, all in one folder; none for most."""
    shipped = {other: file for kind in TOGETHER for other, file in shipped_files(kind).items()}
    return [
        other
        for other, file in shipped.items()
        if name in shipped and file.parent == shipped[name].parent and other != name
    ]


def find_scenario(path: str | os.PathLike[str], kind: str = "scenario") -> Path:
    """Return the scenario file, or another one of `KINDS`, given a path or the name of a shipped one.

    Raises
    ------
    ScenarioError
        If there is neither.
    """
    file, what = expanded(path), NOUNS.get(kind, f"{kind} file")
    if is_file(file):
        return file
    name, shipped = os.fspath(path), shipped_files(kind)
    if name in shipped:
        return shipped[name]
    if is_folder(file):
        raise ScenarioError(f"{path} is a folder. Give the {what} in it.")
    if file.suffix == ".toml" or file.parent != Path("."):
        folder = file.parent.absolute()
        if not is_folder(folder):
            raise ScenarioError(f"There is no {what} {path}: the folder {folder} does not exist. Check the path.")
        there = _of_kind(folder, kind)
        near = did_you_mean(file.name, there) if there else f"the folder {folder} has no {what}. Check the path."
        raise ScenarioError(f"There is no {what} {path}; {near}")
    raise ScenarioError(
        _other_kind(name, what)
        or f"There is no file {name!r} and no shipped {kind} of this name; "
        + did_you_mean(name, [*shipped, *_of_kind(Path(), kind)])
    )


def _of_kind(folder: Path, kind: str) -> list[str]:
    """Return the names of the TOML files in a folder that are of a kind, or of none."""
    names = []
    for file in sorted(folder.glob("*.toml")):
        try:
            keys = set(read_toml(file))
        except ScenarioError:  # perhaps the expected one, with a mistake in it
            keys = set()
        if MARKS.get(kind) in keys or not keys & {*MARKS.values()}:
            names.append(file.name)
    return names


def _other_kind(name: str, what: str) -> str:
    """Return the message about the name of a shipped file of another kind than the expected one; empty for other names."""
    for kind in KINDS:
        if file := shipped_files(kind).get(name):
            copied = "" if kind == "scenario" else f"bayesftc example {name} > {file.name} && "
            varied = f" For a campaign, write a file with scenario = {name!r}; bayesftc example tracking prints one."
            return (
                f"{name!r} is a shipped {kind}, not a {what}. To use it: {copied}{use_of(kind, name, file)}."
                f"{varied if (kind, what) == ('scenario', 'campaign file') else ''}"
            )
    return ""


def read_toml(file: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    ScenarioError
        If it cannot be read, or is no TOML. The message has line and column.
    """
    if instead := OTHERS.get(file.suffix.lower()):
        raise ScenarioError(f"{file} is {instead.format(file=file)}")
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise ScenarioError(
            f"The file {file} cannot be read ({error.strerror}). Check its path and permissions."
        ) from None
    except UnicodeDecodeError:
        raise ScenarioError(f"The scenario {file} is no text in UTF-8. Save it as UTF-8.") from None
    except tomllib.TOMLDecodeError as error:
        problem = str(error)[0].lower() + str(error)[1:]
        remedy = _with_point(file, str(error)) or "Texts need quotes, and a key may occur only once."
        raise ScenarioError(f"{file} is no valid TOML: {problem}. {remedy}") from None
    except ValueError:  # Python limits the digits of integers
        raise ScenarioError(f"{file} is no valid scenario: it has a number of thousands of digits. Round it.") from None
    except RecursionError:
        raise ScenarioError(
            f"{file} is no valid scenario: its lists are nested too deeply. Check the brackets."
        ) from None


def _with_point(file: Path, error: str) -> str:
    """Return what to write instead of a number with a decimal comma, if the error is at one; else nothing."""
    place = re.search(r"at line (\d+), column (\d+)", error)
    if place is None:
        return ""
    line, column = file.read_text("utf-8-sig").split("\n")[int(place[1]) - 1], int(place[2]) - 1
    for found in re.finditer(r"=\s*([+-]?\d+,\d+)", line):
        if found.start() <= column <= found.end():
            return f"Numbers have a decimal point: write {found[1].replace(',', '.')} for {found[1]}."
    return ""
