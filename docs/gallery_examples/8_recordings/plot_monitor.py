"""
Find the faulty sensor in a recording
=====================================

Without a controller, the monitor estimates a quantity from recorded sensors, and reports which of them failed, how and when.
Here one of three level sensors jumps at 30 s, and one has a lower rate.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers
from bayesftc.monitoring import Signal, align, monitor_recording

rng = np.random.default_rng(0)
t = 0.1 * np.arange(600)
level = 5 + np.cumsum(0.02 * rng.standard_normal(600))
readings = level[:, None] + 0.1 * rng.standard_normal((600, 3))
readings[300:, 1] += 0.5
signals = {f"sensor {i}": Signal(t, readings[:, i]) for i in range(3)}
signals["sensor 2"] = Signal(t[::5], readings[::5, 2])

recording = align(signals, inputs={}, dt=0.1)
model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 0.02**2, 0.1**2, dt=0.1)
found = monitor_recording(recording, model, initial_mean=5.0)
for event in found.events:
    print(event)
found.plot()
plt.show()
