"""
Every learner on the same fault
===============================

Each precision learner controls the car on the same noise, while sensor 0 drifts from 4 to 9 s. ``FixedPrecision`` is the
Kalman filter. The paper's learners are ``PointMassPrecision``, ``GammaPrecision`` and ``WishartPrecision``.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
learners = [
    controllers.FixedPrecision(),
    controllers.PointMassPrecision(),
    controllers.GammaPrecision(),
    controllers.WishartPrecision(),
    controllers.EFFDI(),
    controllers.SERFDI(),
    controllers.VariationalBayesKF(),
    controllers.StudentTUpdate(),
    controllers.WeightedLikelihood(),
    controllers.ExplicitDetection(),
    controllers.SwitchingPrecision(),
]
names = [type(learner).__name__ for learner in learners]
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.Drift(sensor=0, start=4.0, stop=9.0, slope=1.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
runs = [cosim.varied(loop, {"controller.precision": learner}).simulate(12.0, seed=1) for learner in learners]

figure, axes = plt.subplots(len(runs), 1, figsize=(8, 12), sharex=True, sharey=True, layout="constrained")
for axis, name, run in zip(axes, names, runs):
    precision = run["controller.precision"]
    axis.axvspan(4.0, 9.0, color="0.93")
    with np.errstate(divide="ignore"):
        for i in range(2):
            axis.semilogy(run.time, np.maximum(precision[:, i], 1e-4), f"C{i}", lw=1.1, label=f"sensor {i}")
    error = (run["plant.v"][1:] - run["reference.y"][:-1])[(run.time[1:] >= 4.0) & (run.time[1:] < 9.0)]
    axis.set_title(f"{name}: tracking error {np.sqrt(np.mean(error**2)):.2f} m/s", fontsize=9, loc="left")
axes[0].legend(loc="lower left", ncols=2, fontsize=8)
axes[-1].set(xlabel="time (s)", xlim=(0, 12), ylim=(5e-5, 20))
figure.supylabel("precision (s²/m²), at least 1e-4")
plt.show()
