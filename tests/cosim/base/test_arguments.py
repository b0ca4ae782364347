"""Arguments that a block does not have are refused with a sentence that names the right ones."""

import copy
import inspect
import pickle
from dataclasses import dataclass

import pytest

from bayesftc import controllers, cosim

MODEL = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 0.01, 1.0, dt=0.1)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: cosim.Freeze(end=5.0), "Freeze has no argument 'end'; did you mean 'stop' or 'duration'?"),
        (lambda: cosim.Drift(slop=5.0), "Drift has no argument 'slop'; did you mean 'slope' or 'stop'?"),
        (lambda: cosim.Gaussian(sigma=1.0), "Gaussian has no argument 'sigma'; did you mean 'std'?"),
        (lambda: cosim.Constant(1.0, colour=2), "Constant has no argument 'colour'; known names: unit, value."),
        (
            lambda: controllers.StateEstimator(MODEL, learner=controllers.GammaPrecision()),
            "StateEstimator has no argument 'learner'; known names: initial_covariance, initial_mean, invalid, model, precision.",
        ),
        (
            lambda: controllers.GammaPrecision(forgeting=0.9),
            "GammaPrecision has no argument 'forgeting'; did you mean 'forgetting' or 'forget_to'?",
        ),
        (
            lambda: controllers.LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 1.0, dt=1.0, name="a"),
            "LinearModel has no argument 'name'; did you mean 'names'?",
        ),
        (
            lambda: cosim.Freeze(0, 5.0),
            "Freeze has 2 arguments without a name, but takes none; write Freeze(sensor=..., start=...).",
        ),
        (
            lambda: cosim.Constant(1.0, "m", 3),
            "Constant has 3 arguments without a name, but takes at most 2; write Constant(value=..., unit=...).",
        ),
        (lambda: cosim.Step(1.0), "Step lacks the argument 'after'; write Step(time=..., after=...)."),
        (lambda: cosim.Step(after=1.0), "Step lacks the argument 'time'; write Step(time=..., after=...)."),
        (lambda: cosim.Drift(start=1.0), "Drift lacks the argument 'slope'; write Drift(slope=...)."),
        (
            lambda: cosim.closed_loop(MODEL, None, control="u", measured="y"),
            "closed_loop lacks the argument 'reference'; write closed_loop(plant=..., controller=..., control=..., "
            "measured=..., reference=...).",
        ),
        (
            lambda: cosim.closed_loop(control="u", measured="y", reference=0.0),
            "closed_loop lacks the arguments 'plant' and 'controller'; write closed_loop(plant=..., controller=..., control=..., "
            "measured=..., reference=...).",
        ),
        (
            lambda: cosim.closed_loop(MODEL, None, "u", "y", 1.0),
            "closed_loop has 5 arguments without a name, but takes at most 2; write closed_loop(plant=..., controller=..., "
            "control=..., measured=..., reference=...).",
        ),
        (
            lambda: cosim.closed_loop(MODEL, None, control="u", measured="y", goal=1.0),
            "closed_loop has no argument 'goal'; did you mean 'reference'?",
        ),
    ],
)
def test_a_wrong_argument_is_named_with_the_right_ones(make, sentence):
    with pytest.raises(TypeError) as caught:
        make()
    assert str(caught.value) == sentence


def test_a_call_without_arguments_is_left_to_python():  # because copies are made in this way
    with pytest.raises(TypeError, match="missing 1 required keyword-only argument: 'slope'"):
        cosim.Drift()


def test_a_function_keeps_its_signature():
    assert list(inspect.signature(cosim.closed_loop).parameters)[:3] == ["plant", "controller", "control"]
    assert pickle.loads(pickle.dumps(cosim.closed_loop)) is cosim.closed_loop


def test_blocks_with_constructors_of_their_own_are_made_and_copied():
    class Anything(cosim.Block):
        def __init__(self, *args, **settings):
            self.given = args, settings

    @dataclass(frozen=True)
    class Own(cosim.Source):
        gain: float

        def define(self, step):
            raise NotImplementedError

    assert Anything(1, end=2).given == ((1,), {"end": 2})
    assert Own(gain=2.0).gain == 2.0
    with pytest.raises(TypeError, match="Own has no argument 'gian'; did you mean 'gain'"):
        Own(gian=2.0)
    freeze = cosim.Freeze(start=3.0)
    assert pickle.loads(pickle.dumps(freeze)) == copy.deepcopy(freeze) == freeze


@pytest.mark.parametrize("times", [{"start": -1.0}, {"start": -2.0, "stop": -1.0}])
def test_a_fault_before_the_beginning_is_refused(times):
    with pytest.raises(cosim.ModelError, match=r"Freeze has start=-\d.* a run begins at 0 s\. Give start=0"):
        cosim.Freeze(**times)
