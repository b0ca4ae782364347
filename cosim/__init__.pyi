# The one list of public names: read by type checkers and, at run time, by lazy_loader.

from . import errors as errors
from . import ops as ops
from . import random as random
from .block import Block as Block
from .block import Definition as Definition
from .block import ExternalBlock as ExternalBlock
from .diagram import Diagram as Diagram
from .diagram import Node as Node
from .errors import (
    AlgebraicLoopError as AlgebraicLoopError,
)
from .errors import (
    BayesFTCError as BayesFTCError,
)
from .errors import (
    ConnectionError as ConnectionError,
)
from .errors import (
    FMUError as FMUError,
)
from .errors import (
    KernelError as KernelError,
)
from .errors import (
    ModelError as ModelError,
)
from .errors import (
    ResultFileError as ResultFileError,
)
from .errors import (
    ScenarioError as ScenarioError,
)
from .errors import (
    SimulationError as SimulationError,
)
from .errors import (
    StepSizeError as StepSizeError,
)
from .errors import (
    UnknownNameError as UnknownNameError,
)
from .faults import (
    FAULTS as FAULTS,
)
from .faults import (
    Bias as Bias,
)
from .faults import (
    Drift as Drift,
)
from .faults import (
    Dropout as Dropout,
)
from .faults import (
    Fault as Fault,
)
from .faults import (
    Freeze as Freeze,
)
from .faults import (
    GainFault as GainFault,
)
from .faults import (
    Injection as Injection,
)
from .faults import (
    NoiseIncrease as NoiseIncrease,
)
from .faults import (
    RandomFaults as RandomFaults,
)
from .faults import (
    Spikes as Spikes,
)
from .fmu import FMU as FMU
from .loops import closed_loop as closed_loop
from .mathblocks import Gain as Gain
from .mathblocks import Saturation as Saturation
from .mathblocks import Sum as Sum
from .mathblocks import UnitDelay as UnitDelay
from .online import Online as Online
from .ports import Port as Port
from .ports import PortRef as PortRef
from .result import Result as Result
from .sensors import Sensors as Sensors
from .sources import (
    Constant as Constant,
)
from .sources import (
    Gaussian as Gaussian,
)
from .sources import (
    Ramp as Ramp,
)
from .sources import (
    Sine as Sine,
)
from .sources import (
    Source as Source,
)
from .sources import (
    Step as Step,
)
from .sources import (
    Table as Table,
)
from .state_space import StateSpace as StateSpace
