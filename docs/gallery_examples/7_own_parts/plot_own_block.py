"""
A block of your own
===================

A block is a step function and a dataclass that declares its ports and state. The same text runs in Python, compiled, and as C.
Here a block holds the peak of a signal, and the peak fades.
"""

from dataclasses import dataclass

from matplotlib import pyplot as plt

from bayesftc import cosim
from bayesftc.cosim.ops import maximum


def peak(u, highest, y, fading):
    highest[0] = maximum(u[0], fading[0] * highest[0])
    y[0] = highest[0]


@dataclass(frozen=True)
class PeakHold(cosim.Block):
    """The largest value so far, which fades by a share of itself each second."""

    rate: float = 0.3  # 1/s

    inputs = (cosim.Port("u"),)
    outputs = (cosim.Port("y"),)

    def define(self, step):
        return cosim.Definition(peak, state={"highest": 0.0}, parameters={"fading": 1.0 - self.rate * float(step)})


diagram = cosim.Diagram(dt=0.01)
wave, hold = diagram.add(cosim.Chirp(amplitude=1.0, begin=0.2, end=1.5, duration=10.0)), diagram.add(PeakHold())
diagram.connect(wave["y"], hold["u"])
result = diagram.simulate(10.0)

figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.plot(result.time, result["chirp.y"], color="0.6", label="signal")
axis.plot(result.time, result["peakhold.y"], "C3", label="held peak")
axis.set(xlabel="time (s)", ylabel="value", xlim=(0, 10))
axis.legend(loc="lower right")
plt.show()
