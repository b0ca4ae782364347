"""The engine of the car fails, or a speed sensor, or both: the detected faults, and the speed errors.

Run it with ``python -m bayesftc.examples.cruise_control.actuator_faults [runs]``. Each learner gets the same noise.
"""

import sys

import numpy as np

from bayesftc import cosim
from bayesftc.controllers import (
    BayesianController,
    FixedPrecision,
    InputOffset,
    LinearModel,
    LostEffect,
    StuckActuator,
    SwitchingPrecision,
)
from bayesftc.examples.cruise_control.cruise_control import cruise_control

START, STOP, DURATION = 6.0, 14.0, 20.0
ENGINE: dict[str | None, cosim.Fault] = {
    "1500 N more": cosim.Bias(magnitude=1500.0, start=START, stop=STOP),
    "0.4 of the force": cosim.GainFault(factor=0.4, start=START, stop=STOP),
    "stuck": cosim.Freeze(start=START, stop=STOP),
}
SENSOR: dict[str | None, cosim.Fault] = {"5 m/s more": cosim.Bias(magnitude=5.0, start=START, stop=STOP)}
SINE = cosim.Sine(amplitude=10.0, period=8.0, offset=20.0)
CASES = [(engine, None) for engine in ENGINE] + [(None, "5 m/s more"), ("1500 N more", "5 m/s more"), (None, None)]
MODES = (InputOffset, LostEffect, StuckActuator)
LEARNERS = {
    "FixedPrecision": FixedPrecision(),
    "SwitchingPrecision": SwitchingPrecision(),
    "with actuator modes": SwitchingPrecision(actuator_modes=[mode() for mode in MODES]),
}
OFTEN = SwitchingPrecision(actuator_modes=[mode(time_to_fault=60.0) for mode in MODES])
"""The same learner for engines that fail as often as sensors."""


def main(runs: int = 20) -> dict[tuple[str | None, str | None], dict[str, float]]:
    """Run all, print a table, and return the tracking errors (RMSE in m/s) during the fault."""
    print("Speed error (m/s, RMSE) during the fault, and time with an alarm of sensor 1 and of the engine (%)")
    print(f"{'engine':18}{'sensor 0':12}" + "".join(f"{name:>26}" for name in LEARNERS))
    table: dict[tuple[str | None, str | None], dict[str, float]] = {}
    for engine, sensor in CASES:
        row, cells = {}, []
        for name, precision in LEARNERS.items():
            diagram = cruise_control(precision, SENSOR.get(sensor), SINE, ENGINE.get(engine))
            signals = ["plant.v", "reference.y", "controller.fault_probability"]
            signals += ["controller.actuator_fault_probability"] * (name == "with actuator modes")
            results = [diagram.simulate(DURATION, seed=seed, record=signals) for seed in range(runs)]
            during = (results[0].time > START) & (results[0].time <= STOP)
            errors = [(r["plant.v"][1:] - r["reference.y"][:-1])[during[1:]] for r in results]
            row[name] = float(np.sqrt(np.mean(np.square(errors))))
            # Sensor 1, which is always healthy, and the engine.
            shares = [100 * np.mean([r[s][during, -1] > 0.5 for r in results]) for s in signals[2:]]
            cells.append(
                f"{row[name]:12.3f}" + "".join(f"{share:7.1f}" for share in shares) + "      -" * (2 - len(shares))
            )
        table[engine, sensor] = row
        print(f"{engine or 'healthy':18}{sensor or 'healthy':12}" + "".join(cells))
    return table


def insurance(runs: int = 20) -> dict[str, float]:
    """Print and return the cost of each learner on healthy runs: its tracking error relative to fixed precision."""
    errors = {}
    for name, precision in {**LEARNERS, "with frequent actuator faults": OFTEN}.items():
        diagram = cruise_control(precision, None, SINE)
        runs_of = [diagram.simulate(DURATION, seed=seed, record=["plant.v", "reference.y"]) for seed in range(runs)]
        errors[name] = float(
            np.mean([np.mean((r["plant.v"][1:] - r["reference.y"][:-1]) ** 2) for r in runs_of]) ** 0.5
        )
    price = {name: error / errors["FixedPrecision"] for name, error in errors.items()}
    print("Over fixed precision, healthy: " + ", ".join(f"{name} {ratio:.4f}" for name, ratio in price.items()))
    return price


def slow_engine(
    runs: int = 5, lags: tuple[float, ...] = (0.1, 0.3, 0.5), steps: int = 600, compiled: bool = True
) -> dict[float, dict[str, float]]:
    """Print and return the tracking errors with a lag (s) of the engine that the controller's model does not have."""
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
    goal = 20.0 + 5.0 * np.sin(0.016 * np.arange(steps + 1))
    table: dict[float, dict[str, float]] = {}
    for lag in lags:
        table[lag] = {}
        for name, precision in {
            **LEARNERS,
            "InputOffset alone": SwitchingPrecision(actuator_modes=[InputOffset()]),
        }.items():
            squares = []
            for seed in range(runs):
                noise, speed, force = np.random.default_rng(seed), 20.0, 0.0
                step = BayesianController(model, precision=precision, initial_mean=20.0).online(compiled=compiled)
                for k in range(steps):
                    out = step(y=list(speed + noise.normal(size=2)), goal=goal[k + 1 : k + 2])
                    squares.append((speed - goal[k]) ** 2)
                    force += 0.02 / lag * (out.u[0] - force)
                    speed = 0.999 * speed + 2e-4 * force + 0.001**0.5 * noise.normal()
            table[lag][name] = float(np.mean(squares) ** 0.5)
        print(
            f"Engine slower by {lag:g} s: " + ", ".join(f"{name} {error:.3g} m/s" for name, error in table[lag].items())
        )
    return table


if __name__ == "__main__":
    chosen = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    main(chosen)
    insurance(3 * chosen)
    slow_engine()
