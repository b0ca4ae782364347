"""
Compare two controllers over seeds
==================================

``compare`` runs two loops on the same noise and the same faults. The difference of their errors has a confidence interval. The
difference is significant if the interval does not contain zero.
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
loops = {
    "Kalman filter": cosim.varied(loop, {"controller.precision": controllers.FixedPrecision()}),
    "gamma": cosim.varied(loop, {"controller.precision": controllers.GammaPrecision()}),
    "default": loop,
}
comparison = cosim.compare(loops, duration=10.0, seeds=20)
comparison.plot()
plt.show()

# %%
# The numbers:

comparison
