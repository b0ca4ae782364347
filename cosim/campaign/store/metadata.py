"""The metadata of a stored campaign: ``campaign.json``, by which a result is traced, resumed and repeated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cosim.base.paths import exists, is_file
from bayesftc.cosim.campaign.designs.plan import Plan
from bayesftc.cosim.campaign.store.durable import write_whole
from bayesftc.cosim.campaign.store.environment import environment
from bayesftc.cosim.errors import StoreError, brief
from bayesftc.cosim.types import Floats

NAME, FORMAT, VERSION = "campaign.json", "bayesftc-campaign", 1
CHECK = "sha256"
"""Hash of the rest of the file. Without it, a flipped bit could turn the file into that of another campaign."""
FILES = "files"
"""Part of a description: texts of the files that define the campaign."""

Signal = tuple[tuple[int, ...], str | None]
"""Shape and unit."""


@dataclass(frozen=True)
class Metadata:
    """The content of ``campaign.json``.

    Attributes
    ----------
    description : mapping
        Description of the campaign by its author: any JSON data. Its ``files``, texts by their names, are for readers, so that
        comments in them may change.
    plan : Plan
        The plan, with labels as the values of the points.
    signals : mapping of str to (shape, unit)
        The recorded signals of each run.
    rows : int
        Number of rows of each signal.
    times : str
        Hash of the time of each row.
    metrics : tuple of str
        Names of the metrics.
    fmus : mapping of str to str
        The name of the file of each FMU, by its SHA-256.
    environment : mapping
        Versions and machine at the beginning.
    resumed : tuple of mapping
        For each resumption in another environment: the environment, and the number of finished pieces.
    units : mapping of str to str
        The unit of each column of the table that has one; none in stores of early versions.
    """

    description: Mapping[str, Any]
    plan: Plan
    signals: Mapping[str, Signal]
    rows: int
    times: str
    metrics: tuple[str, ...]
    fmus: Mapping[str, str]
    environment: Mapping[str, Any] = field(default_factory=environment)
    resumed: tuple[Mapping[str, Any], ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def latest(self) -> Mapping[str, Any]:
        """The environment of the last runs."""
        last: Mapping[str, Any] = self.resumed[-1]["environment"] if self.resumed else self.environment
        return last

    def again(self, environment: Mapping[str, Any], done: int) -> Metadata:
        """Return the metadata with a further resumption in another environment."""
        return replace(self, resumed=(*self.resumed, {"environment": environment, "done": done}))

    def identity(self) -> dict[str, Any]:
        """Return the JSON data that distinguish this campaign from others.

        The size of the pieces, the units of columns and the texts of files are left out.
        """
        content = self._content()
        content["description"] = {name: part for name, part in content["description"].items() if name != FILES}
        return content

    def _content(self) -> dict[str, Any]:
        seeds = list(dict.fromkeys(self.plan.seeds))  # most campaigns have the same seeds at each point
        place = {seeds_of_point: i for i, seeds_of_point in enumerate(seeds)}
        content = {
            "description": self.description,
            "points": [dict(point) for point in self.plan.points],
            "seeds": seeds,
            "seeds_of_point": [place[seeds_of_point] for seeds_of_point in self.plan.seeds],
            "signals": {name: {"shape": list(shape), "unit": unit} for name, (shape, unit) in self.signals.items()},
            "rows": self.rows,
            "times": self.times,
            "metrics": list(self.metrics),
            "fmus": dict(self.fmus),
        }
        plain: dict[str, Any] = json.loads(json.dumps(content, default=_plain))
        return plain

    def write(self, folder: Path) -> None:
        """Write the file, completely or not at all."""
        text = {
            "format": FORMAT,
            "version": VERSION,
            **self._content(),
            "piece": self.plan.size,
            "units": dict(self.units),
            "environment": self.environment,
            "resumed": self.resumed,
        }
        text = json.loads(json.dumps(text, default=_plain))  # as it will be read, because the hash is of the read data
        text[CHECK] = _check(text)
        write_whole(folder / NAME, json.dumps(text, indent=1, ensure_ascii=False).encode())

    @classmethod
    def read(cls, folder: Path) -> Metadata:
        """Read the file of a campaign's folder.

        Raises
        ------
        StoreError
            If there is none, or it is damaged or of a later version.
        """
        if not exists(folder):
            raise StoreError(f"There is no campaign {folder}; check the path, or run the campaign first.")
        path = folder / NAME
        if not is_file(path):
            raise StoreError(f"{folder} is not a stored campaign, because it has no {NAME}; check the path.")
        try:
            text = json.loads(path.read_bytes())
            if text["format"] != FORMAT:
                raise ValueError(text["format"])
            if text["version"] > VERSION:
                raise StoreError(
                    f"The campaign {folder} was written by a later version of bayesftc "
                    f"({text['environment']['versions']['bayesftc']}); update bayesftc to read it."
                )
            if CHECK in text and text.pop(CHECK) != _check(text):  # stores of early versions have no hash
                raise ValueError(CHECK)
            seeds = [tuple(map(int, group)) for group in text["seeds"]]
            plan = Plan(
                tuple(map(dict, text["points"])), tuple(seeds[i] for i in text["seeds_of_point"]), text["piece"]
            )
            if len(plan.points) != len(plan.seeds) or plan.size < 1:
                raise ValueError(plan.size)
            return cls(
                dict(text["description"]),
                plan,
                {name: (tuple(map(int, s["shape"])), s["unit"]) for name, s in text["signals"].items()},
                int(text["rows"]),
                str(text["times"]),
                tuple(map(str, text["metrics"])),
                dict(text["fmus"]),
                dict(text["environment"]),
                tuple(text["resumed"]),
                dict(text.get("units", {})),
            )
        except OSError as error:
            raise StoreError(f"The campaign {folder} cannot be read: {error.strerror or error}.") from None
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            raise StoreError(
                f"{path} is damaged, or of another program, and the campaign cannot be read without it; use a backup of the "
                "file, or run the campaign again."
            ) from None


def _check(text: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(text, sort_keys=True).encode()).hexdigest()


def hash_of(times: Floats) -> str:
    """Return the hash of the times of the rows."""
    return hashlib.sha256(np.ascontiguousarray(times, dtype="<f8").tobytes()).hexdigest()


def differences(stored: Any, given: Any, place: str = "") -> list[str]:
    """Return the differences of two JSON values as texts: the setting, its stored value and its new value."""
    if isinstance(stored, dict) and isinstance(given, dict):
        names = dict.fromkeys([*stored, *given])
        within = [(f"{place}.{n}" if place else str(n), stored.get(n, _ABSENT), given.get(n, _ABSENT)) for n in names]
        return [text for name, a, b in within for text in differences(a, b, name)]
    if isinstance(stored, list) and isinstance(given, list) and len(stored) == len(given):
        return [text for i, (a, b) in enumerate(zip(stored, given)) for text in differences(a, b, f"{place}[{i}]")]
    if json.dumps(stored, default=repr) == json.dumps(
        given, default=repr
    ):  # as texts, NaN equals NaN, and 1 is not 1.0
        return []
    old, new = _text_of(stored), _text_of(given)
    if old == new and isinstance(stored, str) and isinstance(given, str):
        # Of long texts that begin alike, what is from a little before the difference on.
        pairs = enumerate(zip(stored, given, strict=False))
        alike = next((i for i, (a, b) in pairs if a != b), min(len(stored), len(given)))
        old, new = (f"{'...' * (alike > SHOWN)}{brief(text[max(alike - SHOWN, 0) :])}" for text in (stored, given))
    return [f"{place} is {old} in the store and {new} now"]


SHOWN = 20
"""Letters before a difference of two long texts that a message shows."""


class _Absent:
    def __repr__(self) -> str:
        return "absent"


_ABSENT = _Absent()


def _text_of(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) > 4:
        return f"a list of {len(value)}"
    return brief(value)


def _plain(value: Any) -> Any:
    """Return the JSON form of a value of another type."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise StoreError(
        f"The description of a campaign contains {brief(value)}, which cannot be stored; use numbers, texts, lists and dicts."
    )


__all__ = ["FORMAT", "NAME", "VERSION", "Metadata", "Signal", "differences", "hash_of"]
