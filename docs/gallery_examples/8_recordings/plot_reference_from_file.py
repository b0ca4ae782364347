"""
A reference and a disturbance from a file
=========================================

``Table.read`` takes a signal from a column of a CSV file: here the reference speed, and the slope of the road as a
disturbance.
"""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

file = Path(tempfile.mkdtemp()) / "drive.csv"
time = np.arange(0.0, 21.0, 1.0)
pd.DataFrame({"time": time, "speed": 20 + 4 * np.sin(time / 3), "slope": 0.02 * (time > 10)}).to_csv(file, index=False)

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=0.09, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(
        model.with_disturbance(100.0), initial_mean=[20.0, 0.0], u_min=-4000.0, u_max=4000.0
    ),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=0.3),
    reference=cosim.Table.read(file, "speed"),
    noise={"disturbance": cosim.Table.read(file, "slope", interpolate=False)},
)
result = loop.simulate(20.0, seed=1)
result.plot_signals(["reference.y", "plant.v", "controller.u", "disturbance_noise.y"])
plt.show()
