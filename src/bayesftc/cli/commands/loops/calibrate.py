"""``bayesftc calibrate``: fit the logistic map of beta, or evaluate the learner's own probability, for a scenario."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from math import isnan
from pathlib import Path
from typing import Annotated, Any

import typer

from bayesftc import controllers
from bayesftc.cli import output
from bayesftc.cli.options import AScenario, Json, by_options
from bayesftc.controllers.detection.calibration import (
    default_sizes,
    judge_own_probability,
    needed_steps,
    simulated_sizes,
)
from bayesftc.controllers.detection.doubt import doubt, too_few
from bayesftc.controllers.precision.rate import RateLearner
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.probabilities import Reliability
from bayesftc.scenario import load_scenario
from bayesftc.scenario._place import Place

DIAGRAM, NUMBERS = "reliability.png", "calibration.json"

OPTIONS = {
    "mean_time_to_fault": "--time-to-fault",
    "mean_time_to_recovery": "--time-to-recovery",
    "steps": "--steps",
    "injection": "--injection",
    "drift": "--drift",
}
"""Arguments of `bayesftc.controllers.calibrate` that its errors name, and their options."""


def calibrate(
    scenario: AScenario,
    time_to_fault: Annotated[
        float | None, typer.Option(help="Mean time to a fault in seconds, by default 2.8, or 28 samples if longer.")
    ] = None,
    time_to_recovery: Annotated[
        float | None, typer.Option(help="Mean time to recovery in seconds, by default 0.4, or 4 samples if longer.")
    ] = None,
    injection: Annotated[
        list[float] | None,
        typer.Option(
            help="Offset of an injection in the unit of the sensor, by default 3 sd of each sensor. One number is for all "
            "sensors; else repeat the option for each."
        ),
    ] = None,
    drift: Annotated[
        list[float] | None,
        typer.Option(
            help="Drift per second, given in the same way, by default 5 sd of each sensor (less for sample times above 0.1 s)."
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            help="Length of the simulated run in steps; the last fifth is the test. By default 80000, or up to 1000000 for rare "
            "or long faults."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of its noise and faults.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help=f"Write {DIAGRAM} and {NUMBERS} there.")
    ] = None,
    json: Json = False,
) -> None:
    """Measure the accuracy of a scenario's fault probability on simulated faults of the sensors.

    The scenario's model is simulated with its learner, controller and reference; its plant and faults are not used. The last
    fifth of the run is the test. For a learner with the residual beta, such as GammaPrecision, the map from beta to a probability
    is fitted on the rest, and printed as a line of TOML. For one that gives a probability itself, as the default learner does,
    nothing is fitted.
    """
    lists = {name: sizes for name, sizes in {"injection": injection, "drift": drift}.items() if sizes}
    magnitudes = {name: sizes[0] if len(sizes) == 1 else sizes for name, sizes in lists.items()}
    if out is not None:
        output.check_folder(out, (DIAGRAM, NUMBERS), silent=True)
    loaded = load_scenario(scenario)
    controller = loaded.controller
    if not isinstance(controller, controllers.BayesianController):
        raise ModelError(
            f"{scenario} has a {type(controller).__name__}. bayesftc calibrate needs a scenario with a BayesianController."
        )
    if out is not None and not json:  # the scenario is checked
        output.note_replaced(out / name for name in (DIAGRAM, NUMBERS))
    settings = {f.name: getattr(controller, f.name) for f in fields(controller) if f.name != "model"}
    usual = controllers.Hazards.usual(controller.model.step)  # type: ignore[attr-defined]
    given = {"mean_time_to_fault": time_to_fault, "mean_time_to_recovery": time_to_recovery}
    hazards = usual._replace(**{name: seconds for name, seconds in given.items() if seconds is not None})
    learner = controller.precision
    has_probability = not isinstance(learner, RateLearner) and learner.why_no_probability is None
    with Place(scenario).named(), by_options(**OPTIONS):
        report = (judge_own_probability if has_probability else controllers.calibrate)(
            controller.model,
            hazards,
            magnitudes,
            reference=loaded.reference,
            steps=steps,
            seed=seed,
            kind=type(controller),
            **settings,
        )
    assert report.reliability is not None
    sizes = simulated_sizes(controller.model, magnitudes)
    numbers = asdict(replace(report, reliability=None, sensors=())) | {
        "reliability": report.reliability.to_dict(),
        "sensors": [sensor.to_dict() for sensor in report.sensors],
        "simulated": {**hazards._asdict(), **sizes},
    }
    if out is not None:
        _write(out, scenario, report.reliability, numbers)
    if json:
        typer.echo(output.as_json(numbers))
        return
    c = report.calibration
    typer.echo(_simulated(hazards, sizes, controller.model, magnitudes))
    low, high = report.calibration_error_interval
    interval = "" if isnan(low) else f" (95 % interval {low:.3f} to {high:.3f})"
    sensors = f"the {len(report.sensors)} sensors" if len(report.sensors) > 1 else "the sensor"
    typer.echo(
        f"On {report.samples} samples of {sensors}, the last fifth of the run{'' if c is None else ', not used for the fit'}, "
        f"{report.fault_share:.1%} of them in fault ({report.faults} faults begin): "
        f"AUC {report.auc:.3f}, Brier score {report.brier:.4f} (of a constant: {report.brier_of_constant:.4f}), "
        f"calibration error {report.calibration_error:.3f}{interval}."
    )
    if loaded.sensors is not None and max(loaded.sensors.rates, default=1) > 1:
        typer.echo("Here all sensors have a sample in each step, also those that [sensors] gives fewer (every).")
    names = controller.model.names
    if few := too_few(report, needed_steps(hazards, controller.model.step)):  # type: ignore[attr-defined]
        typer.echo(few)
    elif doubts := doubt(report, None if names is None else names.sensors):
        typer.echo(doubts + _remedy(learner))
    if out is not None:
        typer.echo(f"Written to {out}: {DIAGRAM}, {NUMBERS}.")
    if c is None:
        typer.echo(
            f"{type(learner).__name__} gives a fault probability itself, so there is no map to fit. To fit a map of the residual "
            'beta, write kind = "GammaPrecision" in [controller.precision].'
        )
        return
    typer.echo("For [controller.precision]:\n")
    typer.echo(f'calibration = {{ slope = {c.slope:.4g}, intercept = {c.intercept:.4g}, feature = "{c.feature}" }}')


def _simulated(
    hazards: controllers.Hazards,
    sizes: Mapping[str, list[float]],
    model: controllers.LinearModel,
    given: Mapping[str, Any],
) -> str:
    """Return which faults were simulated."""
    usual = default_sizes(model.step)
    injection, drift = (_size(sizes[name], None if name in given else usual[name]) for name in ("injection", "drift"))
    return (
        f"Simulated faults of each sensor: it freezes, jumps by {injection} or drifts by {drift} a second. "
        f"A fault lasts {hazards.mean_time_to_recovery:.4g} s on average, and the next one begins "
        f"{hazards.mean_time_to_fault:.4g} s after it on average. For faults as in your plant, give --injection, --drift, "
        "--time-to-recovery and --time-to-fault."
    )


def _size(sizes: list[float], deviations: float | None) -> str:
    """Return the size of a fault in words: a number of standard deviations, or the given numbers."""
    if deviations is not None:
        return f"{deviations:.3g} sd of its noise"
    if len(set(sizes)) == 1:
        return f"{sizes[0]:.3g}"
    return f"{', '.join(f'{size:.3g}' for size in sizes)} (sensors 0 to {len(sizes) - 1})"


def _remedy(learner: object) -> str:
    """Return what may help a learner with wrong probabilities."""
    if not isinstance(learner, controllers.SwitchingPrecision):
        return ""
    joint = ", or compare with joint = false in [controller.precision]" * learner.joint
    return f" If yours are like these, give its modes their times, time_to_fault and time_to_recovery{joint}."


def _write(folder: Path, scenario: str, reliability: Reliability, numbers: Mapping[str, Any]) -> None:
    """Write the reliability diagram and the numbers."""
    from bayesftc.cosim.judging.figures.panels import bare_figure
    from bayesftc.cosim.judging.figures.reliability import plot_reliability

    picture = io.BytesIO()
    title = f"{Path(scenario).stem}: {numbers['samples']} samples of simulated faults"
    plot_reliability(reliability, bare_figure(), title).savefig(picture, dpi=output.DOTS_PER_INCH, format="png")
    with output.staged(folder) as stage:
        (stage / DIAGRAM).write_bytes(picture.getbuffer())
        (stage / NUMBERS).write_text(output.as_json(numbers) + "\n", encoding="utf-8")
