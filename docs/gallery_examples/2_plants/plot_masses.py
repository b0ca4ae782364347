"""
Two masses with a sensor that drifts
====================================

``TwoMasses`` has two masses on a rail with a spring between them. A force moves the first mass, and the second one has the
goal. A sensor of the second mass drifts from 4 to 9 s.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

plant = cosim.FMU(fmus.path("TwoMasses"))
controller = controllers.design(
    plant, measured=["x1", "x2"], goal="x2", actuated="force1", sensors=4, sensor_std=0.01, noise={"force2": 0.5},
    acceptable_error=0.05, acceptable_control=2.0, u_min=-10.0, u_max=10.0,
)
loop = cosim.closed_loop(
    plant=plant, controller=controller, control="force1", measured=["x1", "x2"],
    sensors=cosim.Sensors(count=4, signals=2, std=0.01), noise={"force2": cosim.Gaussian(std=0.5)},
    faults=[cosim.Drift(sensor=1, start=4.0, stop=9.0, slope=0.1)],
    reference=cosim.Step(time=2.0, after=0.5),
)
result = loop.simulate(12.0, seed=1)
animation = result.animate(frames=40)
animation

# %%
# The spring oscillates a little after the step:

result.plot_signals(["plant.x1", "plant.x2", "plant.v1", "plant.v2"])
plt.show()
