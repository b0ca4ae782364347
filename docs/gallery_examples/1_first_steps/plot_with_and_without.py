"""
With and without fault tolerance
================================

The same controller twice, on the same noise. With fixed precision it is a Kalman filter with a linear-quadratic law, and
follows the mean of both sensors. The default learns that one sensor is wrong.
"""

from matplotlib import pyplot as plt

from bayesftc import controllers, cosim, fmus

servo = cosim.FMU(fmus.path("PositionServo"))
learners = {"default": controllers.SwitchingPrecision(), "fixed precision": controllers.FixedPrecision()}
runs = {}
for name, precision in learners.items():
    controller = controllers.design(
        servo, measured="angle", actuated="voltage", sensors=2, sensor_std=0.01, noise={"load": 0.02},
        acceptable_error=0.1, acceptable_control=5.0, precision=precision,
    )
    loop = cosim.closed_loop(
        plant=servo, controller=controller, control="voltage", measured="angle", sensors=cosim.Sensors(count=2, std=0.01),
        noise={"load": cosim.Gaussian(std=0.02)}, faults=[cosim.Drift(sensor=0, start=3.0, slope=0.5)],
        reference=cosim.Sine(amplitude=0.5, period=4.0),
    )
    runs[name] = loop.simulate(10.0, seed=1)

figure, axis = plt.subplots(figsize=(8, 3.5), layout="constrained")
axis.axvspan(3.0, 10.0, color="0.93", label="sensor 0 drifts")
axis.plot(runs["default"].time, runs["default"]["reference.y"], color="0.6", lw=3, label="reference")
for name, style in (("fixed precision", "C3--"), ("default", "C0-")):
    axis.plot(runs[name].time, runs[name]["plant.angle"], style, label=name)
axis.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(0, 10))
axis.legend(loc="lower left")
plt.show()
