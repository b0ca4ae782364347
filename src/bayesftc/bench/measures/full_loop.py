"""The whole loop (noise, two sensors, a fault, precision learning) and a fast loop with fmpy and filterpy."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import CAR, Unpacked, unpacked_fmu
from bayesftc.bench._user_loop import COLUMNS, Setting, user_loop
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.precision.base import PrecisionLearner
    from bayesftc.cosim.diagram.diagram import Diagram

SETTING = Setting()
EXPERIMENT = 1_000
"""Steps of one run of the experiment: 20 s, with the fault in the middle."""

RECORD = ("plant.v", "freeze_0.y", "controller.u", "controller.x_hat", "controller.precision", "reference.y")
"""The signals of the eight columns that both loops record."""

NOISE = (("disturbance_noise.noise", 0), ("sensors.noise", 0), ("sensors.noise", 1))
"""Stream and channel of the random numbers of the disturbance and of both sensors."""


def full_diagram(
    setting: Setting = SETTING,
    precision: PrecisionLearner | None = None,
    sensors: int = 2,
    *,
    isolate: bool = False,
) -> Diagram:
    """Return the loop as a diagram; by default with the learner of the user's loop, and the FMU in process."""
    from bayesftc import controllers, cosim, fmus

    s = setting
    model = controllers.LinearModel(
        [[s.a]],
        [[s.b]],
        [[1.0]] * sensors,
        process_covariance=s.process_variance,
        sensor_covariance=s.sensor_std**2,
        dt=s.step,
    )
    if precision is None:
        precision = controllers.GammaPrecision(forgetting=s.forgetting, prior_shape=s.prior_shape)
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path(CAR), parameters={"v0": s.start_speed}, isolate=isolate),
        controller=controllers.BayesianController(model, precision=precision, initial_mean=s.start_speed),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=s.process_variance**0.5)},
        sensors=cosim.Sensors(count=sensors, std=s.sensor_std),
        faults=[cosim.Freeze(sensor=0, start=s.fault_start, stop=s.fault_stop)],
        reference=cosim.Sine(amplitude=s.amplitude, period=s.period, offset=s.offset),
    )


def engine_recording(diagram: Diagram, steps: int, seed: int) -> Floats:
    """Run the compiled engine and return the eight columns."""
    result = diagram.simulate(steps * diagram.step, seed=seed, record=RECORD)
    return np.column_stack([result[name] for name in RECORD])


def own_noise(steps: int, seed: int) -> Floats:
    """Return the engine's random numbers, in the order of the user's loop."""
    from bayesftc.cosim.random import numbers

    return np.column_stack([numbers(seed, name, steps + 1, channel=channel) for name, channel in NOISE])


def tracking_error(recording: Floats) -> float:
    """Return the root mean square of the speed minus the goal of the step before."""
    return float(np.sqrt(np.mean((recording[1:, 0] - recording[:-1, -1]) ** 2)))


def measure(quick: bool = False) -> Section:
    """Compare the results of both loops, then measure them in turns."""
    # A million steps record 64 MB. With far more, the speed of the system's memory allocation would be measured.
    fast, slow, rounds, runs = (20_000, 300, 2, 2) if quick else (1_000_000, 20_000, 11, 100)
    diagram = full_diagram()
    with unpacked_fmu() as car:
        same = np.abs(
            engine_recording(diagram, EXPERIMENT, 1) - user_loop(car, EXPERIMENT, own_noise(EXPERIMENT, 1), SETTING)
        )
        errors = [tracking_error(engine_recording(diagram, EXPERIMENT, seed)) for seed in range(runs)]
        users = [tracking_error(user_loop(car, EXPERIMENT, _noise(EXPERIMENT, seed), SETTING)) for seed in range(runs)]
        rates = in_turns({"engine": lambda: _engine_rate(diagram, fast), "user": lambda: _user_rate(car, slow)}, rounds)
    rate, label, either = "steps/s", f"compiled engine, {COLUMNS} signals recorded", "this or 4 million steps/s"
    over, difference, note_on_ratio = (
        ratios(rates["engine"], rates["user"]),
        [float(same[:, 0].max())],
        "differs from 1 only by the noise",
    )
    ratio = [float(np.mean(errors) / np.mean(users))]
    return Section(
        "full_loop",
        "The whole loop with fault and precision learning",
        (
            Figure("engine", label, rate, rates["engine"], at_least=4e6, either="speed"),
            Figure("user", "loop with fmpy, NumPy and filterpy", rate, rates["user"]),
            Figure("engine_over_user", "engine / user's loop", "", over, 100.0, either="speed", note=either),
            Figure("difference", "largest difference of the speeds, same noise", "m/s", difference, at_most=1e-9),
            Figure("engine_rmse", f"tracking error, engine, {runs} runs of 20 s", "m/s", errors),
            Figure("user_rmse", f"tracking error, user's loop, {runs} runs of 20 s", "m/s", users, note="own noise"),
            Figure("rmse_ratio", "ratio of the mean tracking errors", "", ratio, 0.9, 1.1, note=note_on_ratio),
        ),
    )


def _noise(steps: int, seed: int) -> Floats:
    return np.random.default_rng(seed).standard_normal((steps + 1, 3))


def _engine_rate(diagram: Diagram, steps: int) -> float:
    started = time.perf_counter()
    diagram.simulate(steps * diagram.step, seed=1, record=RECORD)
    return steps / (time.perf_counter() - started)


def user_rate(steps: int) -> float:
    """Return the steps per second of the user's loop."""
    with unpacked_fmu() as car:
        return _user_rate(car, steps)


def _user_rate(car: Unpacked, steps: int) -> float:
    started = time.perf_counter()
    user_loop(car, steps, _noise(steps, 1), SETTING)
    return steps / (time.perf_counter() - started)
