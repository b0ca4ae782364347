"""A live run between wires, for the page: its rows and alarms, which are only shown."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.console.desk.alarms import Alarm, Alarms, sensor_names
from bayesftc.console.desk.desk import MEMORY, MOST_ACTIONS
from bayesftc.console.desk.events import Events
from bayesftc.console.desk.history import History, Recorded
from bayesftc.console.desk.inference import Inference
from bayesftc.cosim.diagram.roles import LoopRoles, find_roles
from bayesftc.cosim.errors import UnknownNameError, brief, did_you_mean
from bayesftc.cosim.live.wires import Incoming
from bayesftc.cosim.ports import labels

if TYPE_CHECKING:
    from pathlib import Path

    from bayesftc.cosim.live.recorder import Recording
    from bayesftc.cosim.live.steppers import Stepper
    from bayesftc.cosim.live.wires import Outgoing, Wire
    from bayesftc.cosim.types import Floats
    from bayesftc.scenario.live.controller import LiveController

SAMPLES = "controller.y"


class LiveLane:
    """The rows of a live run: its inputs and outputs at each step.

    Parameters
    ----------
    inference : Inference
        What the stepper infers; its learner is the name of the lane.
    stepper : Stepper
        What runs; it is prepared.
    roles : LoopRoles
        The roles of its signals.
    sensors : sequence of str
        The names of the sensors; by default their numbers.
    prefix : str
        Beginning of the names of the outputs, if the stepper's have none.
    """

    stopped: str | None = None
    plants: Mapping[str, Any] = {}

    def __init__(
        self, inference: Inference, stepper: Stepper, roles: LoopRoles, sensors: Sequence[str] = (), prefix: str = ""
    ):
        ports = {**stepper.inputs, **{prefix + output: port for output, port in stepper.outputs.items()}}
        self.name, self.inference, self.step, self.roles = inference.learner, inference, stepper.step, roles
        self.sensors = tuple(sensors) or sensor_names(roles)
        self.shapes = {name: port.shape for name, port in ports.items()}
        self.units = {name: port.unit for name, port in ports.items() if port.unit}
        self.columns = [label for name, shape in self.shapes.items() for label in labels(name, shape)]
        self.place = {label: i for i, label in enumerate(self.columns)}
        without = () if inference.has_probability else ("fault_probability",)
        self.watch = Alarms(self.roles, self.place, self.sensors, without)
        self._history = History(len(self.columns), MEMORY)

    @property
    def rows(self) -> Recorded:
        """The recorded rows."""
        return self._history.rows

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """The last alarms."""
        return self.watch.found

    def add(self, k: int, inputs: Floats, outputs: Floats) -> None:
        """Add the row of a step."""
        row = np.concatenate((inputs, outputs))[None]
        self._history.append(row, k)
        self.watch.take(row, k)


class LiveRun:
    """What the server shows of a live run, in place of an `Engine`. The only command is to drop samples, if that is allowed.

    Parameters
    ----------
    name : str
        Name of the controller's file.
    lane : LiveLane
        The run.
    wires : mapping of str to Wire
        Its wires.
    recording : Recording, optional
        How it is recorded.
    drops : bool
        Whether an operator may drop samples.

    Attributes
    ----------
    folder : Path or None
        The folder with the pieces of its recording; None before there is one.
    """

    failure: str | None = None
    desk = None
    busy = None
    late = 0
    running = True

    def __init__(
        self,
        name: str,
        lane: LiveLane,
        wires: Mapping[str, Wire],
        recording: Recording | None = None,
        *,
        drops: bool = False,
    ):
        self.name, self.lane, self.pace = name, lane, 1.0
        self.only_shows = not drops
        self.recording = recording
        self.folder: Path | None = None
        self.events = Events()
        self.view: Any = None
        self._wires = wires
        self._opened: Mapping[str, Incoming | Outgoing] = {}
        self._steps = 0
        self._actions: deque[dict[str, Any]] = deque(maxlen=MOST_ACTIONS)

    def start(self) -> None:
        """Start nothing: the run has its own clock."""

    def stop(self) -> None:
        """Stop nothing: the run ends by itself."""

    def opened(self, wires: Sequence[Incoming | Outgoing], folder: Path | None) -> None:
        """Take the wires when they are open, and the folder of the recording; `opened` of `LiveSettings`."""
        self._opened = {wire.name: wire for wire in wires}
        self.folder = folder

    def feed(self, time: float, inputs: Floats, outputs: Floats) -> None:
        """Take a step of the run; the watcher of `LiveSettings`."""
        lane = self.lane
        self._steps += 1
        k = round(time / lane.step)
        lane.add(k, inputs, outputs)
        for alarm in lane.watch.after(k - 1):
            self.events.add("alarm", lane.watch.words_of(alarm), "live", time)

    def drop(self, name: str, seconds: float) -> None:
        """Drop the samples of a wire for some seconds.

        Raises
        ------
        BayesFTCError
            If no open wire of this name brings samples, or the time is too long.
        """
        open_ones = {each.name: each.inbox for each in self._opened.values() if isinstance(each, Incoming)}
        if name not in open_ones:
            raise UnknownNameError(f"No open wire {brief(name)} brings samples; {did_you_mean(name, open_ones)}")
        open_ones[name].drop(seconds)
        words = f"drop the samples of {name} for {seconds:g} s" if seconds else f"use the samples of {name} again"
        time = self.lane.rows.last * float(self.lane.step)
        self._actions.append({"t": time, "words": words})
        self.events.add("action", words, "live", time)

    def actions(self) -> list[dict[str, Any]]:
        """Return the last actions of operators."""
        return [*self._actions]

    def wires(self) -> list[dict[str, Any]]:
        """Return the state of each wire, and its numbers when it is open."""
        return [
            {
                "name": name,
                "signals": ", ".join(wire.names),
                "is_input": wire.is_input,
                "connected": wire.bridge.connected,
                "problem": wire.bridge.problem,
                **self._numbers(name),
            }
            for name, wire in self._wires.items()
        ]

    def _numbers(self, name: str) -> dict[str, Any]:
        wire = self._opened.get(name)
        if wire is None:
            return {}
        dropping = {"dropping": wire.inbox.dropping} if isinstance(wire, Incoming) else {}
        return {**wire.numbers(self._steps), **dropping}


def controller_lane(controller: LiveController, stepper: Stepper) -> LiveLane:
    """Return the rows of a live controller."""
    roles = find_roles(controller.diagram)
    block = next(node.block for node in controller.diagram.nodes if node.name == roles.controller)
    return LiveLane(Inference.of(block), stepper, _without_plant(roles))


def _without_plant(roles: LoopRoles) -> LoopRoles:
    """Return the roles of a loop whose samples come from outside: nothing is known of what is true.

    Sensors that are compared with one element of the goal, and with the same belief, measure one quantity.
    """
    sensors = tuple(replace(role, samples=(SAMPLES, i)) for i, role in enumerate(roles.sensors))
    of: dict[Any, Any] = {}
    for each in roles.quantities:
        key = each.reference, each.belief, each.unit
        known = of.get(key)
        of[key] = (
            replace(known, sensors=known.sensors + each.sensors)
            if known
            else replace(each, truth=None, name=f"quantity {len(of)}" if each.sensors else each.name)
        )
    quantities = tuple(of.values())
    if sum(bool(each.sensors) for each in quantities) == 1:
        quantities = tuple(replace(each, name="measured quantity") if each.sensors else each for each in quantities)
    return replace(roles, sensors=sensors, quantities=quantities)


__all__ = ["LiveLane", "LiveRun", "controller_lane"]
