"""
No steady error on a hill
=========================

From 5 s on, a hill takes 1000 N. The plain controller stays 1.8 m/s too slow. A model with a disturbance estimates the hill
and compensates for it, as an integrator does.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

plain = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
axis.axvspan(5.0, 40.0, color="0.93", label="hill")
for name, model in (("plain model", plain), ("with a disturbance", plain.with_disturbance(100.0))):
    loop = cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(model, initial_mean=[20.0] + [0.0] * (model.states - 1)),
        control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
        input_faults={"force": [cosim.Bias(magnitude=-1000.0, start=5.0)]}, reference=20.0,
    )
    result = loop.simulate(40.0, seed=1)
    axis.plot(result.time, result["plant.v"], label=name)
axis.axhline(20.0, color="0.4", lw=0.8, label="reference")
axis.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0, 40))
axis.legend(loc="lower right", ncols=2)
plt.show()
