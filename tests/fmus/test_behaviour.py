"""The shipped FMUs behind fmpy's own slave objects: numbers, saved states, and refusals where a master goes wrong."""

import ctypes
import math
import random
import re
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import extract, fmi2, fmi3, read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException

from bayesftc import fmus
from bayesftc.fmus.build import FMI_VERSIONS

H = 0.02


def car_map(v, force, disturbance, h=H, b=5.0, m=100.0):
    return (1.0 - b / m * h) * v + h / m * force + disturbance


class Slave:
    """One instance, with the same names for FMI 2 and FMI 3, that keeps its log."""

    def __init__(self, folder, token=None, model=None, logger=True):
        description = read_model_description(folder)
        self.fmi = description.fmiVersion
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.log = []
        arguments = {
            "guid": token or description.guid,
            "unzipDirectory": str(folder),
            "modelIdentifier": description.coSimulation.modelIdentifier,
            "instanceName": "car",
        }
        if self.fmi == "2.0":
            self.fmu = (model or fmi2.FMU2Slave)(**arguments)
            callbacks = fmi2.fmi2CallbackFunctions()
            if logger:
                callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log2)
            self.options = {"callbacks": callbacks}
        else:
            self.fmu = (model or fmi3.FMU3Slave)(**arguments)
            self.options = {"logMessage": self._log3}

    def _log2(self, environment, name, status, category, message):
        assert name == b"car"
        self.log.append((status, category.decode(), message.decode()))

    def _log3(self, environment, status, category, message):
        self.log.append((status, category.decode(), message.decode()))

    def instantiate(self):
        self.fmu.instantiate(**self.options)
        return self

    def enter(self, start=0.0, stop=None):
        if self.fmi == "2.0":
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)

    def start(self, start=0.0, stop=None, **values):
        for name, value in values.items():
            self.set(name, value)
        self.enter(start, stop)
        self.fmu.exitInitializationMode()
        return self

    def set(self, name, value):
        (self.fmu.setReal if self.fmi == "2.0" else self.fmu.setFloat64)([self.references[name]], [value])

    def get(self, name):
        return (self.fmu.getReal if self.fmi == "2.0" else self.fmu.getFloat64)([self.references[name]])[0]

    def step(self, k, h=H, start=0.0):
        return self.fmu.doStep(start + k * h, h)

    def drive(self, steps, seed, first=0):
        rng, velocities = random.Random(seed), []
        for k in range(first, first + steps):
            self.set("force", rng.uniform(-1e3, 1e3))
            self.set("disturbance", rng.gauss(0.0, 0.03))
            self.step(k)
            velocities.append(self.get("v"))
        return velocities

    def refused(self, call, *arguments):
        """Return the message of a call that must fail with the status 'error'."""
        before = len(self.log)
        with pytest.raises(FMICallException) as caught:
            call(*arguments)
        assert caught.value.status == 3
        assert len(self.log) == before + 1
        status, category, message = self.log[-1]
        assert (status, category) == (3, "logStatusError")
        return message


@pytest.fixture(scope="module", params=FMI_VERSIONS)
def folder(request, tmp_path_factory):
    return Path(extract(fmus.path("CruiseControl", fmi=request.param), str(tmp_path_factory.mktemp("fmu"))))


@pytest.fixture
def make(folder):
    made = []

    def new(**options):
        slave = Slave(folder, **options).instantiate()
        made.append(slave)
        return slave

    yield new
    for slave in made:
        slave.fmu.freeInstance()


def test_the_recursion_bit_for_bit(make):
    car = make().start(v0=12.5)
    rng, v = random.Random(7), 12.5
    assert car.get("v") == v
    for k in range(2000):
        force, disturbance = rng.uniform(-1e3, 1e3), rng.gauss(0.0, 0.03)
        car.set("force", force)
        car.set("disturbance", disturbance)
        car.step(k)
        v = car_map(v, force, disturbance)
        assert car.get("v") == v
    assert car.log == []


def test_parameters_and_step_size(make):
    # Awkward numbers, so that another order of the operations shows in the last digits.
    b, m, force = 310.7, 777.3, 77.1
    car = make().start(b=b, m=m, v0=-3.3, force=force)
    v, t, reordered = -3.3, 0.0, 0
    for h in (0.013, 0.51, 1e-6, 3.1, 0.7, 0.33, 0.021, 1.7):
        reordered += car_map(v, force, 0.0, h, b, m) != (1.0 - b * h / m) * v + h / m * force
        car.fmu.doStep(t, h)
        v, t = car_map(v, force, 0.0, h, b, m), t + h
        assert car.get("v") == v
    assert reordered


@pytest.mark.parametrize("fmi", FMI_VERSIONS)
def test_fmpys_own_loop(fmi):
    path = fmus.path("CruiseControl", fmi=fmi)
    result = simulate_fmu(
        str(path), stop_time=1.0, output_interval=H, start_values={"v0": 3.0, "force": 40.0}, output=["v"]
    )
    v = [3.0]
    for _ in range(50):
        v.append(car_map(v[-1], 40.0, 0.0))
    assert np.array_equal(result["v"], v)


def test_initial_velocity_in_initialization_mode(make):
    car = make()
    car.enter()
    assert car.get("v") == 0.0
    car.set("v0", 4.25)
    assert car.get("v") == 4.25
    car.set("v0", -1.0)
    car.fmu.exitInitializationMode()
    assert car.get("v") == -1.0


def test_an_output_does_not_depend_on_inputs_at_the_same_point(make):
    car = make().start(v0=2.0)
    car.set("force", 1e6)
    assert car.get("v") == 2.0


def test_nan_is_accepted_and_passed_on(make):
    car = make().start()
    car.set("force", math.nan)
    assert math.isnan(car.get("force"))
    car.step(0)
    assert math.isnan(car.get("v"))
    assert car.log == []


def test_the_instances_own_time(make):
    car = make().start(start=2.0)
    if car.fmi == "3.0":
        assert car.get("time") == 2.0
        assert car.step(0, start=2.0) == (False, False, False, 2.0 + H)
        assert car.get("time") == 2.0 + H
        # The master's own points count, rounded as they may be.
        assert car.fmu.doStep(2.0 + H + 1e-9, H)[3] == 2.0 + H + 1e-9 + H
        assert "'time' (value reference 6) is computed" in car.refused(car.set, "time", 1.0)
    else:
        car.step(0, start=2.0)
        assert car.fmu.getRealStatus(fmi2.fmi2LastSuccessfulTime) == 2.0 + H
        car.fmu.doStep(2.0 + H + 1e-9, H)
        assert car.fmu.getRealStatus(fmi2.fmi2LastSuccessfulTime) == 2.0 + H + 1e-9 + H
        assert car.fmu.getBooleanStatus(fmi2.fmi2Terminated) is False


def test_a_saved_state_continues_identically(make):
    car = make().start(v0=9.0)
    car.drive(20, seed=1)
    state = car.fmu.getFMUState()
    first = car.drive(50, seed=2, first=20)
    car.fmu.setFMUState(state)
    assert car.drive(50, seed=2, first=20) == first
    data = car.fmu.serializeFMUState(state)
    assert car.fmu.serializeFMUState(state) == data
    car.fmu.freeFMUState(state)

    other = make()  # not even initialized: the state carries that along
    state = other.fmu.deserializeFMUState(data)
    other.fmu.setFMUState(state)
    other.fmu.freeFMUState(state)
    assert other.drive(50, seed=2, first=20) == first


def test_a_state_that_is_not_ours_is_refused(make):
    car = make().start()
    state = car.fmu.getFMUState()
    data = car.fmu.serializeFMUState(state)
    car.fmu.freeFMUState(state)
    assert f"has {len(data)} bytes, not 3" in car.refused(car.fmu.deserializeFMUState, b"abc")
    assert "not a serialised state" in car.refused(car.fmu.deserializeFMUState, bytes(len(data)))


def test_instances_do_not_disturb_each_other(make):
    alone = make().start(v0=1.0).drive(100, seed=3)
    one, two = make().start(v0=1.0), make().start(v0=50.0, m=10.0)
    rng, together = random.Random(3), []
    for k in range(100):
        one.set("force", rng.uniform(-1e3, 1e3))
        one.set("disturbance", rng.gauss(0.0, 0.03))
        two.set("force", 1e5 * k)
        two.step(k)
        one.step(k)
        together.append(one.get("v"))
    assert together == alone


def test_reset_returns_to_the_start_values(make):
    car = make().start(v0=9.0, m=7.0)
    car.drive(5, seed=1)
    car.fmu.reset()
    car.start()
    assert (car.get("v"), car.get("m"), car.get("force")) == (0.0, 100.0, 0.0)
    car.step(0)


def test_a_wrong_token_is_refused(folder):
    slave = Slave(folder, token="{of-another}")
    with pytest.raises(Exception, match="Failed to instantiate"):
        slave.instantiate()
    assert slave.log[0][0] == 3
    assert "'{of-another}' is not that of this CruiseControl" in slave.log[0][2]
    slave.fmu.freeLibrary()


def test_no_logger_is_no_crash(folder):
    if (folder / "sources" / "fmi2.c").is_file():
        slave = Slave(folder, logger=False).instantiate()
        with pytest.raises(FMICallException):
            slave.step(0)
        slave.fmu.freeInstance()
        refused = Slave(folder, logger=False, token="wrong")
        with pytest.raises(Exception, match="Failed to instantiate"):
            refused.instantiate()
        refused.fmu.freeLibrary()
    else:
        slave = Slave(folder)
        nothing = ctypes.cast(None, fmi3.fmi3LogMessageCallback)
        arguments = (b"car", slave.fmu.guid.encode(), None, False, False, False, False, None, 0, None, nothing)
        no_update = ctypes.cast(None, fmi3.fmi3IntermediateUpdateCallback)
        instance = slave.fmu.fmi3InstantiateCoSimulation(*arguments, no_update)
        assert instance
        with pytest.raises(FMICallException):
            slave.fmu.fmi3ExitInitializationMode(instance)
        slave.fmu.fmi3FreeInstance(instance)
        slave.fmu.freeLibrary()


def test_other_interfaces_are_refused(folder):
    three = (folder / "sources" / "fmi3.c").is_file()
    models = [fmi3.FMU3Model, fmi3.FMU3ScheduledExecution] if three else [fmi2.FMU2Model]
    for model in models:
        slave = Slave(folder, model=model)
        with pytest.raises(Exception, match="Failed to instantiate"):
            slave.instantiate()
        assert "for co-simulation only" in slave.log[0][2]
        slave.fmu.freeLibrary()
    if three:
        for options in ({"eventModeUsed": True}, {"requiredIntermediateVariables": [2]}):
            slave = Slave(folder)
            slave.options.update(options)
            with pytest.raises(Exception, match="Failed to instantiate"):
                slave.instantiate()
            assert "without event mode and intermediate updates" in slave.log[0][2]
            slave.fmu.freeLibrary()


@pytest.mark.parametrize(
    ("prepare", "call", "message"),
    [
        ("instantiated", lambda c: c.step(0), "DoStep: not allowed in the state 'instantiated'"),
        ("instantiated", lambda c: c.get("v"), "not allowed in the state 'instantiated'"),
        ("instantiated", lambda c: c.fmu.exitInitializationMode(), "ExitInitializationMode: not allowed"),
        ("instantiated", lambda c: c.fmu.terminate(), "Terminate: not allowed"),
        ("instantiated", lambda c: c.set("v", 1.0), "'v' (value reference 2) is computed"),
        ("instantiated", lambda c: c.enter(math.nan), "start time nan is not finite"),
        ("instantiated", lambda c: c.enter(2.0, 1.0), "stop time 1 lies before the start time 2"),
        ("initialization", lambda c: c.step(0), "DoStep: not allowed in the state 'initialization mode'"),
        ("stepping", lambda c: c.enter(), "not allowed in the state 'step mode'"),
        ("stepping", lambda c: c.set("v", 1.0), "'v' (value reference 2) is computed"),
        ("stepping", lambda c: c.set("m", 1.0), "'m' (value reference 4) is a fixed parameter; set it before"),
        ("stepping", lambda c: c.set("v0", 1.0), "'v0' (value reference 5) is a fixed parameter"),
        ("stepping", lambda c: c.step(0, h=0.0), "step size 0 must be positive"),
        ("stepping", lambda c: c.step(0, h=-H), "must be positive"),
        ("stepping", lambda c: c.step(0, h=math.nan), "step size nan"),
        ("stepping", lambda c: c.fmu.doStep(0.0, math.inf), "step size inf"),
        ("stepping", lambda c: c.step(1), "communication point 0.02"),
        ("stepping", lambda c: c.fmu.doStep(1e-9 * H * 1.5, H), "is not the time 0"),
        ("stepping", lambda c: c.fmu.doStep(math.nan, H), "is not the time 0"),
        ("stepping", lambda c: c.fmu.doStep(0.0, 1.001), "passes the stop time 1"),
        ("terminated", lambda c: c.step(0), "DoStep: not allowed in the state 'terminated'"),
        ("terminated", lambda c: c.set("force", 1.0), "not allowed in the state 'terminated'"),
    ],
)
def test_what_a_master_must_not_do(make, prepare, call, message):
    car = make()
    if prepare == "initialization":
        car.enter()
    elif prepare != "instantiated":
        car.start(stop=1.0)
    if prepare == "terminated":
        car.fmu.terminate()
    assert message in car.refused(call, car)
    # An error is the end, but for reading, resetting and restoring.
    assert "not allowed in the state 'error'" in car.refused(car.step, 0)
    car.get("v")
    car.fmu.reset()
    car.start().step(0)


def test_what_only_one_version_can_get_wrong(make):
    car = make()
    if car.fmi == "2.0":
        assert "call fmi2SetupExperiment first" in car.refused(car.fmu.enterInitializationMode)
    else:
        references, values = (ctypes.c_uint32 * 2)(0, 1), (ctypes.c_double * 2)()
        message = car.refused(car.fmu.fmi3SetFloat64, car.fmu.component, references, 2, values, 1)
        assert "1 values for variables with 2 elements" in message


def test_an_unknown_value_reference_is_named(make):
    car = make().start()
    car.references["ghost"] = 4711
    assert "no variable with the value reference 4711" in car.refused(car.get, "ghost")
    car.fmu.reset()
    assert "no variable with the value reference 4711" in car.refused(car.set, "ghost", 1.0)


def test_a_refused_set_changes_nothing(make):
    car = make().start()
    setter = car.fmu.setReal if car.fmi == "2.0" else car.fmu.setFloat64
    car.refused(setter, [0, 2], [5.0, 6.0])
    assert car.get("force") == 0.0


def test_an_error_is_undone_by_restoring_a_state(make):
    car = make().start(v0=3.0)
    state = car.fmu.getFMUState()
    car.refused(car.step, 5)
    car.fmu.setFMUState(state)
    car.fmu.freeFMUState(state)
    car.step(0)
    assert car.get("v") == car_map(3.0, 0.0, 0.0)


def test_rounded_communication_points_and_the_stop_time(make):
    car = make().start(stop=1.0)
    t = 0.0
    for _ in range(50):
        car.fmu.doStep(t, H)
        t += H  # a running sum, off by some last digits
    assert "passes the stop time" in car.refused(car.fmu.doStep, 1.0, H)


def test_other_types_and_unsupported_functions(make):
    car = make().start()
    types = ["Integer", "Boolean"] if car.fmi == "2.0" else ["Int32", "UInt64", "Float32", "Boolean", "Int8"]
    for name in types:
        getattr(car.fmu, f"get{name}")([])
        assert "has another type" in car.refused(getattr(car.fmu, f"get{name}"), [0])
        car.fmu.reset()
        assert "has another type" in car.refused(getattr(car.fmu, f"set{name}"), [0], [1])
        car.fmu.reset()
    if car.fmi == "2.0":
        with pytest.raises(FMICallException) as caught:
            car.fmu.getStatus(fmi2.fmi2DoStepStatus)
        assert caught.value.status == fmi2.fmi2Discard
        assert car.log[-1][:2] == (fmi2.fmi2Discard, "logStatusDiscard")
    car.start().step(0)


def test_log_categories(make):
    car = make()
    car.fmu.setDebugLogging(True, ["logStatusError"])
    assert car.log == []
    car.fmu.setDebugLogging(True, ["logEverything"])
    assert car.log[0][0] == 1
    assert "'logEverything'" in car.log[0][2]


def standard_functions(fmi):
    header = Path(fmpy.__file__).parent / "c-code" / f"fmi{fmi[0]}Functions.h"
    return re.findall(rf"FMI\d_Export\s+fmi\d\w+TYPE\s+(fmi{fmi[0]}\w+);", header.read_text())


UNSUPPORTED = {
    "2.0": "CancelStep SetRealInputDerivatives GetRealOutputDerivatives GetDirectionalDerivative EnterEventMode "
    "NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates GetDerivatives "
    "GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates",
    "3.0": "EnterEventMode EnterStepMode EvaluateDiscreteStates UpdateDiscreteStates EnterConfigurationMode "
    "ExitConfigurationMode GetNumberOfVariableDependencies GetVariableDependencies GetDirectionalDerivative "
    "GetAdjointDerivative GetOutputDerivatives GetIntervalDecimal GetIntervalFraction GetShiftDecimal GetShiftFraction "
    "SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction ActivateModelPartition "
    "EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates GetContinuousStateDerivatives "
    "GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates GetNumberOfEventIndicators "
    "GetNumberOfContinuousStates",
}


def test_every_function_of_the_standard_is_there(make):
    car = make()
    names = standard_functions(car.fmi)
    assert len(names) > 40
    assert [name for name in names if not hasattr(car.fmu.dll, name)] == []
    for name in UNSUPPORTED[car.fmi].split():
        function = car.fmu.dll[f"fmi{car.fmi[0]}{name}"]  # a new object: fmpy has given its own a signature
        function.restype = ctypes.c_int
        before = len(car.log)
        assert function(ctypes.c_void_p(car.fmu.component)) == 3
        assert len(car.log) == before + 1
        assert f"{name}: not supported, because" in car.log[-1][2]
        assert function(None) == 3
