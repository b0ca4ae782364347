"""
A fault of an actuator
======================

From 4 s on the engine pushes with 1500 N more than the controller asks for. A controller with an actuator mode infers this
and compensates. A controller that knows only sensor faults blames its sensors.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)


def run(precision):
    loop = cosim.closed_loop(
        plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(model, precision, initial_mean=20.0, u_min=-5000.0, u_max=5000.0),
        control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
        input_faults={"force": [cosim.Bias(magnitude=1500.0, start=4.0)]}, reference=20.0,
    )
    return loop.simulate(10.0, seed=1)


both = run(controllers.SwitchingPrecision(actuator_modes=[controllers.InputOffset()]))
sensors_only = run(controllers.SwitchingPrecision())
both.plot()

# %%
# The speed with both controllers:

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.axvspan(4.0, 10.0, color="0.93", label="1500 N too much")
axis.plot(sensors_only.time, sensors_only["plant.v"], "C3--", label="sensor faults only")
axis.plot(both.time, both["plant.v"], "C0", label="with an actuator mode")
axis.axhline(20.0, color="0.5", lw=0.8, label="reference")
axis.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0, 10))
axis.legend()
plt.show()
