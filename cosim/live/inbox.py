"""The samples of a wire, of which a step uses one, and the reasons of missing ones.

A filter may use a sample once only: it would take a second use for a second measurement, and the learner a repetition for a
freeze. But two clocks drift. When a sender's phase passes that of the steps, jitter lets some steps see no message and the next
ones two. To use the newest only would then lose a sixth of the samples, for as long as the phase needs to pass the jitter (40 s
for 2 ms and 50 parts in a million). So after a step without a message, a second sample waits for the next step; the price is an
age of up to two periods instead of one. When each of the last `CALM` steps had a message, the newest is used again. Each slip of
the phase by a period still costs one sample, or one step without any: nothing that uses samples once can avoid it.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isinf, nan
from typing import Any, NamedTuple

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.formats import Format, Message, decode
from bayesftc.cosim.types import Floats

NONE, LATE, STALE, ORDER, TWICE, NUMBER, RANGE, DECODING, SIZE, STATUS, DROPPED = REASONS = (
    "no message",
    "late",
    "stale",
    "out of order",
    "duplicate",
    "not a number",
    "out of range",
    "not decodable",
    "wrong size",
    "bad status",
    "dropped by hand",
)
"""Reasons of missing samples. A step without a sample counts the reason of the last message since the step before."""

RESTART = 10
"""After so many messages in a row with old stamps that increase, the sender has restarted, and the new stamps hold."""

STEADY = 2.0
"""Seconds in which all messages are late by the same, after which the sender's clock has been set back or has stopped."""

DRIFT = 2e-4
"""Largest relative difference of the rates of two clocks, by which the least delay of a message grows with time."""

CALM = 100
"""Steps in a row with a message after which no sample waits any more."""

BEHIND = 8
"""Most samples that wait for steps that are late: those that came while the process had stopped."""

WAITING = 2 + BEHIND
"""Most samples that wait."""

LONGEST_DROP = 3600.0
"""Most seconds for which messages are dropped by hand."""

CLOCKS, YEAR = 1.0, 3.2e7
"""Largest lead of a sender's clock, and largest age of a sample that the other side has kept, in seconds."""


@dataclass(frozen=True)
class Limits:
    """How raw values become samples, and which samples are used.

    Attributes
    ----------
    stale_after : float, optional
        Seconds after which a sample is not used any more. Its age counts from its arrival. If the messages have time stamps, the
        age also has the delay on the way, beyond the smallest delay so far; so the two clocks need not agree. If all messages
        of two seconds are late by the same (to ``stale_after``), delays count from there on: the sender had stopped, or its
        clock has been set. A lasting delay on the way cannot be told from that.
    hold : bool
        Whether a sample is used in each step until a newer one comes, or is stale. By default it is used in one step only, and
        may wait for it for one period; so `stale_after` should be at least three periods of the samples.
    scale, offset : float
        The sample is ``scale * value + offset``.
    low, high : float
        Least and largest sample; others are missing.

    Examples
    --------
    >>> from bayesftc.cosim.live import Inbox, Limits
    >>> inbox = Inbox(1, Limits(scale=0.2778, low=0.0, high=60.0))  # from km/h to m/s
    >>> inbox.put([72.0])
    >>> inbox.take().round(1).tolist()
    [20.0]
    """

    stale_after: float | None = None
    hold: bool = False
    scale: float = 1.0
    offset: float = 0.0
    low: float = -inf
    high: float = inf

    def __post_init__(self) -> None:
        if self.stale_after is not None and not 0 < self.stale_after < inf:
            raise ModelError(f"stale_after is {self.stale_after!r}; it must be a positive number of seconds.")
        for name in ("scale", "offset"):
            if not isfinite(getattr(self, name)) or self.scale == 0:
                raise ModelError(f"{name} is {getattr(self, name)!r}; it must be a finite number, and scale not zero.")
        if not self.low < self.high:
            raise ModelError(f"low is {self.low!r} and high is {self.high!r}; low must be less than high.")


class _Sample(NamedTuple):
    values: Floats
    reasons: list[str]
    born: float


class Inbox:
    """The samples of a wire: bridges put samples in from any thread, the loop takes one at each step.

    A sample that is late, out of order, not a number or out of range is missing (NaN), and counted by its reason.

    A step takes the newest sample. If a message has been lacking at one of the last 100 steps, it takes the older of the last
    two, so that the jitter of messages leaves no gaps.

    Parameters
    ----------
    size : int
        Number of values in a sample.
    limits : Limits, optional
        Scale, range and age of samples.
    clock : callable
        The clock in seconds.

    Attributes
    ----------
    received, replaced : int
        Number of messages, and of those that newer ones have replaced before any step used them.
    rejected : Counter of str
        Number of messages that were not used, by reason. A message of which only some elements are not used counts, too.
    missing : Counter of str
        Number of elements of samples that were missing at a step, by reason.

    Examples
    --------
    >>> from bayesftc.cosim.live import Inbox
    >>> inbox = Inbox(1)
    >>> inbox.put([20.0])
    >>> inbox.take().tolist(), inbox.take().tolist()
    ([20.0], [nan])
    >>> inbox.receive(b'{"value": "hot"}', "json")
    >>> inbox.take().tolist(), dict(inbox.missing)
    ([nan], {'no message': 1, 'not decodable': 1})
    """

    def __init__(self, size: int, limits: Limits | None = None, clock: Callable[[], float] = time.monotonic):
        self.size, self.limits = size, limits or Limits()
        self.received = self.replaced = 0
        self.rejected: Counter[str] = Counter()
        self.missing: Counter[str] = Counter()
        self.last_reason = ""
        self._clock = clock
        self._lock = threading.Lock()
        self._waiting: deque[_Sample] = deque()  # the oldest first
        self._born = -inf
        self._used, self._came, self._calm = False, False, CALM
        self._why = NONE
        self._drops_until = -inf
        self._stamps: dict[str, float] = {}
        self._old: list[float] = []
        self._least: float | None = None
        self._least_at = 0.0
        self._late: tuple[float, float, float] | None = (
            None  # since when messages are, and their least and largest delay
        )

    def put(
        self,
        values: Sequence[float] | float,
        sent: float | None = None,
        *,
        sequence: int | None = None,
        kept: bool = False,
        age: float = 0.0,
    ) -> None:
        """Add a sample, from any thread.

        Parameters
        ----------
        values : float or sequence of float
            The numbers as the sender gave them, before scale and offset; NaN for a missing one.
        sent : float, optional
            The sender's time in seconds, from any origin.
        sequence : int, optional
            The sender's sequence number.
        kept : bool
            Whether the other side has kept the sample for some time, as a broker does. Its age is then the time since `sent`,
            in seconds since 1970, and counts for ``stale_after``. Without ``stale_after``, it is used if samples are held.
        age : float
            Seconds since it arrived.
        """
        raw = tuple(np.ravel(np.asarray(values, dtype=np.float64)).tolist())
        self._put(Message(raw, sent, sequence), kept, self._clock() - age)

    def _put(self, message: Message, kept: bool, now: float) -> None:
        raw, sent, sequence = message
        with self._lock:
            self.received += 1
            if self._is_dropped(now):
                return
            if len(raw) != self.size:
                self._refuse(SIZE, f"{SIZE}: {len(raw)} instead of {self.size}")
                return
            for kind, stamp in (("sequence", sequence), ("sent", sent)):
                if stamp is not None and (reason := self._misplaced(kind, stamp)):
                    self._refuse(reason)
                    return
            if kept:
                delay = _age(sent)
                if self.limits.stale_after is None and not self.limits.hold:
                    self._refuse(LATE, f"{LATE}: kept by the other side, and no stale_after is given")
                    return
            else:
                delay = 0.0 if sent is None else self._counted(now, self._delay(now, sent))
            if self.limits.stale_after is not None and delay > self.limits.stale_after:
                unknown = f"{LATE}: kept by the other side, without the time in seconds since 1970"
                self._refuse(LATE, unknown if isinf(delay) else "")
                return
            self._accept(raw, now - delay)

    def receive(self, payload: bytes, form: Format, *, kept: bool = False, age: float = 0.0) -> None:
        """Decode a message and add its sample, or reject it, from any thread.

        Parameters
        ----------
        payload : bytes
            The message.
        form : {"doubles", "stamped doubles", "json", "text"}
            Its format.
        kept : bool
            Whether the other side has kept it for some time; see `put`.
        age : float
            Seconds since it arrived.
        """
        try:
            message = decode(payload, form)
        except ValueError as error:
            self.reject(str(error), age=age)
        else:
            self._put(message, kept, self._clock() - age)

    def skip(self, count: int) -> None:
        """Count messages that newer ones have replaced before they were decoded, from any thread."""
        if count:
            with self._lock:
                self.received += count
                self.replaced += count

    def reject(self, reason: str, *, age: float = 0.0) -> None:
        """Count a message that cannot be decoded, from any thread; `reason` is shown as the last one."""
        with self._lock:
            self.received += 1
            if not self._is_dropped(self._clock() - age):
                self._refuse(DECODING, f"{DECODING}: {reason}")

    def fail(self, reason: str) -> None:
        """Note that the other side has no valid sample now, from any thread; a held sample ends."""
        with self._lock:
            self.received += 1
            self._refuse(STATUS, f"{STATUS}: {reason}")
            self._drop(0)

    def drop(self, seconds: float) -> None:
        """Use no message that arrives in the next seconds, for a test, from any thread. With 0 they are used again.

        Raises
        ------
        ModelError
            If it is not from 0 to 3600 s.
        """
        if not 0 <= seconds <= LONGEST_DROP:
            raise ModelError(f"Samples are to be dropped for {seconds:g} s; it must be from 0 to {LONGEST_DROP:g} s.")
        with self._lock:
            self._drops_until = self._clock() + seconds

    @property
    def dropping(self) -> float:
        """Seconds for which messages are still dropped by hand."""
        return max(self._drops_until - self._clock(), 0.0)

    def take(self, late: float = 0.0, behind: int = 0) -> Floats:
        """Return the sample for a step, with NaN for each missing element.

        Parameters
        ----------
        late : float
            Seconds by which the step is late. The age of a sample counts to the time at which the step was due.
        behind : int
            Number of further steps that are due already. For them, samples wait.
        """
        now, limits = self._clock() - late, self.limits
        with self._lock:
            self._calm = min(self._calm + 1, CALM) if self._came else 0
            self._came = False
            self._drop(1 if limits.hold else 1 + (self._calm < CALM) + min(behind, BEHIND))
            while len(self._waiting) > 1 and self._is_stale(self._waiting[0], now):
                self._drop(len(self._waiting) - 1)
            if not self._waiting:
                values, reasons = np.full(self.size, np.nan), [self._why] * self.size
            elif self._is_stale(self._waiting[0], now):
                values, reasons = np.full(self.size, np.nan), [STALE] * self.size
            else:
                values, reasons = self._waiting[0].values.copy(), self._waiting[0].reasons
            if limits.hold:
                self._used = True
            elif self._waiting:
                self._waiting.popleft()
            for reason in reasons:
                if reason:
                    self.missing[reason] += 1
            self._why = NONE
            return values

    def numbers(self, steps: int) -> dict[str, Any]:
        """Return the numbers of messages and missing samples after so many steps, from any thread."""
        with self._lock:
            return {
                "received": self.received,
                "replaced": self.replaced,
                "rejected": dict(self.rejected.most_common()),
                "missing": dict(self.missing.most_common()),
                "missing_share": self.missing.total() / max(steps * self.size, 1),
                "last_reason": self.last_reason,
            }

    def age(self) -> float:
        """Return the age of the last sample in seconds; infinity before the first."""
        with self._lock:
            return self._clock() - self._born

    def _accept(self, raw: Sequence[float], born: float) -> None:
        limits = self.limits
        values = [limits.scale * value + limits.offset for value in raw]  # quicker than arrays of a few elements
        reasons = [
            NUMBER if not isfinite(value) else "" if limits.low <= value <= limits.high else RANGE for value in values
        ]
        for reason in (NUMBER, RANGE):
            if reason in reasons:
                self.rejected[reason] += 1
                self.last_reason = reason
        if all(reasons):
            self._why = RANGE if RANGE in reasons else NUMBER
            return
        if any(reasons):
            values = [nan if reason else value for value, reason in zip(values, reasons, strict=True)]
        self._waiting.append(_Sample(np.array(values), reasons, born))
        self._born, self._came = born, True
        self._drop(1 if limits.hold else WAITING)

    def _drop(self, most: int) -> None:
        """Leave at most so many of the newest samples."""
        while len(self._waiting) > most:
            self._waiting.popleft()
            self.replaced += not self._used
            self._used = False

    def _is_dropped(self, now: float) -> bool:
        """Return whether messages are dropped by hand now; then this one is counted."""
        dropped = now < self._drops_until
        if dropped:
            self._refuse(DROPPED)
        return dropped

    def _is_stale(self, sample: _Sample, now: float) -> bool:
        return self.limits.stale_after is not None and now - sample.born > self.limits.stale_after

    def _refuse(self, reason: str, text: str = "") -> None:
        self.rejected[reason] += 1
        self.last_reason = text or reason
        self._why = reason

    def _misplaced(self, kind: str, stamp: float) -> str:
        """Return why a message with this stamp is not the next one, or an empty text."""
        last = self._stamps.get(kind, -inf)
        if stamp > last:
            self._stamps[kind] = stamp
            self._old.clear()
            return ""
        if stamp == last:
            return TWICE
        if self._old and stamp <= self._old[-1]:
            self._old.clear()
        self._old.append(stamp)
        if len(self._old) < RESTART:
            return ORDER
        self._old.clear()
        self._stamps = {kind: stamp}
        self._least = None
        return ""

    def _delay(self, now: float, sent: float) -> float:
        """Return the delay of a message beyond the smallest one so far, in seconds."""
        delay = now - sent
        if self._least is not None:
            self._least += DRIFT * (now - self._least_at)
        self._least = delay if self._least is None else min(self._least, delay)
        self._least_at = now
        return delay - self._least

    def _counted(self, now: float, delay: float) -> float:
        """Return the delay, or less if delays count anew because all have been large and alike for `STEADY` seconds."""
        most = self.limits.stale_after
        if most is None or delay <= most:
            self._late = None
            return delay
        since, low, high = self._late or (now, delay, delay)
        low, high = min(low, delay), max(high, delay)
        self._late = (since, low, high) if high - low <= most else (now, delay, delay)
        if high - low > most or now - since < STEADY or self._least is None:
            return delay
        self._least, self._late = self._least + low, None
        return delay - low


def _age(sent: float | None) -> float:
    """Return the age of a sample by the clock in seconds; infinity if its time stamp is missing or not of this clock."""
    age = inf if sent is None else time.time() - sent
    return max(age, 0.0) if -CLOCKS < age < YEAR else inf


__all__ = ["REASONS", "Inbox", "Limits"]
