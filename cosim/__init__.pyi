# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from . import errors as errors, live as live, ops as ops, random as random, statistics as statistics
from .block import Block as Block, Definition as Definition, ExternalBlock as ExternalBlock
from .blocks.combining import (
    Compare as Compare,
    Logic as Logic,
    Maximum as Maximum,
    Minimum as Minimum,
    Product as Product,
    Switch as Switch,
)
from .blocks.elementwise import (
    Abs as Abs,
    DeadZone as DeadZone,
    Polynomial as Polynomial,
    Quantizer as Quantizer,
    Saturation as Saturation,
    Sign as Sign,
)
from .blocks.excitation import PRBS as PRBS, Chirp as Chirp, Pulse as Pulse
from .blocks.faults.conditions import When as When, when as when
from .blocks.faults.kinds import (
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
from .blocks.kinds import BLOCKS as BLOCKS
from .blocks.mathblocks import Gain as Gain, Sum as Sum, UnitDelay as UnitDelay
from .blocks.memory import (
    Counter as Counter,
    ExponentialFilter as ExponentialFilter,
    Hysteresis as Hysteresis,
    Integrator as Integrator,
    MovingAverage as MovingAverage,
    RateLimiter as RateLimiter,
    SampleAndHold as SampleAndHold,
    VariableDelay as VariableDelay,
)
from .blocks.preview import Preview as Preview
from .blocks.sensing.camera import (
    arm_with_camera as arm_with_camera,
    planar_arm as planar_arm,
    radial_distortion as radial_distortion,
)
from .blocks.sensing.sensors import Sensors as Sensors
from .blocks.sources import (
    Constant as Constant,
    Gaussian as Gaussian,
    Ramp as Ramp,
    Sine as Sine,
    Source as Source,
    Step as Step,
    Table as Table,
)
from .blocks.state_space import StateSpace as StateSpace
from .blocks.tables import LookupTable as LookupTable, LookupTable2D as LookupTable2D
from .blocks.transfer_function import TransferFunction as TransferFunction
from .campaign.campaign import Campaign as Campaign
from .campaign.designs.design import Design as Design, Grid as Grid, Points as Points
from .campaign.designs.factors import varied as varied
from .campaign.designs.samples import (
    LatinHypercube as LatinHypercube,
    SaltelliDesign as SaltelliDesign,
    SobolSequence as SobolSequence,
)
from .campaign.executors.base import Threads as Threads
from .campaign.executors.dask import DaskCluster as DaskCluster
from .campaign.executors.processes import Processes as Processes
from .campaign.outcomes import CampaignResult as CampaignResult
from .campaign.runs.metrics import (
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
from .comparison.compare import Comparison as Comparison, compare as compare
from .control.control_system import initial_state as initial_state
from .control.linear_loop import LinearLoop as LinearLoop
from .control.margins import Margins as Margins
from .diagram.closed_loop import closed_loop as closed_loop
from .diagram.coupling import Coupling as Coupling
from .diagram.diagram import Diagram as Diagram
from .diagram.nodes import Node as Node, PortRef as PortRef
from .diagram.subsystem import Subsystem as Subsystem
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
from .export.exporting import export_c as export_c, export_fmu as export_fmu
from .export.verification import Deviation as Deviation, Verification as Verification, verify_fmu as verify_fmu
from .fitting.fit import fit as fit
from .fitting.fitted import FittedFMU as FittedFMU
from .fitting.settings import FitSettings as FitSettings
from .fitting.uncertainty import Combination as Combination
from .fmi.equations import Jacobians as Jacobians, ModelEquations as ModelEquations
from .fmi.fmu import FMU as FMU
from .judging.alarms import Alarms as Alarms, alarm_threshold as alarm_threshold, judge_alarms as judge_alarms
from .judging.probabilities import Reliability as Reliability, reliability as reliability
from .ports import Port as Port
from .run.online import Online as Online
from .run.result import Result as Result
from .run.session import RunState as RunState, Session as Session
from .run.summary import RunSummary as RunSummary
from .ssp.system import open_ssp as open_ssp, save_ssp as save_ssp
from .stepping.differentiation import jacobian as jacobian
