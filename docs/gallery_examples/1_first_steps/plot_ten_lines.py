"""
Ten lines
=========

A servo has two sensors of its angle. One of them drifts away from 3 s on. The controller detects the drift, ignores this
sensor and continues to follow the reference.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo"))
controller = controllers.design(
    servo, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, noise={"load": 0.02},
    acceptable_error=0.1, acceptable_control=5.0,
)
loop = cosim.closed_loop(
    plant=servo, controller=controller, control="voltage", measured="angle", sensors=cosim.Sensors(count=2, std=0.01),
    noise={"load": cosim.Gaussian(std=0.02)}, faults=[cosim.Drift(sensor=0, start=3.0, slope=0.5)],
    reference=cosim.Sine(amplitude=0.5, period=4.0),
)
result = loop.simulate(10.0, seed=1)
result.plot()
plt.show()
