"""Control any FMU with the Bayesian controller without a model: excite it, fit a first-order model, close the loop.

``python -m bayesftc.examples.cruise_control.couple_external_fmu`` uses the shipped car;
``... plant.fmu --control valve --measured level --around 2.0 --shake 0.1`` uses yours. ``bayesftc inspect plant.fmu`` lists
the names. A first-order model is enough for a tank, an oven or a car. Other plants need a model of higher order.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from bayesftc import controllers, cosim, fmus


def fit(plant: cosim.FMU, arguments: argparse.Namespace) -> tuple[float, float, float]:
    """Return a, b and the residual's variance of ``y(t+1) = a y(t) + b u(t) + c``, from a run with a random control."""
    experiment = cosim.Diagram(dt=arguments.dt)
    node = experiment.add(plant, "plant")
    shaker = experiment.add(cosim.Gaussian(std=arguments.shake), "shaker")
    experiment.connect(shaker["y"], node[arguments.control])
    run = experiment.simulate(500 * experiment.step, seed=0)
    y, u = run[f"plant.{arguments.measured}"], run["shaker.y"]
    columns = np.column_stack([y[:-1], u[:-1], np.ones(len(y) - 1)])
    fitted, *_ = np.linalg.lstsq(columns, y[1:], rcond=None)
    return float(fitted[0]), float(fitted[1]), float(np.var(y[1:] - columns @ fitted))


def main(argv: Sequence[str] | None = None) -> cosim.Result:
    """Fit, close the loop with two sensors, the first with an offset from half-time on, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("fmu", nargs="?", default=str(fmus.path("CruiseControl")), help="the FMU's file")
    parser.add_argument("--control", default="force", help="input that the controller drives")
    parser.add_argument("--measured", default="v", help="output that the sensors measure")
    parser.add_argument("--around", type=float, default=20.0, help="value to hold")
    parser.add_argument("--shake", type=float, default=500.0, help="standard deviation of the control in the first run")
    parser.add_argument("--noise", type=float, default=0.5, help="standard deviation of each sensor")
    parser.add_argument("--dt", default="0.02", help="sample time in seconds")
    parser.add_argument("--duration", type=float, default=20.0, help="seconds")
    arguments = parser.parse_args(argv)

    plant = cosim.FMU(arguments.fmu)
    a, b, variance = fit(plant, arguments)
    y, u = arguments.measured, arguments.control
    print(f"{plant.default_name}: {y}(t+1) = {a:.6f} {y}(t) + {b:.6g} {u}(t) + ...")
    model = controllers.LinearModel(
        A=[[a]],
        B=[[b]],
        C=[[1], [1]],
        process_covariance=variance + 1e-4 * arguments.noise**2,
        sensor_covariance=arguments.noise**2,
        dt=arguments.dt,
    )
    loop = cosim.closed_loop(
        plant=plant,
        # An estimated disturbance covers what the fit does not have: a constant load, an operating point.
        controller=controllers.BayesianController(model.with_disturbance((0.01 * arguments.noise / b) ** 2)),
        control=arguments.control,
        measured=arguments.measured,
        sensors=cosim.Sensors(count=2, std=arguments.noise),
        faults=[cosim.Injection(sensor=0, magnitude=10 * arguments.noise, start=arguments.duration / 2)],
        reference=arguments.around,
    )
    result = loop.simulate(arguments.duration, seed=1)
    value, half = result[f"plant.{y}"], len(result.time) // 2
    halves = {"both sensors right": value[half // 2 : half], "one sensor wrong": value[half + half // 2 :]}
    for what, part in halves.items():
        print(f"{what}: {y} = {np.mean(part):.3f} +- {np.std(part):.3f}, reference {arguments.around:g}")
    return result


if __name__ == "__main__":
    main()
