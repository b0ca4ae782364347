"""
Which fault is it?
==================

The default learner infers how a sensor has failed: the probability of each kind, the size and the onset. A sensor drifts by
1 m/s per second from 5 s on.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=0.09, dt=0.02)
controller = controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), controller=controller,
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=0.3),
    faults=[cosim.Drift(sensor=0, start=5.0, slope=1.0)], reference=20.0,
)
result = loop.simulate(10.0, seed=1)
kinds = ("Healthy", *controller.fault_kinds)
probability = result["controller.mode_probability"][:, 0, :]

figure, axes = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
for k in np.argsort(-probability[result.time > 5.0].max(axis=0))[:5]:
    axes[0].plot(result.time, probability[:, k], label=kinds[k])
axes[0].set_ylabel("probability")
axes[0].legend(title="kind", loc="center left", fontsize=8)
axes[1].plot(result.time, result["controller.fault_size"][:, 0], label="inferred")
axes[1].plot(result.time, np.maximum(result.time - 5.0, 0.0), "k--", lw=0.8, label="true deviation (m/s)")
axes[1].set_ylabel("size")
axes[1].legend()
axes[2].plot(result.time, result["controller.fault_onset"][:, 0], label="inferred")
axes[2].axhline(5.0, color="k", ls="--", lw=0.8, label="true")
axes[2].set(xlabel="time (s)", ylabel="onset (s)", xlim=(0, 10))
axes[2].legend()
plt.show()
