"""
A learner of your own
=====================

A precision learner is a step function from the innovations to the covariance of the sensors. This one takes a moving average of
the squared innovations. Every controller accepts it as ``precision``.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.ops import maximum, minimum

NAN = float("nan")


def average(sample, trust, memory, settings, work):
    """The variance of a sensor is a moving average of its squared innovations, but at least that of the model."""
    for i in range(sample.y.shape[0]):
        for j in range(sample.y.shape[0]):
            trust.R[i, j] = 0.0
        nominal = sample.nominal[i, i]
        squared = minimum(sample.e[i] * sample.e[i], 1e6 * nominal)
        memory[i] = memory[i] + settings[0] * sample.present[i] * (squared - memory[i])
        trust.R[i, i] = maximum(memory[i], nominal)
        trust.used[i] = sample.present[i]
        trust.precision[i] = 1.0 / trust.R[i, i]
        trust.beta[i] = NAN
        trust.fault_probability[i] = NAN


@dataclass(frozen=True)
class MovingVariance(controllers.PrecisionLearner):
    """A learner whose memory has a variance for each sensor."""

    weight: float = 0.1  # of the newest sample

    def learner(self, model):
        return controllers.Learner(average, np.diag(model.matrix("sensor_covariance")).copy(), np.array([self.weight]))


model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, MovingVariance(), initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.Injection(sensor=0, magnitude=5.0, start=4.0, stop=8.0)], reference=20.0,
)
mine = loop.simulate(12.0, seed=1)
fixed = cosim.varied(loop, {"controller.precision": controllers.FixedPrecision()}).simulate(12.0, seed=1)

figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
axes[0].plot(fixed.time, fixed["plant.v"], "C3--", label="fixed precision")
axes[0].plot(mine.time, mine["plant.v"], "C0", label="MovingVariance")
axes[0].set_ylabel("speed (m/s)")
axes[0].legend()
for i in range(2):
    axes[1].plot(mine.time, mine["controller.precision"][:, i] ** -0.5, label=f"sensor {i}")
axes[1].set(xlabel="time (s)", ylabel="expected standard\ndeviation (m/s)", xlim=(0, 12))
axes[1].legend()
for axis in axes:
    axis.axvspan(4.0, 8.0, color="0.93", zorder=0)
plt.show()
