"""A motor drives a load through a shaft, and the load is heavier than the controller's model says, with friction and a delay.

Run it with ``python -m bayesftc.examples.wrong_motor.drive [runs]``. By fault it prints the error of the belief about the load,
and how long healthy sensors are blamed, for a controller without an estimated load, with one on the control, and with one on the
control and process noise at the load. All have the same noise.
"""

import sys
from collections.abc import Sequence
from typing import Any

import control
import numpy as np

from bayesftc import controllers, cosim

MOTOR, LOAD, STIFFNESS, DAMPING, DRAG = 0.01, 0.02, 16.84, 0.02, 0.05
"""Inertias in kg m², stiffness in N m/rad, damping of shaft and motor in N m s/rad: a resonance of 8 Hz."""
HEAVIER, FRICTION, LIMIT, STEP = 1.25, 0.1, 4.0, 0.005
"""Factor of the real load, Coulomb friction and limit of the torque in N m, seconds between samples. The torque is a step
late."""

MEASURED, COUNT = ["motor", "load", "speed"], [2, 1, 1]
SENSORS = cosim.Sensors(COUNT, [0.0005] * 3 + [0.05], resolution=[0.001, 0.001, 0.006, 0.0])
DESIGNS: dict[str, dict[str, Any]] = {
    "none": {},
    "disturbance=True": {"disturbance": True},
    "and noise at_load": {"disturbance": True, "noise": {"torque": 0.05, "at_load": 0.1}},
}
FAULTS: dict[str, Sequence[cosim.Fault]] = {
    "healthy": (),
    "an encoder of the motor slips": (cosim.Bias(sensor=0, start=4.0, magnitude=0.05),),
    "the encoder of the load slips": (cosim.Bias(sensor=2, start=4.0, magnitude=0.05),),
    "the tachometer drifts": (cosim.Drift(sensor=3, start=3.0, slope=0.3),),
}


def model() -> control.StateSpace:
    """Return what the controller knows."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1] = np.array([-STIFFNESS, -DAMPING - DRAG, STIFFNESS, DAMPING]) / MOTOR
    A[3] = np.array([STIFFNESS, DAMPING, -STIFFNESS, -DAMPING]) / LOAD
    B = np.array([[0, 0], [1 / MOTOR, 0], [0, 0], [0, 1 / LOAD]])
    C = np.eye(4)[[0, 2, 1]]
    return control.ss(A, B, C, 0, inputs=["torque", "at_load"], outputs=MEASURED)


def real() -> cosim.StateSpace:
    """Return the real drive."""

    def rates(t: float, x: Any, u: Any, params: Any) -> list[float]:
        shaft = STIFFNESS * (x[0] - x[2]) + DAMPING * (x[1] - x[3])
        torque = min(max(u[0], -LIMIT), LIMIT) - FRICTION * np.tanh(x[1] / 0.05)
        return [x[1], (torque - shaft - DRAG * x[1]) / MOTOR, x[3], shaft / (HEAVIER * LOAD)]

    def outputs(t: float, x: Any, u: Any, params: Any) -> list[float]:
        return [x[0], x[2], x[1]]

    drive = control.nlsys(rates, outputs, inputs=["torque"], outputs=MEASURED, states=4)
    return cosim.StateSpace(drive, feedthrough=False)


def make_loop(design: str, fault: str) -> cosim.Diagram:
    """Return the loop of the real drive."""
    controller = controllers.design(
        model(),
        measured=MEASURED,
        actuated="torque",
        goal="load",
        dt=STEP,
        sensors=COUNT,
        sensor_std=SENSORS.error_std,
        acceptable_error=0.05,
        acceptable_control=2.0,
        u_min=-LIMIT,
        u_max=LIMIT,
        **DESIGNS[design],
    )
    return cosim.closed_loop(
        real(),
        controller,
        control="torque",
        measured=MEASURED,
        sensors=SENSORS,
        faults=FAULTS[fault],
        input_faults={"torque": [cosim.Delay(delay=STEP, initial=0.0)]},
        reference=cosim.Sine(amplitude=1.0, period=4.0),
    )


def main(
    seeds: int = 5, designs: Sequence[str] = tuple(DESIGNS), faults: Sequence[str] = tuple(FAULTS)
) -> dict[tuple[str, str], tuple[float, float]]:
    """Print the table; return error in mrad and share of blame by design and fault."""
    print("Belief about the load in mrad (root mean square error), share of time in which a healthy sensor is blamed")
    print(f"{'':32}" + "".join(f"{name:>26}" for name in designs))
    table = {}
    for fault in faults:
        row = f"{fault:32}"
        for design in designs:
            loop, runs = make_loop(design, fault), []
            reading = loop["controller"].block.measurement_matrix[2]  # type: ignore[attr-defined]
            faulty = [each.sensor for each in FAULTS[fault]]
            for seed in range(seeds):
                result = loop.simulate(10.0, seed=seed)
                errors = result["controller.x_hat"] @ reading - result["plant.load"]
                blamed = np.delete(result["controller.fault_probability"] > 0.5, faulty, axis=1).mean(axis=0).max()
                runs.append((1e3 * float(np.sqrt(np.mean(errors**2))), float(blamed)))
            mean = np.mean(runs, axis=0)
            table[design, fault] = float(mean[0]), float(mean[1])
            row += f"{mean[0]:18.2f}{mean[1]:8.1%}"
        print(row)
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
