"""The lists of all controllers, laws, precision learners and baselines: tests run over them, scenario files choose from them."""

from bayesftc.controllers.active_inference import UnbiasedActiveInference
from bayesftc.controllers.baselines import EFFDI, SERFDI
from bayesftc.controllers.bayesian import BayesianController
from bayesftc.controllers.explicit import ExplicitDetection
from bayesftc.controllers.gamma import GammaPrecision
from bayesftc.controllers.laws import PID, Proportional, ProportionalDerivative
from bayesftc.controllers.lqg import LQGController
from bayesftc.controllers.nonlinear import NonlinearBayesianController
from bayesftc.controllers.point_mass import PointMassPrecision
from bayesftc.controllers.precision import FixedPrecision, PrecisionLearner
from bayesftc.controllers.robust import StudentTUpdate, WeightedLikelihood
from bayesftc.controllers.switching import SwitchingPrecision
from bayesftc.controllers.variational import VariationalBayesKF
from bayesftc.controllers.wishart import WishartPrecision
from bayesftc.cosim.block import Block

CONTROLLERS: tuple[type[Block], ...] = (
    BayesianController,
    LQGController,
    NonlinearBayesianController,
    UnbiasedActiveInference,
)
"""What can stand between sensors and plant: a block with the inputs ``y`` and ``goal`` and the output ``u``."""

LAWS: tuple[type[Block], ...] = (Proportional, ProportionalDerivative, PID)
"""To add a law, write a block with the inputs ``x_hat`` and ``goal`` and the output ``u``, and name it here."""

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
"""To add a learner, write it by the rules of `bayesftc.controllers.precision` and name it here."""
