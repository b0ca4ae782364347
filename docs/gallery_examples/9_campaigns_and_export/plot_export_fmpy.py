"""
Export the controller, and run it in FMPy
=========================================

The controller becomes an FMU that needs no Python. Here FMPy, another tool, runs it: it gives the samples of two sensors to
the FMU and reads the force. A C compiler is needed.
"""

import tempfile
from pathlib import Path

import fmpy
import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, controllers.GammaPrecision(), initial_mean=20.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.Drift(sensor=0, start=4.0, slope=1.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
file = cosim.export_fmu(loop, Path(tempfile.mkdtemp()) / "controller.fmu", blocks="controller")
print(cosim.verify_fmu(file, loop, duration=10.0, seed=1).verdict())

# %%
# FMPy replays the recorded samples. The force is the same as in the loop.

result = loop.simulate(10.0, seed=1, record=["*", "controller.y", "controller.goal"])
samples, goal = result["controller.y"], result["controller.goal"].reshape(-1)
rows = list(zip(result.time, samples[:, 0], samples[:, 1], goal))
inputs = np.array(rows, dtype=[("time", float), ("y[0]", float), ("y[1]", float), ("goal[0]", float)])
played = fmpy.simulate_fmu(
    str(file), start_time=0.0, stop_time=10.0, step_size=0.02, output_interval=0.02, input=inputs, output=["u[0]"],
    use_event_mode=False,
)

figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
axis.plot(result.time, result["controller.u"][:, 0], color="0.7", lw=3, label="in the loop")
axis.plot(played["time"], played["u[0]"], "C0", lw=0.9, label="the FMU in FMPy")
axis.set(xlabel="time (s)", ylabel="force (N)", xlim=(0, 10))
axis.legend()
plt.show()
