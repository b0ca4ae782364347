"""A block on its own is the block in the diagram, step by step."""

import copy
import io
import math
import pickle
import threading

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim import Port
from bayesftc.cosim.ops import isnan, select


def filter_output(y, goal, kept, gain, u, last):
    kept[0] = select(isnan(y[0]), kept[0], kept[0] + gain[0] * (y[0] - kept[0]))
    u[0] = goal[0] - kept[0]
    last[0] = y[0]
    last[1] = y[1]


def filter_update(k, t, kept, gain):
    kept[1] = kept[1] + gain[0] * t / (k + 1)
    kept[0] = kept[0] + 0.01 * kept[1]


class Filter(cosim.Block):
    inputs = (Port("y", (2,)), Port("goal", default=1.5))
    outputs = (Port("u"), Port("last", (2,)))
    sample_time = cosim.Diagram("1/30").step

    def define(self, step):
        return cosim.Definition(filter_output, filter_update, {"kept": [0.0, 1.0]}, {"gain": 0.3})


@pytest.fixture(params=[True, False], ids=["compiled", "plain"])
def step(request):
    return Filter().online(compiled=request.param)


def test_is_the_block_of_the_diagram(step, same_bits):
    diagram = cosim.Diagram("1/30")
    noise, block = diagram.add(cosim.Gaussian((1.0, 2.0))), diagram.add(Filter())
    diagram.connect(noise["y"], block["y"])
    result = diagram.simulate(3, seed=8)
    for _ in range(2):
        outs = [step(y=y) for y in result["gaussian.y"]]
        same_bits([out.u for out in outs], result["filter.u"])
        same_bits([out["last"] for out in outs], result["filter.last"])
        step.reset()


def test_outputs(step):
    out = step(y=[1.0, 2.0])
    assert isinstance(out.u, float)
    assert out.last.tolist() == [1.0, 2.0]
    assert sorted(out) == ["last", "u"]
    kept = out.last
    step(y=[5.0, 6.0])
    assert kept.tolist() == [1.0, 2.0]  # what was handed out does not change
    with pytest.raises(AttributeError, match="The block has no output 'las'; did you mean 'last'"):
        out.las  # noqa: B018
    with pytest.raises(AttributeError, match=r"depend on its learner .* Use out\.get\('fault_kind'\)"):
        out.fault_kind  # noqa: B018
    assert {"u", "last", "items"} <= set(dir(out))  # what a console completes
    assert repr(out).startswith("Outputs(u=")
    assert repr(type(out)(p=np.full((2, 8), 1 / 3), q=np.ones(2))) == "Outputs(p=<2 x 8 numbers>, q=array([1., 1.]))"
    assert repr(step).startswith("<Step of ")


def test_missing_samples(step):
    for y in ([None, 2.0], [math.nan, 2.0], (np.nan, np.float32(2.0)), np.array([np.nan, 2])):
        out = step(y=y)
        assert math.isnan(out.last[0])
        assert out.last[1] == 2.0
        assert math.isfinite(out.u)


def test_an_input_that_is_left_out_takes_its_start_value(step):
    first = step(y=[0.0, 0.0]).u
    assert first == 1.5
    step.reset()
    assert step(y=[0.0, 0.0], goal=7.0).u == 7.0
    step.reset()
    step(y=[0.0, 0.0], goal=[9.0])
    goal_again = step(y=[0.0, 0.0]).u
    step.reset()
    step(y=[0.0, 0.0])
    assert step(y=[0.0, 0.0]).u == goal_again


@pytest.mark.parametrize(
    ("inputs", "error", "sentence"),
    [
        ({}, cosim.ModelError, r"Filter needs its input 'y' at every step; give y=\.\.\."),
        ({"y": [1.0]}, cosim.ModelError, r"Filter: the input 'y' has the shape \(1,\); it must be \(2,\)"),
        ({"y": 1.0}, cosim.ModelError, r"the input 'y' has the shape \(\); it must be \(2,\)"),
        ({"y": [[1.0, 2.0]]}, cosim.ModelError, r"the input 'y' has the shape \(1, 2\)"),
        ({"y": ["a", 1.0]}, cosim.ModelError, r"the input y=\['a', 1.0\] is not a number or a sequence of numbers"),
        ({"y": [[1.0], [1.0, 2.0]]}, cosim.ModelError, r"is not a number or a sequence of numbers"),
        ({"y": [1j, 1.0]}, cosim.ModelError, r"is not a number or a sequence of numbers"),
        ({"y": [1.0, 2.0], "gaol": 1.0}, cosim.UnknownNameError, r"Filter has no input 'gaol'; did you mean 'goal'"),
    ],
)
def test_wrong_inputs_change_nothing(step, inputs, error, sentence):
    with pytest.raises(error, match=sentence):
        step(**inputs)
    assert step(y=[0.0, 0.0]).u == 1.5


def test_inputs_by_position_are_refused_with_their_names(step):
    with pytest.raises(cosim.ModelError, match=r"Filter takes its inputs by name: step\(y=\.\.\., goal=\.\.\.\)"):
        step([0.0, 0.0], 1.0)
    assert step(y=[0.0, 0.0]).u == 1.5


def test_sample_time():
    with pytest.raises(cosim.StepSizeError, match=r"Filter runs every 1/30 s, not every 0.1 s"):
        Filter().online(0.1)
    assert Filter().online("1/30")(y=[0.0, 0.0]).u == 1.5
    with pytest.raises(cosim.StepSizeError, match=r"Ramp has no sample time; give online\(dt=...\) in seconds"):
        cosim.Ramp(1.0).online()
    ramp = cosim.Ramp(3.0).online(0.5)
    assert [ramp().y for _ in range(3)] == [0.0, 1.5, 3.0]
    with pytest.raises(cosim.StepSizeError, match="must be positive"):
        cosim.Ramp(1.0).online(0)


def test_randomness_is_an_input():
    noise = cosim.Gaussian(2.0, mean=1.0).online(1)
    assert noise(noise=0.5).y == 2.0
    with pytest.raises(cosim.ModelError, match="needs its input 'noise'"):
        noise()


def test_external_blocks_do_not_run_online():
    with pytest.raises(cosim.ModelError, match="ExternalBlock runs in diagrams only"):
        cosim.ExternalBlock().online(1)


def test_python_callbacks_run_online(make_block):
    def callback(t, y):
        y[0] = math.cos(float(t))

    step = make_block(outputs=[Port("y")], output=callback, compiled=False).online(1)
    assert [step().y for _ in range(3)] == [math.cos(k) for k in range(3)]


def test_each_has_its_own_state(same_bits):
    steps = [Filter().online() for _ in range(4)]
    rows = [[] for _ in steps]

    def work(i):
        for k in range(500):
            rows[i].append(steps[i](y=[k * (i + 1) * 0.1, 0.0]).u)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(4):
        plain = Filter().online(compiled=False)
        same_bits(rows[i], [plain(y=[k * (i + 1) * 0.1, 0.0]).u for k in range(500)])


@pytest.mark.parametrize("how", ["copied", "pickled", "restored", "from a file"])
def test_goes_on_from_a_saved_state(step, how, same_bits):
    """A copy had step functions that wrote into the memory of the original."""
    rows = [[k * 0.1, 0.0] for k in range(20)]
    for row in rows[:10]:
        step(y=row)
    again = Filter().online(compiled=False)
    if how == "copied":
        again = copy.deepcopy(step)
    elif how == "pickled":
        again = pickle.loads(pickle.dumps(step))
    elif how == "restored":
        again.restore(step.save_state())
    else:
        file = io.BytesIO()
        np.save(file, step.save_state())
        again.restore(np.load(io.BytesIO(file.getvalue())))
    expected = [step(y=row).u for row in rows[10:]]
    same_bits([again(y=row).u for row in rows[10:]], expected)
    again.reset()
    same_bits(again(y=rows[0]).u, Filter().online(compiled=False)(y=rows[0]).u)


def test_a_controller_and_a_subsystem_go_on_from_a_saved_state(same_bits):
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    inner = cosim.Diagram("0.1")
    integral = inner.add(cosim.Integrator())
    whole = cosim.Subsystem(inner, inputs={"u": integral["u"]}, outputs={"y": integral["y"]})
    for block, inputs in (
        (controllers.BayesianController(model), {"y": [0.3, 0.1], "goal": [1.0]}),
        (whole, {"u": 2.0}),
    ):
        step = block.online(compiled=False)
        for _ in range(3):
            step(**inputs)
        again = pickle.loads(pickle.dumps(step))
        expected, repeated = step(**inputs), again(**inputs)
        for name, value in expected.items():
            same_bits(repeated[name], value)


def changed(step, place, value):
    state = step.save_state()
    state[place] = value
    return state


def test_a_state_of_another_block_is_refused(step):
    """With other settings the old ones would be restored, silently."""
    integral = cosim.Integrator().online(dt=0.1, compiled=False)
    wrong = [
        step.save_state(),
        changed(integral, -1, np.nan),
        changed(integral, -1, -3.5),
        changed(integral, -1, np.inf),
        changed(integral, -1, 0.5),
    ]
    for state in (*wrong, "abc", {}, None, 3.0):
        with pytest.raises(
            cosim.ModelError, match="Integrator: this is no state of such a block; give what save_state"
        ):
            integral.restore(state)
    with pytest.raises(cosim.ModelError, match="Integrator: this state belongs to a block with other settings"):
        integral.restore(cosim.Integrator().online(dt=0.5, compiled=False).save_state())
    gains = [controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 0.001, noise, dt=0.1) for noise in (0.04, 4.0)]
    one, other = (controllers.StateEstimator(model).online(compiled=False) for model in gains)
    with pytest.raises(cosim.ModelError, match="StateEstimator: this state belongs to a block with other settings"):
        one.restore(other.save_state())
    assert integral(u=1.0).y == 0.0


def test_a_subsystems_state_of_other_settings_is_refused():
    def made(factor):
        inside = cosim.Diagram(dt=0.1)
        gain = inside.add(cosim.Gain(factor), "gain")
        return cosim.Subsystem(inside, inputs={"e": ["gain.u"]}, outputs={"u": gain["y"]}).online(compiled=False)

    with pytest.raises(cosim.ModelError, match="Subsystem: this state belongs to a block with other settings"):
        made(2.0).restore(made(5.0).save_state())


def test_the_quick_form_is_a_call_with_flat_vectors():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    called, quick = (controllers.BayesianController(model).online(compiled=False) for _ in range(2))
    assert list(quick.inputs) == ["y", "goal"]
    for y in ([0.1, 0.2], [math.nan, 0.3]):
        out = called(y=y, goal=[1.0])
        row = quick.advance(np.array([*y, 1.0]))
        assert np.array_equal(row, np.concatenate([np.ravel(value) for value in out.values()]), equal_nan=True)
    with pytest.raises(cosim.ModelError, match=r"3 elements of inputs \(y, goal\), not 1"):
        quick.advance(np.array([20.0]))


def test_none_means_that_all_samples_are_missing():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    short, full = (controllers.BayesianController(model).online(compiled=False) for _ in range(2))
    np.testing.assert_array_equal(short(y=None, goal=[1.0]).u, full(y=[None, math.nan], goal=[1.0]).u)
