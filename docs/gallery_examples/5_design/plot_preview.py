"""
A goal that is known ahead
==========================

A path or a schedule is known before its time. With ``preview=20`` the controller knows the next 20 goals, and no longer lags
behind them.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo"))
figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
for preview, style in ((0, "C3--"), (20, "C0-")):
    controller = controllers.design(
        servo, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, acceptable_control=5.0, preview=preview
    )
    loop = cosim.closed_loop(
        plant=servo, controller=controller, control="voltage", measured="angle", sensors=cosim.Sensors(count=2, std=0.01),
        reference=cosim.Sine(amplitude=0.5, period=2.0),
    )
    result = loop.simulate(6.0, seed=1)
    if preview == 0:
        axis.plot(result.time, result["reference.y"], color="0.7", lw=4, label="goal")
    axis.plot(result.time, result["plant.angle"], style, label=f"preview={preview}")
axis.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(0, 6))
figure.legend(loc="outside upper center", ncols=3)
plt.show()
