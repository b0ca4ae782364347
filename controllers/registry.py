"""Lists of all controllers, laws, precision learners and baselines, for tests and for scenario files."""

from bayesftc.controllers.active_inference.controller import UnbiasedActiveInference
from bayesftc.controllers.bayesian.linear import BayesianController
from bayesftc.controllers.bayesian.lqg import LQGController
from bayesftc.controllers.bayesian.nonlinear import NonlinearBayesianController
from bayesftc.controllers.laws import PID, Proportional, ProportionalDerivative
from bayesftc.controllers.precision.base import FixedPrecision, PrecisionLearner
from bayesftc.controllers.precision.baselines import EFFDI, SERFDI
from bayesftc.controllers.precision.explicit import ExplicitDetection
from bayesftc.controllers.precision.gamma import GammaPrecision
from bayesftc.controllers.precision.point_mass import PointMassPrecision
from bayesftc.controllers.precision.robust import StudentTUpdate, WeightedLikelihood
from bayesftc.controllers.precision.variational import VariationalBayesKF
from bayesftc.controllers.precision.wishart import WishartPrecision
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.block import Block

CONTROLLERS: tuple[type[Block], ...] = (
    BayesianController,
    LQGController,
    NonlinearBayesianController,
    UnbiasedActiveInference,
)
"""Blocks between sensors and plant: inputs ``y`` and ``goal``, output ``u``."""

LAWS: tuple[type[Block], ...] = (Proportional, ProportionalDerivative, PID)
"""To add a law, write a block with the inputs ``x_hat`` and ``goal`` and the output ``u``, and list it here."""

LEARNERS: tuple[type[PrecisionLearner], ...] = (
    FixedPrecision,
    PointMassPrecision,
    GammaPrecision,
    WishartPrecision,
    EFFDI,
    SERFDI,
    VariationalBayesKF,
    StudentTUpdate,
    WeightedLikelihood,
    SwitchingPrecision,
    ExplicitDetection,
)
"""To add a learner, follow the rules of `bayesftc.controllers.precision.base` and list it here."""
