"""A scenario: the content of its file as blocks, their loop, and its run."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import Block, sample_time_of
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.diagram.closed_loop import base_step, check_parts, closed_loop, with_invalid
from bayesftc.cosim.diagram.feedthrough import DELAYED
from bayesftc.cosim.diagram.wiring import for_rates
from bayesftc.cosim.errors import AlgebraicLoopError
from bayesftc.scenario import _sections as sections
from bayesftc.scenario._blocks import Added, Connection, Surroundings, blocks, connections
from bayesftc.scenario._files import find_scenario, read_toml
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build
from bayesftc.scenario._sections import Simulation, Wiring

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.run.result import Result

KNOWN = "known"
"""The section of what a controller is designed for, if that is not the plant and the sensors of the run."""
SECTIONS = (
    "simulation",
    "plant",
    "noise",
    "sensors",
    "faults",
    "input_faults",
    "reference",
    "model",
    "controller",
    "blocks",
    "connections",
    KNOWN,
)
REQUIRED = ("simulation", "plant", "reference", "controller")

_Seen = tuple[Block, Wiring, Sensors | None]
"""A plant, its control and measured variables, and the sensors."""


@dataclass(frozen=True)
class Scenario:
    """A closed loop and the settings of its run, from a scenario file.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    simulation : Simulation
        Duration, step, seed and the like.
    plant, controller : Block
        The blocks of ``[plant]`` and ``[controller]``.
    wiring : Wiring
        Names of the plant's control and measured variables.
    reference : list of Block
        One source per element of the controller's goal.
    sensors : Sensors or None
        None for a perfect sensor on each measured variable.
    faults : list of Fault
        In the order of the file.
    noise : mapping of str to Block
        Sources for further inputs of the plant.
    input_faults : mapping of str to list of Fault
        Faults of actuators and of the process, by input of the plant.
    blocks : mapping of str to (Block, int)
        Further blocks, each with the number of base steps between its steps.
    connections : list of (tuple of str, str)
        The sources and the input of each connection of the further blocks.
    """

    path: Path
    simulation: Simulation
    plant: Block
    wiring: Wiring
    controller: Block
    reference: list[Block]
    sensors: Sensors | None
    faults: list[Fault]
    noise: Mapping[str, Block]
    input_faults: Mapping[str, list[Fault]]
    blocks: Added
    connections: list[Connection]

    def loop(self) -> Diagram:
        """Return the diagram, built and ready; see `bayesftc.cosim.closed_loop`.

        Raises
        ------
        BayesFTCError
            If the parts do not fit together. The message begins with the file's name.
        """
        with Place(str(self.path)).named(), _remedies_of_files():
            return closed_loop(
                self.plant,
                self.controller,
                control=self.wiring.control,
                measured=self.wiring.measured,
                reference=self.reference,
                sensors=self.sensors,
                faults=self.faults,
                input_faults=self.input_faults,
                noise=self.noise,
                blocks=self.blocks,
                connections=self.connections,
                dt=self.simulation.dt,
            )

    def simulate(self, loop: Diagram | None = None, **options: Any) -> Result:
        """Run the scenario.

        Parameters
        ----------
        loop : Diagram, optional
            The diagram that `loop` returned, to use it again.
        **options
            ``duration``, ``seed``, ``engine``, ``record``, ``decimation`` in place of the file's values (None: the file's
            value), and ``progress``, ``time_limit``, ``pace``.

        Returns
        -------
        Result
            Signals by name.
        """
        defaults = {f.name: getattr(self.simulation, f.name) for f in fields(self.simulation) if f.name != "dt"}
        given = {name: value for name, value in options.items() if value is not None}
        # An error names the file only if all settings come from the file.
        place = nullcontext() if given.keys() - {"progress"} else Place(str(self.path)).named()
        diagram = self.loop() if loop is None else loop
        with place:
            return diagram.simulate(**(defaults | given))


@contextmanager
def _remedies_of_files() -> Iterator[None]:
    """Give the error of an algebraic loop the table of a delayed condition in place of the call in Python."""
    try:
        yield
    except AlgebraicLoopError as error:
        table = 'give it as a table, { signal = "controller.u", relation = ">", value = 500.0, delayed = true }'
        raise AlgebraicLoopError(str(error).replace(DELAYED, table)) from error


def load_scenario(path: str | os.PathLike[str]) -> Scenario:
    """Read a scenario file and check its content.

    Parameters
    ----------
    path : str or path
        A TOML file, or the name of a shipped scenario such as ``"cruise_control"``. Paths in the file are relative to it.

    Returns
    -------
    Scenario
        Its blocks, ready to run.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or if a key is unknown, missing or of a wrong type. The message names the key and its place.
    BayesFTCError
        If a block rejects its settings (`ModelError`, `FMUError`, ...). The message begins with the place in the file.
    """
    file = find_scenario(path)
    return scenario_of(read_toml(file), file)


def scenario_of(content: Mapping[str, Any], file: Path) -> Scenario:
    """Return the scenario of a file's content. The file is only used in messages and as the start of relative paths.

    Raises
    ------
    BayesFTCError
        As `load_scenario`.
    """
    root = Place(str(file))
    root.refuse_unknown(content, SECTIONS, "section")
    for name in REQUIRED:
        if name not in content:
            raise root.error(f"lacks the section [{name}]. A scenario needs {', '.join(f'[{r}]' for r in REQUIRED)}.")
    simulation: Simulation = build(Simulation, content["simulation"], root / "simulation")
    folder = file.absolute().parent
    plant, wiring, sensors = _plant_and_sensors(content, root, simulation)
    # The controller comes last: its design may take seconds, and a mistake elsewhere in the file needs none of it.
    parts: dict[str, Any] = {
        "reference": sections.reference(content["reference"], root / "reference"),
        "sensors": sensors,
        "faults": sections.fault_list(content.get("faults", []), root / "faults"),
        "noise": sections.noise(content.get("noise", {}), root / "noise"),
        "input_faults": sections.input_faults(content.get("input_faults", {}), root / "input_faults"),
        "connections": connections(content.get("connections", []), root / "connections"),
    }
    step = None if simulation.dt is None else rational_step(simulation.dt)
    added = _blocks(content, root, folder, step) if step is not None else {}
    with root.named():
        check_parts(
            plant, **{name: parts[name] for name in ("sensors", "faults", "noise", "input_faults")}, **asdict(wiring)
        )
    controller = sections.controller(
        content, root, simulation, *_known(content, root, simulation, (plant, wiring, sensors))
    )
    if sensors is not None:
        with (root / "sensors").named():
            controller = with_invalid(controller, sensors)
            controller = for_rates(controller, sensors.rates, _steps_of(controller, simulation))
    if step is None:
        added = _blocks(content, root, folder, step_of(root, controller, simulation))
    return Scenario(
        path=file, simulation=simulation, plant=plant, wiring=wiring, controller=controller, blocks=added, **parts
    )


def _plant_and_sensors(content: Mapping[str, Any], place: Place, simulation: Simulation) -> _Seen:
    folder = Path(place.file).absolute().parent
    plant, wiring = sections.plant(content["plant"], place / "plant", folder, simulation)
    if "sensors" not in content:
        return plant, wiring, None
    return plant, wiring, sections.sensors(content["sensors"], place / "sensors", wiring, plant)


def is_designed(content: Mapping[str, Any]) -> bool:
    """Return whether a scenario's controller, or its model, is made from the plant."""
    tables = [table if isinstance(table := content.get(name), Mapping) else {} for name in ("controller", "model")]
    return str(tables[0].get("kind")).lower() == "design" or "kind" in tables[1]


def _known(content: Mapping[str, Any], root: Place, simulation: Simulation, there: _Seen) -> _Seen:
    """Return the plant and the sensors that a controller is designed for: those of ``[known]``, by default those of the run."""
    if KNOWN not in content:
        return there
    if not is_designed(content):
        warn_user(
            f"The section [{KNOWN}] has no effect: the controller is not designed for the plant. Leave it out, or choose "
            "kind = 'design' in [controller]."
        )
        return there
    known = as_table(content[KNOWN], root / KNOWN)
    (root / KNOWN).refuse_unknown(known, ["plant", "sensors"])
    designed_for = _plant_and_sensors({**content, **known}, root / KNOWN, simulation)
    counts = [_count_samples(wiring, plant, sensors) for plant, wiring, sensors in (designed_for, there)]
    if counts[0] != counts[1]:
        raise (root / KNOWN).error(
            f"gives the controller {counts[0]} sensors, but the run has {counts[1]}. Repeat in [{KNOWN}.plant] and "
            f"[{KNOWN}.sensors] what is the same, as 'measured' and 'count'."
        )
    return designed_for


def _count_samples(wiring: Wiring, plant: Block, sensors: Sensors | None) -> int:
    if sensors is not None:
        return len(sensors)
    names = [wiring.measured] if isinstance(wiring.measured, str) else wiring.measured
    return sum(port.size for port in plant.outputs if port.name in names)


def _steps_of(controller: Block, simulation: Simulation) -> int:
    """Return the number of base steps from one sample of the controller to the next; 1 if they do not fit, which is refused."""
    time = sample_time_of(controller)
    steps = Fraction(1) if simulation.dt is None or time is None else time / rational_step(simulation.dt)
    return int(steps) if steps.denominator == 1 else 1


def _blocks(content: Mapping[str, Any], root: Place, folder: Path, step: Fraction) -> Added:
    return blocks(content.get("blocks", {}), root / "blocks", Surroundings(folder, step), taken=SECTIONS)


def step_of(root: Place, controller: Block, simulation: Simulation) -> Fraction:
    """Return the base step of a scenario in seconds."""
    with root.named():
        return rational_step(base_step(controller, simulation.dt))
