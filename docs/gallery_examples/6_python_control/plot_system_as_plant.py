"""
A system of python-control as plant
===================================

``StateSpace`` makes a plant of a system of python-control, and ``LinearModel.from_control`` the model of its controller. The
result converts to a time response of python-control.
"""

import control
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim

motor = control.ss([[-1.0]], [[2.0]], [[1.0]], 0, inputs=["voltage"], outputs=["speed"])
model = controllers.LinearModel.from_control(motor, dt=0.1, sensors=2, process_covariance=1e-4, sensor_covariance=0.01)
loop = cosim.closed_loop(
    plant=cosim.StateSpace(motor), controller=controllers.BayesianController(model, u_min=-5.0, u_max=5.0),
    control="voltage", measured="speed", sensors=cosim.Sensors(count=2, std=0.1),
    faults=[cosim.Freeze(sensor=0, start=5.0)], reference=cosim.Step(time=1.0, after=1.0),
)
result = loop.simulate(10.0, seed=1)
response = result.to_control(["plant.speed", "controller.u"])
response.plot()
plt.gcf().set_size_inches(8, 4)
plt.show()
