"""The closed loop of the arm experiment: the arm's FMU, its sensors, the frozen encoder, and the controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.types import Kernel
from bayesftc.reproduce.settings import Arm

FAULTY, HEALTHY = 0, 1
"""The joint whose encoder freezes, and the other."""


@dataclass(frozen=True)
class Case:
    """A controller, whether the encoder freezes, and whether its samples are then missing (``deterministic``)."""

    precision: controllers.PrecisionLearner
    fault: bool = True
    drop_faulty: bool = False


def learning(settings: Arm) -> controllers.PointMassPrecision:
    """Return the precision learner of the two rows with precision learning."""
    return controllers.PointMassPrecision(rate=settings.learning_rate, lower_bound=settings.lower_bound)


def explicit(settings: Arm, thresholds: tuple[controllers.FittedThreshold, ...]) -> controllers.ExplicitDetection:
    """Return the same learner, which starts only above thresholds."""
    return controllers.ExplicitDetection(
        learning(settings), threshold=thresholds, groups=settings.detection_groups, hold=settings.hold
    )


def switching(modes: Sequence[str]) -> controllers.SwitchingPrecision:
    """Return the learner with these fault modes; with active inference it is the per-sensor form."""
    by_name = {mode.__name__: mode for mode in controllers.FAULT_MODES}
    return controllers.SwitchingPrecision([by_name[name]() for name in modes], joint=False)


def controller(settings: Arm, precision: controllers.PrecisionLearner) -> controllers.UnbiasedActiveInference:
    """Return the unbiased active inference controller with a precision learner."""
    # Three modalities with independent noise equal one with a diagonal precision. The same function measures and predicts.
    sensors = controllers.Modality(
        "encoders, velocity encoders and camera",
        6,
        _seen(settings.distortion),
        std=_std(settings),
        precision=(settings.encoder_precision,) * 4 + (settings.camera_precision,) * 2,
    )
    law = controllers.PID(
        (settings.proportional,) * 2,
        derivative_gain=settings.derivative,
        integral_gain=settings.integral,
        integral_limit=settings.integral_limit,
    )
    return controllers.UnbiasedActiveInference(
        [sensors],
        law,
        settings.step,
        settings.belief_rate,
        control=settings.control,
        precision=precision,
        initial_mean=(*settings.start, 0.0, 0.0),
    )


def closed_loop(settings: Arm, case: Case) -> cosim.Diagram:
    """Return the arm's FMU under a controller, moving from the start to one goal and then the other."""
    faults: list[cosim.Fault] = [cosim.Freeze(sensor=FAULTY, start=settings.fault_start)] if case.fault else []
    if case.drop_faulty:  # a missing sample has the precision zero
        faults.append(cosim.Dropout(sensor=FAULTY, start=settings.fault_start))
    start = dict(zip(("q1_0", "q2_0"), settings.start, strict=True))
    return cosim.closed_loop(
        plant=cosim.FMU(fmus.path("TwoLinkArm"), parameters=start),
        controller=controller(settings, case.precision),
        control=["torque1", "torque2"],
        measured=["q1", "q2", "dq1", "dq2"],
        sensors=cosim.Sensors(count=6, signals=4, function=_seen(settings.distortion), std=_std(settings)),
        faults=faults,
        reference=[
            cosim.Step(settings.switch, after, before)
            for before, after in zip(settings.first_goal, settings.second_goal, strict=True)
        ],
    )


@cache
def _seen(distortion: tuple[float, float, float]) -> Kernel:
    """Return the step function from the arm's state to its sensors; the lengths of the links come from the FMU."""
    arm: Any = cosim.FMU(fmus.path("TwoLinkArm"))
    return cosim.arm_with_camera([arm.start_value("L1"), arm.start_value("L2")], distortion)


def _std(settings: Arm) -> tuple[float, ...]:
    """Return the standard deviations of the two encoders, the two velocity encoders and the camera's two coordinates."""
    return (settings.encoder_std,) * 4 + (settings.camera_std,) * 2
