"""
A pendulum on a cart with a sensor that jumps
=============================================

``CartPendulum`` falls without control. Two sensors measure the position of the cart and two the angle of the pendulum. One
sensor of the angle jumps by 0.1 rad at 5 s.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

plant = cosim.FMU(fmus.path("CartPendulum"))
controller = controllers.design(
    plant, measured=["position", "angle"], goal="position", actuated="force", sensors=4, sensor_std=0.005,
    noise={"torque": 0.02}, acceptable_error=0.1, acceptable_control=5.0, u_min=-15.0, u_max=15.0,
)
loop = cosim.closed_loop(
    plant=plant, controller=controller, control="force", measured=["position", "angle"],
    sensors=cosim.Sensors(count=4, signals=2, std=0.005), noise={"torque": cosim.Gaussian(std=0.02)},
    faults=[cosim.Injection(sensor=1, start=5.0, stop=9.0, magnitude=0.1)],
    reference=cosim.Step(time=2.0, after=0.3),
)
result = loop.simulate(12.0, seed=1)
animation = result.animate(frames=40)
animation

# %%
# Sensors are numbered as the loop measures: 0 and 2 measure the position, 1 and 3 the angle.

result.plot()
plt.show()
