"""Experiment 1: active inference on a robot arm whose first encoder freezes (paper, section 5.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim._repeat import repeat
from bayesftc.cosim.block import Floats, Kernel
from bayesftc.reproduce import paper
from bayesftc.reproduce._ensemble import Progress, check_jobs, chunks, in_parallel, prepare, seeds
from bayesftc.reproduce.settings import Arm

FAULTY, HEALTHY = 0, 1
"""The joint whose encoder freezes, and the other."""
GROUPS = ((0, 1), (4, 5))
"""Samples that the explicit detection judges together: the encoders; the camera. The errors of the velocity encoders say above
all that the arm accelerates, which a random walk does not predict."""
CHUNK = 5
"""Runs that one task makes: about a fifth of a second."""
BELIEF = ("plant.q1", "plant.q2", "controller.x_hat")
NAMES = ("none", "implicit", "explicit", "deterministic")


@dataclass(frozen=True)
class Case:
    """A controller, and whether the encoder freezes and whether it is told so (``deterministic``)."""

    precision: controllers.PrecisionLearner
    fault: bool = True
    told: bool = False


def run(
    *,
    seed: int = 0,
    jobs: int = 1,
    runs: int | None = None,
    beyond: bool = True,
    settings: Arm | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and return what ``arm.json`` holds.

    Parameters
    ----------
    seed : int
        Seed of all noise; the thresholds are learned on seeds of their own.
    jobs : int
        Number of threads; the result is the same to the last bit for any.
    runs : int, optional
        Runs of each controller, instead of the settings'.
    beyond : bool
        Whether the unpublished settings are varied as well (``grid``).
    settings : Arm, optional
        Other settings than those of `bayesftc.reproduce.settings`.
    progress : callable, optional
        Called as ``progress(what, done, of)``.

    Raises
    ------
    ModelError
        If a number of jobs or runs cannot be.
    """
    check_jobs(jobs)
    settings = settings or Arm()
    settings = settings if runs is None else replace(settings, runs=runs)
    thresholds = learn_thresholds(settings, seed, jobs, progress)
    cases = {
        "none": Case(controllers.FixedPrecision()),
        "implicit": Case(learning(settings)),
        "explicit": Case(explicit(settings, thresholds)),
        "deterministic": Case(controllers.FixedPrecision(), told=True),
    }
    loops = {name: closed_loop(settings, case) for name, case in cases.items()}
    chosen = seeds(seed, "arm", settings.runs)
    errors = squared_errors(settings, loops, chosen, jobs, progress, "The paper's table")
    detection = detections(settings, cases["explicit"], chosen, jobs, progress)
    return {
        "settings": {
            "seed": seed,
            **settings.to_dict(),
            "techniques": {n: repr(c.precision) for n, c in cases.items()},
        },
        "mse": {name: _summary(values) for name, values in errors.items()},
        "paper": paper.ARM,
        "detection": detection,
        "trajectories": {name: _trajectory(settings, loop, chosen[0]) for name, loop in loops.items()},
        "grid": _grid(settings, seed, jobs, progress) if beyond else None,
    }


@cache
def camera(lengths: tuple[float, ...], distortion: tuple[float, float, float]) -> Kernel:
    """Return the step function from the arm's state to where the camera sees its end."""
    arm, lens = cosim.planar_arm(lengths), cosim.radial_distortion(*distortion)

    def arm_seen_by_camera(x, y):  # type: ignore[no-untyped-def]
        arm(x, y)
        lens(y, y)

    return arm_seen_by_camera


def learning(settings: Arm) -> controllers.PointMassPrecision:
    """Return the precision learner of both rows with precision learning."""
    return controllers.PointMassPrecision(rate=settings.learning_rate, lower_bound=settings.lower_bound)


def explicit(settings: Arm, thresholds: tuple[controllers.FittedThreshold, ...]) -> controllers.ExplicitDetection:
    """Return the same learner, triggered by thresholds."""
    return controllers.ExplicitDetection(learning(settings), threshold=thresholds, groups=GROUPS, hold=settings.hold)


def controller(settings: Arm, precision: controllers.PrecisionLearner) -> controllers.UnbiasedActiveInference:
    """Return the unbiased active inference controller with a precision learner."""
    lengths, eye = _lengths(), np.eye(4)
    encoders, camera_of = settings.encoder_precision, camera(lengths, settings.distortion)
    modalities = (
        controllers.Modality("encoders", matrix=eye[:2], std=settings.encoder_std, precision=encoders),
        controllers.Modality("velocity encoders", matrix=eye[2:], std=settings.encoder_std, precision=encoders),
        controllers.Modality("camera", 2, camera_of, std=settings.camera_std, precision=settings.camera_precision),
    )
    law = controllers.PID(
        (settings.proportional,) * 2,
        derivative_gain=settings.derivative,
        integral_gain=settings.integral,
        integral_limit=settings.integral_limit,
    )
    return controllers.UnbiasedActiveInference(
        modalities,
        law,
        settings.step,
        settings.belief_rate,
        control="law",
        precision=precision,
        initial_mean=(*settings.start, 0.0, 0.0),
    )


def closed_loop(settings: Arm, case: Case) -> cosim.Diagram:
    """Return the arm's FMU under a controller, moving from the start to one goal and then the other."""
    faults: list[cosim.Fault] = [cosim.Freeze(sensor=FAULTY, start=settings.fault_start)] if case.fault else []
    if case.told:  # a missing sample has the precision zero
        faults.append(cosim.Dropout(sensor=FAULTY, start=settings.fault_start))
    start = dict(zip(("q1_0", "q2_0"), settings.start, strict=True))
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("TwoLinkArm"), parameters=start),
        controller=controller(settings, case.precision),
        control=["torque1", "torque2"],
        measured=["q1", "q2", "dq1", "dq2"],
        sensors=cosim.Sensors(
            count=6,
            signals=4,
            function=cosim.arm_with_camera(_lengths(), settings.distortion),
            std=(settings.encoder_std,) * 4 + (settings.camera_std,) * 2,
        ),
        faults=faults,
        reference=[
            cosim.Step(settings.switch, after, before)
            for before, after in zip(settings.first_goal, settings.second_goal, strict=True)
        ],
    )


def learn_thresholds(
    settings: Arm, seed: int, jobs: int = 1, progress: Progress | None = None
) -> tuple[controllers.FittedThreshold, ...]:
    """Return a Chebyshev threshold for each modality, learned from the innovations of healthy runs of other seeds."""
    loop = closed_loop(settings, Case(controllers.FixedPrecision(), fault=False))
    prepare([loop], progress)
    own = seeds(seed, "arm thresholds", settings.threshold_runs)
    name = "controller.innovation"
    tasks = [partial(_signals, loop, settings.duration, [s], (name,)) for s in own]
    parts = in_parallel(tasks, jobs, progress, "Healthy runs")
    innovations = np.concatenate([result[name] for part in parts for result in part])
    rule = controllers.ChebyshevThreshold(settings.alpha)
    return tuple(rule.fit(innovations[:, list(group)]) for group in GROUPS)


def squared_errors(
    settings: Arm,
    loops: Mapping[Any, cosim.Diagram],
    of: Sequence[int],
    jobs: int,
    progress: Progress | None,
    what: str,
) -> dict[Any, Floats]:
    """Return for each loop the mean squared error of the belief about both joints in each run (runs x 2)."""
    prepare(list(loops.values()), progress)
    groups = chunks(of, CHUNK)
    tasks = [partial(_errors, settings, loop, group) for loop in loops.values() for group in groups]
    done = iter(in_parallel(tasks, jobs, progress, what))
    return {name: np.concatenate([next(done) for _ in groups]) for name in loops}


def detections(
    settings: Arm, case: Case, of: Sequence[int], jobs: int, progress: Progress | None = None
) -> dict[str, float]:
    """Return how soon the explicit detection finds the fault, and how often it sees one where there is none."""
    tasks = []
    for fault in (True, False):
        loop = closed_loop(settings, replace(case, fault=fault))
        prepare([loop], progress)
        tasks += [partial(_detected, settings, loop, group) for group in chunks(of, CHUNK)]
    parts = in_parallel(tasks, jobs, progress, "Detection")
    found = np.concatenate(parts)
    delays, healthy = found[: len(of), 0], found[len(of) :, 1]
    return {
        "delay_mean": float(np.mean(delays[np.isfinite(delays)])) if np.isfinite(delays).any() else float("nan"),
        "missed": int(np.isnan(delays).sum()),
        "healthy_share": float(healthy.mean()),
        "n": len(of),
    }


@cache
def _lengths() -> tuple[float, float]:
    """Return the lengths of the arm's links in metres, as the FMU has them."""
    plant: Any = cosim.FMU(fmus.path("TwoLinkArm"))
    return float(plant.start_value("L1")), float(plant.start_value("L2"))


def _signals(loop: cosim.Diagram, duration: float, of: Sequence[int], record: tuple[str, ...]) -> list[cosim.Result]:
    return list(repeat(loop, duration, of, record))


def _errors(settings: Arm, loop: cosim.Diagram, of: Sequence[int]) -> Floats:
    first, last = (round(t / settings.step) for t in settings.judged)
    rows = []
    for result in repeat(loop, settings.duration, of, BELIEF):
        truth = np.column_stack([result["plant.q1"], result["plant.q2"]])
        errors = (result["controller.x_hat"][:, :2] - truth)[first : last + 1]
        rows.append(np.mean(errors * errors, axis=0))
    return np.array(rows)


def _detected(settings: Arm, loop: cosim.Diagram, of: Sequence[int]) -> Floats:
    """Return for each run the delay of the faulty encoder's detection in seconds, and the share of time with a detection."""
    start, rows = round(settings.fault_start / settings.step), []
    for result in repeat(loop, settings.duration, of, ["controller.detected"]):
        flags = result["controller.detected"] > 0.5
        hits = np.flatnonzero(flags[start:, FAULTY])
        rows.append([hits[0] * settings.step if len(hits) else np.nan, flags.any(axis=1).mean()])
    return np.array(rows)


def _summary(errors: Floats) -> dict[str, dict[str, Any]]:
    """Return the mean over runs for each joint, with its 95 % confidence interval (Student's t)."""
    summary = {}
    for name, joint in (("faulty", FAULTY), ("healthy", HEALTHY)):
        values = errors[:, joint]
        half = student_t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
        mean = float(values.mean())
        summary[name] = {"mean": mean, "ci": [mean - float(half), mean + float(half)], "n": len(values)}
    return summary


def _trajectory(settings: Arm, loop: cosim.Diagram, seed: int) -> dict[str, Any]:
    """Return angles, belief and goal of one run."""
    names = (*BELIEF, "reference_0.y", "reference_1.y")
    result = loop.simulate(settings.duration, seed=seed, record=names, decimation=settings.every)
    return {
        "time": result.time.tolist(),
        "angle": np.column_stack([result["plant.q1"], result["plant.q2"]]).tolist(),
        "belief": result["controller.x_hat"][:, :2].tolist(),
        "goal": np.column_stack([result["reference_0.y"], result["reference_1.y"]]).tolist(),
    }


def _grid(settings: Arm, seed: int, jobs: int, progress: Progress | None) -> dict[str, list[dict[str, Any]]]:
    """Return the errors for other values of the settings that the paper does not publish."""
    none, learned = Case(controllers.FixedPrecision()), ("learning_rate", "lower_bound")
    cells: dict[str, list[dict[str, float]]] = {
        "none": [
            {"switch": s, "camera_precision": c} for s, c in product(settings.switches, settings.camera_precisions)
        ],
        "implicit": [
            dict(zip(learned, pair, strict=True)) for pair in product(settings.learning_rates, settings.lower_bounds)
        ],
    }
    loops: dict[Any, cosim.Diagram] = {}
    for kind, values in cells.items():
        for i, changes in enumerate(values):
            varied = replace(settings, **changes)  # type: ignore[arg-type]
            loops[kind, i] = closed_loop(varied, none if kind == "none" else Case(learning(varied)))
    own = seeds(seed, "arm grid", settings.grid_runs)
    errors = squared_errors(settings, loops, own, jobs, progress, "Unpublished settings")
    return {
        kind: [
            {**changes, "faulty": float(e[FAULTY]), "healthy": float(e[HEALTHY])}
            for i, changes in enumerate(values)
            for e in [errors[kind, i].mean(axis=0)]
        ]
        for kind, values in cells.items()
    }
