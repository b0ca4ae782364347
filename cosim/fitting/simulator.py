"""Runs of an FMU with recorded inputs, at many values of its parameters, on all cores."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.sources import Table
from bayesftc.cosim.campaign.executors.base import check_jobs, cores
from bayesftc.cosim.campaign.executors.choice import against_threads
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError, UnknownNameError, did_you_mean
from bayesftc.cosim.fitting.samples import Samples
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import labels
from bayesftc.cosim.run.many import StoppedFromOutside
from bayesftc.cosim.types import Floats

PLANT = "plant"


class Simulator:
    """Runs an FMU with the inputs of a recording; each run has an instance of its own.

    Parameters
    ----------
    fmu : FMU
        The FMU, with the parameters that are not fitted.
    samples : Samples
        The recording.
    jobs : int, optional
        Number of threads; by default one for each core. If the FMU computes in Python or allows one instance only, one.

    Raises
    ------
    UnknownNameError
        If the FMU has no such input or output.
    ModelError
        If the size of an input differs from its number of columns.
    """

    def __init__(self, fmu: FMU, samples: Samples, jobs: int | None = None):
        check_jobs(jobs)
        self._fmu = fmu.watching(samples.sensors)
        watching: Block = self._fmu
        self._samples = samples
        signals = [
            (label, port.name, i) for port in watching.outputs for i, label in enumerate(labels(port.name, port.shape))
        ]
        known = {label: (name, i) for label, name, i in signals}
        for output in samples.sensors:
            if output not in known:
                raise UnknownNameError(f"The FMU has no output {output!r}; {did_you_mean(output, known)}")
        self._places = [known[output] for output in samples.sensors]
        times = np.arange(len(samples.y)) * samples.step.numerator / samples.step.denominator
        ports = {port.name: port for port in watching.inputs}
        self._sources: dict[str, list[Table]] = {}
        for name, values in samples.inputs.items():
            if name not in ports:
                raise UnknownNameError(f"The FMU has no input {name!r}; {did_you_mean(name, ports)}")
            if ports[name].size != values.shape[1]:
                raise ModelError(
                    f"The input {name!r} has {ports[name].size} element(s), but {values.shape[1]} column(s) are given. "
                    "Give one column for each element."
                )
            self._sources[name] = [Table(times.tolist(), column.tolist(), interpolate=False) for column in values.T]
        alone = next(against_threads(self.diagram({})), None)
        self._jobs = 1 if alone else jobs or cores()

    def diagram(self, parameters: Mapping[str, float]) -> Diagram:
        """Return the diagram of the FMU with these parameters and the recorded inputs."""
        diagram = Diagram(self._samples.step)
        plant = diagram.add(replace(self._fmu, parameters={**(self._fmu.parameters or {}), **parameters}), PLANT)
        for name, tables in self._sources.items():
            sources = [diagram.add(table, f"{PLANT}.{name}.{i}")["y"] for i, table in enumerate(tables)]
            diagram.connect(sources if len(sources) > 1 else sources[0], plant[name])
        return diagram

    def runs(self, points: Sequence[Mapping[str, float]], rows: int) -> list[Floats | str]:
        """Run the FMU with each of these parameters; return its outputs (rows x outputs), or why a run has failed."""
        stopped = threading.Event()
        if self._jobs == 1 or len(points) == 1:
            return [self._run(point, rows, stopped) for point in points]
        with ThreadPoolExecutor(self._jobs, thread_name_prefix="fit") as pool:
            futures = [pool.submit(self._run, point, rows, stopped) for point in points]
            try:
                return [future.result() for future in futures]
            except BaseException:  # also Ctrl-C: the other runs end within a twentieth of a second
                stopped.set()
                pool.shutdown(cancel_futures=True)
                raise

    def _run(self, parameters: Mapping[str, float], rows: int, stopped: threading.Event) -> Floats | str:
        def go_on(step: int, steps: int) -> None:
            if stopped.is_set():
                raise StoppedFromOutside

        names = list(dict.fromkeys(f"{PLANT}.{name}" for name, _ in self._places))
        try:
            result = self.diagram(parameters).simulate((rows - 1) * self._samples.step, record=names, progress=go_on)
        except (SimulationError, FMUError) as error:
            return str(error)
        if result.stopped:
            return result.stopped
        return np.column_stack([result[f"{PLANT}.{name}"].reshape(rows, -1)[:, i] for name, i in self._places])
