"""
Every kind of sensor fault
==========================

A healthy sensor and the same sensor with each kind of fault, from 4 to 8 s. A fault is a block between the sensor and the
controller, so that plant and controller do not know of it.
"""

from matplotlib import pyplot as plt

from bayesftc import cosim

window = {"channels": 1, "start": 4.0, "stop": 8.0}
faults = [
    cosim.Freeze(**window),
    cosim.Stuck(at=0.0, **window),
    cosim.Injection(magnitude=0.5, amplitude=0.5, period=1.0, **window),
    cosim.Bias(magnitude=1.0, **window),
    cosim.Drift(slope=0.5, **window),
    cosim.GainFault(factor=0.3, **window),
    cosim.Dropout(**window),
    cosim.Spikes(magnitude=2.0, probability=0.05, **window),
    cosim.NoiseIncrease(std=0.5, **window),
    cosim.NoiseGrowth(slope=0.3, **window),
    cosim.Clipping(low=-0.5, high=0.5, **window),
    cosim.Rounding(resolution=0.5, **window),
    cosim.Lag(time_constant=0.5, **window),
    cosim.Delay(delay=0.5, **window),
    cosim.RandomFaults(mean_time_to_fault=1.0, mean_time_to_recovery=1.0, **window),
]
diagram = cosim.Diagram(dt=0.02)
wave, sensor = diagram.add(cosim.Sine(amplitude=1.0, period=4.0), "wave"), diagram.add(cosim.Sensors(count=1, std=0.05), "sensor")
diagram.connect(wave["y"], sensor["u"])
for fault in faults:
    block = diagram.add(fault, type(fault).__name__)
    diagram.connect(sensor["y"], block["u"])
result = diagram.simulate(12.0, seed=3)

figure, axes = plt.subplots(-(-len(faults) // 3), 3, figsize=(9, 9), sharex=True, sharey=True, layout="constrained")
for axis, fault in zip(axes.flat[: len(faults)], faults, strict=True):
    name = type(fault).__name__
    axis.axvspan(4.0, 8.0, color="0.93")
    axis.plot(result.time, result["sensor.y"], color="0.7", lw=0.8, label="healthy sensor")
    axis.plot(result.time, result[f"{name}.y"], color="C3", lw=0.9, label="faulty sensor")
    axis.set_title(name, fontsize=9)
    axis.set_ylim(-2.5, 3.2)
axes[0, 0].legend(fontsize=7, loc="upper left", ncols=2)
figure.supxlabel("time (s)")
figure.supylabel("reading")
plt.show()
