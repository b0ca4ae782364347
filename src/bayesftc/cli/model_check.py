"""What a run shows of an error of the controller's model, for the commands that print runs."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.diagram.wiring import find_controller, find_inference, inferring
from bayesftc.cosim.errors import BayesFTCError, UnknownNameError
from bayesftc.cosim.judging.metrics import without_nan

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.run.result import Result


def diagnosed(loop: Diagram, result: Result) -> tuple[dict[str, Any] | None, int]:
    """Return how the model in a loop is wrong, as far as the run was recorded, and how many samples were compared with it.

    The first is None without enough evidence against the model, the second 0 if no model was compared.
    """
    from bayesftc.controllers import diagnose
    from bayesftc.controllers.diagnosis.diagnose import checked_model, compared_samples

    try:
        node = find_inference(loop)
    except BayesFTCError:
        return None, 0
    model = checked_model(inferring(node.block))
    if model is None or result.decimation != 1:
        return None, 0
    try:
        finding = diagnose(result, loop)
    except UnknownNameError:  # a signal that it needs is not recorded
        return None, 0
    return None if finding is None else without_nan(asdict(finding)), compared_samples(model, len(result.time))


def source_of_samples(loop: Diagram) -> str | None:
    """Return the name of the signal that is connected to the controller's ``y``."""
    controller = find_controller(loop)
    source = loop.source_of(controller, controller.port("y"), 0)
    return None if source is None else f"{source[0].node.name}.{source[0].port.name}"


__all__ = ["diagnosed", "source_of_samples"]
