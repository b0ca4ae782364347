"""The sections of a scenario file, each made into its blocks or settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

from bayesftc.controllers.models.delays import whole_delays
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.controllers.registry import CONTROLLERS
from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.faults import kinds as faults
from bayesftc.cosim.blocks.kinds import SOURCES
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.blocks.sources import Constant, Table
from bayesftc.cosim.diagram.closed_loop import check_count, with_arrays
from bayesftc.cosim.diagram.subsystem import Subsystem
from bayesftc.scenario._blocks import Surroundings, subsystem
from bayesftc.scenario._fmu_files import fmu_of, taken
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build, build_one_of, choose, settings


@dataclass(frozen=True)
class Simulation:
    """Default settings of a scenario's runs; see `bayesftc.cosim.Diagram.simulate`.

    Attributes
    ----------
    duration : float or str
        Duration of the run in seconds.
    dt : float or str, optional
        Base step in seconds, and the default step of the model and the controller. By default, the model's or controller's.
    seed : int
        Seed of noise and random faults.
    engine : str
        As for `simulate`.
    record : str or sequence of str, optional
        Signals to record; by default all.
    decimation : int
        Every n-th step is recorded.
    """

    duration: float | str
    dt: float | str | None = None
    seed: int = 0
    engine: Literal["auto", "compiled", "interpreted"] = "auto"
    record: str | Sequence[str] | None = None
    decimation: int = 1

    def __post_init__(self) -> None:
        rational_step(self.duration, "duration")
        if self.dt is not None:
            rational_step(self.dt, "dt")


@dataclass(frozen=True)
class Wiring:
    """The plant's control inputs and measured outputs.

    Attributes
    ----------
    control : str or sequence of str
        Inputs of the plant that the controller drives.
    measured : str or sequence of str
        Outputs or local variables of the plant that the sensors measure.
    """

    control: str | Sequence[str]
    measured: str | Sequence[str]


def plant(table: object, place: Place, folder: Path, simulation: Simulation) -> tuple[Block, Wiring]:
    """Return the plant of ``[plant]``, and its control and measured variables."""
    rest = dict(as_table(table, place))
    for name in (f.name for f in fields(Wiring) if f.name not in rest):
        place.refuse_unknown(get_close_matches(name, rest, cutoff=0.8), [name])
    wiring = build(Wiring, taken(rest, Wiring), place)
    if "fmu" in rest:  # first, because an FMU has a kind, too
        _refuse_start(rest, place, ("start", "initial", "x0"), "parameters = { angle_0 = 0.4 }, by variable")
        return fmu_of(rest, place, folder), wiring
    if "kind" in rest:
        if "A" in rest:
            raise (place / "kind").error(
                "is not needed for a linear plant, which is known by its matrix A. Leave kind out."
            )
        _, rest = choose((Subsystem,), rest, place)
        return _subsystem(rest, place, folder, simulation), wiring
    if "A" in rest:
        from bayesftc.scenario._linear_plant import linear_plant

        _refuse_start(rest, place, ("start", "x0"), "initial = [0.4, 0.0], a number for each state")
        return linear_plant(rest, place), wiring
    raise place.error(
        "has no plant. Add fmu = '...' (a shipped name or a file), the matrices A, B, C of a linear plant, or "
        "kind = 'Subsystem' with blocks."
    )


def _refuse_start(table: Mapping[str, Any], place: Place, names: Sequence[str], remedy: str) -> None:
    """Refuse other names for the start of a plant; none of them is similar to the right one."""
    for name in names:
        if name in table:
            raise (place / name).error(f"is no key of this plant. To start it elsewhere, write {remedy}.")


def _subsystem(table: Mapping[str, Any], place: Place, folder: Path, simulation: Simulation) -> Block:
    if simulation.dt is None:
        raise place.error("is a subsystem, whose step is not known. Add dt = ... to [simulation].")
    return subsystem(table, place, Surroundings(folder, rational_step(simulation.dt)))


def noise(table: object, place: Place) -> dict[str, Block]:
    """Return the sources of ``[noise.<input>]``."""
    return {name: _source(value, place / name) for name, value in as_table(table, place).items()}


def reference(value: object, place: Place) -> list[Block]:
    """Return the sources of ``[reference]`` or ``[[reference]]``; a number is a constant."""
    if isinstance(value, list):
        return [_source(item, place / i) for i, item in enumerate(value)]
    return [_source(value, place)]


def with_numbers(content: dict[str, Any], file: Path) -> dict[str, Any]:
    """Return a scenario's content with numbers in place of the files of its tables, which a store does not have."""

    def made(value: Any) -> Any:
        if isinstance(value, list):
            return [made(item) for item in value]
        if not isinstance(value, Mapping) or str(value.get("kind")).lower() != "table" or "file" not in value:
            return value
        source = _source(value, Place(str(file)))
        assert isinstance(source, Table)
        kept = {key: item for key, item in value.items() if key in ("kind", "interpolate", "unit")}
        return {**kept, "times": list(source.times), "values": list(source.values)}

    changed = {**content}
    if "reference" in content:
        changed["reference"] = made(content["reference"])
    if isinstance(noise := content.get("noise"), Mapping):
        changed["noise"] = {name: made(value) for name, value in noise.items()}
    return changed


def _source(value: object, place: Place) -> Block:
    if isinstance(value, int | float) and not isinstance(value, bool):
        with place.named():
            return Constant(real(value))
    cls, rest = choose(SOURCES, value, place)
    if cls is Table and "file" in rest:  # a column of a file, in place of numbers
        if not isinstance(rest["file"], str):
            raise (place / "file").error(f"is {rest['file']!r}. It must be the path of a file, in quotes.")
        rest["file"] = str(Path(place.file).absolute().parent / rest["file"])
        return build(Table.read, rest, place, of_kind=True)  # type: ignore[no-any-return]
    return build(cls, rest, place, of_kind=True)  # type: ignore[no-any-return]


def sensors(table: object, place: Place, wiring: Wiring, plant: Block) -> Sensors:
    """Return the sensors of ``[sensors]``, which read the plant's measured variables; of a vector each element."""
    names = [wiring.measured] if isinstance(wiring.measured, str) else wiring.measured
    sizes = {port.name: port.size for port in plant.outputs}
    measured = sum(sizes.get(name, 1) for name in names)
    # The number of variables follows from the plant, so the file need not repeat it for the width of a matrix.
    return build(Sensors, {"signals": measured, **as_table(table, place)}, place)  # type: ignore[no-any-return]


def fault_list(value: object, place: Place) -> list[faults.Fault]:
    """Return the faults of ``[[faults]]``, or of another such list."""
    if not isinstance(value, list):
        raise place.error(f"must be a list of tables. Write [[{place.key}]], with two brackets, above each fault.")
    with place.named():
        check_count(value)
    return [build_one_of(faults.FAULTS, table, place / i) for i, table in enumerate(value)]


def input_faults(table: object, place: Place) -> dict[str, list[faults.Fault]]:
    """Return the faults of ``[[input_faults.<input>]]``."""
    if isinstance(table, list):
        raise place.error(
            f"does not name the faulty input of the plant. Write [[{place.key}.<input>]] above each fault."
        )
    return {name: fault_list(value, place / name) for name, value in as_table(table, place).items()}


def controller(
    content: Mapping[str, Any],
    root: Place,
    simulation: Simulation,
    plant: Block,
    wiring: Wiring,
    sensors: Sensors | None,
) -> Block:
    """Return the controller of ``[controller]``: with the model of ``[model]``, designed, a subsystem, or an exported FMU."""
    from bayesftc.controllers import design

    place = root / "controller"
    if isinstance(content["controller"], Mapping) and "fmu" in content["controller"]:
        if "model" in content:
            raise (root / "model").error("cannot be used with an FMU as controller, which has no model. Leave it out.")
        return with_arrays(fmu_of(dict(content["controller"]), place, Path(root.file).absolute().parent))
    cls, rest = choose((*CONTROLLERS, design, Subsystem), content["controller"], place)
    if cls is Subsystem:
        if "model" in content:
            raise (root / "model").error("cannot be used with kind = 'Subsystem', which has no model. Leave it out.")
        return _subsystem(rest, place, Path(root.file).absolute().parent, simulation)
    by_name = {f.name: f for f in fields(cls)} if isinstance(cls, type) else {}  # type: ignore[arg-type]
    if simulation.dt is not None and ("dt" in by_name or cls is design) and "model" not in content:
        rest.setdefault("dt", simulation.dt)
    if cls is design:
        from bayesftc.scenario._design import designed

        if "model" in content:
            raise (root / "model").error(
                "cannot be used with kind = 'design', which makes its model from the plant. Leave it out."
            )
        wired = {"measured": wiring.measured, "actuated": wiring.control}
        return designed(rest, place, plant, wired, sensors, converted=_feeds_controller(content))
    given: dict[str, Any] = {}
    if "model" in content:
        from_plant = plant, {"measured": wiring.measured, "actuated": wiring.control}, sensors
        given["model"] = _model(content["model"], root / "model", simulation, from_plant, _feeds_controller(content))
    elif "model" in by_name and by_name["model"].default is MISSING:
        raise root.error(
            f"lacks the section [model], which {cls.__name__} needs. Add [model] with A, B, C, ... below it."
        )
    return build(cls, rest, place, given=given, of_kind=True)  # type: ignore[no-any-return]


def _feeds_controller(content: Mapping[str, Any]) -> bool:
    """Return whether a connection of the file feeds the samples to the controller, which may convert their units."""
    listed = content.get("connections", [])
    targets = [each.get("to") for each in listed if isinstance(each, Mapping)] if isinstance(listed, list) else []
    return any(isinstance(to, str) and to.partition("[")[0] == "controller.y" for to in targets)


def _model(
    table: object,
    place: Place,
    simulation: Simulation,
    from_plant: tuple[Block, Mapping[str, Any], Sensors | None],
    converted: bool,
) -> LinearModel | NonlinearModel:
    rest = dict(as_table(table, place))
    if "dt" not in rest and simulation.dt is not None:
        rest["dt"] = simulation.dt
    if "kind" in rest:
        from bayesftc.scenario._design import model_of_plant

        _, rest = choose((NonlinearModel.from_fmu,), rest, place)
        return model_of_plant(rest, place, *from_plant, converted=converted)
    place.refuse_unknown(rest, [*settings(LinearModel), *settings(Extension)])
    extension: Extension = build(Extension, taken(rest, Extension), place)
    model: LinearModel = build(LinearModel, rest, place)
    if extension.disturbance is not None:
        with (place / "disturbance").named():
            model = model.with_disturbance(extension.disturbance)
    with place.named():
        late = whole_delays("input_delays", extension.input_delays, model.controls, "control", model.dt)
        old = whole_delays("sensor_delays", extension.sensor_delays, model.sensors, "sensor", model.dt)
        return model.with_delays(late, old)


@dataclass(frozen=True)
class Extension:
    """Keys of ``[model]`` beside those of `LinearModel`.

    Attributes
    ----------
    disturbance : number, sequence or matrix, optional
        Covariance per sample of an unknown load on each control: see `LinearModel.with_disturbance`.
    input_delays : int or sequence of int
        Samples by which each control acts late: see `LinearModel.with_delays`.
    sensor_delays : int or sequence of int
        Samples by which the values of each sensor are old.
    """

    disturbance: float | Sequence[float] | Sequence[Sequence[float]] | None = None
    input_delays: int | Sequence[int] = 0
    sensor_delays: int | Sequence[int] = 0
