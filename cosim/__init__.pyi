# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from . import errors as errors, ops as ops, random as random, statistics as statistics
from ._campaign.dask import DaskCluster as DaskCluster
from ._campaign.design import Design as Design, Grid as Grid, Points as Points
from ._campaign.executors import Threads as Threads
from ._campaign.factors import varied as varied
from ._campaign.metrics import (
    METRICS as METRICS,
    RMSE as RMSE,
    Final as Final,
    LoopFigures as LoopFigures,
    MaxAbsoluteError as MaxAbsoluteError,
    Mean as Mean,
    MeanAbsoluteError as MeanAbsoluteError,
    Metric as Metric,
    OfResult as OfResult,
)
from ._campaign.outcomes import CampaignResult as CampaignResult
from ._campaign.processes import Processes as Processes
from ._campaign.samples import (
    LatinHypercube as LatinHypercube,
    SaltelliDesign as SaltelliDesign,
    SobolSequence as SobolSequence,
)
from ._exchange.equations import Jacobians as Jacobians, ModelEquations as ModelEquations
from ._nodes import Node as Node, PortRef as PortRef
from .alarms import Alarms as Alarms, alarm_threshold as alarm_threshold, judge_alarms as judge_alarms
from .block import Block as Block, Definition as Definition, ExternalBlock as ExternalBlock
from .camera import arm_with_camera as arm_with_camera, planar_arm as planar_arm, radial_distortion as radial_distortion
from .campaign import Campaign as Campaign
from .control_system import initial_state as initial_state
from .coupling import Coupling as Coupling
from .diagram import Diagram as Diagram
from .differentiation import jacobian as jacobian
from .errors import (
    AlgebraicLoopError as AlgebraicLoopError,
    BayesFTCError as BayesFTCError,
    ConnectionError as ConnectionError,
    FMUCrashed as FMUCrashed,
    FMUError as FMUError,
    FMUPlatformError as FMUPlatformError,
    FMUVersionError as FMUVersionError,
    KernelError as KernelError,
    ModelError as ModelError,
    RecordingError as RecordingError,
    ResultFileError as ResultFileError,
    ScenarioError as ScenarioError,
    SimulationError as SimulationError,
    SSPError as SSPError,
    StepSizeError as StepSizeError,
    StoreError as StoreError,
    UnconnectedInputError as UnconnectedInputError,
    UnknownNameError as UnknownNameError,
)
from .export import export_c as export_c, export_fmu as export_fmu
from .faults import (
    FAULTS as FAULTS,
    Bias as Bias,
    Clipping as Clipping,
    Delay as Delay,
    Drift as Drift,
    Dropout as Dropout,
    Fault as Fault,
    Freeze as Freeze,
    GainFault as GainFault,
    Injection as Injection,
    Lag as Lag,
    NoiseGrowth as NoiseGrowth,
    NoiseIncrease as NoiseIncrease,
    RandomFaults as RandomFaults,
    Rounding as Rounding,
    Spikes as Spikes,
    Stuck as Stuck,
)
from .fmu import FMU as FMU
from .loops import closed_loop as closed_loop
from .mathblocks import Gain as Gain, Saturation as Saturation, Sum as Sum, UnitDelay as UnitDelay
from .online import Online as Online
from .ports import Port as Port
from .probabilities import Reliability as Reliability, reliability as reliability
from .result import Result as Result
from .sensors import Sensors as Sensors
from .session import RunState as RunState, Session as Session
from .sources import (
    Constant as Constant,
    Gaussian as Gaussian,
    Ramp as Ramp,
    Sine as Sine,
    Source as Source,
    Step as Step,
    Table as Table,
)
from .ssp import open_ssp as open_ssp, save_ssp as save_ssp
from .state_space import StateSpace as StateSpace
from .verification import Deviation as Deviation, Verification as Verification, verify_fmu as verify_fmu
