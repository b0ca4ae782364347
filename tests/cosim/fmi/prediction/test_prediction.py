"""The equations of an FMU as functions: against the same Runge-Kutta method, and its derivatives by CasADi's differentiation."""

import threading
import time

import casadi as ca
import numpy as np
import pytest

from bayesftc.controllers import NonlinearModel
from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.fmi.fmu import FMU

DT, PARTS = 0.05, 3
KINDS = ("plain", "directional")


def rate(x, u):
    return ca.vertcat(x[1], -(x[0] ** 3) + u * ca.cos(x[0]))


def transition():
    """Return the classical Runge-Kutta method and its derivatives, by CasADi."""
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    h, z = DT / PARTS, x
    for _ in range(PARTS):
        k1 = rate(z, u)
        k2 = rate(z + h / 2 * k1, u)
        k3 = rate(z + h / 2 * k2, u)
        k4 = rate(z + h * k3, u)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("f", [x, u], [z, ca.jacobian(z, x), ca.jacobian(z, u)])


@pytest.fixture
def model(curved):
    def of(kind, **options):
        return NonlinearModel.from_fmu(
            curved(kind), measured=["y", "x"], actuated="u", dt=DT, substeps=PARTS, **options
        )

    return of


@pytest.mark.parametrize("kind", KINDS)
def test_steps_and_derivatives_are_those_of_the_method(model, kind):
    made, exact = model(kind), transition()
    following, F, B, C, y = np.empty(2), np.empty((2, 2)), np.empty((2, 1)), np.empty((2, 2)), np.empty(2)
    tolerance = 1e-13 if kind == "directional" else 1e-9
    rng = np.random.default_rng(0)
    for x, u in zip(2.0 * rng.normal(size=(20, 2)), 5.0 * rng.normal(size=(20, 1)), strict=True):
        made.f(x, u, following)
        made.f_jacobian(x, u, F, B)
        made.g(x, y)
        made.g_jacobian(x, C)
        reached, by_state, by_control = (np.array(part) for part in exact(x, u))
        np.testing.assert_allclose(following, reached[:, 0], rtol=0, atol=1e-13 * max(1.0, np.abs(reached).max()))
        np.testing.assert_allclose(F, by_state, rtol=0, atol=tolerance * max(1.0, np.abs(by_state).max()))
        np.testing.assert_allclose(B, by_control, rtol=0, atol=tolerance * max(1.0, np.abs(by_control).max()))
        np.testing.assert_allclose(y, [x[0] * x[1], x[0]], rtol=1e-15)
        np.testing.assert_allclose(C, [[x[1], x[0]], [1.0, 0.0]], rtol=0, atol=1e-9)


def test_an_unknown_load_adds_to_the_control(model):
    plain, loaded = model("directional"), model("directional", disturbance=1e-4)
    assert (loaded.states, loaded.disturbances) == (3, 1)
    x, d = np.array([0.3, -0.2]), 0.7
    expected, following = np.empty(2), np.empty(3)
    plain.f(x, np.array([1.0 + d]), expected)
    loaded.f(np.array([*x, d]), np.array([1.0]), following)
    assert following.tolist() == [*expected, d]
    F, B, inner, effect = np.empty((3, 3)), np.empty((3, 1)), np.empty((2, 2)), np.empty((2, 1))
    loaded.f_jacobian(np.array([*x, d]), np.array([1.0]), F, B)
    plain.f_jacobian(x, np.array([1.0 + d]), inner, effect)
    np.testing.assert_array_equal(F, np.block([[inner, effect], [np.zeros((1, 2)), np.eye(1)]]))
    np.testing.assert_array_equal(B, np.vstack([effect, [[0.0]]]))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("x", [np.nan, np.inf, 11.0, -11.0])
def test_where_the_fmu_has_no_value_the_model_is_not_finite_and_works_on(model, kind, x):
    made, u = model(kind), np.zeros(1)
    before, after, nothing, F, B = np.empty(2), np.empty(2), np.zeros(2), np.zeros((2, 2)), np.zeros((2, 1))
    here = np.array([0.1, 0.2])
    made.f(here, u, before)
    made.f(np.array([x, 0.0]), u, nothing)
    made.f_jacobian(np.array([x, 0.0]), u, F, B)
    for result in (nothing, F, B):
        assert np.isnan(result).all()
    made.f(here, u, after)
    assert after.tolist() == before.tolist()


def test_threads_use_instances_of_their_own(model):
    made = model("directional")
    points = np.random.default_rng(1).normal(size=(400, 2))
    alone = np.empty_like(points)
    for x, following in zip(points, alone, strict=True):
        made.f(x, np.ones(1), following)
    together = np.empty((4, *points.shape))

    def work(results):
        for x, following in zip(points, results, strict=True):
            made.f(x, np.ones(1), following)

    threads = [threading.Thread(target=work, args=(results,)) for results in together]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (together == alone).all()


def test_building_an_equal_model_frees_nothing_that_is_in_use(model):
    made, x, u = model("directional"), np.array([0.4, 0.1]), np.ones(1)
    F, B = np.empty((2, 2)), np.empty((2, 1))
    made.f_jacobian(x, u, F, B)
    expected, wrong, stop = F.copy(), [], threading.Event()

    def work():
        F, B = np.empty((2, 2)), np.empty((2, 1))
        while not stop.is_set():
            made.f_jacobian(x, u, F, B)
            if not np.array_equal(F, expected):
                wrong.append(F.copy())

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for _ in range(10):
        model("directional")
    stop.set()
    for thread in threads:
        thread.join()
    assert not wrong


def test_arrays_of_wrong_size_or_type_are_refused(model):
    made, x, u, following = model("plain"), np.zeros(2), np.zeros(1), np.zeros(2)
    fixed = np.zeros(2)
    fixed.flags.writeable = False
    for arguments, message in (
        ((x[:1], u, following), "needs 2 elements for x, not 1"),
        ((x, u, following[:1]), "needs 2 elements for x_next, not 1"),
        ((x, [0.0], following), "needs a contiguous float64 array for u, with 1 elements"),
        ((np.zeros(2, dtype=int), u, following), "needs a contiguous float64 array for x"),
        ((x, u, fixed), "writes x_next, but this array cannot be written to"),
    ):
        with pytest.raises(KernelError, match=message):
            made.f(*arguments)


def pool_of(made):
    return made.f.__closure__[0].cell_contents.prediction.pool


def test_an_instance_that_cannot_be_replaced_is_not_used_again(model, monkeypatch, caplog):
    made, following = model("plain"), np.zeros(2)
    pool = pool_of(made)
    here = np.array([0.1, 0.2])
    made.f(here, np.zeros(1), following)
    expected = following.copy()

    def no_memory():
        raise MemoryError("no memory")

    with monkeypatch.context() as patch:
        patch.setattr(pool, "_open", no_memory)
        for x in (np.array([11.0, 0.0]), here):
            made.f(x, np.zeros(1), following)
            assert np.isnan(following).all()
    assert "cannot be opened once more. no memory" in caplog.text
    made.f(here, np.zeros(1), following)  # it can be opened again
    assert following.tolist() == expected.tolist()


@pytest.mark.slow
def test_ctrl_c_while_an_instance_is_opened_is_not_lost(model, monkeypatch):
    made = model("plain", sensor_std=0.5)
    pool = pool_of(made)
    pool._free()

    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(pool, "_open", interrupted)
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - it comes after the call
        made.f(np.zeros(2), np.zeros(1), np.zeros(2))
        time.sleep(5.0)


@pytest.mark.parametrize(
    ("kind", "message"),
    [("events", "has 1 event indicators: it switches or jumps"), ("discrete", "has the discrete variable 'gear'")],
)
def test_events_are_refused(model, kind, message):
    with pytest.raises(ModelError, match=message):
        model(kind)


@pytest.mark.slow
def test_an_fmu_with_one_instance_a_process_needs_an_isolated_plant(model, curved):
    from bayesftc import cosim
    from bayesftc.cosim.errors import FMUError

    made = model("once")
    following = np.empty(2)
    made.f(np.zeros(2), np.ones(1), following)
    diagram = cosim.Diagram(dt=DT)
    diagram.add(FMU(curved("once")), "plant")
    with pytest.raises(FMUError, match="one instance per process"):
        diagram.simulate(0.1)
    apart = cosim.Diagram(dt=DT)
    apart.add(FMU(curved("once"), isolate=True), "plant")
    apart.simulate(0.1)
