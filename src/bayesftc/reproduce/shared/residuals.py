"""The residuals that the detection experiment compares, each from its own controller's loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.settings import Car, Detection
from bayesftc.reproduce.shared.car import model
from bayesftc.reproduce.shared.streams import Stream

SIGNALS = ("controller.innovation", "controller.beta", "controller.precision", "controller.fault_probability")
GRID = ("SER", "beta", "beta (PL of tracking)")
"""The residuals of the grid; each has one loop."""
SWITCHING = "SwitchingPrecision"
PER_SENSOR = f"{SWITCHING}, per sensor"
LABELS = {
    SWITCHING: "SwitchingPrecision (mean times to\nfault and recovery known)",
    PER_SENSOR: "SwitchingPrecision, per sensor\n(mean times known)",
    f"{SWITCHING}, default": "SwitchingPrecision (default settings)",
}
"""Names in figures for residuals whose learners have additional knowledge."""
PLAIN = controllers.FixedPrecision()
"""A Kalman filter that trusts all sensors."""
LEAST = 1e-16
"""Least probability in odds: 1 - p has no finer resolution."""


@dataclass(frozen=True)
class Residual:
    """A residual, from which a fault probability is computed."""

    text: str  # description
    learners: tuple[controllers.PrecisionLearner, ...]  # one loop is run with each
    # For each learner the function from its run to a feature of each step and sensor.
    columns: tuple[Callable[[cosim.Result], Floats], ...]
    # From the learner's run to the fault probability of each step and sensor, if the learner gives one.
    probability: Callable[[cosim.Result], Floats] | None = None

    def features(self, streams: Sequence[Stream]) -> Floats:
        """Return the features from the learners' runs, of shape (steps, sensors, features)."""
        return np.stack([f(stream.result) for f, stream in zip(self.columns, streams, strict=True)], axis=-1)


def ser(settings: Detection) -> Residual:
    """Return the paper's baseline."""
    learner = controllers.SERFDI(threshold=settings.ser_threshold)
    return Residual("|y - C x_t|t-1| in the loop of SER FT", (learner,), (controllers.state_estimation_residual,))


def beta(learner: controllers.PrecisionLearner) -> Residual:
    """Return the logarithm of beta, which ranks like beta itself."""
    return Residual("log(beta) in its learner's loop", (learner,), (_log_beta,))


def papers(settings: Detection, chosen: controllers.GammaPrecision) -> dict[str, Residual]:
    """Return the paper's two residuals by name."""
    return {"SER": ser(settings), "beta": beta(chosen)}


def known(settings: Detection, chosen: controllers.GammaPrecision, car: Car) -> dict[str, Residual]:
    """Return all residuals by name: the paper's two, variations of them, log odds of fault modes, the betas of all learners."""
    base, best = papers(settings, chosen).values()
    plain = controllers.GammaPrecision(forgetting=settings.plain_forgetting)
    kept = chosen.forgetting or 1.0

    def smoothed(result: cosim.Result) -> Floats:
        from scipy.signal import lfilter

        return np.asarray(
            lfilter([1.0 - kept], [1.0, -kept], controllers.state_estimation_residual(result) ** 2, axis=0)
        )

    residuals = {
        "SER": base,
        "beta": best,
        "SER, smoothed": Residual("square of SER with the exponential memory of beta", base.learners, (smoothed,)),
        "SER and beta": Residual("both as features", (*base.learners, chosen), (*base.columns, *best.columns)),
        "innovation of PL": Residual(
            "|y - C x_t|t-1| in the loop of beta", (chosen,), (controllers.state_estimation_residual,)
        ),
        "innovation of No FT": Residual(
            "|y - C x_t|t-1| of a Kalman filter that trusts all sensors",
            (PLAIN,),
            (controllers.state_estimation_residual,),
        ),
        "precision": Residual("-log(precision) in the loop of beta", (chosen,), (_log_variance,)),
        "beta (PL of tracking)": beta(plain),
        **posteriors(settings),
    }
    for cls in controllers.LEARNERS:
        if cls is not controllers.GammaPrecision and _has_beta(cls(), car):
            residuals[f"beta ({cls.__name__})"] = beta(cls())
    return residuals


def posterior(text: str, learner: controllers.PrecisionLearner) -> Residual:
    """Return the log odds of a fault by a learner that gives a fault probability."""
    return Residual(text, (learner,), (_log_odds,), _probability)


def posteriors(settings: Detection) -> dict[str, Residual]:
    """Return the residuals of the learners of fault modes by name."""
    return {
        SWITCHING: posterior("log odds of a fault, with the experiment's hazards", switching(settings, True)),
        PER_SENSOR: posterior("the same, judged sensor by sensor", switching(settings, False)),
        f"{SWITCHING}, default": posterior("with default hazards", controllers.SwitchingPrecision()),
    }


def switching(settings: Detection, joint: bool) -> controllers.SwitchingPrecision:
    """Return the learner of fault modes with the mean times of the experiment's three kinds of faults, but not their sizes.

    It also has no process modes, because the experiment has no disturbances such as a kick. In the joint form a drift may be slow
    or fast.
    """
    kinds = [controllers.Frozen, controllers.Offset, controllers.Drifting]
    between, lasts = settings.mean_time_to_fault, settings.mean_time_to_recovery
    modes = [kind(3.0 * between, lasts) for kind in kinds]
    if joint:
        modes[2:] = [kind(6.0 * between, lasts) for kind in (controllers.Drifting, controllers.Ramping)]
    return controllers.SwitchingPrecision(modes, joint=joint, process_modes=(), duration_shape=inf)


def _has_beta(learner: controllers.PrecisionLearner, car: Car) -> bool:
    """Return whether a learner has a beta, which one sample shows."""
    step = controllers.BayesianController(model(car), precision=learner).online(compiled=False)
    return bool(np.isfinite(step(y=[1.0] * car.sensors, goal=[0.0]).beta).all())


def _log_beta(result: cosim.Result) -> Floats:
    return np.log(controllers.beta_residual(result))


def _probability(result: cosim.Result) -> Floats:
    return result["controller.fault_probability"]


def _log_odds(result: cosim.Result) -> Floats:
    p = _probability(result)
    return np.log(np.maximum(p, LEAST)) - np.log(np.maximum(1.0 - p, LEAST))


def _log_variance(result: cosim.Result) -> Floats:
    return -np.log(result["controller.precision"])
