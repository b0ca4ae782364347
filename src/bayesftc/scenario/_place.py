"""A place in a scenario file, which every error message names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from bayesftc.cosim.base.arguments import hint_at
from bayesftc.cosim.errors import BayesFTCError, ScenarioError, SimulationError
from bayesftc.scenario._files import MARKS

KINDS_OF_FILES = {
    MARKS["campaign"]: "looks like a campaign file: bayesftc campaign {file}",
    MARKS["wires"]: "looks like a file of wires: bayesftc live SCENARIO --bridge {file}",
    MARKS["scenario"]: "looks like a scenario: bayesftc run {file}",
    MARKS["monitor's model"]: "looks like the model of a monitor: bayesftc monitor RECORDING --model {file}",
}
"""A key that each file of a kind has, and the command that reads the file."""


@dataclass(frozen=True)
class Place:
    """A file and the path of keys in it: ``faults[0].start``."""

    file: str
    key: str = ""

    def __truediv__(self, key: str | int) -> Place:
        part = f"[{key}]" if isinstance(key, int) else f".{key}" if self.key else key
        return Place(self.file, self.key + part)

    def __str__(self) -> str:
        return f"{self.file}: {self.key!r}" if self.key else self.file

    def error(self, problem: str) -> ScenarioError:
        """Return the error about this place; `problem` is the rest of its sentence."""
        return ScenarioError(f"{self} {problem}")

    def refuse_unknown(self, keys: Iterable[str], known: Iterable[str], what: str = "key") -> None:
        """Raise a ScenarioError for the first of `keys` that is not in `known`."""
        keys, known = list(keys), list(known)
        for key in keys:
            if key not in known:
                hint = "" if self.key else _hint(self.file, keys, known)
                error = self.error(f"has the unknown {what} {key!r}; {hint_at(key, known)}{hint}")
                error.unknown = key, tuple(known)
                raise error

    @contextmanager
    def named(self) -> Iterator[None]:
        """Put the place before the message of any error raised inside. The error's class and exit code stay."""
        try:
            yield
        except (ScenarioError, SimulationError):  # the first has its place, the second is about the run, not the file
            raise
        except BayesFTCError as error:
            raise type(error)(f"{self}: {error}") from error


def _hint(file: str, keys: list[str], known: list[str]) -> str:
    """Return what a file of another kind looks like; nothing if it has the key of the known kind."""
    typical = [key for key in KINDS_OF_FILES if key in keys]
    return f" The file {KINDS_OF_FILES[typical[0]].format(file=file)}." if typical and not {*typical} & {*known} else ""
