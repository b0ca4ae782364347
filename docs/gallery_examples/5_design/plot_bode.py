"""
Bode plot, margins and step response
====================================

A loop that is designed from an FMU has a Bode plot, margins and a step response, before anything runs. The loop is broken at
the input of the plant.
"""

import control
from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo"))
controller = controllers.design(
    servo, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, acceptable_error=0.1, acceptable_control=5.0
)
loop = cosim.closed_loop(
    plant=servo, controller=controller, control="voltage", measured="angle", sensors=cosim.Sensors(count=2, std=0.01),
    reference=1.0,
)
margins = loop.margins()
print(f"gain margin {margins.gain:.2f}, phase margin {margins.phase:.0f} degrees")
loop.bode()

# %%
# The step response of the closed loop:

info = loop.step_info()
print(f"settling time {info['SettlingTime']:.2f} s, overshoot {info['Overshoot']:.1f} %")
response = control.step_response(loop.linear().closed[0, 0], T=1.5)
figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
axis.plot(response.time, response.outputs.squeeze())
axis.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(0, 1.5))
plt.show()
