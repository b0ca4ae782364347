"""Plants and settings with extreme numbers: `design` gives a controller or a sentence, and no error of another library."""

import warnings

import control
import numpy as np
import pandas as pd
import pytest
from harness import FOREIGN

from bayesftc import cosim, fmus
from bayesftc.controllers import LinearModel, design
from bayesftc.cosim.errors import BayesFTCError, ModelError

pytestmark = pytest.mark.slow

SIZES = [
    0.0,
    -0.0,
    5e-324,
    1e-300,
    1e-150,
    1e-45,
    1e-18,
    1e-8,
    0.5,
    1.0,
    -1.0,
    1e8,
    1e18,
    1e45,
    1e150,
    1e300,
    -1e300,
    1.7e308,
]
OPTIONS = {
    "acceptable_error": 0.2, "acceptable_control": 0.2, "sensor_std": 0.2, "u_min": 0.1, "u_max": 0.1, "u_rate": 0.1,
    "disturbance": 0.1, "goal_covariance": 0.1, "control_covariance": 0.1,
}  # fmt: skip
"""Settings, and how often each is given."""
FUNCTIONS = [np.sin, np.exp, np.log, np.sqrt, lambda v: 1.0 / v, lambda v: v**3]
PLANTS = {
    "CruiseControl": ("v", "force"),
    "PositionServo": ("angle", "voltage"),
    "TwoMasses": ("x1", "force1"),
    "CartPendulum": (["position", "angle"], "force"),
    "HydroTurbine": ("power", "command"),
}


def number(rng):
    return float(rng.choice(SIZES)) if rng.random() < 0.35 else float(rng.normal())


def matrix(rng, *shape):
    """Return normal numbers, of which up to two are extreme."""
    entries = rng.normal(size=shape)
    for _ in range(rng.integers(0, 3)):
        entries.flat[rng.integers(entries.size)] = rng.choice(SIZES)
    return entries


def linear(rng):
    n, p, m = rng.integers(1, 4), rng.integers(1, 3), rng.integers(1, 3)
    inputs, outputs = [f"v{i}" for i in range(p)], [f"w{i}" for i in range(m)]
    sampled = bool(rng.random() < 0.5)
    matrices = matrix(rng, n, n), matrix(rng, n, p), matrix(rng, m, n), np.zeros((m, p))
    system = control.ss(*matrices, 0.1 if sampled else 0, inputs=inputs, outputs=outputs)
    goal = {"goal": outputs[0]} if p < m else {}
    dt = {} if sampled else {"dt": float(rng.choice([1e-6, 0.01, 0.1, 1e6]))}
    return system, {"measured": outputs, "actuated": inputs} | goal | dt


def nonlinear(rng):
    a, b, start, f = number(rng), number(rng), number(rng), rng.choice(FUNCTIONS)
    system = control.nlsys(
        lambda t, x, u, p: np.array([a * f(x[0]) + b * u[0]]), lambda t, x, u, p: x,
        inputs=["v"], outputs=["w"], states=1, dt=0,
    )  # fmt: skip
    return cosim.StateSpace(system, initial=[start]), {"measured": "w", "actuated": "v", "dt": 0.1}


def fmu(rng):
    name = str(rng.choice(list(PLANTS)))
    measured, actuated = PLANTS[name]
    plain = cosim.FMU(fmus.path(name))
    parameters = [v.name for v in plain.description.variables if v.causality == "parameter" and v.name != "max_substep"]
    chosen = {str(p): number(rng) for p in rng.choice(parameters, 2, replace=False)}
    goal = {"goal": measured[0]} if isinstance(measured, list) else {}
    return cosim.FMU(fmus.path(name), parameters=chosen), {"measured": measured, "actuated": actuated} | goal


@pytest.mark.parametrize(
    ("make", "count"),
    [
        (linear, 30), (nonlinear, 20), (fmu, 1),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((linear, 1500), (nonlinear, 500), (fmu, 60))),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore")  # of scipy, and of loops at the edge of stability
def test_extreme_plants(chance, make, count):
    failures, designed = [], 0
    for i in range(count):
        with np.errstate(all="ignore"):
            try:
                plant, settings = make(chance)
                given = {name: number(chance) for name, often in OPTIONS.items() if chance.random() < often}
                controller = design(plant, **settings, **given)
                controller.describe()
                designed += 1
            except BayesFTCError as error:
                if FOREIGN.search(str(error)):
                    failures.append(f"{i}: {error}")
            except Exception as error:  # noqa: BLE001 - any other error is what the test is about
                failures.append(f"{i}, {make.__name__} {settings} {given}: {type(error).__name__}: {error}")
    assert not failures, "\n".join(failures)
    assert count < 20 or designed >= count // 20  # most are to be refused, but not all


def spoiled(table, rng):
    """Return a recording with extreme samples, with columns of other sizes, or with columns that follow from each other."""
    way, table = rng.integers(4), table.copy()
    if way == 0:
        for _ in range(5):
            table.flat[rng.integers(table.size)] = rng.choice(SIZES)
    elif way == 1:
        table *= 10.0 ** rng.integers(-40, 40, table.shape[1])
    elif way == 2:
        table[:, rng.integers(4)] = table[:, rng.integers(4)]
    else:
        table[rng.random(table.shape) < rng.random()] = np.nan
    return table


def recorded(rng, rows=400):
    """Return inputs a and b, and outputs x and y of a plant with a state for each."""
    u, y = rng.normal(size=(rows, 2)), np.zeros((rows, 2))
    for k in range(1, rows):
        y[k] = 0.8 * y[k - 1] + u[k - 1] * [1.0, 0.5]
    return np.hstack([u, y + 0.01 * rng.normal(size=y.shape)])


def identified(table):
    with np.errstate(all="ignore"):
        frame = pd.DataFrame(table, columns=["a", "b", "x", "y"])
        return LinearModel.identify(frame, inputs=["a", "b"], outputs=["x", "y"], dt=0.1)


@pytest.mark.parametrize("count", [4, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore")
def test_extreme_recordings(chance, count):
    failures = []
    for i in range(count):
        try:
            design(identified(spoiled(recorded(chance), chance)), goal=["x"])
        except BayesFTCError as error:
            if FOREIGN.search(str(error)):
                failures.append(f"{i}: {error}")
        except Exception as error:  # noqa: BLE001 - any other error is what the test is about
            failures.append(f"{i}: {type(error).__name__}: {error}")
    assert not failures, "\n".join(failures)


@pytest.mark.filterwarnings("ignore")
def test_a_recording_without_a_steady_filter_is_refused():
    table = recorded(np.random.default_rng(0))
    assert identified(table).fit.min() > 95
    with pytest.raises(ModelError, match=r"no steady Kalman filter in double precision.* similar sizes"):
        identified(table * [1e24, 1e-34, 1e-26, 1e-22])


@pytest.mark.parametrize(
    ("A", "B", "dt", "words"),
    [
        ([[0.0, 1e300], [0.0, 0.0]], [[0.0], [1.0]], 0.1, r"The matrix A of the plant has the entry 1e\+300; at most 1e\+50"),
        ([[0.0, 1.0], [0.0, 1.0]], [[0.0], [1e150]], 0.1, r"The matrix B of the plant has the entry 1e\+150"),
        ([[0.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]], 1e6, r"\(the change in one sample of 1e\+06 s\).* give a smaller dt=\.\.\."),
    ],
)  # fmt: skip
def test_matrices_of_a_plant_that_are_too_large_are_named(A, B, dt, words):
    plant = control.ss(A, B, [[1.0, 0.0]], 0.0)
    with warnings.catch_warnings(action="error"), pytest.raises(BayesFTCError, match=words):
        design(plant, measured="y", actuated="u", dt=dt)


def test_goals_that_see_no_state_are_refused():
    plant = control.ss([[1.0]], [[1.0]], [[0.0], [1.0]], 0.0, 0.1, outputs=["goal", "seen"], inputs=["v"])
    with pytest.raises(ModelError, match="The goals see no state of the plant"):
        design(plant, measured=["goal", "seen"], goal="goal", actuated="v")
