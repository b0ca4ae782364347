# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from .baselines import EFFDI as EFFDI
from .baselines import SERFDI as SERFDI
from .bayesian import BayesianController as BayesianController
from .bayesian import UnstableLoopWarning as UnstableLoopWarning
from .calibration import calibrate as calibrate
from .model import LinearModel as LinearModel
from .precision import (
    Calibration as Calibration,
)
from .precision import (
    FixedPrecision as FixedPrecision,
)
from .precision import (
    GammaPrecision as GammaPrecision,
)
from .precision import (
    Learner as Learner,
)
from .precision import (
    PrecisionLearner as PrecisionLearner,
)
from .registry import LEARNERS as LEARNERS
from .validation import KalmanCheck as KalmanCheck
from .validation import check_kalman as check_kalman
from .validation import ser_reference as ser_reference
