"""A robot's wheel follows a sine, while its motor is weaker, stronger, slower or faster than the controller's model says.

Run it with ``python -m bayesftc.examples.wrong_motor.study [runs]``. By sensors, motor and fault it prints the errors of belief
and position, and how long healthy sensors are blamed, for controllers without and with an estimated load. All have equal noise.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean

import control
import numpy as np

from bayesftc import controllers, cosim

STD, NOISE, DURATION = {"position": 0.01, "speed": 0.05}, {"w": 0.05}, 30.0
"""Noise of a sensor in m and m/s, process noise in V, and seconds of a run."""
MOTORS = {
    "as modelled": {},
    "20 % weaker": {"gain": 0.8},
    "25 % stronger": {"gain": 1.25},
    "30 % slower": {"time": 0.65},
    "25 % faster": {"time": 0.375},
    "late by 0.1 s": {"lag": 0.1},
}
SENSORS = {"2 + 2 speed": (2, 2), "3": (3,), "2": (2,), "1 + 1 speed": (1, 1)}
"""Numbers of position sensors, and of speed sensors if there are any."""
FAULTS = {
    "healthy": (),
    "drift": (cosim.Drift(sensor=0, start=8.0, stop=20.0, slope=0.03),),
    "freeze": (cosim.Freeze(sensor=0, start=8.0, stop=20.0),),
}
LOADS = (None, True)


def wheel(gain: float = 1.0, time: float = 0.5, lag: float = 0.0) -> control.StateSpace:
    """Return a wheel: the voltage (V) moves its position (m); w is a disturbance of the voltage."""
    A, B = [[0, 1], [0, -1 / time]], [[0, 0], [gain / time, 1 / time]]
    if lag:
        A = [[0, 1, 0], [0, -1 / time, gain / time], [0, 0, -1 / lag]]
        B = [[0, 0], [0, 1 / time], [1 / lag, 0]]
    outputs = np.eye(2, len(A))
    return control.ss(A, B, outputs, 0, inputs=["voltage", "w"], outputs=list(STD))


@dataclass(frozen=True)
class Outcome:
    """Means over the runs of a row."""

    belief: float  # root mean square error of the belief of the position, in standard deviations of a sensor
    tracking: float  # root mean square error of the position, in m
    blamed: float  # share of the time in which the most blamed of the healthy sensors is blamed


def make_loop(
    motor: str, count: Sequence[int], faults: Sequence[cosim.Fault], disturbance: bool | None
) -> cosim.Diagram:
    """Return the loop of a motor, with a controller for the motor as modelled."""
    measured = list(STD)[: len(count)]
    std = [STD[name] for name, number in zip(measured, count, strict=True) for _ in range(number)]
    controller = controllers.design(
        wheel(),
        measured=measured,
        actuated="voltage",
        goal="position",
        dt=0.02,
        sensors=count,
        sensor_std=std,
        noise=NOISE,
        acceptable_error=0.05,
        acceptable_control=1.0,
        disturbance=disturbance,
    )
    return cosim.closed_loop(
        wheel(**MOTORS[motor]),
        controller,
        control="voltage",
        measured=measured,
        sensors=cosim.Sensors(count, std),
        noise={name: cosim.Gaussian(std) for name, std in NOISE.items()},
        faults=faults,
        reference=cosim.Sine(amplitude=1.0, period=6.0),
    )


def outcome(
    motor: str, count: Sequence[int], faults: Sequence[cosim.Fault], disturbance: bool | None, seeds: int
) -> Outcome:
    """Return what a loop reaches on the seeds 0, 1, ..."""
    loop, runs = make_loop(motor, count, faults, disturbance), []
    reading = loop["controller"].block.measurement_matrix[0]  # type: ignore[attr-defined]
    for seed in range(seeds):
        result = loop.simulate(DURATION, seed=seed)
        position = result["plant.position"]
        healthy = result["controller.fault_probability"][:, len(faults) :]  # a fault is one of the first sensor
        blamed = (healthy > 0.5).mean(axis=0).max()
        errors = (result["controller.x_hat"] @ reading - position) / STD["position"], position - result["reference.y"]
        runs.append((*(float(np.sqrt(np.mean(error**2))) for error in errors), float(blamed)))
    return Outcome(*map(mean, zip(*runs, strict=True)))


def main(
    seeds: int = 20,
    sensors: Sequence[str] = tuple(SENSORS),
    motors: Sequence[str] = tuple(MOTORS),
    faults: Sequence[str] = tuple(FAULTS),
) -> dict[tuple[str, str, str, bool | None], Outcome]:
    """Print the table; return its rows by sensors, motor, fault and load."""
    print(f"{'':39}{'without a load':>32}{'disturbance=True':>32}")
    print(f"{'sensors':12}{'motor':15}{'fault':12}" + f"{'belief (sd)':>12}{'tracking':>10}{'blamed':>10}" * len(LOADS))
    table = {}
    for count in sensors:
        for motor in motors:
            for fault in faults:
                row = f"{count:12}{motor:15}{fault:12}"
                for load in LOADS:
                    reached = outcome(motor, SENSORS[count], FAULTS[fault], load, seeds)
                    table[count, motor, fault, load] = reached
                    row += f"{reached.belief:12.2f}{reached.tracking:10.3f}{reached.blamed:10.1%}"
                print(row)
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
