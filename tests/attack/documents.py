"""Scenario files in which every kind of plant, fault, source, controller and learner occurs."""

from __future__ import annotations

import numpy as np
from block_kinds import SIZES

from bayesftc import controllers, cosim

LEARNERS = (
    'kind = "FixedPrecision"',
    'kind = "PointMassPrecision"\nrate = 0.1\nlower_bound = 0.001\nvariance_bound = 1.0\nfull = true',
    'kind = "GammaPrecision"\nforgetting = 0.95\ncalibration = { slope = 2.0, intercept = -7.0, feature = "log" }',
    'kind = "GammaPrecision"\nforgetting = 0.9\nwindow = 5\nestimate = "mode"\nbelief_uncertainty = true',
    'kind = "WishartPrecision"\nforgetting = 0.95\ndegrees_of_freedom = 6.0',
    'kind = "EFFDI"\nthreshold = 19.76\nduration = 0.08',
    'kind = "SERFDI"\nthreshold = 3.0',
    'kind = "VariationalBayesKF"\nforgetting = 0.95\niterations = 3\ncovariance = "full"',
    'kind = "StudentTUpdate"\ndegrees_of_freedom = 5.0\niterations = 5\njoint = true',
    'kind = "WeightedLikelihood"\nc = 3.0',
    'kind = "SwitchingPrecision"\nloss = 0.01\njoint = false\nnoise_factor = 3.0\nalike = 0.2\nduration_shape = 1.1',
    'kind = "SwitchingPrecision"\nmodes = [{ kind = "Frozen", repeats = 0.9 }, { kind = "Offset", jump = 1.0, walk = 0.01 }]\n'
    'actuator_modes = [{ kind = "LostEffect", share = 0.5 }, { kind = "InputOffset", jump = 5.0 }]',
    'kind = "SwitchingPrecision"\nmodes = [{ kind = "Noisier", scale = 4.0 }, { kind = "Burst" }, { kind = "Unmodelled" },'
    ' { kind = "DroppedOut", arrives = 0.001 }, { kind = "Drifting", slope = 0.02 }]\nprocess_modes = []\njoint = false',
    'kind = "ExplicitDetection"\nthreshold = 3.0\nhold = 0.4\ngroups = [[0, 1]]',
)
FAULTS = (
    'kind = "Freeze"\nsensor = 0\nstart = 0.04\nstop = 0.12',
    'kind = "Stuck"\nsensor = 1\nat = 17.0\nstart = 0.06',
    'kind = "Injection"\nsensor = 1\nmagnitude = 2.0\namplitude = 1.0\nperiod = 0.3\nphase = 0.1\nstart = 0.02',
    'kind = "Bias"\nsensor = 0\nmagnitude = 2.0\nmean_time_to_fault = 0.1\nmean_time_to_recovery = 0.05',
    'kind = "Drift"\nsensor = 1\nslope = 2.0\nstart = 0.02',
    'kind = "GainFault"\nsensor = 0\nfactor = 0.5\nstart = 0.02',
    'kind = "Dropout"\nsensor = 0\nstart = 0.05\nstop = 0.11',
    'kind = "Spikes"\nsensor = 1\nmagnitude = 9.0\nprobability = 0.3\nrandom_size = true',
    'kind = "NoiseIncrease"\nsensor = 0\nstd = 3.0',
    'kind = "NoiseGrowth"\nsensor = 0\nslope = 3.0',
    'kind = "Clipping"\nsensor = 1\nlow = 19.0\nhigh = 20.5',
    'kind = "Rounding"\nsensor = 0\nresolution = 0.5',
    'kind = "Lag"\nsensor = 0\ntime_constant = 0.1',
    'kind = "Delay"\nsensor = 1\ndelay = 0.06',
    'kind = "RandomFaults"\nsensor = 0\nmean_time_to_fault = 0.1\nmean_time_to_recovery = 0.04\n'
    'kinds = [{ kind = "Freeze" }, { kind = "Drift", slope = 5.0 }]\nweights = [1.0, 2.0]',
)
LEARNERS += tuple(
    f'kind = "{cls.__name__}"' for cls in controllers.LEARNERS if f'"{cls.__name__}"' not in "".join(LEARNERS)
)
FAULTS += tuple(
    "\n".join([f'kind = "{cls.__name__}"', "sensor = 0", *(f"{k} = {v}" for k, v in SIZES[cls.__name__].items())])
    for cls in cosim.FAULTS
    if f'"{cls.__name__}"' not in "".join(FAULTS)
)
SOURCES = (
    'kind = "Constant"\nvalue = 20.0',
    'kind = "Step"\ntime = 0.1\nafter = 21.0\nbefore = 20.0',
    'kind = "Ramp"\nslope = 2.0\noffset = 20.0\nstart = 0.05',
    'kind = "Sine"\namplitude = 5.0\nperiod = 8.0\noffset = 20.0\nphase = 0.1\nunit = "m/s"',
    'kind = "Table"\ntimes = [0.0, 0.1, 0.2]\nvalues = [20.0, 21.0, 19.0]\ninterpolate = true',
    'kind = "Gaussian"\nstd = 0.1\nmean = 20.0',
)
PLANTS = (
    '[plant]\nfmu = "CruiseControl"\nfmi = "FMI"\nparameters = { v0 = 20.0, m = 100.0 }\ncontrol = "force"\nmeasured = "v"\n'
    '[noise.disturbance]\nkind = "Gaussian"\nstd = 0.03\n',
    '[plant]\nA = [[0.999]]\nB = [[2e-4]]\nC = [[1.0]]\ndt = 0.02\ninputs = ["force"]\noutputs = ["v"]\ninitial = [20.0]\n'
    'process_noise = [[1.0]]\ncontrol = "force"\nmeasured = "v"\n',
    '[plant]\nA = [[-0.05, 0.0], [1.0, 0.0]]\nB = [[0.01], [0.0]]\nC = [[1.0, 0.0], [0.0, 1.0]]\ndt = 0\ninputs = ["force"]\n'
    'outputs = ["v", "s"]\ninitial = [20.0, 0.0]\ncontrol = "force"\nmeasured = "v"\n',
)
SENSORS = (
    'count = 2\nstd = 1.0\nunit = "m/s"\n',
    "count = 2\nstd = [1.0, 0.5]\nbias = [0.1, 0.0]\nresolution = 0.1\ninvalid = [-9999.0]\n",
    "count = 2\ncovariance = [[1.0, 0.2], [0.2, 1.0]]\nmatrix = [[1.0], [1.0]]\n",
)
MODEL = """[model]
A = [[0.999]]
B = [[2e-4]]
C = [[1.0], [1.0]]
process_covariance = 0.001
sensor_covariance = [[1.0, 0.0], [0.0, 1.0]]
dt = 0.02
"""
CONTROLLERS = (
    'kind = "BayesianController"\ninitial_mean = 20.0\ninitial_covariance = 2.0\nu_min = -1e4\nu_max = [1e5]\nu_rate = 1e6\n'
    "goal_covariance = 1.0\ncontrol_covariance = 1e-6\n",
    'kind = "BayesianController"\nbelief = "joint"\ninitial_mean = [20.0]\ngoal_on = "states"\n',
    'kind = "LQGController"\ninitial_mean = 20.0\ngoal_covariance = 1.0\ncontrol_covariance = 1e6\ngoal_on = [[1.0]]\n',
)
ACTIVE_INFERENCE = """kind = "UnbiasedActiveInference"
control = "law"
belief_rate = 1.0
inner_steps = 2
state_prior = "kalman"
initial_mean = 20.0
[controller.law]
kind = "PID"
gain = 500.0
integral_gain = 10.0
integral_limit = 3.0
u_max = 1e4
"""
DESIGN = """[controller]
kind = "design"
noise = { load = 0.02 }
acceptable_error = 0.1
acceptable_control = 5.0
u_min = -12.0
u_max = 12.0
"""

BLOCKS = (
    '[blocks.limiter]\nkind = "RateLimiter"\nrising = 9.5\nfalling = 7.5\nevery = 2\n[[connections]]\nfrom = "controller.u"\n'
    'to = "limiter.u"\n[[connections]]\nfrom = "limiter.y"\nto = "plant.force"\n',
    '[blocks.smooth]\nkind = "MovingAverage"\nsamples = 3\nsize = 2\n[[connections]]\nfrom = "controller.y"\nto = "smooth.u"\n'
    '[[connections]]\nfrom = ["smooth.y[0]", "smooth.y[1]"]\nto = "controller.y"\n',
    '[blocks.part]\nkind = "Subsystem"\ninputs = { e = ["a.u", "b.u[0]"] }\noutputs = { y = "deep.y" }\n'
    '[blocks.part.blocks]\na = { kind = "Hysteresis", on = 20.0, off = 19.0 }\nb = { kind = "Product", operations = "*/" }\n'
    '[blocks.part.blocks.deep]\nkind = "Subsystem"\n[blocks.part.blocks.deep.blocks.table]\nkind = "LookupTable"\n'
    'points = [0.0, 1.0, 2.0]\nvalues = [0.0, 3.0, -1.0]\n[[blocks.part.connections]]\nfrom = "a.y"\nto = "b.u[1]"\n'
    '[[blocks.part.connections]]\nfrom = "b.y"\nto = "deep.u"\n[[connections]]\nfrom = "plant.v"\nto = "part.e"\n',
    '[blocks.lag]\nkind = "TransferFunction"\nnumerator = [1.0]\ndenominator = [0.1, 1.0]\n[blocks.count]\nkind = "Counter"\n'
    'limit = 4.0\n[blocks.edge]\nkind = "Compare"\nrelation = ">"\n[[connections]]\nfrom = "reference.y"\nto = "lag.u"\n'
    '[[connections]]\nfrom = ["lag.y", "sensors.y[0]"]\nto = "edge.u"\n[[connections]]\nfrom = "edge.y"\nto = "count.u"\n',
)
LOOP = """
[simulation]
duration = 0.2
engine = "interpreted"
[plant]
A = [[0.999]]
B = [[2e-4]]
C = [[1.0]]
dt = 0.02
control = "u"
measured = "y"
[sensors]
count = 2
std = 1.0
[[faults]]
kind = "Freeze"
start = 0.04
[reference]
kind = "Constant"
value = 20.0
[model]
A = [[0.999]]
B = [[2e-4]]
C = [[1.0], [1.0]]
process_covariance = 0.001
sensor_covariance = 1.0
dt = 0.02
[controller]
kind = "BayesianController"
precision = { kind = "FixedPrecision" }
[blocks.part]
kind = "Subsystem"
[blocks.part.blocks.limiter]
kind = "RateLimiter"
rising = 9.5
[[connections]]
from = "controller.u"
to = "part.u"
[[connections]]
from = "part.y"
to = "plant.u"
"""
"""A small loop, for campaigns."""


def any_of(texts, rng: np.random.Generator) -> str:
    """Return one of some texts."""
    return texts[int(rng.integers(len(texts)))]


def scenario(rng: np.random.Generator) -> str:
    """Return a scenario of ten steps that works."""
    head = '[simulation]\nduration = 0.2\nseed = 1\nengine = "interpreted"\nrecord = "*"\ndecimation = 1\n'
    chosen = rng.choice(len(FAULTS), int(rng.integers(3)), replace=False)  # two of a kind would need names
    faults = "".join(f"[[faults]]\n{FAULTS[i]}\n" for i in chosen)
    if rng.random() < 0.03:
        plant = '[plant]\nfmu = "PositionServo"\ncontrol = "voltage"\nmeasured = "angle"\n'
        return (
            head
            + plant
            + "[sensors]\ncount = 2\nstd = 0.01\n"
            + faults
            + '[reference]\nkind = "Constant"\nvalue = 0.5\n'
            + DESIGN
        )
    plant = any_of(PLANTS, rng).replace('"FMI"', any_of(('"2.0"', '"3.0"'), rng))
    if rng.random() < 0.3:
        fault = (
            any_of([fault for fault in FAULTS if "Dropout" not in fault], rng)
            .replace("sensor = 0\n", "")
            .replace("sensor = 1\n", "")
        )
        faults += f"[[input_faults.force]]\n{fault}\n"
    controller = ACTIVE_INFERENCE if rng.random() < 0.2 else any_of(CONTROLLERS, rng)
    learner = any_of(
        [
            text
            for text in LEARNERS
            if "actuator_modes" not in text or (controller is not ACTIVE_INFERENCE and "joint" not in controller)
        ],
        rng,
    )
    parts = (
        *(plant, f"[sensors]\n{any_of(SENSORS, rng)}", faults, f"[reference]\n{any_of(SOURCES, rng)}\n"),
        *(MODEL, f"[controller]\n{controller}", f"[controller.precision]\n{learner}\n"),
    )
    blocks = any_of(BLOCKS, rng) if rng.random() < 0.4 and "input_faults" not in faults else ""
    return head + "".join(parts) + blocks
