# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from .active_inference.controller import UnbiasedActiveInference as UnbiasedActiveInference
from .bayesian.estimator import StateEstimator as StateEstimator
from .bayesian.linear import BayesianController as BayesianController, UnstableLoopWarning as UnstableLoopWarning
from .bayesian.lqg import LQGController as LQGController
from .bayesian.nonlinear import NonlinearBayesianController as NonlinearBayesianController
from .bayesian.validation import (
    KalmanCheck as KalmanCheck,
    check_kalman as check_kalman,
    ser_reference as ser_reference,
)
from .design import design as design
from .detection.calibration import CalibrationReport as CalibrationReport, Hazards as Hazards, calibrate as calibrate
from .detection.classifier import (
    FaultClassifier as FaultClassifier,
    UntrainedClassifierError as UntrainedClassifierError,
)
from .detection.detectability import Detectability as Detectability, detectability as detectability
from .detection.monitor import FaultMonitor as FaultMonitor, LogisticMap as LogisticMap
from .detection.residuals import (
    beta_residual as beta_residual,
    residual_features as residual_features,
    state_estimation_residual as state_estimation_residual,
)
from .diagnosis.diagnose import diagnose as diagnose, diagnose_recording as diagnose_recording
from .diagnosis.finding import ModelFinding as ModelFinding
from .diagnosis.plant_check import (
    ModelMismatchWarning as ModelMismatchWarning,
    compare_with_plant as compare_with_plant,
)
from .identification.identify import Identification as Identification
from .laws import PID as PID, Proportional as Proportional, ProportionalDerivative as ProportionalDerivative
from .learning.learn_modes import LearnedModes as LearnedModes, RecordedRun as RecordedRun, learn_modes as learn_modes
from .learning.resolution import find_resolution as find_resolution
from .models.linear import LinearModel as LinearModel, SignalNames as SignalNames
from .models.modality import Modality as Modality
from .models.nonlinear import NonlinearModel as NonlinearModel
from .models.pulse_responses import PoorFitWarning as PoorFitWarning
from .precision.base import (
    FixedPrecision as FixedPrecision,
    Learner as Learner,
    PrecisionLearner as PrecisionLearner,
)
from .precision.baselines import EFFDI as EFFDI, SERFDI as SERFDI
from .precision.explicit import ExplicitDetection as ExplicitDetection
from .precision.gamma import GammaPrecision as GammaPrecision
from .precision.point_mass import PointMassPrecision as PointMassPrecision
from .precision.rate import Calibration as Calibration, RateLearner as RateLearner
from .precision.robust import StudentTUpdate as StudentTUpdate, WeightedLikelihood as WeightedLikelihood
from .precision.variational import VariationalBayesKF as VariationalBayesKF
from .precision.wishart import WishartPrecision as WishartPrecision
from .registry import CONTROLLERS as CONTROLLERS, LAWS as LAWS, LEARNERS as LEARNERS
from .switching.actuator_modes import (
    ACTUATOR_MODES as ACTUATOR_MODES,
    ActuatorMode as ActuatorMode,
    InputOffset as InputOffset,
    LostEffect as LostEffect,
    StuckActuator as StuckActuator,
)
from .switching.fault_modes import (
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
from .switching.learner import SwitchingPrecision as SwitchingPrecision
from .switching.process_modes import NoisierProcess as NoisierProcess
from .thresholds.chebyshev import ChebyshevThreshold as ChebyshevThreshold, FittedThreshold as FittedThreshold
