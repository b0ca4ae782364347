"""
Any other plant
===============

A plant without a picture of its own has a scale for each quantity. Here a heated tank has three thermometers, and one of them
loses its samples.
"""

import control

from bayesftc import controllers, cosim

tank = control.ss([[-0.02]], [[0.01]], [[1.0]], 0, inputs=["heat"], outputs=["temperature"])
model = controllers.LinearModel.from_control(tank, dt=1.0, sensors=3, process_covariance=1e-3, sensor_covariance=0.04)
loop = cosim.closed_loop(
    plant=cosim.StateSpace(tank), controller=controllers.BayesianController(model, u_min=0.0, u_max=100.0),
    control="heat", measured="temperature", sensors=cosim.Sensors(count=3, std=0.2),
    faults=[cosim.Dropout(sensor=2, start=60.0, stop=120.0), cosim.Bias(sensor=0, magnitude=4.0, start=100.0)],
    reference=cosim.Step(time=10.0, after=20.0),
)
result = loop.simulate(200.0, seed=1)
animation = result.animate(frames=40, speed=20.0)
animation
