"""
A fault of your own
===================

A fault is a function that returns the faulty value, and a dataclass with its settings. Here the counter of a sensor begins at
zero again when it reaches 15 m/s.
"""

from dataclasses import dataclass

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.ops import floor


def overflown(sample, held, age, chance, noise, settings):
    return sample - settings[0] * floor(sample / settings[0])


@dataclass(frozen=True, kw_only=True)
class Overflow(cosim.Fault):
    """The sensor's counter begins at zero again when it has reached `limit`."""

    limit: float
    value = staticmethod(overflown)


model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 10.0}),
    controller=controllers.BayesianController(model, initial_mean=10.0, u_min=-2000.0, u_max=2000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0), faults=[Overflow(sensor=0, limit=15.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=12.0),
)
result = loop.simulate(16.0, seed=1)
result.plot()
plt.show()
