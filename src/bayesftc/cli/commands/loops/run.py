"""``bayesftc run``: run a scenario file, print tables and write files."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from bayesftc._interrupt import Interrupted
from bayesftc.cli import completion, output
from bayesftc.cli.commands.loops._compare import compare_scenarios
from bayesftc.cli.findings import add_findings, notes_on, source_of_samples
from bayesftc.cli.options import Duration, Json, Quiet, RunFolder, Seed, check_numbers
from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
from bayesftc.cosim.diagram.wiring import dead_times
from bayesftc.cosim.errors import BayesFTCError, ModelError, SimulationError
from bayesftc.cosim.judging.findings import numbers_of
from bayesftc.cosim.judging.metrics import without_nan
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.judging.signals import LoopSignals
from bayesftc.scenario import Scenario, load_scenario
from bayesftc.scenario._unused import unused

if TYPE_CHECKING:
    from bayesftc.controllers import BayesianController, LinearModel
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.run.result import Result
    from bayesftc.cosim.run.running import Progress
    from bayesftc.cosim.types import Floats

COMPARED = 20_000
"""Samples over which a run with our SER baseline is compared with filterpy's: less than a second."""
UNKNOWN = "The comparison with filterpy has no result, because one of its numbers is not finite."
NOT_COMPARED = (
    "The SER baseline was not compared with filterpy's, which needs every signal at every step. Remove 'record' and "
    "'decimation' from the scenario, or add --check-kalman."
)
DIFFERENCES = ("mean_difference", "covariance_difference", "mean_absolute", "covariance_absolute")


Engine = StrEnum("Engine", ["auto", "compiled", "interpreted"])


def run(
    scenarios: Annotated[
        list[str],
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file (TOML), or the name of a shipped one such as cruise_control; several with --compare.",
            autocompletion=completion.scenarios,
        ),
    ],
    out: RunFolder = None,
    seed: Seed = None,
    duration: Duration = None,
    engine: Annotated[Engine | None, typer.Option(help="Engine, instead of the scenario's.")] = None,
    pace: Annotated[
        float | None,
        typer.Option(metavar="FACTOR", help="Simulated seconds per second of the clock; 1 for real time."),
    ] = None,
    check_kalman: Annotated[
        bool, typer.Option("--check-kalman", help="Compare the belief with filterpy's Kalman filter.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Run several scenarios with the same seeds, and compare their errors.")
    ] = False,
    seeds: Annotated[
        int | None, typer.Option(min=2, help="With --compare: number of runs of each, by default 50.")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a scenario, print its figures and write its files; or compare several."""
    check_numbers(duration=duration, seed=seed, pace=pace)
    if compare:
        if engine is not None or pace is not None or check_kalman:
            raise ModelError("--compare cannot be used with --engine, --pace and --check-kalman. Leave them out.")
        compare_scenarios(scenarios, seeds=seeds, seed=seed, duration=duration, out=out, json=json, quiet=quiet)
        return
    if len(scenarios) > 1 or seeds is not None:
        raise ModelError(
            f"bayesftc run has {'--seeds' if seeds is not None else f'{len(scenarios)} scenarios'}, but makes one run of one "
            "scenario. To compare several scenarios over many seeds, add --compare."
        )
    (scenario,) = scenarios
    options: dict[str, Any] = {"seed": seed, "duration": duration, "engine": engine and engine.value, "pace": pace}
    if out is not None:
        output.check_folder(out, silent=True)
    loaded = load_scenario(scenario)
    with noted_elsewhere():
        loop = loaded.loop()
        _compare(loaded)
    if check_kalman:
        _refuse_kalman(loaded)
        options = {**options, "record": _with_kalmans(loaded, loop)}
    notes = unused(loaded, duration)
    if not json and not quiet:
        output.say_notes(notes)
        if out is not None:  # the scenario is checked
            output.note_replaced(out / name for name in (output.RESULT, output.FIGURE, output.NUMBERS))
    try:
        with _progress(shown=sys.stderr.isatty() and not quiet and not json) as progress, noted_elsewhere():
            result = loaded.simulate(loop, progress=progress, **options)
    except (SimulationError, Interrupted, KeyboardInterrupt) as error:
        kept = getattr(error, "result", None)  # after Ctrl-C only of a paced run
        if out is not None and kept is not None and len(kept.time):
            output.write_files(out, kept, *_report(scenario, loaded, loop, kept))
            said = error if isinstance(error, SimulationError) else kept.stopped
            error.args = (f"{said} The signals up to then are in {out / output.RESULT}.",)
        elif isinstance(error, SimulationError) and kept is not None and len(kept.time):
            error.args = (f"{error} To keep the signals up to then, add --out FOLDER.",)
        if isinstance(error, SimulationError) and kept is not None and not json and not quiet:
            output.say_notes(kept.suspicions)
        raise
    numbers, signals = _report(scenario, loaded, loop, result)
    failed = add_findings(numbers, loop, result, signals)
    if check_kalman:
        numbers["kalman"] = _kalman(loaded, loop, result)
    elif _is_ser(loaded):
        if loaded.simulation.record is None and result.decimation == 1:
            numbers["kalman"] = _kalman(loaded, loop, result, most=COMPARED)
        else:
            numbers["notes"].append(NOT_COMPARED)
    if not json and not quiet:
        output.print_report(numbers)  # the figure takes seconds
    undrawn = None if out is None else output.write_files(out, result, numbers, signals)
    if json:
        numbers["notes"] += notes
        typer.echo(output.as_json(numbers))
    elif out is not None and not quiet:
        output.say_written(out, undrawn)
    if failed := failed or undrawn:
        raise failed


def _compare(scenario: Scenario) -> None:
    """Warn if the step responses of the controller's model and of the plant differ."""
    from bayesftc.controllers import LinearModel, compare_with_plant

    controller, sensors, wiring = scenario.controller, scenario.sensors, scenario.wiring
    if not isinstance(getattr(controller, "model", None), LinearModel):
        return
    reads = None if sensors is None else sensors.reads
    if reads is not None and all(output is None for output in reads):
        return  # the sensors measure a function of the plant's outputs
    if any(
        not target.startswith(("controller.goal", *(f"{name}." for name in scenario.blocks)))
        for _, target in scenario.connections
    ):
        return  # the controller controls the plant together with blocks
    limits = {name: getattr(controller, name) for name in ("u_min", "u_max") if hasattr(controller, name)}
    model: LinearModel = controller.model  # type: ignore[attr-defined]
    if model.delays is not None:
        model = _of_plant_alone(model, scenario.loop())
    compare_with_plant(
        model,
        scenario.plant,
        control=wiring.control,
        measured=wiring.measured,
        reads=reads,
        at=np.asarray(controller.initial_mean)[: model.plant_states],  # type: ignore[attr-defined]
        **limits,
    )


def _of_plant_alone(model: LinearModel, loop: Diagram) -> LinearModel:
    """Return the model without the dead times that the loop has outside of its plant."""
    assert model.delays is not None
    late, old = dead_times(loop, "plant")
    inputs = [max(steps - round(late.get(j, 0) / model.step), 0) for j, steps in enumerate(model.delays.inputs)]
    sensors = [max(steps - round(of / model.step), 0) for steps, of in zip(model.delays.sensors, old, strict=True)]
    return model.undelayed.with_delays(inputs, sensors)


def _report(path: str, scenario: Scenario, loop: Diagram, result: Result) -> tuple[dict[str, Any], LoopSignals]:
    """Return the numbers of a run as plain data, and its signals by their role in the loop."""
    from bayesftc import __version__

    signals = loop_signals(loop, result)
    # With a decimation the last step may have no row. The steps of a run that stopped are known only from its rows.
    recorded = max(len(result.time) - 1, 0) * result.decimation
    steps = recorded if result.stopped else round(Fraction(result.metadata["duration"]) / result.step)
    numbers: dict[str, Any] = {
        "scenario": path,
        "bayesftc": __version__,
        **{name: result.metadata[name] for name in ("seed", "engine")},
        "duration": float(steps * result.step),
        "steps": steps,
        "stopped": result.stopped,
        **numbers_of(signals),
        "notes": [
            *notes_on(loop, result, signals),
            *_notes(scenario, signals),
        ],
    }
    if pace := result.metadata.get("pace"):
        numbers["pace"] = pace
        numbers["notes"].append(_in_time(pace))
    return numbers, signals


def _in_time(pace: Mapping[str, float]) -> str:
    """Return a sentence on how a run kept pace with the clock."""
    aim = f"At a pace of {pace['pace']:g} simulated seconds per second"
    if not pace["overruns"]:
        if "tolerance" in pace:
            return f"{aim} no step was late by more than {1e3 * pace['tolerance']:.3g} ms."
        return f"{aim} every step was complete before the next was due."
    times = "once" if pace["overruns"] == 1 else f"{pace['overruns']} times"
    return (
        f"{aim} the run was late {times}, by at most {1e3 * pace['worst_overrun']:.3g} ms. It then continued without a pause "
        "until it was on time again."
    )


def _notes(scenario: Scenario, signals: LoopSignals) -> list[str]:
    """Return sentences on the numbers that the figures lack, and why."""
    why = getattr(getattr(scenario.controller, "precision", None), "why_no_probability", None)
    notes = [f"There is no fault probability: {why}"] if why else []
    if any(sensor.detected is not None and sensor.alarm is sensor.detected for sensor in signals.sensors):
        notes.append("Alarms are the samples at which the controller detects a fault.")
    if signals.unrecorded:
        notes.append(
            f"Figures are missing, because these signals were not recorded: {', '.join(sorted(signals.unrecorded))}. Add them to "
            "'record' of the scenario, or remove 'record'."
        )
    goals, others = ([q.name for q in signals.quantities if q.has_goal == has_goal] for has_goal in (True, False))
    if others:
        of = (
            f"the goal is for {' and '.join(map(repr, goals))}"
            if goals
            else "there is no goal for " + ("it" if len(others) == 1 else "them")
        )
        notes.append(f"No tracking error of {', '.join(map(repr, others))}: {of}.")
    for quantity in signals.quantities:
        if quantity.only_ahead:
            notes.append(
                f"{quantity.name} has no tracking error: its goal comes through a block after 'ahead', so no signal has the "
                "present goal."
            )
        if not quantity.has_belief:
            notes.append(
                f"{quantity.name} has no error of the belief: the controller does not say how {quantity.name} depends on "
                "its states (measurement_matrix), or they do not determine it."
            )
        for what, values, figures_of in (
            ("true value", quantity.truth, "errors"),
            ("reference", quantity.reference, "tracking error"),
            ("belief", quantity.belief, "error of the belief"),
        ):
            if when := _first_not_finite(values, signals.time):
                notes.append(f"The {what} of {quantity.name} is not finite {when}, so it has no {figures_of} then.")
    if signals.faulty is None and not signals.unrecorded:
        notes.append("There are no figures of detection: the times of the faults were not recorded.")
    for sensor in signals.sensors:
        if sensor.probability is not None and why is None:
            probability = (
                sensor.probability if sensor.missing is None else np.where(sensor.missing, 0.0, sensor.probability)
            )
            if when := _first_not_finite(probability, signals.time):
                notes.append(f"The fault probability of sensor {sensor.index} is not finite {when}.")
    if any(s.lost is not None and s.lost.any() for s in signals.sensors):
        notes.append(
            "A missing sample needs no detector: the controller leaves that sensor out at once. The figures of detection and "
            "precision leave out missing samples. So a fault whose samples are all missing has no delay, and cannot be missed."
        )
    elif signals.faulty is not None and any(s.missing is None for s in signals.sensors):
        notes.append("The samples were not recorded, so the figures of detection assume that none is missing.")
    if not signals.quantities:
        notes.append("There are no true values: the sensors measure a function of the plant's outputs.")
    return notes


def _first_not_finite(values: Floats | None, time: Floats) -> str | None:
    """Return a phrase on when values (a row for each time) are not finite, or None if they always are."""
    if values is None:
        return None
    bad = np.asarray(~np.isfinite(values).reshape(len(time), -1).all(axis=1))
    if not bad.any():
        return None
    first = int(np.argmax(bad))
    return f"from t = {time[first]:g} s on" if bad[first:].all() else f"at times, the first at t = {time[first]:g} s"


def _refuse_kalman(scenario: Scenario) -> None:
    """Raise an error before the run if --check-kalman cannot be done after it."""
    from bayesftc.controllers import BayesianController

    if not isinstance(scenario.controller, BayesianController):
        raise ModelError(
            f"--check-kalman needs a BayesianController, not a {type(scenario.controller).__name__}. Leave it out."
        )
    if scenario.simulation.decimation != 1:
        raise ModelError(
            f"--check-kalman compares every step, but {scenario.path} has decimation = {scenario.simulation.decimation} in "
            "[simulation]. Set it to 1, or leave out --check-kalman."
        )


def _is_ser(scenario: Scenario) -> bool:
    """Return whether the controller is the SER baseline, whose reference implementation is filterpy's filter."""
    from bayesftc.controllers import SERFDI, BayesianController

    controller = scenario.controller
    return isinstance(controller, BayesianController) and isinstance(controller.precision, SERFDI)


def _with_kalmans(scenario: Scenario, loop: Diagram) -> list[str] | None:
    """Return the signals that the scenario records and those that the comparison needs; None for all signals."""
    record = scenario.simulation.record
    if record is None:
        return None
    needed = [f"controller.{port}" for port in ("u", "x_hat", "P", "R")]
    return [*([record] if isinstance(record, str) else record), *needed, source_of_samples(loop) or "controller.y"]


def _kalman(scenario: Scenario, loop: Diagram, result: Result, most: int | None = None) -> dict[str, Any]:
    """Return the differences from filterpy's filter over the first samples, whether the two agree, and a verdict."""
    from bayesftc.controllers import BayesianController
    from bayesftc.controllers.bayesian.recorded import sampled_rows
    from bayesftc.controllers.bayesian.validation import check_kalman, sensor_by_sensor

    controller = scenario.controller
    assert isinstance(controller, BayesianController)
    name = source_of_samples(loop)
    signals: Mapping[str, Any] = result
    together, rows = _has_another_form(controller), sampled_rows(result, controller.model.step, "--check-kalman")
    try:
        with np.errstate(all="ignore"):  # the verdict reports a filter that diverges
            if together:
                signals, controller = sensor_by_sensor(result, controller, y=name)
            found = asdict(check_kalman(signals, controller, y=name, most=most))
            check = {key: found[key] for key in (*DIFFERENCES, "steps")}
    except BayesFTCError as error:
        raise type(error)(f"--check-kalman: {error}") from None
    except np.linalg.LinAlgError:  # with a belief that diverges filterpy inverts a singular matrix
        check = {**dict.fromkeys(DIFFERENCES, float("nan")), "steps": len(result.time[rows])}
    agrees, verdict = _verdict(check, controller)
    if together:
        verdict = (
            f"{type(controller.precision).__name__} infers state and faults together, which a Kalman filter does not. The "
            f"comparison uses its per-sensor form, with the same samples and controls. {verdict}"
        )
        if agrees is False:
            verdict += (
                " That form did not control the run: where it loses the plant, as an unstable one, both filters lose digits. "
                'A run with kind = "FixedPrecision" in [controller.precision] is checked as it was.'
            )
    if agrees is None:
        for what, signal in (("mean", "x_hat"), ("covariance", "P")):
            values = np.asarray(signals[f"controller.{signal}"])
            if when := _first_not_finite(values if together else values[rows], result.time[rows]):
                verdict += f" The {what} of the belief is not finite {when}."
        if verdict.endswith(UNKNOWN):
            verdict += " The belief is finite, so filterpy's belief has overflowed."
    plain: dict[str, Any] = without_nan(check | {"agrees": agrees, "verdict": verdict})
    return plain


def _has_another_form(controller: BayesianController) -> bool:
    """Return whether the learner infers state and faults together, and also has a per-sensor form."""
    model = controller.model
    if controller.belief == "joint" or controller.precision.learner(model).infer is None:
        return False
    try:
        return controller.precision.apart("The Kalman check").learner(model).infer is None
    except ModelError:  # the learner has actuator faults or process modes, which have no per-sensor form
        return False


def _verdict(check: Mapping[str, float], controller: BayesianController) -> tuple[bool | None, str]:
    """Return whether the belief agrees with filterpy's (None if that is unknown), and a sentence on it."""
    from bayesftc.controllers.bayesian.validation import AGREEMENT, expected_to_differ

    # Where the absolute difference is zero the relative one is zero too, or 0/0.
    pairs = (("mean_difference", "mean_absolute"), ("covariance_difference", "covariance_absolute"))
    relative = [0.0 if check[absolute] == 0.0 else check[name] for name, absolute in pairs]
    if not np.isfinite(relative).all():
        return None, UNKNOWN
    largest = max(relative)
    if largest <= AGREEMENT:
        return True, "The belief agrees with filterpy to 1e-9."
    sentence = f"The belief does not agree with filterpy to 1e-9: the largest relative difference is {largest:.2g}."
    return False, f"{sentence} {expected_to_differ(controller)}".rstrip()


@contextmanager
def _progress(shown: bool) -> Iterator[Progress | None]:
    """Give a function that moves a progress bar on stderr, or None."""
    # The bar starts as "Preparing": the first run of a kind of loop takes some seconds to compile.
    with output.progress_bar("Preparing", "{task.percentage:3.0f} %", "remaining", shown=shown) as move:
        yield move and (lambda step, steps: move(step, steps, description="Simulating"))
