"""
A campaign
==========

Many runs of one loop: a grid of masses of the car and slopes of the drift, with several seeds each, on all cores. The model of
the controller stays that of 100 kg. The maps show what an unknown mass costs.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.Drift(sensor=0, start=4.0, slope=1.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
learners = {"fixed": controllers.FixedPrecision(), "default": controllers.SwitchingPrecision()}
grid = {
    "plant.m": [60.0, 80.0, 100.0, 125.0, 160.0],
    "drift_0.slope": [0.25, 0.5, 1.0, 2.0, 4.0],
    "controller.precision": learners,
}
rmse = cosim.RMSE("plant.v", "reference.y", shift=1, start=4.0, name="rmse")
table = cosim.Campaign(loop, duration=10.0, grid=grid, seeds=4, metrics=[rmse]).run().table
print(len(table), "runs")

figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), sharey=True, layout="constrained")
for axis, name in zip(axes, learners):
    chosen = table[table["controller.precision"] == name]
    means = chosen.pivot_table("rmse", "drift_0.slope", "plant.m")
    image = axis.imshow(means, origin="lower", vmin=0.0, vmax=table["rmse"].quantile(0.95), cmap="viridis", aspect="auto")
    axis.set(xticks=range(5), xticklabels=means.columns, yticks=range(5), yticklabels=means.index, title=name)
    axis.set_xlabel("mass (kg)")
    for i in range(5):
        for j in range(5):
            axis.text(j, i, f"{means.iloc[i, j]:.2f}", ha="center", va="center", color="w", fontsize=8)
axes[0].set_ylabel("slope of the drift (m/s²)")
figure.colorbar(image, ax=axes, label="RMS tracking error (m/s)", extend="max")
plt.show()
