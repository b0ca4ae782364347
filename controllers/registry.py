"""The lists of all controllers, precision learners and baselines: tests run over them, scenario files choose from them."""

from bayesftc.controllers.baselines import EFFDI, SERFDI
from bayesftc.controllers.bayesian import BayesianController
from bayesftc.controllers.gamma import GammaPrecision
from bayesftc.controllers.precision import FixedPrecision, PrecisionLearner
from bayesftc.cosim.block import Block

CONTROLLERS: tuple[type[Block], ...] = (BayesianController,)
"""What can stand between sensors and plant: a block with the inputs ``y`` and ``goal`` and the output ``u``."""

LEARNERS: tuple[type[PrecisionLearner], ...] = (FixedPrecision, GammaPrecision, EFFDI, SERFDI)
"""To add a learner, write it by the rules of `bayesftc.controllers.precision` and name it here."""
