"""A Dask cluster on this machine: a scheduler in this process, and worker processes that end with it."""

from __future__ import annotations

import asyncio
import logging
import subprocess
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any

from bayesftc.cosim.base.processes import Lifeline, begin, can_start, kill_group, start
from bayesftc.cosim.base.temporary import temporary_folder
from bayesftc.cosim.campaign.executors.base import cores
from bayesftc.cosim.errors import ModelError

HOST = "127.0.0.1"
FOLDER = "bayesftc-dask-"
"""Prefix of the temporary folder in which workers put data that do not fit into memory."""


class LocalCluster:
    """A context in which the cluster runs.

    Dask's own local cluster starts its workers by multiprocessing. This runs the user's script again in each, and fails if the
    script has no ``if __name__ == "__main__"``.

    Parameters
    ----------
    workers : int, optional
        Number of workers, of one thread each; by default one for each core.

    Attributes
    ----------
    address : str
        Address of its scheduler.
    processes : list of subprocess.Popen
        The workers.
    """

    def __init__(self, workers: int | None = None):
        if not can_start():
            raise ModelError(
                "A Dask cluster on this machine needs Linux or macOS and a Python executable; use executor=Threads(), "
                "or give the address= of a scheduler."
            )
        self._count = workers or cores()
        self.processes: list[subprocess.Popen[bytes]] = []
        self._lifelines: dict[subprocess.Popen[bytes], Lifeline] = {}

    def __enter__(self) -> LocalCluster:
        from distributed import LocalCluster

        with ExitStack() as stack:
            self._folder = str(stack.enter_context(temporary_folder(FOLDER)))
            scheduler: Any = LocalCluster(
                n_workers=0,
                host=HOST,
                protocol="tcp",
                processes=True,
                silence_logs=logging.ERROR,
                scheduler_kwargs={
                    "dashboard": False,
                    "dashboard_address": f"{HOST}:0",
                    "local_directory": self._folder,
                },
            )
            stack.callback(_close, scheduler)
            self.address: str = scheduler.scheduler_address
            stack.callback(self._end_all)
            for _ in range(self._count):
                self._start()
            self._stack = stack.pop_all()
        return self

    def tend(self) -> None:
        """Replace workers that have died."""
        for process in [p for p in self.processes if p.poll() is not None]:
            self._end(process)
            self._start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _start(self) -> None:
        process, lifeline = start(
            "bayesftc.cosim.campaign.executors.local_cluster:worker", arguments=[self.address, self._folder]
        )
        self.processes.append(process)
        self._lifelines[process] = lifeline

    def _end_all(self) -> None:
        for process in list(self.processes):
            self._end(process)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        kill_group(process)
        process.wait()
        self.processes.remove(process)
        self._lifelines.pop(process).close()


def _close(scheduler: Any) -> None:
    with suppress(Exception):
        scheduler.close(timeout=5)


def worker(lifeline: str, address: str, folder: str) -> None:
    """Run a worker until the scheduler ends."""
    begin(int(lifeline))
    asyncio.run(_serve(address, folder))


async def _serve(address: str, folder: str) -> None:
    from distributed import Worker

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    made = await Worker(
        address,
        nthreads=1,
        host=HOST,
        dashboard=False,
        memory_limit=0,
        local_directory=folder,
        silence_logs=logging.CRITICAL,
    )
    await made.finished()


__all__ = ["LocalCluster"]
