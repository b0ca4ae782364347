"""
A fault when something happens
==============================

A fault may start on a condition instead of at a time. Here a sensor loses a tenth of its reading for two seconds, each time
the car has become faster than 23 m/s.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=0.3),
    faults=[cosim.GainFault(sensor=0, factor=0.9, start=cosim.when("plant.v", ">", 23.0), duration=2.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
result = loop.simulate(20.0, seed=1)
result.plot()
plt.show()
