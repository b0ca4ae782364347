"""A car under cruise control, built with ``control.interconnect``: its plant is a system of python-control, or an FMU.

``python -m bayesftc.examples.python_control_style.cruise_control [seconds]``. One of two speed sensors freezes from 6 to 14 s.
A PI controller that uses only this sensor does not notice it. The Bayesian controller in the same diagram uses both sensors
and learns their precisions.
"""

import sys

import control
import numpy as np

from bayesftc import controllers, cosim, fmus

B, M, DT = 5.0, 100.0, 0.02  # drag in N s/m, mass in kg, sample time in s
START, STOP = 6.0, 14.0


def car(t, x, u, params):
    """Return the speed after a step, under a driving force and a disturbance."""
    return [(1 - B / M * DT) * x[0] + DT / M * u[0] + u[1]]


PLANTS = {
    "nlsys": lambda: control.nlsys(
        car, name="car", inputs=["force", "disturbance"], outputs=["v"], states=["v"], dt=DT
    ),
    "FMU": lambda: cosim.FMU(fmus.path("CruiseControl")).to_control(DT, name="car"),  # the only line that changes
}


def pi_controller() -> list[control.InputOutputSystem]:
    """Return a PI controller that uses the first sensor."""
    error = control.summing_junction(["goal", "-samples[0]"], "error", name="comparison")
    law = control.ss([[1.0]], [[DT * 200.0]], [[1.0]], [[500.0]], DT, name="pi", inputs=["error"], outputs=["force"])
    return [error, law]


def bayesian_controller() -> list[control.InputOutputSystem]:
    """Return the Bayesian controller, which uses both sensors."""
    model = controllers.LinearModel([[1 - B / M * DT]], [[DT / M]], [[1], [1]], 1e-3, 1.0, DT)
    block = controllers.BayesianController(model, control_covariance=1e7)
    return [block.to_control(inputs={"y": "samples", "goal[0]": "goal"}, outputs={"u[0]": "force"})]


LAWS = {"PI": pi_controller, "Bayesian": bayesian_controller}


def cruise_control(plant: control.InputOutputSystem, law: str, seed: int = 1) -> control.InterconnectedSystem:
    """Return the closed loop, connected by the names of the signals."""
    noise = cosim.Gaussian(std=1e-3**0.5).to_control(DT, seed=seed, name="noise", outputs={"y": "disturbance"})
    sensors = cosim.Sensors(count=2, std=1.0).to_control(DT, seed=seed, inputs={"u": "v"}, outputs={"y": "reading"})
    fault = cosim.Freeze(sensor=0, start=START, stop=STOP, channels=2)
    failing = fault.to_control(DT, name="fault", inputs={"u": "reading"}, outputs={"y": "samples"})
    return control.interconnect(
        [plant, noise, sensors, failing, *LAWS[law]()], inputs=["goal"], outputs=["v", "force"], check_unused=False
    )


def main(duration: float = 20.0) -> dict[tuple[str, str], control.TimeResponseData]:
    """Run both controllers with both plants, and print the speed errors before and during the fault."""
    times = np.arange(round(duration / DT) + 1) * DT
    goal = 20.0 + 5.0 * np.sin(2 * np.pi / 8.0 * times)
    print("Speed error (m/s, RMSE)   before   while the sensor is frozen")
    runs = {}
    for law in LAWS:
        for kind, plant in PLANTS.items():
            loop = cruise_control(plant(), law)
            # The initial state of the blocks, such as the covariance of the belief; python-control's default is zero.
            run = control.input_output_response(loop, times, goal, X0=cosim.initial_state(loop))
            runs[law, kind] = run
            before, frozen = ((times > a) & (times <= b) for a, b in ((START / 2, START), (START, STOP)))
            errors = [np.sqrt(np.mean((run.outputs[0] - goal)[when] ** 2)) for when in (before, frozen) if when.any()]
            print(f"{law:10}{kind:8}" + "".join(f"{error:12.3f}" for error in errors))
    return runs


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
