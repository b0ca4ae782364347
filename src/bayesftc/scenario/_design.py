"""Design a controller from the plant itself, so that a scenario file needs no model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesftc.controllers import design
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.sensors import Sensors
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import build


def designed(
    table: Mapping[str, Any], place: Place, plant: Block, given: Mapping[str, Any], sensors: Sensors | None
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
        The sensors: their number, and the standard deviation if the table has none.
    """
    from_file = {"plant": plant, **given}
    settings = dict(table)
    if sensors is not None:
        _refuse_uneven(sensors, place)
        from_file["sensors"] = sensors.count
        if sensors.covariance is not None and "sensor_std" not in table:
            raise place.error(
                "lacks 'sensor_std', which a design needs if [sensors] has a covariance: it assumes independent noise. Add "
                "sensor_std = ... (a number, or one for each sensor)."
            )
        std = sensors.std
        if np.any(std):
            settings.setdefault("sensor_std", std if isinstance(std, float) else list(std))
    for name in ("plant", "measured", "actuated", "sensors"):
        if name in table:
            raise (place / name).error("is already set by [plant] and [sensors]. Leave it out here.")
    return build(design, settings, place, given=from_file)  # type: ignore[no-any-return]


def _refuse_uneven(sensors: Sensors, place: Place) -> None:
    matrix = sensors.matrix
    if sensors.function is None and matrix is None:
        return
    in_turn = [[float(j == i % sensors.signals) for j in range(sensors.signals)] for i in range(sensors.count)]
    if matrix is None or not np.array_equal(matrix, in_turn):
        raise place.error(
            "cannot be a design, because [sensors] has a matrix. A design needs sensors that read the measured variables in "
            "turn. Leave out the matrix, or choose a controller with a [model]."
        )
