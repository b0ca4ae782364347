"""The engine of the car fails, or one of its speed sensors, or both: who is blamed, and how the car keeps its speed.

Run it with ``python -m bayesftc.examples.cruise_control.actuator_faults [runs]``. Each learner gets the same noise.
"""

import sys

import numpy as np

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import FixedPrecision, InputOffset, LostEffect, StuckActuator, SwitchingPrecision

START, STOP, DURATION = 6.0, 14.0, 20.0
ENGINE = {
    "1500 N more": cosim.Bias(magnitude=1500.0, start=START, stop=STOP),
    "0.4 of the force": cosim.GainFault(factor=0.4, start=START, stop=STOP),
    "stuck": cosim.Freeze(start=START, stop=STOP),
}
SENSOR = {"5 m/s more": cosim.Bias(magnitude=5.0, start=START, stop=STOP)}
CASES = [(engine, None) for engine in ENGINE] + [(None, "5 m/s more"), ("1500 N more", "5 m/s more"), (None, None)]
LEARNERS = {
    "FixedPrecision": FixedPrecision(),
    "SwitchingPrecision": SwitchingPrecision(),
    "with actuator modes": SwitchingPrecision(actuator_modes=(InputOffset(), LostEffect(), StuckActuator())),
}


def loop(precision: controllers.PrecisionLearner, engine: str | None, sensor: str | None) -> cosim.Diagram:
    """Return the closed loop with a fault of the engine, or of sensor 0, or of both."""
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], 0.001, 1.0, dt=0.02)
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(model, precision=precision, initial_mean=20.0),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=0.001**0.5)},
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[SENSOR[sensor]] if sensor else [],
        input_faults={"force": ENGINE[engine]} if engine else None,
        reference=cosim.Sine(amplitude=10.0, period=8.0, offset=20.0),
    )


def main(runs: int = 20) -> dict[tuple[str | None, str | None], dict[str, float]]:
    """Run all, print a table, and return the tracking errors (RMSE in m/s) while something has failed."""
    print("Speed error (m/s, RMSE) during the fault, and how often sensor 1 and the engine are blamed (% of the time)")
    print(f"{'engine':18}{'sensor 0':12}" + "".join(f"{name:>26}" for name in LEARNERS))
    table: dict[tuple[str | None, str | None], dict[str, float]] = {}
    for engine, sensor in CASES:
        row, said = {}, []
        for name, precision in LEARNERS.items():
            diagram = loop(precision, engine, sensor)
            signals = ["plant.v", "reference.y", "controller.fault_probability"]
            signals += ["controller.actuator_fault_probability"] * (name == "with actuator modes")
            results = [diagram.simulate(DURATION, seed=seed, record=signals) for seed in range(runs)]
            during = (results[0].time > START) & (results[0].time <= STOP)
            errors = [(r["plant.v"][1:] - r["reference.y"][:-1])[during[1:]] for r in results]
            row[name] = float(np.sqrt(np.mean(np.square(errors))))
            # Sensor 1, which is always healthy, and the engine.
            shares = [100 * np.mean([r[s][during, -1] > 0.5 for r in results]) for s in signals[2:]]
            said.append(
                f"{row[name]:12.3f}" + "".join(f"{share:7.1f}" for share in shares) + "      -" * (2 - len(shares))
            )
        table[engine, sensor] = row
        print(f"{engine or 'healthy':18}{sensor or 'healthy':12}" + "".join(said))
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
