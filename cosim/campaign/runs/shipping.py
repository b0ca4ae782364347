"""Send the FMUs of a campaign to machines without their files, identified by the hash of their content."""

from __future__ import annotations

import hashlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.campaign.runs.fmus import fmus_of
from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.runs.pickling import Reduced, pickled
from bayesftc.cosim.errors import BayesFTCError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.archive import open_archive, stand_in


@dataclass(frozen=True)
class Content:
    """An FMU to send: the hash of its content, and the name of its file for messages."""

    digest: str
    name: str

    @property
    def path(self) -> Path:
        """The path of its copy on the receiving machine."""
        return cache_directory("shipped") / self.digest / self.name

    def place(self, data: bytes) -> None:
        """Write the copy, completely, unless it already exists."""
        if self._is_there():
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=self.path.parent, prefix=".")  # several processes may write at once
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.replace(temporary, self.path)
        except OSError as error:
            Path(temporary).unlink(missing_ok=True)
            raise BayesFTCError(
                f"The FMU {self.name} cannot be written to {self.path.parent} ({error.strerror}); make space or change rights."
            ) from None

    def _is_there(self) -> bool:
        try:
            with self.path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest() == self.digest
        except OSError:
            return False


class Parcel:
    """A job for other machines.

    Attributes
    ----------
    payload : bytes
        The job. Where it is unpickled, its FMU blocks refer to the copies of `Content.place`.
    fmus : dict of Content to pathlib.Path
        The FMUs and their paths here: those of its blocks and factors. If a function makes the loop, those of the first point
        and of factors that are paths.

    Raises
    ------
    ModelError
        If the job cannot be pickled.
    FMUError
        If an FMU cannot be read.
    """

    def __init__(self, job: object):
        self.fmus: dict[Content, Path] = {}
        paths = fmus_of(job).values() if isinstance(job, Job) else ()
        table = dict(self._noted(path) for path in paths)
        self.payload = pickled(_Opened(table, job), self._substitute)

    def _substitute(self, value: Any) -> Reduced | None:
        if not isinstance(value, FMU):
            return None
        _, content = self._noted(Path(value.path))
        return _restored, (type(value), content, {k: v for k, v in vars(value).items() if k != "path"})

    def _noted(self, path: Path) -> tuple[Path, Content]:
        content = Content(open_archive(path).digest, path.name)
        self.fmus[content] = path
        return path, content


class _Opened:
    """A wrapper of a job; unpickling it gives the job itself."""

    def __init__(self, table: dict[Path, Content], job: object):
        self._parts = table, job

    def __reduce__(self) -> tuple[Any, ...]:
        return _opened, self._parts


def _opened(table: dict[Path, Content], job: object) -> object:
    for path, content in table.items():
        stand_in(path, content.path)
    return job


def _restored(kind: type[FMU], content: Content, settings: dict[str, Any]) -> FMU:
    block = kind.__new__(kind)
    vars(block).update(settings, path=content.path)
    return block


__all__ = ["Content", "Parcel"]
