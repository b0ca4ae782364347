"""Blocks of every kind, for all that is exported, and their C, compiled."""

import ctypes
import subprocess
from pathlib import Path

import block_kinds
import fmpy
import numpy as np
import pytest
from block_kinds import DT
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException

from bayesftc import controllers, cosim
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.program import program_of
from bayesftc.cosim.ops import sin

MODEL = controllers.LinearModel(
    A=[[0.95, 0.1], [0.0, 0.9]],
    B=[[0.0], [0.1]],
    C=[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
    process_covariance=np.diag([1e-4, 1e-3]),
    sensor_covariance=[0.04, 0.09, 0.01],
    dt=DT,
)


def brain(precision, **options):
    return controllers.BayesianController(MODEL, precision=precision, control_covariance=100.0, **options)


def pendulum(x, u, x_next):
    x_next[0] = x[0] + 0.1 * x[1]
    x_next[1] = x[1] + 0.1 * (u[0] - sin(x[0]) - 0.1 * x[1])


def angles(x, y):
    y[0] = x[0]
    y[1] = sin(x[0])


BLOCKS = {
    **block_kinds.BLOCKS,
    **{learner.__name__: brain(learner()) for learner in controllers.LEARNERS},
    "joint belief": brain(controllers.GammaPrecision(), belief="joint", posterior_outputs=True),
    "precision matrix": brain(controllers.PointMassPrecision(full=True)),
    "switching alone": brain(controllers.SwitchingPrecision(joint=False)),
    "lqg": controllers.LQGController(
        MODEL,
        goal_on=[[1.0, 0.0]],
        precision=controllers.GammaPrecision(window=7, calibration=controllers.Calibration(2.0, -1.0)),
    ),
    "lqg with a preview": controllers.LQGController(
        MODEL, goal_on=[[1.0, 0.0]], precision=controllers.FixedPrecision(), preview=4, u_max=3.0
    ),
    "lqg with delays": controllers.LQGController(
        MODEL.with_delays(2, [0, 2, 1]), goal_on=[[1.0, 0.0]], precision=controllers.FixedPrecision()
    ),
    "nonlinear": controllers.NonlinearBayesianController(
        controllers.NonlinearModel(
            pendulum,
            angles,
            states=2,
            controls=1,
            sensors=2,
            process_covariance=[1e-6, 1e-4],
            sensor_covariance=[0.01, 0.01],
            dt=DT,
        ),
        precision=controllers.GammaPrecision(),
        control_covariance=1.0,
        iterations=10,
        posterior_outputs=True,
    ),
    "active inference": controllers.UnbiasedActiveInference(
        [
            controllers.Modality(
                "arm", 6, cosim.arm_with_camera((1.0, 0.8), (-0.05, 0.01, 0.001)), std=0.1, precision=0.5
            )
        ],
        controllers.ProportionalDerivative(2.0 * np.eye(2), derivative_gain=0.5 * np.eye(2)),
        DT,
        2.0,
        0.5,
        inner_steps=2,
    ),
    "proportional": controllers.Proportional([[2.0, 1.0], [0.0, 3.0]], u_min=-1.0, u_max=(2.0, 3.0)),
    "proportional derivative": controllers.ProportionalDerivative(2.0, derivative_gain=0.5, states=3, u_max=3.0),
    "PID": controllers.PID(1.0, states=2, derivative_gain=0.1, integral_gain=0.5, u_max=3.0),
    "monitor": controllers.FaultMonitor(
        2, ("beta", "precision"), 0.4, controllers.LogisticMap((1.0, 2.0), (0.0, 0.5), (1.0, 2.0), -1.0)
    ),
    "estimator": controllers.StateEstimator(MODEL, precision=controllers.GammaPrecision(), invalid=[-9999.0, 65535.0]),
}
"""Every kind of block, learner, fault and law."""


@pytest.fixture(scope="session")
def blocks():
    """Return `BLOCKS`."""
    return BLOCKS


@pytest.fixture(params=BLOCKS.values(), ids=BLOCKS)
def block(request):
    """Return a block of each kind."""
    return request.param


FLAGS = ["-O2", "-std=c99", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]


class Compiled:
    """The C of a program, compiled: makes a step at each call, as `Block.online` does.

    Attributes
    ----------
    state : ndarray
        The program's structure: memory, parameters, time of the first step, number of steps.
    """

    def __init__(self, program, file, library):
        self.program, self.file = program, file
        self._functions = [getattr(library, f"{file.name}_{part}") for part in ("init", "evaluate", "advance")]
        self.begin()

    def begin(self):
        """Go back to the beginning."""
        tuned = sum(len(t.start) for t in self.program.tunables)
        self.state = np.full(self.file.memory + tuned + 2, np.nan)
        self._in = np.zeros(max(sum(len(s.places) for s in self.program.inputs), 1))
        self._out = np.zeros(max(sum(len(s.places) for s in self.program.outputs), 1))
        self._call(0)

    @property
    def parameters(self):
        """The numbers of all tunables, one after the other, as a view."""
        return self.state[self.file.memory : -2]

    def _call(self, which, *arrays):
        self._functions[which](*(ctypes.c_void_p(array.ctypes.data) for array in (self.state, *arrays)))

    def evaluate(self, **inputs):
        """Return the outputs, flat."""
        values = [np.ravel(inputs.get(s.name, s.start)) for s in self.program.inputs]
        self._in[: sum(map(len, values))] = np.concatenate([np.zeros(0), *values])
        self._call(1, self._in, self._out)
        found, at = {}, 0
        for signal in self.program.outputs:
            found[signal.name] = self._out[at : at + len(signal.places)].copy()
            at += len(signal.places)
        return found

    def __call__(self, **inputs):
        found = self.evaluate(**inputs)
        self._call(2)
        return found


@pytest.fixture(scope="session")
def compiled_together(c_compiler):
    """Return what compiles programs in a folder to one library."""

    def make(folder, programs):
        files = [write_c(program) for program in programs]
        for file in files:
            (folder / f"{file.name}.h").write_text(file.header)
            (folder / f"{file.name}.c").write_text(file.source)
        library = f"{files[0].name}.so"
        command = [c_compiler, *FLAGS, *(f"{file.name}.c" for file in files), "-o", library, "-lm"]
        made = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr[:3000]
        loaded = ctypes.CDLL(str(folder / library))
        return [Compiled(program, file, loaded) for program, file in zip(programs, files, strict=True)]

    return make


@pytest.fixture(scope="session")
def compiled_blocks():
    """Return those of `BLOCKS` that have been compiled, by their identity."""
    return {}


@pytest.fixture
def compiled(tmp_path, compiled_together, compiled_blocks):
    """Return what compiles a block, or makes a compiled one of `BLOCKS` begin again."""

    def make(exported, **settings):
        key = id(exported), repr(settings)
        if key in compiled_blocks:
            compiled_blocks[key].begin()
            return compiled_blocks[key]
        (made,) = compiled_together(tmp_path, [program_of(exported, **settings)])
        if any(exported is block for block in BLOCKS.values()):
            compiled_blocks[key] = made
        return made

    return make


@pytest.fixture
def sample_time():
    """Return the sample time to name for a block: none where it has its own."""
    return lambda block: None if block.sample_time else DT


@pytest.fixture
def random_inputs():
    """Return what makes a step's inputs: noise as it is drawn, other inputs with missing samples."""

    def inputs(block, rng):
        values = {}
        for port in block.inputs:
            shape = port.shape or (1,)
            values[port.name] = rng.uniform(size=shape) if port.draw == "uniform" else rng.normal(size=shape)
            if port.draw is None and port.feedthrough:
                values[port.name][rng.uniform(size=shape) < 0.05] = np.nan
        return values

    return inputs


class Instance:
    """An instance of an exported FMU behind fmpy's own objects, by the names of the block's signals; keeps its log."""

    def __init__(self, path, folder):
        self.description = fmpy.read_model_description(str(path))
        self.three = self.description.fmiVersion.startswith("3")
        self.log = []
        self._references, self.size = {}, {}
        for variable in self.description.modelVariables:
            name = variable.name.partition("[")[0]
            self._references.setdefault(name, []).append(variable.valueReference)
            lengths = [int(dimension.start) for dimension in variable.dimensions]
            self.size[name] = self.size.get(name, 0) + int(np.prod(lengths))
        self.fmu = (fmi3.FMU3Slave if self.three else fmi2.FMU2Slave)(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="it",
        )
        if self.three:
            self.fmu.instantiate(logMessage=lambda _, status, category, line: self.log.append(line.decode()))
        else:
            callbacks = fmi2.fmi2CallbackFunctions()
            callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *given: self.log.append(given[-1].decode()))
            self.fmu.instantiate(callbacks=callbacks)

    def begin(self, start=0.0, stop=None, **values):
        self.set(**values)
        self.enter(start, stop)
        self.fmu.exitInitializationMode()
        return self

    def enter(self, start=0.0, stop=None):
        if not self.three:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
        self.fmu.enterInitializationMode(**({"startTime": start, "stopTime": stop} if self.three else {}))

    def set(self, **values):
        set_ = self.fmu.setFloat64 if self.three else self.fmu.setReal
        for name, value in values.items():
            set_(self._references[name], np.ravel(value).tolist())

    def get(self, name):
        if self.three:
            return np.array(self.fmu.getFloat64(self._references[name], self.size[name]))
        return np.array(self.fmu.getReal(self._references[name]))

    def step(self, k, h, start=0.0, **inputs):
        self.set(**inputs)
        self.fmu.doStep(start + k * h, h)

    def refused(self, call):
        """Return the one line that is logged by a call that fails."""
        before = len(self.log)
        with pytest.raises(FMICallException) as caught:
            call(self)
        assert caught.value.status == 3
        assert len(self.log) == before + 1
        return self.log[-1]


@pytest.fixture
def instance(tmp_path):
    """Return what makes instances of an FMU; all are freed in the end."""
    made = []

    def make(path):
        folder = tmp_path / f"unpacked {len(made)}"
        fmpy.extract(str(path), str(folder))
        made.append(Instance(path, folder))
        return made[-1]

    yield make
    for each in made:
        each.fmu.freeInstance()


_LARGE = ("SwitchingPrecision", "switching alone", "nonlinear", "active inference", "StudentTUpdate", "VariationalBayesKF",
          "WishartPrecision", "WeightedLikelihood", "ExplicitDetection", "EFFDI", "SERFDI", "lqg", "joint belief")  # fmt: skip


def pytest_collection_modifyitems(items):
    """Leave large blocks to the slow tests where what is asked does not hang on size; their bits are compared always."""
    for item in items:
        asks = item.path.name in {"test_tunables.py", "test_dependencies.py"} or "validators" in item.name
        if item.path.parent == Path(__file__).parent and asks and any(f"[{name}" in item.name for name in _LARGE):
            item.add_marker(pytest.mark.slow)
