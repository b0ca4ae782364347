"""Runs on a cluster, by Dask distributed.

The job is sent as one task. Each Dask worker with the job starts a crew of processes, which run the pieces. FMUs are tasks,
too, named by the hash of their content. All three are pure functions, so that lost results can be computed again elsewhere.
"""

from __future__ import annotations

import re
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.campaign.designs.plan import Piece, joined
from bayesftc.cosim.campaign.executors.base import AHEAD, R, Work, check_jobs
from bayesftc.cosim.campaign.executors.crew import GLANCE, Crew
from bayesftc.cosim.campaign.executors.local_cluster import LocalCluster
from bayesftc.cosim.campaign.runs.shipping import Content, Parcel
from bayesftc.cosim.campaign.store.environment import changes, environment
from bayesftc.cosim.errors import BayesFTCError, ModelError

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECTING = 10
"""Seconds for the scheduler to answer."""
IDLE = 10.0
"""Seconds without a piece after which a worker ends the processes of a job, because its client may have been killed."""
LOOK = 1.0
"""Seconds between two checks of the cluster."""


@dataclass(frozen=True)
class DaskCluster:
    """Runs on a Dask cluster.

    The workers need this package, and the modules of the campaign's functions and blocks (definitions of a script or notebook
    are sent). FMUs are sent automatically. Each Dask worker makes its runs in separate processes, as many as it has threads, so
    that a run that crashes does not end a worker. If a worker dies, its pieces run again elsewhere.

    Parameters
    ----------
    address : str or distributed.Client, optional
        Address of the scheduler, such as ``"tcp://10.0.0.1:8786"``, or a client that is connected to it. By default a cluster
        on this machine, which ends with the campaign; it needs Linux or macOS.
    workers : int, optional
        Number of workers of a cluster on this machine; by default one for each core.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=1.0), "noise")
    >>> campaign = cosim.Campaign(diagram, duration=100.0, seeds=4, metrics=[cosim.RMSE("noise.y", name="size")])
    >>> cluster = cosim.DaskCluster("tcp://10.0.0.1:8786")
    >>> campaign.run(executor=cluster).table["size"].round(1).tolist()  # doctest: +SKIP
    [1.0, 1.0, 1.0, 1.0]
    """

    address: str | Client | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        check_jobs(self.workers)
        if self.workers is not None and self.address is not None:
            raise ModelError(
                "workers= is for a cluster on this machine, and address= for another cluster; give only one of them."
            )
        if isinstance(self.address, str) and not re.fullmatch(r"(\w+://)?[^/\s]+:\d+/?|inproc://\S+", self.address):
            raise ModelError(
                f"address is {self.address!r}; give the Dask scheduler's address with its port, such as tcp://10.0.0.1:8786."
            )

    def run(self, job: Work[R], pieces: Iterable[Piece]) -> Generator[R, None, None]:
        """See `Executor.run`."""
        extra("distributed", "A campaign on a cluster")
        parcel = Parcel(job)
        with ExitStack() as stack:
            local = stack.enter_context(LocalCluster(self.workers)) if self.address is None else None
            client = stack.enter_context(_client(local.address if local else self.address))
            _check(client)
            yield from _Campaign(client, job, parcel, local).outcomes(iter(pieces))


class _Campaign:
    """The pieces of one job on a cluster."""

    def __init__(self, client: Client, job: Any, parcel: Parcel, local: LocalCluster | None):
        self._client, self._job, self._local = client, job, local
        self._name = f"bayesftc-{uuid.uuid4().hex}"
        fmus = [
            client.submit(_same, path.read_bytes(), key=f"fmu-{content.digest}")
            for content, path in parcel.fmus.items()
        ]
        self._crew = client.submit(_Crew, self._name, parcel.payload, tuple(parcel.fmus), *fmus, key=self._name)
        self._waiting: dict[Future[Any], Piece] = {}
        self._given: dict[Future[Any], str] = {}  # the preferred worker; the scheduler may choose another
        self._threads: dict[str, int] = {}
        self._looked, self._began = 0.0, time.monotonic()
        self._again: deque[Piece] = deque()
        self._parts: dict[int, tuple[Piece, dict[int, Any]]] = {}  # outcomes of pieces that are made run by run

    def outcomes(self, pieces: Iterator[Piece]) -> Iterator[Any]:
        """Yield the outcome of each piece."""
        try:
            while True:
                self._look()
                self._submit(pieces)
                if not self._waiting:
                    return
                for future in self._done():
                    del self._given[future]
                    yield from self._taken(future, self._waiting.pop(future))
        finally:
            with suppress(Exception):  # if the cluster has ended, there is nothing to stop
                if self._client.status == "running":
                    self._client.cancel(list(self._waiting))
                    self._client.run(_stop, self._name, on_error="ignore")
            self._waiting.clear()
            self._crew.release()

    def _look(self) -> None:
        """Update the number of threads once in a while, and warn if there are none."""
        if time.monotonic() - self._looked < LOOK and self._threads:
            return
        if self._local:
            self._local.tend()
        try:
            self._threads = self._client.nthreads()
        except (OSError, ValueError) as error:  # ValueError: the client is closed
            raise _lost(error) from None
        self._looked = time.monotonic()
        if not self._threads and self._began and self._looked - self._began > CONNECTING:
            warn_user("The Dask cluster has no workers; the campaign waits until there are some.")
            self._began = 0.0

    def _submit(self, pieces: Iterator[Piece]) -> None:
        if self._again:
            # When a worker dies, Dask suspects all its tasks. So each suspected run is made alone.
            if not self._waiting:
                self._send(self._again.popleft())
            return
        while (worker := self._least_busy()) is not None:
            piece = next(pieces, None)
            if piece is None:
                return
            self._send(piece, worker)

    def _least_busy(self) -> str | None:
        """Return the worker for the next piece. By default, Dask would give all pieces to the first worker with the job."""
        if not self._threads:
            return None if self._waiting else ""
        count = Counter(self._given.values())
        load = {worker: count[worker] / threads for worker, threads in self._threads.items()}
        least = min(load, key=lambda worker: load[worker])
        return least if load[least] < AHEAD else None

    def _send(self, piece: Piece, worker: str = "") -> None:
        where = {"workers": [worker], "allow_other_workers": True} if worker else {}
        future = self._client.submit(_run, self._crew, piece, key=self._key(piece), pure=False, **where)
        self._waiting[future] = piece
        self._given[future] = worker

    def _key(self, piece: Piece) -> str:
        return f"{self._name}-{piece.begin}-{piece.end}{'-alone' if piece.index in self._parts else ''}"

    def _done(self) -> list[Future[Any]]:
        from distributed import wait

        with suppress(TimeoutError, CancelledError), self._client.as_current():
            wait(list(self._waiting), timeout=LOOK, return_when="FIRST_COMPLETED")
        return [future for future in self._waiting if future.status != "pending"]

    def _taken(self, future: Future[Any], piece: Piece) -> Iterator[Any]:
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker

        try:
            outcome = future.result()
        except KilledWorker as error:
            if not hasattr(self._job, "failed") or error.task != self._key(piece):
                raise BayesFTCError(f"The workers of the Dask cluster die one after the other: {error}") from None
            if piece.index not in self._parts:  # find out which of the runs is responsible
                self._parts[piece.index] = piece, {}
                self._again += [Piece(piece.index, run, run + 1) for run in range(piece.begin, piece.end)]
                return
            outcome = self._job.failed(
                piece, "has ended several workers of the Dask cluster, the last one " + _last(error)
            )
        except (CancelledError, CommClosedError) as error:  # CommClosedError: the client has not noticed yet
            raise _lost(error) from None
        except OSError as error:
            if self._client.status != "running":
                raise _lost(error) from None
            raise
        if piece.index not in self._parts:
            yield outcome
            return
        whole, parts = self._parts[piece.index]
        parts[piece.begin] = outcome
        if len(parts) == len(whole):
            del self._parts[piece.index]
            yield joined(whole, [parts[begin] for begin in sorted(parts)])


# On the workers


class _Crew:
    """The job and its FMUs, as a task that Dask copies between workers. The processes belong to the Dask worker."""

    def __init__(self, name: str, payload: bytes, contents: tuple[Content, ...], *fmus: bytes):
        self._parts: tuple[Any, ...] = name, payload, contents, *fmus

    def run(self, piece: Piece) -> Any:
        name, payload, contents, *fmus = self._parts
        with _lock:
            if name not in _here:
                for content, data in zip(contents, fmus, strict=True):
                    content.place(data)
                _here[name] = _Here(name, payload)
            here = _here[name]
        return here.run(piece)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Crew, self._parts


class _Here:
    """The crew of this Dask worker for one job; it ends on `stop`, or when it has been idle for `IDLE` seconds.

    It does not end with `_Crew`, because Dask drops and fetches copies of that at any time.
    """

    def __init__(self, name: str, payload: bytes):
        self._name, self._crew = name, Crew(payload)
        self._running, self._used, self._is_stopped = 0, time.monotonic(), False
        threading.Thread(target=self._watch, name="campaign", daemon=True).start()

    def run(self, piece: Piece) -> Any:
        with _lock:
            self._running += 1
        try:
            return self._crew.run(piece, lambda: not self._is_stopped)
        finally:
            with _lock:
                self._running, self._used = self._running - 1, time.monotonic()

    def stop(self) -> None:
        self._is_stopped = True

    def _watch(self) -> None:
        while True:
            time.sleep(GLANCE)
            with _lock:
                if self._running or not (self._is_stopped or time.monotonic() - self._used > IDLE):
                    continue
                if _here.get(self._name) is self:
                    del _here[self._name]
            self._crew.close()
            return


_here: dict[str, _Here] = {}
_lock = threading.Lock()


def _run(crew: _Crew, piece: Piece) -> Any:
    return crew.run(piece)


def _stop(name: str) -> None:
    with _lock:
        here = _here.pop(name, None)
    if here:
        here.stop()


def _same(data: bytes) -> bytes:
    return data


# On the client


@contextmanager
def _client(address: str | Client | None) -> Iterator[Client]:
    """Yield a client of the scheduler: the given one, or a new one."""
    import dask
    from distributed import Client
    from distributed.comm.addressing import normalize_address, parse_address
    from distributed.comm.registry import get_backend

    # No warning about large FMUs: each is sent once.
    quiet = {"distributed.admin.large-graph-warning-threshold": "1 TB"}
    with dask.config.set(quiet):
        if isinstance(address, Client):
            yield address
            return
        try:
            if address is not None:
                # Check the address first: Python would close a failed client again at its end, for 20 seconds.
                get_backend(parse_address(normalize_address(address))[0])
            client = Client(address, timeout=CONNECTING, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise BayesFTCError(
                f"There is no Dask scheduler at {address!r} ({_first_line(error)}); start one with: dask scheduler"
            ) from None
        try:
            yield client
        finally:
            client.close(timeout=CONNECTING)


def _check(client: Client) -> None:
    """Check that the present workers have this package; warn if their results may differ."""
    try:
        environments = client.run(environment, on_error="return")
    except Exception as error:  # noqa: BLE001 - it may raise anything
        raise _lost(error) from None
    here = environment()
    for worker, there in environments.items():
        if isinstance(there, BaseException):
            raise BayesFTCError(
                f"The Dask worker {worker} cannot use bayesftc ({_first_line(there)}); install this version of bayesftc there."
            )
        differences = changes(here, there)
        if differences:
            text = "; ".join(differences).replace(" before", " here").replace(" now", " there")
            warn_user(
                f"The Dask worker {worker} differs from this machine ({text}); its numbers may differ in their last digits."
            )
            return


def _lost(error: BaseException) -> BayesFTCError:
    return BayesFTCError(
        f"The connection to the Dask scheduler was lost ({_first_line(error)}), but stored runs are kept; resume the "
        "campaign when the scheduler is back."
    )


def _last(error: Any) -> str:
    worker = getattr(error, "last_worker", None)
    return str(getattr(worker, "address", None) or worker or "unknown")


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


__all__ = ["DaskCluster"]
