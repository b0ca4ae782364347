"""
A water turbine with a sensor that becomes noisy
================================================

``HydroTurbine`` first loses power when its gate opens, because the water in the penstock must accelerate. One of its two
sensors of the power becomes noisy from 10 to 30 s. All quantities are per unit.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

plant = cosim.FMU(fmus.path("HydroTurbine"))
controller = controllers.design(
    plant, measured="power", actuated="command", sensors=2, sensor_std=0.01, noise={"head": 0.01},
    acceptable_error=0.05, acceptable_control=0.1, u_min=0.2, u_max=1.0,
)
loop = cosim.closed_loop(
    plant=plant, controller=controller, control="command", measured="power", sensors=cosim.Sensors(count=2, std=0.01),
    noise={"head": cosim.Gaussian(mean=1.0, std=0.01)},
    faults=[cosim.NoiseIncrease(sensor=0, start=10.0, stop=30.0, std=0.3)],
    reference=cosim.Step(time=5.0, before=0.6, after=0.7),
)
result = loop.simulate(40.0, seed=1)
animation = result.animate(frames=40, speed=5.0)
animation

# %%
# The gate opens at 5 s, and the power first falls:

result.plot_signals(["plant.gate", "plant.flow", "plant.power"])
plt.show()
