"""The sections of a scenario file, each made into its blocks or settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.registry import CONTROLLERS
from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks import sources
from bayesftc.cosim.blocks.faults import kinds as faults
from bayesftc.cosim.blocks.sensors import Sensors
from bayesftc.cosim.diagram.closed_loop import check_count
from bayesftc.cosim.errors import FMUError
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build, build_one_of, choose

SOURCES: tuple[type[Block], ...] = tuple(getattr(sources, name) for name in sources.__all__ if name != "Source")


@dataclass(frozen=True)
class Simulation:
    """Default settings of a scenario's runs; see `bayesftc.cosim.Diagram.simulate`.

    Attributes
    ----------
    duration : float or str
        Seconds.
    dt : float or str, optional
        Base step in seconds, and the default step of the model and the controller. By default, the model's or controller's.
    seed, engine, record, decimation
        As for `simulate`.
    """

    duration: float | str
    dt: float | str | None = None
    seed: int = 0
    engine: Literal["auto", "compiled", "interpreted"] = "auto"
    record: str | Sequence[str] | None = None
    decimation: int = 1

    def __post_init__(self) -> None:
        for name in ("duration", "dt"):
            if isinstance(getattr(self, name), str):
                rational_step(getattr(self, name), f"{name} =")


@dataclass(frozen=True)
class Wiring:
    """The plant's control inputs and measured outputs."""

    control: str | Sequence[str]
    measured: str | Sequence[str]


@dataclass(frozen=True)
class Shipped:
    """An FMU: a shipped one by name and version of FMI, or a file."""

    fmu: str
    fmi: Literal["2.0", "3.0"] | None = None


def plant(table: object, place: Place, folder: Path) -> tuple[Block, Wiring]:
    """Return the plant of ``[plant]``, and its control and measured variables."""
    rest = dict(as_table(table, place))
    wiring = build(Wiring, _taken(rest, Wiring), place)
    if "fmu" in rest:
        return _fmu(rest, place, folder), wiring
    if "A" in rest:
        from bayesftc.scenario._linear_plant import linear_plant

        return linear_plant(rest, place), wiring
    raise place.error(
        "has no plant. Add fmu = '...' (a shipped name or a file), or the matrices A, B, C of a linear plant."
    )


def _fmu(table: dict[str, Any], place: Place, folder: Path) -> Block:
    from bayesftc import fmus
    from bayesftc.cosim.fmi.fmu import FMU

    chosen: Shipped = build(Shipped, _taken(table, Shipped), place)
    is_file = chosen.fmu.lower().endswith(".fmu") or Path(chosen.fmu).name != chosen.fmu
    if is_file and chosen.fmi is not None:
        raise (place / "fmi").error("chooses the version of a shipped FMU, but 'fmu' is a file. Leave out 'fmi'.")
    try:
        path = folder / chosen.fmu if is_file else fmus.path(chosen.fmu, fmi=chosen.fmi or "2.0")
    except (ValueError, FileNotFoundError) as error:
        raise FMUError(f"{place / 'fmu'}: {error} The name of an FMU file must end with .fmu.") from None
    return build(FMU, table, place, given={"path": path})  # type: ignore[no-any-return]


def noise(table: object, place: Place) -> dict[str, Block]:
    """Return the sources of ``[noise.<input>]``."""
    return {name: _source(value, place / name) for name, value in as_table(table, place).items()}


def reference(value: object, place: Place) -> list[Block]:
    """Return the sources of ``[reference]`` or ``[[reference]]``; a number is a constant."""
    if isinstance(value, list):
        return [_source(item, place / i) for i, item in enumerate(value)]
    return [_source(value, place)]


def _source(value: object, place: Place) -> Block:
    if isinstance(value, int | float) and not isinstance(value, bool):
        with place.named():
            return sources.Constant(real(value))
    return build_one_of(SOURCES, value, place)  # type: ignore[no-any-return]


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
    """Return the controller of ``[controller]``, with the model of ``[model]`` or designed for the plant."""
    from bayesftc.controllers import design

    place = root / "controller"
    cls, rest = choose((*CONTROLLERS, design), content["controller"], place)
    settings = {f.name: f for f in fields(cls)} if isinstance(cls, type) else {}  # type: ignore[arg-type]
    if simulation.dt is not None and ("dt" in settings or cls is design) and "model" not in content:
        rest.setdefault("dt", simulation.dt)
    if cls is design:
        from bayesftc.scenario._design import designed

        if "model" in content:
            raise (root / "model").error(
                "cannot be used with kind = 'design', which makes its model from the plant. Leave it out."
            )
        return designed(rest, place, plant, {"measured": wiring.measured, "actuated": wiring.control}, sensors)
    given: dict[str, Any] = {}
    if "model" in content:
        given["model"] = _model(content["model"], root / "model", simulation)
    elif "model" in settings and settings["model"].default is MISSING:
        raise root.error(
            f"lacks the section [model], which {cls.__name__} needs. Add [model] with A, B, C, ... below it."
        )
    return build(cls, rest, place, given=given)  # type: ignore[no-any-return]


def _model(table: object, place: Place, simulation: Simulation) -> LinearModel:
    rest = dict(as_table(table, place))
    disturbance = rest.pop("disturbance", None)
    if "dt" not in rest and simulation.dt is not None:
        rest["dt"] = simulation.dt
    model: LinearModel = build(LinearModel, rest, place)
    if disturbance is None:
        return model
    at = place / "disturbance"
    given = build(Disturbance, {"covariance": disturbance}, at)
    with at.named():
        return model.with_disturbance(given.covariance)


@dataclass(frozen=True)
class Disturbance:
    """``disturbance = 1e-4``: a number, a diagonal, or a matrix, as `LinearModel.with_disturbance` takes it."""

    covariance: float | Sequence[float] | Sequence[Sequence[float]]


def _taken(table: dict[str, Any], cls: type[Any]) -> Mapping[str, Any]:
    """Remove from the table the entries that are fields of `cls`, and return them."""
    return {f.name: table.pop(f.name) for f in fields(cls) if f.name in table}
