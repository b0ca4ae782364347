"""The whole loop written with fmpy, NumPy and filterpy, without this package."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.bench._slave import Unpacked
from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Setting:
    """The parameters of the experiment, the same for both loops."""

    step: float = 0.02
    a: float = 0.999
    b: float = 2e-4
    process_variance: float = 0.001
    sensor_std: float = 1.0
    fault_start: float = 6.0
    fault_stop: float = 14.0
    forgetting: float = 0.95
    prior_shape: float = 2.0
    start_speed: float = 20.0
    amplitude: float = 5.0
    period: float = 8.0
    offset: float = 20.0


COLUMNS = 8
"""Number of values recorded at each step: speed, both samples, force, estimate, both precisions, goal."""


def user_loop(car: Unpacked, steps: int, noise: Floats, setting: Setting) -> Floats:
    """Make `steps` steps and return the recording; each row of ``noise`` has the disturbance and both sensors' noise.

    It is written for speed, as far as Python allows: bound methods, precomputed noise and goal, reused arrays.
    """
    s = setting
    kalman = _filter(s)
    update, predict = kalman.update, kalman.predict
    disturbance = (np.sqrt(s.process_variance) * noise[:, 0]).tolist()
    first, second = (s.sensor_std * noise[:, 1]).tolist(), (s.sensor_std * noise[:, 2]).tolist()
    times = np.arange(steps + 1) * s.step
    goal = (s.offset + s.amplitude * np.sin(2 * np.pi / s.period * times)).tolist()
    times = times.tolist()
    start, stop = round(s.fault_start / s.step), round(s.fault_stop / s.step)
    rho, nominal = s.forgetting, s.sensor_std**2
    shape = s.prior_shape
    rate0 = rate1 = s.prior_shape * nominal
    shape_back, rate_back = (1 - rho) * s.prior_shape, (1 - rho) * s.prior_shape * nominal
    sample, covariance, control = np.empty((2, 1)), np.zeros((2, 2)), np.empty((1, 1))
    recording = np.empty((steps + 1, COLUMNS))
    speed_reference = [car.references["v"]]
    input_references = [car.references["force"], car.references["disturbance"]]
    held = 0.0
    with car.slave(v0=s.start_speed) as slave:
        get_real, set_real, do_step = slave.getReal, slave.setReal, slave.doStep
        for k in range(steps + 1):
            v = get_real(speed_reference)[0]
            y0, y1 = v + first[k], v + second[k]
            if start <= k < stop:
                y0 = held
            else:
                held = y0
            expected = kalman.x[0, 0]
            shape = rho * shape + shape_back + 0.5
            rate0 = rho * rate0 + rate_back + 0.5 * (y0 - expected) ** 2
            rate1 = rho * rate1 + rate_back + 0.5 * (y1 - expected) ** 2
            covariance[0, 0], covariance[1, 1] = rate0 / shape, rate1 / shape
            sample[0, 0], sample[1, 0] = y0, y1
            update(sample, R=covariance)
            estimate = kalman.x[0, 0]
            force = (goal[k] - s.a * estimate) / s.b
            recording[k] = v, y0, y1, force, estimate, shape / rate0, shape / rate1, goal[k]
            if k < steps:
                set_real(input_references, [force, disturbance[k]])
                do_step(times[k], s.step)
                control[0, 0] = force
                predict(control)
    return recording


def _filter(s: Setting) -> Any:
    from filterpy.kalman import KalmanFilter

    kalman = KalmanFilter(dim_x=1, dim_z=2, dim_u=1)
    kalman.x, kalman.P = np.array([[s.start_speed]]), np.eye(1)
    kalman.F, kalman.B, kalman.H = np.array([[s.a]]), np.array([[s.b]]), np.ones((2, 1))
    kalman.Q, kalman.R = np.array([[s.process_variance]]), s.sensor_std**2 * np.eye(2)
    return kalman
