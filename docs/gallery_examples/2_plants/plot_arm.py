"""
A robot arm with a joint sensor that sticks
===========================================

``TwoLinkArm`` has two links in a vertical plane and a torque at each joint. Each joint has two encoders, and one encoder of
the first joint sticks. The model includes a disturbance, because gravity changes with the pose.
"""

import numpy as np
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

arm = cosim.FMU(fmus.path("TwoLinkArm"))
controller = controllers.design(
    arm, measured=["q1", "q2"], actuated=["torque1", "torque2"], sensors=4, sensor_std=0.01, dt=0.01,
    noise={"torque1": 1.0, "torque2": 1.0}, disturbance=1.0, acceptable_error=0.02, acceptable_control=1000.0,
)
loop = cosim.closed_loop(
    plant=arm, controller=controller, control=["torque1", "torque2"], measured=["q1", "q2"],
    sensors=cosim.Sensors(count=4, signals=2, std=0.01),
    faults=[cosim.Stuck(sensor=0, at=-1.0, start=3.0)],
    reference=[
        cosim.Sine(amplitude=0.6, period=4.0, offset=0.6 - np.pi / 2, phase=-np.pi / 2), cosim.Sine(amplitude=0.6, period=2.0),
    ],
)
result = loop.simulate(8.0, seed=1)
animation = result.animate(frames=40)
animation

# %%
# The path of the arm's end:

figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
axis.plot(result["plant.x"], result["plant.y"])
axis.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="the end of the arm")
plt.show()
