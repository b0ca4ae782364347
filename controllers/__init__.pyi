# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from ._plant_check import ModelMismatchWarning as ModelMismatchWarning, compare_with_plant as compare_with_plant
from ._pulse_responses import PoorFitWarning as PoorFitWarning
from ._rate import Calibration as Calibration, RateLearner as RateLearner
from ._resolution import find_resolution as find_resolution
from .active_inference import UnbiasedActiveInference as UnbiasedActiveInference
from .actuator_modes import (
    ACTUATOR_MODES as ACTUATOR_MODES,
    ActuatorMode as ActuatorMode,
    InputOffset as InputOffset,
    LostEffect as LostEffect,
    StuckActuator as StuckActuator,
)
from .baselines import EFFDI as EFFDI, SERFDI as SERFDI
from .bayesian import BayesianController as BayesianController, UnstableLoopWarning as UnstableLoopWarning
from .calibration import CalibrationReport as CalibrationReport, Hazards as Hazards, calibrate as calibrate
from .classifier import FaultClassifier as FaultClassifier, UntrainedClassifierError as UntrainedClassifierError
from .design import design as design
from .detectability import Detectability as Detectability, detectability as detectability
from .diagnosis import (
    ModelFinding as ModelFinding,
    diagnose as diagnose,
    diagnose_recording as diagnose_recording,
)
from .estimator import StateEstimator as StateEstimator
from .explicit import ExplicitDetection as ExplicitDetection
from .fault_modes import (
    FAULT_MODES as FAULT_MODES,
    Burst as Burst,
    Drifting as Drifting,
    DroppedOut as DroppedOut,
    FaultMode as FaultMode,
    Frozen as Frozen,
    Noisier as Noisier,
    Offset as Offset,
    Ramping as Ramping,
    Unmodelled as Unmodelled,
)
from .gamma import GammaPrecision as GammaPrecision
from .identification import Identification as Identification
from .laws import PID as PID, Proportional as Proportional, ProportionalDerivative as ProportionalDerivative
from .learning import LearnedModes as LearnedModes, RecordedRun as RecordedRun, learn_modes as learn_modes
from .lqg import LQGController as LQGController
from .modality import Modality as Modality
from .model import LinearModel as LinearModel
from .monitor import FaultMonitor as FaultMonitor, LogisticMap as LogisticMap
from .nonlinear import NonlinearBayesianController as NonlinearBayesianController
from .nonlinear_model import NonlinearModel as NonlinearModel
from .point_mass import PointMassPrecision as PointMassPrecision
from .precision import (
    FixedPrecision as FixedPrecision,
    Learner as Learner,
    PrecisionLearner as PrecisionLearner,
)
from .process_modes import NoisierProcess as NoisierProcess
from .registry import CONTROLLERS as CONTROLLERS, LAWS as LAWS, LEARNERS as LEARNERS
from .residuals import (
    beta_residual as beta_residual,
    residual_features as residual_features,
    state_estimation_residual as state_estimation_residual,
)
from .robust import StudentTUpdate as StudentTUpdate, WeightedLikelihood as WeightedLikelihood
from .switching import SwitchingPrecision as SwitchingPrecision
from .threshold import ChebyshevThreshold as ChebyshevThreshold, FittedThreshold as FittedThreshold
from .validation import KalmanCheck as KalmanCheck, check_kalman as check_kalman, ser_reference as ser_reference
from .variational import VariationalBayesKF as VariationalBayesKF
from .wishart import WishartPrecision as WishartPrecision
