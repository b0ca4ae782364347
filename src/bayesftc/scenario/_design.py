"""Make a controller, or a nonlinear model, from the plant itself, so that a scenario file needs no matrices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.controllers import NonlinearModel, design
from bayesftc.cosim.base.units import difference
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.diagram.wiring import element_name
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import build


def designed(
    table: Mapping[str, Any],
    place: Place,
    plant: Block,
    given: Mapping[str, Any],
    sensors: Sensors | None,
    *,
    converted: bool = False,
) -> Block:
    """Return the controller that `bayesftc.controllers.design` makes for the plant, with the table's settings.

    Parameters
    ----------
    table : mapping
        The table of the file without ``kind``: arguments of `design`.
    place : Place
        Its place in the file.
    plant : Block
        The plant.
    given : mapping
        Further arguments, from other sections of the file.
    sensors : Sensors or None
        The sensors: their number, and the standard deviation of their errors if the table has none.
    converted : bool
        Whether blocks between sensors and controller may convert the units of the samples.
    """
    return _of_plant(design, table, place, {"plant": plant, **given}, sensors, converted)  # type: ignore[no-any-return]


def model_of_plant(
    table: Mapping[str, Any],
    place: Place,
    plant: Block,
    given: Mapping[str, Any],
    sensors: Sensors | None,
    *,
    converted: bool = False,
) -> NonlinearModel:
    """Return the model that `NonlinearModel.from_fmu` makes of the plant, with the table's settings; see `designed`."""
    if not isinstance(plant, FMU):
        raise place.error("has kind = 'from_fmu', but the [plant] is no FMU. Give the path of an FMU in [plant].")
    return _of_plant(NonlinearModel.from_fmu, table, place, {"fmu": plant, **given}, sensors, converted)  # type: ignore[no-any-return]


def _of_plant(
    function: Callable[..., Any],
    table: Mapping[str, Any],
    place: Place,
    from_file: dict[str, Any],
    sensors: Sensors | None,
    converted: bool = False,
) -> Any:
    """Call a function that takes the plant, and what the sections [plant] and [sensors] have, with a table's settings."""
    settings = dict(table)
    if sensors is not None:
        what = "a design" if function is design else "a model of the plant"
        from_file["sensors"] = _numbers(sensors, place, what)
        if not converted or "sensor_std" not in table:
            _check_units(sensors, from_file.get("plant") or from_file["fmu"], from_file["measured"], place, what)
        if sensors.covariance is not None and "sensor_std" not in table:
            raise place.error(
                "lacks 'sensor_std', which it needs if [sensors] has a covariance: it assumes independent noise. Add "
                "sensor_std = ... (a number, or one for each sensor)."
            )
        std = sensors.error_std
        if np.any(std):
            settings.setdefault("sensor_std", std if isinstance(std, float) else list(std))
    for name in ("plant", "fmu", "measured", "actuated", "sensors"):
        if name in table:
            raise (place / name).error("is already set by [plant] and [sensors]. Leave it out here.")
    return build(function, settings, place, given=from_file, of_kind=True)


def _check_units(sensors: Sensors, plant: Block, measured: str | Sequence[str], place: Place, what: str) -> None:
    """Refuse sensors in other units than the plant's variables, which the controller would take for samples in those."""
    names = [measured] if isinstance(measured, str) else measured
    ports = {port.name: port for port in plant.outputs}
    variables = [(ports[name], i) for name in names if name in ports for i in range(ports[name].size)]
    read = next(port for port in sensors.inputs if port.name == "u")
    if len(variables) != read.size:  # elements of vectors
        return
    for k, (port, i) in enumerate(variables):
        of_sensor, of_plant = read.unit_of(k), port.unit_of(i)
        if of_sensor and of_plant and difference(of_plant, of_sensor, port.meaning, read.meaning):
            raise place.error(
                f"cannot be {what}, because {element_name(port, i)} is in {of_plant} in the plant, and so in the model, but in "
                f"{of_sensor} in [sensors]. Give unit and std there in {of_plant}, or [plant] an output in {of_sensor}; or "
                f"convert the samples back to {of_plant} before controller.y, and give sensor_std in {of_plant}."
            )


def _numbers(sensors: Sensors, place: Place, what: str) -> int | list[int]:
    """Return the number of sensors that read the measured variables in turn, or the number that reads each of them."""
    rows, signals = sensors.rows, np.arange(sensors.signals)
    if rows is not None:
        read = rows.argmax(axis=1)
        counts = np.bincount(read, minlength=len(signals))
        if np.array_equal(np.eye(len(signals))[read], rows):
            if np.array_equal(read, np.arange(len(sensors)) % len(signals)):
                return len(sensors)
            if counts.all() and np.array_equal(read, np.repeat(signals, counts)):
                return [int(number) for number in counts]
    raise place.error(
        f"cannot be {what}, because [sensors] has a {'function' if rows is None else 'matrix'}. That needs sensors that read "
        "the measured variables in turn, or so many of each: count = [1, 3]. Leave it out, or choose a controller with a [model] "
        "of numbers."
    )
