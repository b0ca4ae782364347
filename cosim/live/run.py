"""The live run: at each period of the clock it reads the inboxes, makes a step, and sends the outputs."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.live.deadlines import Deadlines
from bayesftc.cosim.live.recorder import Recorder, Recording
from bayesftc.cosim.live.steppers import OnlineStepper, SessionStepper, Stepper
from bayesftc.cosim.live.watchdog import Watchdog
from bayesftc.cosim.live.wires import Incoming, Outgoing, Wire, incoming, outgoing
from bayesftc.cosim.run.online import Online
from bayesftc.cosim.run.pacing import Pacer
from bayesftc.cosim.run.session import Session
from bayesftc.cosim.types import Floats

BREATH = 0.05
"""Most seconds of sleep after which the loop looks whether it is to stop."""

CATCH = 0.1
"""Share of a period in which the bridges read what came while the process had stopped, before the late steps are made."""

LOST_CLOCK = 1.0
"""Seconds of delay after which the clock is set anew and steps are left out, instead of caught up."""

SWITCH = 2e-4
"""Seconds after which Python may switch to another thread."""

FEWEST = 10
"""Default number of periods without a control after which the watchdog sends the safe values."""

Watcher = Callable[[float, Floats, Floats], None]
Opened = Callable[[Sequence[Incoming | Outgoing], Path | None], None]


@dataclass(frozen=True)
class LiveSettings:
    """How a live run is paced, watched and recorded.

    Parameters
    ----------
    duration : float, str or Fraction, optional
        Seconds of the model; by default the run goes on until it is stopped.
    pace : float
        Seconds of the model for each second of the clock.
    watchdog : float
        Number of periods without a step after which the watchdog sends the safe values.
    recording : Recording, optional
        Where the run is recorded.
    watcher : callable, optional
        Called after each step as ``watcher(time, inputs, outputs)``, with the elements as arrays. Its time counts, and it must
        keep copies only.
    opened : callable, optional
        Called once as ``opened(wires, folder)`` when the bridges are open: with the wires, whose numbers any thread may read, and
        the folder of this run's recording.

    Examples
    --------
    >>> from bayesftc.cosim import live
    >>> live.LiveSettings(duration=60.0, watchdog=5).pace
    1.0
    """

    duration: float | str | Fraction | None = None
    pace: float = 1.0
    watchdog: float = FEWEST
    recording: Recording | None = None
    watcher: Watcher | None = None
    opened: Opened | None = None

    def steps(self, step: Fraction) -> int | None:
        """Return the number of steps of so many seconds; None without a duration.

        Raises
        ------
        StepSizeError, ModelError
            If the duration is no whole number of steps, or the pace is not positive.
        """
        Pacer(self.pace, step, 0)
        return None if self.duration is None else whole_steps(self.duration, step, "The duration")


@dataclass(frozen=True)
class LiveSummary:
    """What happened in a live run.

    Attributes
    ----------
    steps : int
        Number of steps.
    time : float
        Time of the last step in seconds.
    stopped : str
        Why the run has ended, as a sentence.
    deadlines : dict
        See `Deadlines.report`.
    wires_in, wires_out : dict of str to dict
        For each wire the numbers of messages and samples, by reason, and whether it was connected at the end.
    watchdog_trips : int
        How often the watchdog has sent safe values.
    recorded : str or None
        The folder of the recording.
    lost_rows : int
        Number of steps that are not in the recording.
    problem : str
        The last error of the recording's disk, or an empty text.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import live
    >>> clock = cosim.Ramp(1.0).online(dt=0.01, compiled=False)
    >>> live.run_live(clock, {}, live.LiveSettings(duration=0.05)).stopped
    'The run has ended after 0.04 s, as requested.'
    """

    steps: int
    time: float
    stopped: str
    deadlines: dict[str, Any]
    wires_in: dict[str, dict[str, Any]] = field(default_factory=dict)
    wires_out: dict[str, dict[str, Any]] = field(default_factory=dict)
    watchdog_trips: int = 0
    recorded: str | None = None
    lost_rows: int = 0
    problem: str = ""


class Stop:
    """A request to end a live run, which any thread or signal handler may make.

    Attributes
    ----------
    reason : str
        The first reason, or an empty text.

    Examples
    --------
    >>> from bayesftc.cosim import live
    >>> stop = live.Stop()
    >>> stop.request("The operator has stopped the run.")
    >>> bool(stop), stop.reason
    (True, 'The operator has stopped the run.')
    """

    def __init__(self) -> None:
        self.reason = ""

    def request(self, reason: str) -> None:
        """End the run before its next step."""
        self.reason = self.reason or reason

    def __bool__(self) -> bool:
        return bool(self.reason)


def run_live(
    target: Session | Online | Stepper,
    wires: Mapping[str, Wire],
    settings: LiveSettings | None = None,
    stop: Stop | None = None,
) -> LiveSummary:
    """Run a session, or a controller alone, between wires to the outside, paced by the clock.

    At each period the samples are read, a step is made, and its outputs are sent. A late step is made at once; after more than a
    second of delay the clock is set anew. The safe values are sent before all inputs have values, if the steps stop (watchdog),
    and at the end, also after an error. SIGTERM and Ctrl-C end the run in this way, if it runs in the main thread.

    Parameters
    ----------
    target : Session, Online or Stepper
        What runs. Inputs without a wire keep their start values.
    wires : mapping of str to Wire
        By name, which messages contain.
    settings : LiveSettings, optional
        Duration, pace, watchdog, recording.
    stop : Stop, optional
        For ending the run from another thread.

    Returns
    -------
    LiveSummary
        Deadlines, and the samples of each wire.

    Raises
    ------
    BayesFTCError
        If a wire does not fit, a bridge cannot be opened, or a step fails. The safe values are sent before.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import live
    >>> received = live.UDP(port=0)
    >>> received.open(box := live.Inbox(1))
    >>> ramp = cosim.Integrator(initial=3.0).online(dt=0.01, compiled=False)
    >>> wires = {
    ...     "rate": live.Wire(live.UDP(port=0), to="u", start=1.0),
    ...     "level": live.Wire(live.UDP(port=received.port_number), source="y", safe=0.0),
    ... }
    >>> summary = live.run_live(ramp, wires, live.LiveSettings(duration=0.05))
    >>> summary.steps, summary.wires_in["rate"]["missing"], summary.wires_out["level"]["sent"]
    (5, {'no message': 5}, 5)
    >>> received.close()
    """
    settings, stop = settings or LiveSettings(), Stop() if stop is None else stop
    stepper = _stepper(target)
    stepper.prepare()
    ins, outs = _connected(stepper, wires)
    steps = settings.steps(stepper.step)
    with ExitStack() as stack:
        stack.enter_context(_signals(stop))
        stack.enter_context(_quick_switches())
        stack.enter_context(_settled_memory())
        loop = _Loop(stepper, ins, outs, settings)
        stack.callback(loop.end)
        loop.begin()
        loop.run(steps, stop)
    return loop.summary(stop.reason or f"The run has ended after {loop.time:g} s, as requested.")


def _stepper(target: object) -> Stepper:
    if isinstance(target, Stepper):
        return target
    if isinstance(target, Session):
        return SessionStepper(target)
    if isinstance(target, Online):
        return OnlineStepper(target)
    raise ModelError(
        f"A live run needs a session (diagram.start()) or a single block (block.online()), not {type(target).__name__}."
    )


def _connected(stepper: Stepper, wires: Mapping[str, Wire]) -> tuple[list[Incoming], list[Outgoing]]:
    ins: list[Incoming] = []
    outs: list[Outgoing] = []
    taken: dict[int, str] = {}
    for name, wire in wires.items():
        try:
            if not wire.is_input:
                outs.append(outgoing(name, wire, stepper))
                continue
            ins.append(incoming(name, wire, stepper))
            for place in ins[-1].places:
                if place in taken:
                    raise ModelError(
                        f"{stepper.input_names[place]} is already set by the wire {taken[place]!r}. Remove one of them."
                    )
                taken[place] = name
        except BayesFTCError as error:
            raise type(error)(f"The wire {name!r}: {error}") from None
    _check_unset(stepper, taken.keys())
    return ins, outs


def _check_unset(stepper: Stepper, taken: Collection[int]) -> None:
    """Refuse an input that nothing sets, and warn of elements of an input whose other elements have wires."""
    unset = np.isnan(stepper.start())
    for full in stepper.inputs:
        places = stepper.input_places(full)
        left = [place for place in places if place not in taken and unset[place]]
        if left and len(left) < len(places):
            names = " and ".join(stepper.input_names[place] for place in left)
            warnings.warn(
                f"No wire sets {names}, so there is no value (NaN) in any step. Add a wire with to = "
                f"{stepper.input_names[left[0]]!r}, or leave the sensor out of the model.",
                stacklevel=4,
            )
        elif left:
            raise ModelError(f"No wire sets the input {full!r}, which has no start value. Add one with to = {full!r}.")


@contextmanager
def _signals(stop: Stop) -> Iterator[None]:
    """End the run at SIGTERM and Ctrl-C; a second Ctrl-C interrupts the program."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def request(number: int, frame: Any) -> None:
        if stop and number == signal.SIGINT and callable(before[number]):
            before[number](number, frame)
        name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        stop.request(f"The run was stopped by {name}.")

    try:
        for number in (
            getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
        ):
            if signal.getsignal(number) != signal.SIG_IGN:
                before[number] = signal.signal(number, request)
        yield
    finally:
        for changed, handler in before.items():
            signal.signal(changed, handler)


@contextmanager
def _quick_switches() -> Iterator[None]:
    """Let threads wait less for each other: the loop must not wait while another thread decodes a message."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, SWITCH))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


_settling = threading.Lock()
_settled: list[bool] = []
"""For each live run of this process, whether objects had been left out of garbage collections before it."""


@contextmanager
def _settled_memory() -> Iterator[None]:
    """Leave what exists now out of garbage collections: to search all of it takes 50 ms, in which no step can be made.

    The last run to end undoes this, unless the program had left out objects of its own (`gc.freeze`) before.
    """
    gc.collect()
    with _settling:
        _settled.append(not _settled and gc.get_freeze_count() > 0)
        gc.freeze()
    try:
        yield
    finally:
        with _settling:
            others = any(_settled)
            _settled.pop()
            if not _settled and not others:
                gc.unfreeze()


class _Loop:
    """The parts of a live run, from the first bridge to the last piece of its recording."""

    def __init__(self, stepper: Stepper, ins: list[Incoming], outs: list[Outgoing], settings: LiveSettings):
        self._stepper, self._ins, self._outs, self._settings = stepper, ins, outs, settings
        period = float(stepper.step) / settings.pace
        self.deadlines = Deadlines(period)
        self._watchdog = Watchdog(settings.watchdog * period, outs)
        self._recorder = None if settings.recording is None else self._recorded(settings.recording)
        self._opened: list[Incoming | Outgoing] = []
        self._inputs = stepper.start()
        for each in ins:
            if each.wire.start is not None:
                self._inputs[each.places] = each.wire.start
        self.time = stepper.time

    def _recorded(self, recording: Recording) -> Recorder:
        ports = {**self._stepper.inputs, **self._stepper.outputs}
        units = {name: port.unit for name, port in ports.items() if port.unit}
        shapes = {name: port.shape for name, port in ports.items()}
        return Recorder(recording, shapes, self._stepper.step, {"units": units})

    def begin(self) -> None:
        """Open the bridges, send the safe values, and start the watchdog."""
        every: list[Incoming | Outgoing] = [*self._outs, *self._ins]
        for each in every:
            try:
                each.wire.bridge.open(each.inbox if isinstance(each, Incoming) else None)
            except BayesFTCError as error:
                raise type(error)(f"The wire {each.name!r}: {error}") from None
            self._opened.append(each)
        self._make_safe()
        self._watchdog.start()
        if self._settings.opened is not None:
            self._settings.opened(every, None if self._recorder is None else self._recorder.folder)

    def run(self, steps: int | None, stop: Stop) -> None:
        """Make the steps."""
        stepper, inputs, pace = self._stepper, self._inputs, self._settings.pace
        pacer = Pacer(pace, stepper.step, 0)
        k = behind = 0
        while not stop and k != steps:
            due = pacer.due(k)
            while (rest := due - time.perf_counter()) > 0 and not stop:
                time.sleep(min(rest, BREATH))
            if stop:
                return
            begin = time.perf_counter()
            if begin - due > max(LOST_CLOCK, self.deadlines.period):
                self.deadlines.skipped += int((begin - due) / self.deadlines.period)
                pacer, due = Pacer(pace, stepper.step, k), begin
            was_behind, behind = behind, max(int((begin - due) / self.deadlines.period), 0)
            if behind and not was_behind:
                time.sleep(CATCH * self.deadlines.period)
            # Samples wait only while the run catches up. If each step takes too long, they would only become old.
            waits = behind if behind <= was_behind or not was_behind else 0
            waiting = False
            for each in self._ins:
                each.read(inputs, begin - due, waits)
                waiting |= each.waiting
            outputs = stepper.advance(inputs)
            self.time = stepper.time
            for wire in self._outs:
                if waiting and wire.wire.safe is not None:
                    wire.make_safe(self.time)
                else:
                    wire.send(outputs, self.time)
            self._watchdog.feed()
            self.deadlines.add(begin - due, time.perf_counter() - due)
            if self._recorder is not None:
                self._recorder.add(stepper.k, self.time, [*inputs, *outputs])
            if self._settings.watcher is not None:
                self._settings.watcher(self.time, inputs, outputs)
            k += 1

    def end(self) -> None:
        """Send the safe values, close the bridges, and complete the recording, even if one of these fails."""
        with ExitStack() as stack:
            if self._recorder is not None:
                stack.callback(self._recorder.close)
            self.connected = {each.name: each.wire.bridge.connected for each in self._opened}
            for each in self._opened:
                stack.callback(each.wire.bridge.close)
            stack.callback(self._make_safe)
            self._watchdog.stop()

    def _make_safe(self) -> None:
        for each in self._opened:
            if isinstance(each, Outgoing):
                each.make_safe(self.time)

    def summary(self, stopped: str) -> LiveSummary:
        """Return what happened."""
        recorder = self._recorder
        return LiveSummary(
            self.deadlines.steps,
            self.time,
            stopped,
            self.deadlines.report(),
            {each.name: self._numbers(each) for each in self._ins},
            {each.name: self._numbers(each) for each in self._outs},
            self._watchdog.trips,
            None if recorder is None else str(recorder.folder),
            0 if recorder is None else recorder.lost,
            "" if recorder is None else recorder.problem,
        )

    def _numbers(self, each: Incoming | Outgoing) -> dict[str, Any]:
        bridge = each.wire.bridge
        connected = self.connected.get(each.name, False)
        return {**each.numbers(self.deadlines.steps), "connected": connected, "problem": bridge.problem}
