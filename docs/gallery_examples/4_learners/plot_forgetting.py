"""
How fast to forget
==================

``GammaPrecision`` forgets old samples. The forgetting factor is a compromise: a small one notices a fault soon, a large one
has a quieter precision. Sensor 0 becomes noisier from 5 to 10 s.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, controllers.GammaPrecision(), initial_mean=20.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.NoiseIncrease(sensor=0, std=3.0, start=5.0, stop=10.0)], reference=20.0,
)
figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
axis.axvspan(5.0, 10.0, color="0.93", label="sensor 0 is noisier")
for forgetting, style in ((0.8, "C1:"), (0.95, "C0-"), (0.99, "C2--")):
    result = cosim.varied(loop, {"controller.precision.forgetting": forgetting}).simulate(15.0, seed=1)
    axis.plot(result.time, result["controller.precision"][:, 0] ** -0.5, style, label=f"forgetting {forgetting}")
axis.plot([0, 5, 5, 10, 10, 15], [1, 1, 10**0.5, 10**0.5, 1, 1], "k", lw=1.0, label="true")
axis.set(xlabel="time (s)", ylabel="standard deviation of sensor 0 (m/s)", xlim=(0, 15), ylim=(0, 6))
axis.legend(ncols=2, fontsize=8)
plt.show()
