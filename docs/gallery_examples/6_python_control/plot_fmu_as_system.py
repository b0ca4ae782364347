"""
An FMU in python-control
========================

``to_control`` makes a nonlinear system of an FMU. python-control simulates it, linearises it and draws its Bode plot.
"""

import control
import numpy as np
from matplotlib import pyplot as plt

from bayesftc import cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo")).to_control(0.01, name="servo")
time = np.arange(201) * 0.01
inputs = np.vstack([np.where(time < 1.0, 2.0, -2.0), np.zeros_like(time)])  # voltage (V), load (N.m)
response = control.input_output_response(servo, time, inputs, X0=cosim.initial_state(servo))
figure, axes = plt.subplots(2, 1, figsize=(8, 4), sharex=True, layout="constrained")
axes[0].plot(time, inputs[0], "C3")
axes[0].set_ylabel("voltage (V)")
axes[1].plot(response.time, response.outputs[0])
axes[1].set(xlabel="time (s)", ylabel="angle (rad)", xlim=(0, 2))

# %%
# The linear system about rest, from the voltage to the angle:

linear = control.linearize(servo, cosim.initial_state(servo), [0.0, 0.0])
plt.figure(figsize=(8, 5))
control.bode_plot(linear[0, 0], omega=np.logspace(-1, 2, 200), title="from the voltage to the angle")
plt.show()
