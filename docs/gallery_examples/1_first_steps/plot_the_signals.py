"""
Signals of a run
================

A result is a mapping from names of signals to arrays. It converts to pandas and xarray, and draws any of its signals.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02)
loop = cosim.closed_loop(
    plant=cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
    controller=controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0),
    control="force", measured="v", sensors=cosim.Sensors(count=2, std=1.0),
    faults=[cosim.Freeze(sensor=1, start=6.0, stop=14.0)],
    reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
)
result = loop.simulate(20.0, seed=1)
result

# %%
# One signal is an array with a row for each step. A table has a column for each number.

print(result["controller.fault_probability"].shape)
table = result.to_pandas()
table[["plant.v", "reference.y", "controller.u[0]"]].describe().round(2)

# %%
# ``plot_signals`` draws the signals that you name, with a panel for each unit.

result.plot_signals(["reference.y", "plant.v", "controller.u", "controller.fault_probability"])
plt.show()
