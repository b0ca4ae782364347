"""The controller of a scenario with wires in place of the plant."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.diagram.closed_loop import base_step, closed_loop
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.steppers import Received, SessionStepper
from bayesftc.cosim.ports import Port
from bayesftc.scenario import _sections as sections
from bayesftc.scenario._blocks import Surroundings, blocks, connections
from bayesftc.scenario._files import find_scenario, read_toml
from bayesftc.scenario._place import Place
from bayesftc.scenario._scenario import SECTIONS, Scenario, scenario_of
from bayesftc.scenario._schema import as_table, build
from bayesftc.scenario._sections import Simulation, Wiring

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram

HIDDEN = ("plant", "sensors")
"""Blocks that stand for the plant; their signals are not recorded."""
OF_PLANT = ("sensors", "faults", "input_faults", "noise")
"""Sections that a plant needs."""
NEEDED = ("simulation", "controller")


@dataclass(frozen=True)
class ReceivedGoal(Received):
    """A goal from outside: for a controller with a preview already that of n samples later, so that it is not shifted."""

    later_goals: ClassVar[bool] = True


def _read(received, samples):
    for i in range(samples.shape[0]):
        samples[i] = received[i]


@dataclass(frozen=True)
class Outside(Block):
    """In place of a plant: its output is what has been received.

    Parameters
    ----------
    controls : sequence of Port
        The plant's inputs.
    sensors : int
        Number of sensors.
    units : tuple of str or None
        Unit of the samples of each sensor; empty if none is known.
    """

    controls: tuple[Port, ...]
    sensors: int
    units: tuple[str | None, ...] = ()
    sample_time: ClassVar[None] = None

    @property
    def inputs(self) -> tuple[Port, ...]:
        """The plant's inputs, and ``received``."""
        return (*self.controls, self._port("received", default=float("nan")))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``samples``."""
        return (self._port("samples"),)

    def _port(self, name: str, default: float | None = None) -> Port:
        one = len({*self.units}) == 1
        unit, units = (self.units[0], ()) if one else (None, self.units)
        return Port(name, (self.sensors,), unit, default=default, units=units)

    def define(self, dt: object) -> Definition:
        """Return the copy of what was received."""
        return Definition(_read)


@dataclass(frozen=True, eq=False)
class LiveController:
    """The diagram of a controller with its reference, for a live run.

    Attributes
    ----------
    diagram : Diagram
        The diagram.
    names : mapping of str to str
        The names of its inputs from outside, and those inside the diagram.
    sensors : sequence of str
        Names of the sensors, for alarms.
    modes : sequence of FaultMode
        The modes of the controller's precision learner; empty if it has none.
    actuators : sequence of str
        Names of the actuators, for alarms.
    actuator_modes : sequence of ActuatorMode
        The modes of its actuators; empty if it has none.
    learner : str
        The kind of its precision learner, or of the controller itself.
    """

    diagram: Diagram
    names: Mapping[str, str]
    sensors: Sequence[str]
    modes: Sequence[Any]
    actuators: Sequence[str]
    actuator_modes: Sequence[Any]
    learner: str

    @contextmanager
    def stepper(self) -> Iterator[SessionStepper]:
        """Give what `bayesftc.cosim.live.run_live` runs."""
        names = [f"{n.name}.{p.name}" for n in self.diagram.nodes if n.name not in HIDDEN for p in n.outputs]
        with self.diagram.start(record=names) as session:
            yield SessionStepper(session, self.names)


def live_controller(path: str | os.PathLike[str], received: Collection[str] = ()) -> LiveController:
    """Return the controller of a scenario file, with its reference and further blocks, without its plant.

    Parameters
    ----------
    path : str or path
        A scenario file, or the name of a shipped one. ``[plant]`` may be missing: it is not run. If it is there, it is used only
        where the controller is designed for it. Sensors, faults and noise have no effect.
    received : collection of str
        The inputs from outside. If ``"controller.goal"`` is one of them, the reference is not used. The goal of a controller
        with a preview is then the one that this input must have: that of n samples later.

    Returns
    -------
    LiveController
        Its input is ``controller.y``.

    Raises
    ------
    BayesFTCError
        As `load_scenario`.
    """
    file = find_scenario(path)
    content, root = read_toml(file), Place(str(file))
    with root.named():
        parts = _of_scenario(content, root) if "plant" in content else _of_controller(content, root)
        ports = {port.name: port for port in (*parts.controller.inputs, *parts.controller.outputs)}
        for name in ("y", "goal", "u"):
            if name not in ports:
                raise ModelError(
                    f"The controller, of the kind {type(parts.controller).__name__}, has no port {name!r}; a controller has the "
                    "inputs y and goal and the output u."
                )
        names = {"controller.y": "plant.received"}
        reference: Any = parts.reference
        if any(name.split("[")[0] == "controller.goal" for name in received):
            reference = ReceivedGoal(ports["goal"].size, start=0.0)
            names["controller.goal"] = "reference.u"
        elif not reference:
            raise root.error("lacks the section [reference]. Add it, or a wire with to = 'controller.goal'.")
        controls, control = parts.controls or ((Port("u", ports["u"].shape, feedthrough=False),), "u")
        diagram = closed_loop(
            Outside(controls, ports["y"].size, parts.units),
            parts.controller,
            control=control,
            measured="samples",
            reference=reference,
            blocks=parts.blocks,
            connections=parts.connections,
            dt=parts.dt,
        )
    sensors = tuple(f"sensor {i}" for i in range(ports["y"].size))
    precision = getattr(parts.controller, "precision", None)
    learner = type(parts.controller if precision is None else precision).__name__
    actuators = tuple(role.name for role in find_roles(diagram).controls)
    modes = getattr(precision, "modes", ()), actuators, getattr(precision, "actuator_modes", ())
    return LiveController(diagram, names, sensors, *modes, learner)


@dataclass(frozen=True)
class _Parts:
    controller: Block
    reference: list[Block]
    controls: tuple[tuple[Port, ...], Any] | None
    blocks: Any
    connections: Any
    dt: Any
    units: tuple[str | None, ...] = ()


def _of_scenario(content: Mapping[str, Any], root: Place) -> _Parts:
    scenario = scenario_of(content, Path(root.file))
    wiring = scenario.wiring
    names = {name.split("[")[0] for name in ([wiring.control] if isinstance(wiring.control, str) else wiring.control)}
    # Controls have no effect inside of the diagram.
    controls = tuple(
        Port(p.name, p.shape, p.unit, feedthrough=False, default=p.default, meaning=p.meaning)
        for p in scenario.plant.inputs
        if p.name in names
    )
    dt = _step(scenario.controller, scenario.simulation, bool(scenario.blocks), root)
    return _Parts(
        scenario.controller,
        scenario.reference,
        (controls, wiring.control),
        scenario.blocks,
        scenario.connections,
        dt,
        _units(scenario),
    )


def _units(scenario: Scenario) -> tuple[str | None, ...]:
    """Return the unit of each sensor's samples: its own, or that of the variable of the plant that it reads."""
    measured, sensors = scenario.wiring.measured, scenario.sensors
    names = [measured] if isinstance(measured, str) else measured
    ports = {port.name: port for port in scenario.plant.watching(names).outputs}
    if not ports.keys() >= {*names}:  # an element of a vector
        ports = {}
    of_plant = [port.unit_of(i) for port in (ports[name] for name in names if ports) for i in range(port.size)]
    if sensors is None:
        return tuple(of_plant)
    y = next(port for port in sensors.outputs if port.name == "y")
    reads = [None if j is None or not of_plant else of_plant[j] for j in sensors.reads]
    return tuple(y.unit_of(i) or unit for i, unit in enumerate(reads))


def _of_controller(content: Mapping[str, Any], root: Place) -> _Parts:
    root.refuse_unknown(content, SECTIONS, "section")
    for name in NEEDED:
        if name not in content:
            raise root.error(
                f"lacks the section [{name}]. A live controller needs {', '.join(f'[{n}]' for n in NEEDED)}."
            )
    for name in OF_PLANT:
        if name in content:
            raise (root / name).error("has no effect without [plant]. Leave it out.")
    table, model = as_table(content["controller"], root / "controller"), content.get("model", {})
    designed = str(table.get("kind", "")).lower() == "design" or (isinstance(model, Mapping) and "kind" in model)
    if designed:
        raise root.error(
            "has a controller that is designed for a plant, but no [plant]. Add [plant], which is then not run."
        )
    simulation: Simulation = build(Simulation, {"duration": 1.0, **content["simulation"]}, root / "simulation")
    controller = sections.controller(content, root, simulation, None, Wiring("u", "y"), None)  # type: ignore[arg-type]
    dt = _step(controller, simulation, "blocks" in content, root)
    around = Surroundings(Path(root.file).absolute().parent, dt)
    return _Parts(
        controller,
        sections.reference(content["reference"], root / "reference") if "reference" in content else [],
        None,
        blocks(content["blocks"], root / "blocks", around, taken=SECTIONS) if "blocks" in content else {},
        connections(content.get("connections", []), root / "connections"),
        dt,
    )


def _step(controller: Block, simulation: Simulation, blocks: bool, root: Place) -> Any:
    """Return the step of a live run: that of the controller, because samples between its steps would be lost."""
    step = rational_step(base_step(controller, None if controller.sample_time else simulation.dt))
    if blocks and simulation.dt is not None and rational_step(simulation.dt) != step:
        raise (root / "simulation.dt").error(
            f"is {simulation.dt}, but a live run with [blocks] has the sample time of the controller, {float(step):g} s. Set dt "
            "to it."
        )
    return step
