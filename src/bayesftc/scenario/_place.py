"""A place in a scenario file, which every error message names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from bayesftc.cosim.errors import BayesFTCError, ScenarioError, SimulationError, did_you_mean


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
        known = list(known)
        for key in keys:
            if key not in known:
                raise self.error(f"has the unknown {what} {key!r}; {did_you_mean(key, known)}")

    @contextmanager
    def named(self) -> Iterator[None]:
        """Put the place before the message of any error raised inside. The error's class and exit code stay."""
        try:
            yield
        except (ScenarioError, SimulationError):  # the first has its place, the second is about the run, not the file
            raise
        except BayesFTCError as error:
            raise type(error)(f"{self}: {error}") from error
