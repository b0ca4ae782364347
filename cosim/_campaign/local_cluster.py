"""A Dask cluster on this machine: a scheduler in this process and workers that are programs, which die with it."""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from types import TracebackType
from typing import Any

from bayesftc.cosim._campaign.executors import cores
from bayesftc.cosim._isolation.child import die_with_host, kill_group

HOST = "127.0.0.1"
_BOOT = (
    "import sys; lifeline, address, folder = sys.argv[1:4]; sys.path[:] = sys.argv[4:]; "
    "from bayesftc.cosim._campaign.local_cluster import worker; worker(int(lifeline), address, folder)"
)


class LocalCluster:
    """A context in which the cluster runs.

    Dask's own one starts its workers by multiprocessing, which runs the user's script once more in each, and fails where that has
    no ``if __name__ == "__main__"``.

    Parameters
    ----------
    workers : int, optional
        Of one thread each; by default one for each core.

    Attributes
    ----------
    address : str
        Of its scheduler.
    processes : list of subprocess.Popen
        The workers.
    """

    def __init__(self, workers: int | None = None):
        self._count = workers or cores()
        self.processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> LocalCluster:
        from distributed import LocalCluster

        self._scheduler: Any = LocalCluster(
            n_workers=0,
            host=HOST,
            protocol="tcp",
            processes=True,
            silence_logs=logging.ERROR,
            scheduler_kwargs={"dashboard": False, "dashboard_address": f"{HOST}:0"},
        )
        self.address: str = self._scheduler.scheduler_address
        self._folder = tempfile.mkdtemp(prefix="bayesftc-dask-")
        self._lifeline, self._held = os.pipe()
        self.processes = [self._start() for _ in range(self._count)]
        return self

    def tend(self) -> None:
        """Start workers in place of those that have died."""
        self.processes = [p if p.poll() is None else self._start() for p in self.processes]

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.processes:
            kill_group(process)
            process.wait()
        os.close(self._held)
        os.close(self._lifeline)
        with suppress(Exception):
            self._scheduler.close(timeout=5)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [
                sys.executable,
                "-c",
                _BOOT,
                str(self._lifeline),
                self.address,
                self._folder,
                *map(os.path.abspath, sys.path),
            ],
            stdin=subprocess.DEVNULL,
            pass_fds=[self._lifeline],
            start_new_session=True,
        )


def worker(lifeline: int, address: str, folder: str) -> None:
    """Be a worker until the scheduler has gone."""
    os.set_inheritable(lifeline, False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_host(lifeline)
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
