"""``bayesftc calibrate``: from a scenario to the logistic map that beta needs, or to how good the learner's probability is."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Annotated

import typer

from bayesftc import controllers
from bayesftc.cli import output
from bayesftc.cli.options import AScenario, Json
from bayesftc.controllers.detection.calibration import judge_own_probability
from bayesftc.controllers.precision.rate import RateLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario
from bayesftc.scenario._place import Place


def calibrate(
    scenario: AScenario,
    time_to_fault: Annotated[float, typer.Option(help="Mean time to a fault in seconds.")] = 2.8,
    time_to_recovery: Annotated[float, typer.Option(help="Mean time to recovery in seconds.")] = 0.4,
    injection: Annotated[float | None, typer.Option(help="Offset of an injection; by default 3 sensor sd.")] = None,
    drift: Annotated[float | None, typer.Option(help="Drift per second; by default 5 sensor sd.")] = None,
    steps: Annotated[int, typer.Option(help="Length of the simulated run.")] = 80_000,
    seed: Annotated[int, typer.Option(help="Seed of its noise and faults.")] = 0,
    json: Json = False,
) -> None:
    """Fit the map for a scenario's model, learner, controller and reference, and print it as a line of TOML.

    The scenario's plant and faults are not used, its model is simulated. A learner that gives a probability itself needs no map:
    then it is said how good that probability is.
    """
    hazards, path = controllers.Hazards(time_to_fault, time_to_recovery), scenario
    magnitudes = {n: size for n, size in {"injection": injection, "drift": drift}.items() if size is not None}
    loaded = load_scenario(path)
    controller = loaded.controller
    if not isinstance(controller, controllers.BayesianController):
        raise ModelError(f"{path}: calibrate simulates a BayesianController, not a {type(controller).__name__}.")
    own = {f.name: getattr(controller, f.name) for f in fields(controller) if f.name != "model"}
    learner = controller.precision
    tells = not isinstance(learner, RateLearner) and learner.why_no_probability is None
    with Place(path).named():
        report = (judge_own_probability if tells else controllers.calibrate)(
            controller.model, hazards, magnitudes, reference=loaded.reference, steps=steps, seed=seed, **own
        )
    if json:
        typer.echo(output.as_json(asdict(report)))
        return
    c = report.calibration
    typer.echo(
        f"On {report.samples} samples that were not fitted, {report.fault_share:.1%} of them in fault: AUC {report.auc:.3f}, "
        f"Brier score {report.brier:.4f} (a constant: {report.brier_of_constant:.4f}), calibration error "
        f"{report.calibration_error:.3f}."
    )
    if c is None:
        typer.echo(
            f"{type(learner).__name__} gives a fault probability itself, so there is no map to fit. For a map of the residual "
            'beta write kind = "GammaPrecision" in [controller.precision].'
        )
        return
    typer.echo("For [controller.precision]:\n")
    typer.echo(f'calibration = {{ slope = {c.slope:.4g}, intercept = {c.intercept:.4g}, feature = "{c.feature}" }}')
