"""A controller that is made of the plant itself, so that a scenario file needs no model."""

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
    """Return what `bayesftc.controllers.design` makes of the plant, with the table's settings.

    Parameters
    ----------
    table : mapping
        The table of the file without ``kind``: arguments of `design`.
    place : Place
        Where it stands.
    plant : Block
        The plant.
    given : mapping
        Further arguments that other sections of the file say.
    sensors : Sensors or None
        What reads the plant: how many there are, and the standard deviation that the table does not give.
    """
    from_file = {"plant": plant, **given}
    settings = dict(table)
    if sensors is not None:
        _refuse_uneven(sensors, place)
        from_file["sensors"] = sensors.count
        if sensors.covariance is not None and "sensor_std" not in table:
            raise place.error(
                "lacks 'sensor_std', for [sensors] has a covariance: a design is for sensors whose noise is independent; add "
                "sensor_std = ... (a number, or one for each sensor)."
            )
        std = sensors.std
        if np.any(std):
            settings.setdefault("sensor_std", std if isinstance(std, float) else list(std))
    for name in ("plant", "measured", "actuated", "sensors"):
        if name in table:
            raise (place / name).error("is said by [plant] and [sensors] already; leave it out here.")
    return build(design, settings, place, given=from_file)  # type: ignore[no-any-return]


def _refuse_uneven(sensors: Sensors, place: Place) -> None:
    matrix = sensors.matrix
    if sensors.function is None and matrix is None:
        return
    in_turn = [[float(j == i % sensors.signals) for j in range(sensors.signals)] for i in range(sensors.count)]
    if matrix is None or not np.array_equal(matrix, in_turn):
        raise place.error(
            "cannot be a design, for [sensors] has a matrix: a design is for sensors that read the measured variables in turn. "
            "Leave the matrix out, or choose a controller that has a [model]."
        )
