"""Runs on a cluster, by Dask distributed.

The job goes there as one task; each Dask worker that has it starts a crew of processes, which do the pieces. FMUs are
tasks too, called by the hash of their content. All three are pure, so what is lost with a worker is made again elsewhere.
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
"""Seconds without a piece after which a worker ends the processes of a job, whose client may have been killed."""
LOOK = 1.0
"""Seconds between two looks at what the cluster has become."""


@dataclass(frozen=True)
class DaskCluster:
    """Runs on a Dask cluster.

    The workers need this package, and the modules that the campaign's own functions and blocks are of (what a script or notebook
    defines goes along); FMUs go there by themselves. Each Dask worker has its runs made in processes of their own, as many as it
    has threads, so that a run that crashes takes no worker down. A piece of which the worker dies runs again elsewhere.

    Parameters
    ----------
    address : str or distributed.Client, optional
        Of the scheduler, as ``"tcp://10.0.0.1:8786"``, or a client that is connected to it. By default a cluster on this
        machine, which ends with the campaign; that needs Linux or macOS.
    workers : int, optional
        How many workers a cluster on this machine has; by default one for each core.
    """

    address: str | Client | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        check_jobs(self.workers)
        if self.workers is not None and self.address is not None:
            raise ModelError(
                "workers= is of a cluster on this machine; the one at address= has the workers that it has."
            )
        if isinstance(self.address, str) and not re.fullmatch(r"(\w+://)?[^/\s]+:\d+/?|inproc://\S+", self.address):
            raise ModelError(
                f"address is {self.address!r}; give that of the Dask scheduler with its port, such as tcp://10.0.0.1:8786."
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
        self._given: dict[Future[Any], str] = {}  # to which worker, as far as the scheduler is free to do so
        self._threads: dict[str, int] = {}
        self._looked, self._began = 0.0, time.monotonic()
        self._again: deque[Piece] = deque()
        self._parts: dict[int, tuple[Piece, dict[int, Any]]] = {}  # of pieces that are made run by run

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
            with suppress(Exception):  # a cluster that is gone has nothing left to stop
                if self._client.status == "running":
                    self._client.cancel(list(self._waiting))
                    self._client.run(_stop, self._name, on_error="ignore")
            self._waiting.clear()
            self._crew.release()

    def _look(self) -> None:
        """See now and then how many threads there are, and that there are any."""
        if time.monotonic() - self._looked < LOOK and self._threads:
            return
        if self._local:
            self._local.tend()
        try:
            self._threads = self._client.nthreads()
        except (OSError, ValueError) as error:  # a client that is closed, too
            raise _lost(error) from None
        self._looked = time.monotonic()
        if not self._threads and self._began and self._looked - self._began > CONNECTING:
            warn_user("The Dask cluster has no workers; the campaign waits for some.")
            self._began = 0.0

    def _submit(self, pieces: Iterator[Piece]) -> None:
        if (
            self._again
        ):  # Dask suspects all that a worker had when it died: a run is alone with its workers, or it is not proven
            if not self._waiting:
                self._send(self._again.popleft())
            return
        while (worker := self._least_busy()) is not None:
            piece = next(pieces, None)
            if piece is None:
                return
            self._send(piece, worker)

    def _least_busy(self) -> str | None:
        """Return who is to have the next piece: left to itself, Dask gives all of them to the first worker that has the job."""
        if not self._threads:
            return None if self._waiting else ""
        given = Counter(self._given.values())
        load = {worker: given[worker] / threads for worker, threads in self._threads.items()}
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
            if piece.index not in self._parts:  # which of the runs it is, is to be found out
                self._parts[piece.index] = piece, {}
                self._again += [Piece(piece.index, run, run + 1) for run in range(piece.begin, piece.end)]
                return
            outcome = self._job.failed(
                piece, "has ended several workers of the Dask cluster, the last one " + _last(error)
            )
        except (CancelledError, CommClosedError) as error:  # the latter while the client has not noticed yet
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
    """What the workers need; where it is sent to another one, that has the same. The processes belong to the Dask worker."""

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
    """The crew of this Dask worker for one job; it ends when it is told to, or has had nothing to do for a while.

    It does not end with `_Crew`, of which Dask drops and fetches copies as it sees fit.
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
    """Yield a client of the scheduler, which may be at work already."""
    import dask
    from distributed import Client
    from distributed.comm.addressing import normalize_address, parse_address
    from distributed.comm.registry import get_backend

    quiet = {
        "distributed.admin.large-graph-warning-threshold": "1 TB"
    }  # an FMU is as large as it is, and goes there once
    with dask.config.set(quiet):
        if isinstance(address, Client):
            yield address
            return
        try:
            if (
                address is not None
            ):  # a client that fails of it would be closed once more when Python ends, for 20 seconds
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
    """See that the workers that are there have this package; warn where their bits may be others."""
    try:
        found = client.run(environment, on_error="return")
    except Exception as error:  # noqa: BLE001 - of whatever kind
        raise _lost(error) from None
    own = environment()
    for worker, theirs in found.items():
        if isinstance(theirs, BaseException):
            raise BayesFTCError(
                f"The Dask worker {worker} cannot use bayesftc ({_first_line(theirs)}); install bayesftc there in this version."
            )
        unlike = changes(own, theirs)
        if unlike:
            said = "; ".join(unlike).replace(" before", " here").replace(" now", " there")
            warn_user(
                f"The Dask worker {worker} differs from this machine ({said}): the last places of its numbers may do so too."
            )
            return


def _lost(error: BaseException) -> BayesFTCError:
    return BayesFTCError(
        f"The connection to the Dask scheduler was lost ({_first_line(error)}); what is stored is kept: resume the "
        "campaign when the scheduler is back."
    )


def _last(error: Any) -> str:
    worker = getattr(error, "last_worker", None)
    return str(getattr(worker, "address", None) or worker or "unknown")


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


__all__ = ["DaskCluster"]
