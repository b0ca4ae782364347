"""``bayesftc calibrate``: from a scenario to the logistic map that beta needs, or to how good the learner's probability is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields

import typer

from bayesftc.cli import output
from bayesftc.controllers import BayesianController, Hazards, calibrate
from bayesftc.controllers.detection.calibration import judge_own_probability
from bayesftc.controllers.precision.rate import RateLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario
from bayesftc.scenario._place import Place


def calibrate_scenario(
    path: str, hazards: Hazards, magnitudes: Mapping[str, float], *, steps: int, seed: int, json: bool
) -> None:
    """Fit the map for a scenario's model, learner, controller and reference, and print it as a line of TOML.

    A learner that gives a probability itself needs none: then it is said how good that probability is.

    Parameters
    ----------
    path : str
        A scenario file or the name of a shipped scenario; its plant and faults are not used, its model is simulated.
    hazards : Hazards
        Mean time to fault and to recovery in seconds.
    magnitudes : mapping
        ``injection`` and ``drift``; what is left out has the default of `bayesftc.controllers.calibrate`.
    steps, seed : int
        Length and seed of the simulated run.
    json : bool
        Whether to print JSON instead.
    """
    scenario = load_scenario(path)
    controller = scenario.controller
    if not isinstance(controller, BayesianController):
        raise ModelError(f"{path}: calibrate simulates a BayesianController, not a {type(controller).__name__}.")
    own = {f.name: getattr(controller, f.name) for f in fields(controller) if f.name != "model"}
    learner = controller.precision
    tells = not isinstance(learner, RateLearner) and learner.why_no_probability is None
    with Place(path).named():
        report = (judge_own_probability if tells else calibrate)(
            controller.model, hazards, magnitudes, reference=scenario.reference, steps=steps, seed=seed, **own
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
