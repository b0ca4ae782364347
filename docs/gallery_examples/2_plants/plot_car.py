"""
A car with a speed sensor that freezes
======================================

``CruiseControl`` is a car on a level road, with two sensors of its speed. Sensor 0 freezes from 6 to 14 s. The controller
then uses sensor 1 alone.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    noise={"disturbance": cosim.Gaussian(std=0.001**0.5)}, faults=[cosim.Freeze(sensor=0, start=6.0, stop=14.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
result = loop.simulate(20.0, seed=1)
animation = result.animate(frames=40, speed=2.0)
animation

# %%
# The figure of the whole run:

result.plot()
plt.show()
