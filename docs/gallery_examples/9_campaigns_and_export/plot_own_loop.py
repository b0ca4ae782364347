"""
The controller in a loop of your own
====================================

``online`` makes a function of the controller: samples in, control out. It works beside any simulation, or on hardware. Here the
plant is three lines of Python, and the second sensor sends nothing from 3 to 5 s.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
step = controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0).online()

rng, speed, rows = np.random.default_rng(1), 20.0, []
for k in range(400):
    samples = speed + rng.standard_normal(2)
    second = None if 150 <= k < 250 else samples[1]
    out = step(y=[samples[0], second], goal=[20.0 + 3.0 * (k > 100)])
    rows.append((k * 0.02, speed, out.x_hat[0], out.P[0, 0] ** 0.5, out.u[0]))
    speed = 0.999 * speed + 2e-4 * out.u[0] + 0.03 * rng.standard_normal()  # your plant

time, speeds, estimate, deviation, force = np.array(rows).T
figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
axes[0].fill_between(
    time, estimate - 2 * deviation, estimate + 2 * deviation, color="C0", alpha=0.25, lw=0, label="estimate ± 2 std"
)
axes[0].plot(time, estimate, "C0", label="estimate")
axes[0].plot(time, speeds, "k", lw=0.9, label="true speed")
axes[0].axvspan(3.0, 5.0, color="0.93", zorder=0, label="sensor 1 is silent")
axes[0].set_ylabel("speed (m/s)")
axes[0].legend(loc="lower right", fontsize=8)
axes[1].plot(time, force)
axes[1].set(xlabel="time (s)", ylabel="force (N)", xlim=(0, 8))
plt.show()
