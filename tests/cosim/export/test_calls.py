"""Exported FMUs, called as importers call FMUs: states, reset, several instances, times, and what is refused."""

import math
import pickle
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import controllers, cosim

H, STEPS = 0.02, 60
MODEL = controllers.LinearModel(
    A=[[0.999]], B=[[2e-4]], C=[[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt="1/50"
)
BLOCKS = {
    "controller": controllers.BayesianController(MODEL, precision=controllers.GammaPrecision(), initial_mean=20.0),
    "fault": cosim.Freeze(sensor=1, start=0.3, stop=0.9, channels=2),  # knows the time
    "source": cosim.Sine(amplitude=2.0, period=0.7),  # has no input
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory, c_compiler):
    folder = tmp_path_factory.mktemp("exported")
    return {
        (name, fmi): cosim.export_fmu(block, folder / f"{name}{fmi[0]}.fmu", fmi=fmi, dt=block.sample_time or "1/50")
        for name, block in BLOCKS.items()
        for fmi in ("2.0", "3.0")
    }


@pytest.fixture(params=["2.0", "3.0"])
def fmi(request):
    return request.param


@pytest.fixture(params=BLOCKS)
def name(request):
    return request.param


def inputs(block, missing=True):
    """Return the inputs of each step: noise, and missing samples now and then."""
    rng = np.random.default_rng(5)
    rows = [{port.name: rng.normal(size=port.shape or (1,)) for port in block.inputs} for _ in range(STEPS)]
    for row in rows[::7] if missing else ():
        for value in row.values():
            value[0] = np.nan
    return rows


def driven(instance, block, first=0, last=STEPS, start=0.0):
    """Return all outputs of each step, as rows: a source's before it is made, and those that inputs act on after it."""
    rows = []
    for k, given in list(enumerate(inputs(block)))[first:last]:
        if block.inputs:
            instance.step(k, H, start, **given)
        rows.append(np.concatenate([instance.get(port.name) for port in block.outputs]))
        if not block.inputs:
            instance.step(k, H, start)
    return np.array(rows)


def by_python(block, given):
    """Return the same of plain Python."""
    step = block.online("1/50", compiled=False)
    return np.array([np.concatenate([np.ravel(value) for value in step(**row).values()]) for row in given])


@pytest.fixture
def expected(name):
    block = BLOCKS[name]
    return by_python(block, inputs(block))


@pytest.mark.slow
def test_steps_are_those_of_python(exported, instance, name, fmi, expected, same_bits):
    it = instance(exported[name, fmi]).begin()
    same_bits(driven(it, BLOCKS[name]), expected)
    assert it.log == []


@pytest.mark.slow
@pytest.mark.parametrize("at", [0, 23])
def test_a_saved_state_goes_on_as_python_does(exported, instance, name, fmi, expected, at, same_bits):
    """In the same instance, in another one from bytes, and before any step."""
    block = BLOCKS[name]
    it = instance(exported[name, fmi]).begin()
    same_bits(driven(it, block, 0, at), expected[:at].reshape(at, -1)) if at else None
    state = it.fmu.getFMUState()
    same_bits(driven(it, block, at), expected[at:])
    it.fmu.setFMUState(state)
    same_bits(driven(it, block, at), expected[at:])
    data = it.fmu.serializeFMUState(state)
    assert it.fmu.serializeFMUState(state) == data
    it.fmu.freeFMUState(state)
    other = instance(exported[name, fmi])  # the state carries along that it is initialized
    state = other.fmu.deserializeFMUState(data)
    other.fmu.setFMUState(state)
    other.fmu.freeFMUState(state)
    same_bits(driven(other, block, at), expected[at:])


def test_a_state_is_refused_where_it_does_not_belong(exported, instance, fmi):
    it = instance(exported["controller", fmi]).begin()
    other = instance(exported["fault", fmi]).begin()
    state = it.fmu.getFMUState()
    data = it.fmu.serializeFMUState(state)
    it.fmu.freeFMUState(state)
    assert "bytes, not" in other.refused(lambda c: c.fmu.deserializeFMUState(data))
    assert "not a serialised state" in it.refused(lambda c: c.fmu.deserializeFMUState(bytes(len(data))))


def remember(u, x, y):
    y[0] = x[0]
    x[0] = u[0]


class Large(cosim.Block):
    """A block with more numbers than a stack holds, which has 8 MB on most systems."""

    inputs = (cosim.Port("u"),)
    outputs = (cosim.Port("y"),)

    def define(self, step):
        return cosim.Definition(remember, state={"x": np.zeros(1_100_000)})


@pytest.mark.slow
def test_a_state_may_be_larger_than_the_stack(instance, tmp_path, fmi, c_compiler):
    it = instance(cosim.export_fmu(Large(), tmp_path / "large.fmu", fmi=fmi, dt=H)).begin()
    it.step(0, H, u=3.0)
    state = it.fmu.getFMUState()
    it.step(1, H, u=4.0)
    restored = it.fmu.deserializeFMUState(it.fmu.serializeFMUState(state))
    it.fmu.setFMUState(restored)
    it.step(1, H, u=5.0)
    assert it.get("y") == 3.0
    for each in (state, restored):
        it.fmu.freeFMUState(each)


def test_a_saved_run_goes_on_in_this_packages_own_import(exported, name, fmi, fed, same_bits):
    """The state of the whole run is pickled and restored in a session of its own."""
    block, fmu = BLOCKS[name], cosim.FMU(exported[name, fmi])
    given = inputs(block, missing=False)
    expected = by_python(block, given)

    def diagram():
        values = {}
        for port in fmu.inputs:
            source, _, index = port.name.partition("[")
            columns = np.array([row[source] for row in given]).T
            values[port.name] = columns[[int(index[:-1])]] if index else columns
        return fed(fmu, values, "it")

    def rows(result):
        return np.column_stack([result[f"it.{port.name}"].reshape(len(result.time), -1) for port in fmu.outputs])

    with diagram().start(engine="interpreted") as session:
        same_bits(rows(session.advance(23 * H)), expected[:24])
        saved = pickle.dumps(session.save_state())
        same_bits(rows(session.advance((STEPS - 24) * H)), expected[24:])
    with diagram().start(engine="interpreted") as session:
        session.restore(pickle.loads(saved))
        same_bits(rows(session.advance((STEPS - 24) * H)), expected[24:])


def test_reset_begins_anew(exported, instance, name, fmi, expected, same_bits):
    it = instance(exported[name, fmi]).begin()
    driven(it, BLOCKS[name], 0, 9)
    it.fmu.terminate()
    it.fmu.reset()
    same_bits(driven(it.begin(), BLOCKS[name]), expected)
    it.refused(lambda c: c.fmu.doStep(0.0, H))  # stands elsewhere, so this is an error, of which reset is the end
    it.fmu.reset()
    same_bits(driven(it.begin(), BLOCKS[name]), expected)


@pytest.mark.sampled(2)
def test_instances_do_not_disturb_each_other(exported, instance, name, fmi, expected, same_bits):
    block = BLOCKS[name]
    one, two = (instance(exported[name, fmi]).begin() for _ in range(2))
    found = []
    for k in range(STEPS):
        two.step(k, H, **{port.name: np.full(port.size, 1e3 * k) for port in block.inputs})
        found.append(driven(one, block, k, k + 1)[0])
    same_bits(np.array(found), expected)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("start", [-3.0, 1e6, 1.7e9])  # the last one is the time of a clock on the wall
def test_another_start_time(exported, instance, fmi, start, same_bits):
    """What knows no time gives the same; a source gives what belongs to its time."""
    block = BLOCKS["controller"]
    zero = driven(instance(exported["controller", fmi]).begin(), block)
    same_bits(driven(instance(exported["controller", fmi]).begin(start), block, start=start), zero)
    source = driven(instance(exported["source", fmi]).begin(start), BLOCKS["source"], start=start)[:, 0]
    time = start + np.arange(STEPS) / 50
    np.testing.assert_allclose(source, 2.0 * np.sin(2 * np.pi * time / 0.7), atol=1e-12 + 50 * np.spacing(abs(start)))


@pytest.mark.parametrize("start", [0.0, 1e5, 1.7e9])
def test_a_step_that_an_importer_computes_from_its_times(exported, instance, fmi, start):
    """It differs from the controller's in what rounding leaves of a difference of times."""
    it = instance(exported["controller", fmi]).begin(start)
    time = start
    for _ in range(20):
        following = time + H
        it.fmu.doStep(time, following - time)
        time = following
    assert it.log == []


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seconds", ["1/30", "1/3000"])
def test_a_step_that_an_importer_counts_in_nanoseconds(instance, tmp_path, fmi, seconds, c_compiler):
    """Of such a step there is no whole number; libcosim is an importer of this kind."""
    it = instance(cosim.export_fmu(cosim.Gain(2.0), tmp_path / "gain.fmu", fmi=fmi, dt=seconds)).begin()
    h = round(Fraction(seconds) * 10**9) / 1e9
    for k in range(20):
        it.step(k, h, u=float(k))
        assert it.get("y") == 2.0 * k
    assert "must be" in it.refused(lambda c: c.fmu.doStep(20 * h, 1.001 * h))


@pytest.mark.sampled(8)
@pytest.mark.parametrize("start", [0.0, 1e6, 1.7e9])
@pytest.mark.parametrize("steps", [1.0, -1.0, 0.5, 0.1])
def test_another_time_is_refused(exported, instance, fmi, start, steps):
    """A step that is left out, or made twice, is noticed however late it is."""
    it = instance(exported["controller", fmi]).begin(start)
    it.fmu.doStep(start, H)
    assert "is not the time" in it.refused(lambda c: c.fmu.doStep(start + H + steps * H, H))


@pytest.mark.parametrize("h", [0.01, 0.04, H * (1 + 1e-6), 1e-9, 0.0, -H, math.nan, math.inf])
def test_another_step_is_refused_with_a_line_in_the_log(exported, instance, fmi, h):
    it = instance(exported["controller", fmi]).begin()
    line = it.refused(lambda c: c.fmu.doStep(0.0, h))
    if math.isfinite(h) and h > 0:
        assert "must be 0.02" in line
        assert "controller" in line
    else:
        assert "must be positive and finite" in line


def test_the_stop_time(exported, instance, fmi):
    it = instance(exported["controller", fmi]).begin(stop=3 * H)
    for k in range(3):
        it.step(k, H)
    assert "passes the stop time" in it.refused(lambda c: c.step(3, H))


@pytest.mark.parametrize(
    ("phase", "call", "message"),
    [
        ("instantiated", lambda c: c.step(0, H), "not allowed in the state 'instantiated'"),
        ("instantiated", lambda c: c.get("u"), "not allowed in the state 'instantiated'"),
        ("instantiated", lambda c: c.set(u=0.0), "is computed by the model"),
        ("instantiated", lambda c: c.fmu.exitInitializationMode(), "not allowed in the state 'instantiated'"),
        ("initialization", lambda c: c.step(0, H), "not allowed in the state 'initialization mode'"),
        ("initialization", lambda c: c.enter(), "not allowed in the state 'initialization mode'"),
        ("stepping", lambda c: c.enter(), "not allowed in the state 'step mode'"),
        ("stepping", lambda c: c.set(u=0.0), "is computed by the model"),
        ("stepping", lambda c: c.step(1, H), "is not the time 0 at which"),
        ("stepping", lambda c: c.step(-1, H), "is not the time 0 at which"),
        ("terminated", lambda c: c.step(0, H), "not allowed in the state 'terminated'"),
        ("terminated", lambda c: c.set(goal=0.0), "not allowed in the state 'terminated'"),
    ],
)
def test_calls_in_the_wrong_order(exported, instance, fmi, phase, call, message, same_bits):
    it = instance(exported["controller", fmi])
    if phase == "initialization":
        it.enter()
    elif phase != "instantiated":
        it.begin()
    if phase == "terminated":
        it.fmu.terminate()
    assert message in it.refused(call)
    it.fmu.reset()
    it.begin().step(0, H)


def test_initial_outputs_follow_what_is_set_in_initialization_mode(exported, instance, fmi):
    """Importers that carry values along connections there, until they stay, get the control for the measured speed."""
    it = instance(exported["controller", fmi])
    it.enter()
    step = BLOCKS["controller"].online(compiled=False)
    for y in (0.0, 21.0, np.nan, 19.0):
        it.set(y=[y, y], goal=22.0)
        assert it.get("u") == step(y=[y, y], goal=[22.0])["u"]
        step.reset()
    it.fmu.exitInitializationMode()
    it.step(0, H, y=[19.0, 19.0])
    assert it.get("u") == step(y=[19.0, 19.0], goal=[22.0])["u"]  # the first sample has counted once
