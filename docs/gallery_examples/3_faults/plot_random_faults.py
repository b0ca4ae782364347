"""
Faults at random times
======================

``RandomFaults`` draws the times and the kinds of faults from the seed of the run. Two sensors fail again and again.
The controller gives the probability that each has failed.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
kinds = (cosim.Freeze(), cosim.Injection(magnitude=4.0), cosim.Drift(slope=1.0))
faults = [
    cosim.RandomFaults(kinds=kinds, mean_time_to_fault=10.0, mean_time_to_recovery=4.0, sensor=i, name=f"fault_{i}")
    for i in range(2)
]
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0), faults=faults,
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
result = loop.simulate(60.0, seed=3)

figure, axes = plt.subplots(3, 1, figsize=(8, 6), sharex=True, layout="constrained")
axes[0].plot(result.time, result["reference.y"], color="0.7", lw=3, label="reference")
axes[0].plot(result.time, result["plant.v"], label="true speed")
axes[0].set_ylabel("speed (m/s)")
axes[0].legend(loc="upper right", ncols=2)
for i in range(2):
    present = result[f"fault_{i}.active"] > 0.5
    axes[1 + i].fill_between(result.time, 0, 1, where=present, color=f"C{i + 2}", alpha=0.25, lw=0, label="fault present")
    axes[1 + i].plot(result.time, result["controller.fault_probability"][:, i], color=f"C{i + 2}", label="fault probability")
    axes[1 + i].set_ylabel(f"sensor {i}")
    axes[1 + i].legend(loc="upper right")
axes[2].set(xlabel="time (s)", xlim=(0, 60))
plt.show()
