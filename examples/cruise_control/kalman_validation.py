"""With fixed precision the controller's belief equals a Kalman filter's: a comparison with filterpy, step by step.

``python -m bayesftc.examples.cruise_control.kalman_validation [seconds]``. filterpy is independent of this package: it gets
only the recorded samples and controls. With learned precision it also gets the sensor covariance of each step, so all but
the learning is checked.
"""

import sys

from bayesftc import controllers
from bayesftc.controllers import BayesianController, FixedPrecision, GammaPrecision, KalmanCheck, PrecisionLearner
from bayesftc.examples.cruise_control.cruise_control import cruise_control


def validate(precision: PrecisionLearner, duration: float) -> KalmanCheck:
    """Return the largest differences between the belief and filterpy's over a run with a frozen sensor."""
    loop = cruise_control(precision)
    result = loop.simulate(duration, seed=1)
    controller = loop["controller"].block
    assert isinstance(controller, BayesianController)
    return controllers.check_kalman(result, controller)


def main(duration: float = 20.0) -> dict[str, KalmanCheck]:
    """Compare both and print the largest differences."""
    checks = {}
    for precision in (FixedPrecision(), GammaPrecision(forgetting=0.95)):
        name = type(precision).__name__
        check = checks[name] = validate(precision, duration)
        print(
            f"{name:16} over {check.steps} samples: mean differs by at most {check.mean_absolute:.1e} m/s "
            f"({check.mean_difference:.1e} relative), variance by {check.covariance_absolute:.1e} "
            f"({check.covariance_difference:.1e} relative)"
        )
    return checks


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
