"""The same loop three times: with `closed_loop`, block by block, and with plants from python-control.

``python -m bayesftc.examples.cruise_control.block_diagram [seconds]`` prints the differences of the runs.
"""

import sys

import control
import numpy as np

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.block import Block

B, M, DT = 5.0, 100.0, 0.02

controller = controllers.BayesianController(
    controllers.LinearModel([[1 - B / M * DT]], [[DT / M]], [[1], [1]], 0.001, 1.0, DT),
    initial_mean=20.0,
)


def by_hand(plant: Block) -> cosim.Diagram:
    """Add every block and connect every port; `plant` has inputs force and disturbance and the output v."""
    diagram = cosim.Diagram(dt=DT)
    reference = diagram.add(cosim.Sine(amplitude=5.0, period=8.0, offset=20.0), "reference")
    car = diagram.add(plant, "plant")
    sensors = diagram.add(cosim.Sensors(count=2, std=1.0), "sensors")
    freeze = diagram.add(cosim.Freeze(sensor=0, start=6.0, stop=14.0, channels=2))
    control_block = diagram.add(controller, "controller")
    noise = diagram.add(cosim.Gaussian(std=0.001**0.5), "disturbance_noise")

    diagram.connect(car["v"], sensors["u"])
    diagram.connect(sensors["y"], freeze["u"])
    diagram.connect(freeze["y"], control_block["y"])
    diagram.connect(reference["y"], control_block["goal"])
    diagram.connect(control_block["u"], car["force"])
    diagram.connect(noise["y"], car["disturbance"])
    return diagram


def in_one_call(plant: Block) -> cosim.Diagram:
    """Make the same diagram with `closed_loop`."""
    return cosim.closed_loop(
        plant=plant,
        controller=controller,
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=0.001**0.5)},
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.Freeze(sensor=0, start=6.0, stop=14.0)],
        reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
    )


def control_plant() -> control.StateSpace:
    """Return the car as a discrete state space of python-control, with named signals."""
    return control.ss(
        [[1 - B / M * DT]], [[DT / M, 1.0]], [[1.0]], 0, DT, name="car", inputs=["force", "disturbance"], outputs=["v"]
    )


def interconnected_plant() -> control.InputOutputSystem:
    """Return the car with a driver and a motor, connected by ``control.interconnect``: 0.5 V/N and 2 N/V."""
    motor = control.ss([], [], [], [[2.0]], DT, name="motor", inputs=["voltage"], outputs=["force"])
    driver = control.ss([], [], [], [[0.5]], DT, name="driver", inputs=["request"], outputs=["voltage"])
    plant = control.interconnect([driver, motor, control_plant()], inputs=["request", "disturbance"], outputs=["v"])
    plant.set_inputs(["force", "disturbance"])  # names of the ports
    return plant


def main(duration: float = 20.0) -> dict[str, float]:
    """Run all, and return the largest difference of the car's speed from that in the FMU's loop, in m/s."""
    car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})
    first = in_one_call(car).simulate(duration, seed=1)
    loops = {
        "FMU, block by block": by_hand(car),
        "python-control plant": in_one_call(cosim.StateSpace(control_plant(), initial=[20.0])),
        "python-control interconnection": by_hand(cosim.StateSpace(interconnected_plant(), initial=[20.0])),
    }
    differences = {}
    for name, loop in loops.items():
        speed = loop.simulate(duration, seed=1)["plant.v"]
        differences[name] = float(np.max(np.abs(speed - first["plant.v"])))
        print(f"{name:32} differs from closed_loop with the FMU by at most {differences[name]:.1e} m/s")
    return differences


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
