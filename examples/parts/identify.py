"""Identify a model of a motor from its answer to a pseudo-random signal, and test the model on a chirp.

``python -m bayesftc.examples.parts.identify`` prints the poles and how much of the chirp's answer the model explains.
"""

from __future__ import annotations

import control
import numpy as np

from bayesftc import controllers, cosim

DT = 0.05
MOTOR = cosim.TransferFunction([8.0], [1.0, 2.4, 4.0])
"""8 / (s^2 + 2.4 s + 4)."""


def experiment(excitation: cosim.Source) -> cosim.Diagram:
    """Return the motor with a test signal, and a sensor with noise and a resolution of 0.01."""
    diagram = cosim.Diagram(DT)
    voltage = diagram.add(excitation, "voltage")
    motor, noise = diagram.add(MOTOR, "motor"), diagram.add(cosim.Gaussian(std=0.02), "noise")
    sum_ = diagram.add(cosim.Sum("++"), "sum")
    sensor = diagram.add(cosim.Quantizer(0.01), "sensor")
    diagram.connect(voltage["y"], motor["u"])
    diagram.connect([motor["y"], noise["y"]], sum_["u"])
    diagram.connect(sum_["y"], sensor["u"])
    return diagram


def main() -> tuple[controllers.LinearModel, float]:
    """Return the model, and the share of the chirp's answer that it explains."""
    recording = experiment(cosim.PRBS(1.0, interval=4 * DT, order=9)).simulate(120.0, seed=1)
    model = controllers.LinearModel.identify(recording, inputs="voltage.y", outputs="sensor.y", order=2).model
    test = experiment(cosim.Chirp(1.0, begin=0.05, end=2.0, duration=30.0)).simulate(30.0, seed=2)
    answer = control.forced_response(model.to_control(), test.time, test["voltage.y"]).outputs
    explained = 1.0 - np.var(test["motor.y"] - answer) / np.var(test["motor.y"])
    poles = np.sort_complex(np.linalg.eigvals(model.matrix("A")))[
        :2
    ]  # the third, 1, is the constant mean of the recording
    true = np.sort_complex(np.exp(np.roots([1.0, 2.4, 4.0]) * DT))
    print(f"poles {poles.round(4)}, true {true.round(4)}; explains {100 * explained:.2f} % of the answer to the chirp")
    return model, float(explained)


if __name__ == "__main__":
    main()
