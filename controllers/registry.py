"""The list of all precision learners and baselines, over which the tests run and from which scenario files choose."""

from bayesftc.controllers.baselines import EFFDI, SERFDI
from bayesftc.controllers.precision import FixedPrecision, GammaPrecision, PrecisionLearner

LEARNERS: tuple[type[PrecisionLearner], ...] = (FixedPrecision, GammaPrecision, EFFDI, SERFDI)
"""To add a learner, write it by the rules of `bayesftc.controllers.precision` and name it here."""
