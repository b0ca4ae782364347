"""Plants in libraries of a user's own: functions in C that are no FMU."""

import ctypes
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numba import cfunc

from bayesftc import cosim

C_STEP = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 4, ctypes.c_double, ctypes.c_int64)
STEP = "int32(voidptr, CPointer(CPointer(double)), CPointer(double), CPointer(double), double, int64)"
DT = 0.01


@cache  # when the first cart is made, and not in each process that collects these tests
def library():
    @cfunc(STEP)
    def read(state, table, inputs, outputs, t, k):
        outputs[0] = table[0][0]
        return 0

    @cfunc(STEP)
    def move(state, table, inputs, outputs, t, k):
        cart = table[0]  # position, speed, mass, step size
        cart[0] += cart[3] * cart[1]
        cart[1] += cart[3] * inputs[0] / cart[2]
        return 7 if abs(inputs[0]) > 1e3 else 0

    return read, move


class RunningCart:
    can_save, has_ended = True, False

    def __init__(self, mass, h, words):
        self.numbers = np.array([0.0, 0.0, mass, h])
        self.table = np.full(words, self.numbers.ctypes.data)
        read, move = library()
        self.output_address, self.update_address = read.address, move.address
        self.read, self.move = C_STEP(read.address), C_STEP(move.address)

    def output(self, inputs, outputs, t):
        return self.read(None, self.table.ctypes.data, inputs.ctypes.data, outputs.ctypes.data, t, 0)

    def update(self, inputs, outputs, t):
        return self.move(None, self.table.ctypes.data, inputs.ctypes.data, outputs.ctypes.data, t, 0)

    def explain(self, status):
        return "The force is absurd."

    def expect_return(self):
        pass

    def save(self):
        return self.numbers.copy()

    def restore(self, saved):
        self.numbers[:] = saved

    def forget(self, saved):
        pass

    def close(self):
        pass


@dataclass(frozen=True)
class Cart(cosim.ExternalBlock):
    mass: float = 1.0
    words: int = 1

    inputs = (cosim.Port("force", unit="N", feedthrough=False, default=0.0),)
    outputs = (cosim.Port("x", unit="m"),)
    checks_finite = True

    def instantiate(self, step, name):
        return RunningCart(self.mass, float(step), self.words)


def pushed(force=2.0, mass=2.0, **options):
    diagram = cosim.Diagram(DT)
    cart, push = diagram.add(Cart(mass, **options), "cart"), diagram.add(cosim.Constant(force))
    diagram.connect(push["y"], cart["force"])
    return diagram


def test_both_engines_and_saved_states(run_both, same_bits):
    diagram = pushed()
    whole = run_both(diagram, 1.0)
    k = np.arange(101)
    np.testing.assert_allclose(whole["cart.x"], DT**2 * k * (k - 1) / 2, atol=1e-14)
    with diagram.start() as session:
        session.advance(0.5)
        here = session.save_state()
        for _ in range(2):
            same_bits(session.advance(0.5)["cart.x"], whole["cart.x"][51:])
            session.restore(here)


def test_a_spring_between_two_is_iterated(run_both):
    diagram = cosim.Diagram(DT)
    left, right = diagram.add(Cart(1.0), "left"), diagram.add(Cart(3.0), "right")
    stretch = diagram.add(cosim.Sum("-+"), "stretch")
    springs = [diagram.add(cosim.Gain(k), n) for k, n in ((40.0, "pull"), (-40.0, "push"))]
    kick = diagram.add(cosim.Sum("++"), "kick")
    diagram.connect([left["x"], right["x"]], stretch["u"])
    for spring in springs:
        diagram.connect(stretch["y"], spring["u"])
    diagram.connect([springs[0]["y"], diagram.add(cosim.Constant(1.0))["y"]], kick["u"])
    diagram.connect(kick["y"], left["force"])
    diagram.connect(springs[1]["y"], right["force"])
    result = run_both(diagram.build("iterated"), 1.0)
    centre = (result["left.x"] + 3.0 * result["right.x"]) / 4.0
    k = np.arange(101)
    np.testing.assert_allclose(centre, DT**2 * k * (k - 1) / 8, atol=1e-9)
    assert np.ptp(result["left.x"] - result["right.x"]) > 0.01


def test_in_python_control():
    import control

    system = Cart(2.0).to_control(DT)
    times = DT * np.arange(51)
    response = control.input_output_response(system, times, np.full(51, 2.0), X0=cosim.initial_state(system))
    np.testing.assert_array_equal(np.ravel(response.outputs), pushed().simulate(0.5)["cart.x"])


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("force", "mass", "sentence"),
    [(2e3, 2.0, "failed. The force is absurd"), (2.0, np.nan, "cart.x came out NaN")],
)
def test_failures_are_sentences(force, mass, sentence, engine):
    with pytest.raises(cosim.SimulationError, match=sentence):
        pushed(force, mass).simulate(1.0, engine=engine)


def test_a_table_that_is_too_long_overwrites_nothing():
    with pytest.raises(cosim.KernelError, match="table of 'cart', a Cart, has 33 words, but the limit is 32"):
        pushed(words=33).simulate(1.0)
    assert pushed(words=32).simulate(1.0)["cart.x"][-1] == pushed().simulate(1.0)["cart.x"][-1]


class StubbornCart(RunningCart):
    """One that some of the time cannot go back."""

    def restore(self, saved):
        if self.asked % 2:
            raise cosim.errors.FMUError("Not now.")
        self.asked += 1
        super().restore(saved)

    asked = 0


@dataclass(frozen=True)
class Stubborn(Cart):
    def instantiate(self, step, name):
        return StubbornCart(self.mass, float(step), self.words)


@pytest.mark.parametrize("block", [Cart(2.0), Stubborn(2.0)], ids=["willing", "stubborn"])
@pytest.mark.parametrize("compiled", [True, False])
def test_campaigns_go_back_or_begin_anew(block, compiled, make_block, campaign_as_alone):
    def output(u, y):
        y[0] = u[0]

    same = make_block(inputs=(cosim.Port("u"),), outputs=(cosim.Port("y"),), output=output, compiled=compiled)
    diagram = cosim.Diagram(DT)
    wind, law = diagram.add(cosim.Gaussian(std=10.0), "wind"), diagram.add(same, "law")
    diagram.connect(wind["y"], law["u"])
    diagram.connect(law["y"], diagram.add(block, "cart")["force"])
    table = campaign_as_alone(diagram, 0.5, seeds=range(7))
    assert (table["status"] == "ok").all()


def test_a_campaign_in_which_a_step_fails(campaign_as_alone):
    diagram = cosim.Diagram(DT)
    diagram.connect(diagram.add(cosim.Gaussian(std=300.0), "wind")["y"], diagram.add(Cart(2.0), "cart")["force"])
    table = campaign_as_alone(diagram, 2.0, seeds=range(12))
    assert set(table["status"]) == {"ok", "failed"}


class Sparse(Cart):
    def instantiate(self, step, name):
        instance = super().instantiate(step, name)
        without = {"expect_return", "has_ended", "__dict__", "__weakref__"}
        members = {k: v for k, v in vars(RunningCart).items() if k not in without}
        members["close"] = lambda _: closed.append(name)
        return type("Sparse", (), members)(instance.numbers[2], float(step), self.words)


closed: list[str] = []


def test_an_instance_that_lacks_something_is_refused():
    closed.clear()
    diagram = cosim.Diagram(DT)
    diagram.add(Sparse(), "cart")
    with pytest.raises(
        cosim.KernelError, match=r"The instance of Sparse, a Sparse, lacks expect_return and has_ended;"
    ):
        diagram.simulate(0.1)
    assert closed == ["cart"]


@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_an_instance_may_end_the_simulation(monkeypatch, engine):
    monkeypatch.setattr(RunningCart, "has_ended", True)
    with pytest.warns(UserWarning, match="as 'cart' requested") as caught:
        result = pushed(force=2e3).simulate(1.0, engine=engine)
    with pushed(force=2e3).start(engine=engine) as session, pytest.warns(UserWarning, match="requested") as live:
        session.advance(1.0)
    assert [warning.filename for warning in (*caught, *live)] == [__file__] * 2
    assert result.stopped == "The run has ended at t = 0 s (step 0), as 'cart' requested. The force is absurd."
    assert len(result.time) == 1
