"""
Is a fault probability of 0.9 right?
====================================

If the probabilities are right, nine of ten sensors with a probability of 0.9 have failed. The reliability diagram compares
probabilities with outcomes in a long run with random faults.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
kinds = (cosim.Freeze(), cosim.Injection(magnitude=4.0), cosim.Drift(slope=1.0))
faults = [
    cosim.RandomFaults(kinds=kinds, mean_time_to_fault=20.0, mean_time_to_recovery=5.0, sensor=i, name=f"fault_{i}")
    for i in range(2)
]
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0), faults=faults,
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
result = loop.simulate(2000.0, seed=1)
probability = result["controller.fault_probability"]
faulty = np.column_stack([result[f"fault_{i}.active"] > 0.5 for i in range(2)])
judged = cosim.reliability(probability.ravel(), faulty.ravel())
print(f"calibration error {judged.calibration_error:.3f}")
judged.plot()
plt.show()
