"""A shipped plant as an fmpy slave, as a user of fmpy would use it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesftc import fmus

CAR = "CruiseControl"


@dataclass(frozen=True)
class Unpacked:
    """An unpacked FMU: its folder, its description, and the value reference of each variable."""

    folder: Path
    description: Any
    references: dict[str, int]

    @contextmanager
    def slave(self, **start: float) -> Iterator[Any]:
        """Yield an initialized slave at t = 0."""
        from fmpy.fmi2 import FMU2Slave

        slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="plant",
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        if start:
            slave.setReal([self.references[name] for name in start], list(start.values()))
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        try:
            yield slave
        finally:
            slave.terminate()
            slave.freeInstance()


@contextmanager
def unpacked_fmu(name: str = CAR) -> Iterator[Unpacked]:
    """Unpack a shipped FMU with fmpy into a temporary folder."""
    import fmpy

    path = str(fmus.path(name))
    description = fmpy.read_model_description(path)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        fmpy.extract(path, unzipdir=folder)
        yield Unpacked(Path(folder), description, {v.name: v.valueReference for v in description.modelVariables})
