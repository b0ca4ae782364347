"""Runs on a cluster, by Dask distributed.

The job goes there as one task, whose result is a crew of worker processes; each Dask worker that needs it has its own. FMUs are
tasks too, called by the hash of their content. All three are pure, so what is lost with a worker is made again elsewhere. The
crew ends with the key, and that ends with the client, however it ends.
"""

from __future__ import annotations

import threading
import time
import uuid
import warnings
import weakref
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesftc.cosim._campaign.crew import Crew
from bayesftc.cosim._campaign.environment import changes, environment
from bayesftc.cosim._campaign.executors import AHEAD, R, Work, check_jobs
from bayesftc.cosim._campaign.extras import extra
from bayesftc.cosim._campaign.local_cluster import LocalCluster
from bayesftc.cosim._campaign.plan import Piece, joined
from bayesftc.cosim._campaign.shipping import Content, Parcel
from bayesftc.cosim.errors import BayesFTCError, ModelError

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECTING = 10
"""Seconds for the scheduler to answer."""
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
        machine, which ends with the campaign.
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
        self._slots, self._looked, self._began = 0, 0.0, time.monotonic()
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
        if time.monotonic() - self._looked < LOOK and self._slots:
            return
        if self._local:
            self._local.tend()
        try:
            self._slots = sum(self._client.nthreads().values())
        except (OSError, ValueError) as error:  # a client that is closed, too
            raise _lost(error) from None
        self._looked = time.monotonic()
        if not self._slots and self._began and self._looked - self._began > CONNECTING:
            warnings.warn("The Dask cluster has no workers; the campaign waits for some.", UserWarning, stacklevel=2)
            self._began = 0.0

    def _submit(self, pieces: Iterator[Piece]) -> None:
        if (
            self._again
        ):  # Dask suspects all that a worker had when it died: a run is alone with its workers, or it is not proven
            if not self._waiting:
                self._send(self._again.popleft())
            return
        while len(self._waiting) < AHEAD * max(self._slots, 1):
            piece = next(pieces, None)
            if piece is None:
                return
            self._send(piece)

    def _send(self, piece: Piece) -> None:
        future = self._client.submit(_run, self._crew, piece, key=self._key(piece), pure=False)
        self._waiting[future] = piece

    def _key(self, piece: Piece) -> str:
        return f"{self._name}-{piece.begin}-{piece.end}{'-alone' if piece.index in self._parts else ''}"

    def _done(self) -> list[Future[Any]]:
        from distributed import wait

        with suppress(TimeoutError, CancelledError), self._client.as_current():
            wait(list(self._waiting), timeout=LOOK, return_when="FIRST_COMPLETED")
        return [future for future in self._waiting if future.status != "pending"]

    def _taken(self, future: Future[Any], piece: Piece) -> Iterator[Any]:
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
        except CancelledError as error:
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

_crews: weakref.WeakSet[_Crew] = weakref.WeakSet()


class _Crew:
    """The crew of a Dask worker; where it is sent to another worker, that one has its own."""

    def __init__(self, name: str, payload: bytes, contents: tuple[Content, ...], *fmus: bytes):
        self.name = name
        self._parts: tuple[Any, ...] = name, payload, contents, *fmus
        self._lock, self._is_placed, self._is_stopped = threading.Lock(), False, False
        self._crew = Crew(payload)
        _crews.add(self)

    def run(self, piece: Piece) -> Any:
        with self._lock:
            if not self._is_placed:
                for content, data in zip(self._parts[2], self._parts[3:], strict=True):
                    content.place(data)
                self._is_placed = True
        return self._crew.run(piece, lambda: not self._is_stopped)

    def stop(self) -> None:
        self._is_stopped = True
        self._crew.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return _Crew, self._parts


def _run(crew: _Crew, piece: Piece) -> Any:
    return crew.run(piece)


def _stop(name: str) -> None:
    for crew in list(_crews):
        if crew.name == name:
            crew.stop()


def _same(data: bytes) -> bytes:
    return data


# On the client


@contextmanager
def _client(address: str | Client | None) -> Iterator[Client]:
    """Yield a client of the scheduler, which may be at work already."""
    import dask
    from distributed import Client

    quiet = {
        "distributed.admin.large-graph-warning-threshold": "1 TB"
    }  # an FMU is as large as it is, and goes there once
    with dask.config.set(quiet):
        if isinstance(address, Client):
            yield address
            return
        try:
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
            warnings.warn(
                f"The Dask worker {worker} differs from this machine ({said}): the last places of its numbers may do so too.",
                UserWarning,
                stacklevel=2,
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
