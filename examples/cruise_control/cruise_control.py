"""A car under cruise control with two speed sensors, one of which freezes: five ways to set the precision of each sensor.

Run it with ``python -m bayesftc.examples.cruise_control.cruise_control [seconds]``. All controllers get the same noise, so
the rows differ only because of the learners.
"""

import sys

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import EFFDI, SERFDI, FixedPrecision, GammaPrecision, SwitchingPrecision
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals

LEARNERS = (FixedPrecision(), EFFDI(), SERFDI(), GammaPrecision(forgetting=0.95), SwitchingPrecision())
"""The last one is the default."""


FREEZE = cosim.Freeze(sensor=0, start=6.0, stop=14.0)
SINE = cosim.Sine(amplitude=5.0, period=8.0, offset=20.0)


def cruise_control(
    precision: controllers.PrecisionLearner,
    fault: cosim.Fault | None = FREEZE,
    reference: cosim.Source = SINE,
    engine: cosim.Fault | None = None,
) -> cosim.Diagram:
    """Return the closed loop of the paper's second experiment with a precision learner.

    `fault` is a fault of a sensor, `engine` a fault of the engine.
    """
    b, m, dt = 5.0, 100.0, 0.02  # drag (N s/m), mass (kg), sample time (s)
    model = controllers.LinearModel(
        A=[[1 - b / m * dt]], B=[[dt / m]], C=[[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=dt
    )
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(model, precision=precision, initial_mean=20.0),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=0.001**0.5)},
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[fault] if fault else [],
        input_faults={"force": engine} if engine else None,
        reference=reference,
    )


def main(duration: float = 20.0, seed: int = 1) -> dict[str, float]:
    """Run all, print a table, and return the tracking errors (RMSE in m/s) while the sensor is frozen."""
    print(f"{'speed error (m/s, RMSE)':24} {'before':>8} {'frozen':>8} {'after':>8}")
    frozen = {}
    for precision in LEARNERS:
        loop = cruise_control(precision)
        result = loop.simulate(duration, seed=seed)
        error = figures(loop_signals(loop, result)).tracking["v"]
        name = type(precision).__name__
        print(f"{name:24} {error.before:8.3f} {error.during:8.3f} {error.after:8.3f}")
        frozen[name] = error.during
    return frozen


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
