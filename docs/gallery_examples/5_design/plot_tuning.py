"""
Faster or gentler
=================

The design has two numbers for the compromise: the error and the control that are equally bad. A larger acceptable control
makes the loop faster.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo"))
figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
for acceptable_control in (0.5, 2.0, 10.0):
    controller = controllers.design(
        servo, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, acceptable_error=0.1,
        acceptable_control=acceptable_control, u_min=-12.0, u_max=12.0,
    )
    loop = cosim.closed_loop(
        plant=servo, controller=controller, control="voltage", measured="angle", sensors=cosim.Sensors(count=2, std=0.01),
        reference=cosim.Step(time=0.5, after=1.0),
    )
    result = loop.simulate(4.0, seed=1)
    axes[0].plot(result.time, result["plant.angle"], label=f"{acceptable_control:g} V for 0.1 rad")
    axes[1].plot(result.time, result["controller.u"][:, 0])
axes[0].plot(result.time, result["reference.y"], color="0.6", lw=0.8, label="reference")
axes[0].set_ylabel("angle (rad)")
axes[0].legend()
axes[1].set(xlabel="time (s)", ylabel="voltage (V)", xlim=(0, 4))
plt.show()
