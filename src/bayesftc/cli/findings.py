"""What the commands that print runs say of a run beside its figures: notes, and what speaks against the controller's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.diagram.wiring import find_controller, find_inference, inferring
from bayesftc.cosim.errors import BayesFTCError, UnknownNameError
from bayesftc.cosim.judging.blame import advice_on, blamed_together, often_blamed
from bayesftc.cosim.judging.findings import never_began
from bayesftc.cosim.judging.lost import loss_of, rows_before
from bayesftc.cosim.judging.metrics import limited, without_nan
from bayesftc.cosim.judging.roles import loop_signals

if TYPE_CHECKING:
    from bayesftc.cosim.block import Block
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.judging.signals import LoopSignals
    from bayesftc.cosim.run.result import Result


def notes_on(loop: Diagram, result: Result, signals: LoopSignals) -> list[str]:
    """Return notes on the model, on inputs at their limits, and on faults that never began."""
    loss = loss_of(signals)
    return [
        *([] if loss is None else [f"{loss.sentence} {loss.advice}"]),
        *result.suspicions,
        *(f"The {note}. {advice}" for note, advice in limited(signals)),
        *(never_began(loop, result) if result.decimation == 1 else ()),
    ]


def add_findings(numbers: dict[str, Any], loop: Diagram, result: Result, signals: LoopSignals) -> Exception | None:
    """Add to the numbers of a run what speaks against the model, and hints where healthy sensors are blamed.

    An error of the diagnosis, which is one of this package, is returned, to be raised once the run is shown and written.
    """
    failed, compared, sound = None, 0, rows_before(result, loss_of(signals))
    try:
        numbers["model"], compared = _diagnosed(loop, sound)
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not take the run with it
        numbers["model"], failed = None, error
    hints = _hints(numbers, loop, sound, signals if sound is result else loop_signals(loop, sound))
    said = [note for note in numbers["notes"] if not any(note in hint for hint in hints)]  # a hint has advice as well
    numbers["notes"] = [*said, *hints]
    faulty = [of["name"] for of in numbers["inputs"] if of["fault_share"]]
    if numbers["model"] and faulty:
        numbers["notes"].append(
            f"This run has faults of {' and '.join(faulty)} (above), and they may be all that speaks against the model: a run "
            "without them tells."
        )
    blaming = numbers["model"] or hints or result.suspicions
    numbers["model_without_error"] = None if blaming or not compared else compared
    return failed


def _diagnosed(loop: Diagram, result: Result) -> tuple[dict[str, Any] | None, int]:
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
    return None if finding is None else without_nan(asdict(finding)), compared_samples(model, result)


def _hints(numbers: Mapping[str, Any], loop: Diagram, result: Result, signals: LoopSignals) -> list[str]:
    """Return a hint if a healthy sensor is blamed often, and nothing else says what is wrong in the model."""
    together = {
        of: [f"{note[0].upper()}{note[1:]}." for note in notes]
        for of, notes in blamed_together(signals, result.decimation).items()
    }
    if together["named"]:
        return together["named"]
    often = often_blamed(signals)
    if often is None or numbers["model"]:
        return []
    worst, note = often
    blamed = " ".join(together["model"]) or f"{note[0].upper()}{note[1:]}."
    return [f"{blamed} {_scatter(signals, worst, inferring(find_inference(loop).block)) or advice_on(signals, worst)}"]


def _scatter(signals: LoopSignals, sensor: int, controller: Block) -> str:
    """Return a sentence if a sensor's healthy samples are further from the true values than its model expects; else nothing.

    It names an offset that is most of their errors.
    """
    of = signals.sensors[sensor]
    truth = next((q.truth for q in signals.quantities if sensor in q.sensors), None)
    covariance = getattr(getattr(controller, "model", None), "sensor_covariance", None)
    if of.samples is None or of.faulty is None or truth is None or covariance is None:
        return ""
    from bayesftc.controllers.diagnosis.scatter import scatter

    expected = float(np.sqrt(np.asarray(covariance)[sensor, sensor]))
    errors = (of.samples - truth)[~of.faulty]
    subject = "Its healthy samples differ from the true values"
    finite = errors[np.isfinite(errors)]
    offset = float(finite.mean()) if len(finite) else 0.0
    if abs(offset) > expected and 2 * offset**2 > np.mean(finite**2):
        return (
            f"{subject} by {offset:.3g}{behind(of.unit)} on average: an offset that the controller's model lacks is a fault to "
            "it. State how large such offsets may be (sensor_bias in design or [controller]), and it estimates this one: "
            "docs/how-to/biased-sensors.md."
        )
    return scatter(errors, expected, of.unit, subject, "the square root of its sensor_covariance")


def source_of_samples(loop: Diagram) -> str | None:
    """Return the name of the signal that is connected to the controller's ``y``."""
    controller = find_controller(loop)
    source = loop.source_of(controller, controller.port("y"), 0)
    return None if source is None else f"{source[0].node.name}.{source[0].port.name}"


__all__ = ["add_findings", "notes_on", "source_of_samples"]
