"""Hundreds of thousands of absurd samples in the compiled loop: all that comes out is finite, and a second later all is well."""

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import GammaPrecision, Proportional, SwitchingPrecision

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], 0.02)
VALUES = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e154, 1e20, 2147483647.0, 5e-324, -5e-324, 1e-310, 0.0, 0.5, -0.5)
"""The plant rests at 0, so that the small ones are what healthy sensors might send."""
MANY = 4096
SECOND = 50
BLOCKS = [
    controllers.StateEstimator(MODEL, SwitchingPrecision()),
    controllers.UnbiasedActiveInference(
        model=MODEL,
        law=Proportional(1.0),
        control="law",
        state_prior="kalman",
        precision=GammaPrecision(),
    ),
    *(controllers.StateEstimator(MODEL, cls()) for cls in controllers.LEARNERS if cls is not SwitchingPrecision),
    controllers.StateEstimator(MODEL, SwitchingPrecision(joint=False)),
    controllers.BayesianController(MODEL, GammaPrecision()),
    controllers.BayesianController(MODEL, GammaPrecision(), belief="joint"),
    controllers.LQGController(MODEL),
    controllers.NonlinearBayesianController(MODEL, GammaPrecision(), iterations=5),
]
FINITE = {"u", "x_hat", "P", "precision"}


def absurd(k, values, healthy, until, y):
    """Take a row of absurd samples until some step, then a row of healthy ones."""
    row = k % len(values)
    for i in range(2):
        y[i] = values[row, i] if k < until[0] else healthy[row, i]


def diagram(block, make_block, rng, steps):
    """Return a loop in which a block meets absurd samples up to a second before the end."""
    healthy = rng.normal(size=(MANY, 2)) * [1.0, 2.0]
    values = rng.choice(VALUES, size=(MANY, 2))
    parameters = {"values": values, "healthy": healthy, "until": np.array([float(steps - SECOND)])}
    source = make_block(name="samples", outputs=(cosim.Port("y", (2,)),), output=absurd, parameters=parameters)
    loop = cosim.Diagram(0.02)
    node = loop.add(block, "block")
    loop.connect(loop.add(source, "samples")["y"], node["y"])
    other = "goal" if "goal" in {port.name for port in block.inputs} else "u"
    loop.connect(loop.add(cosim.Constant(0.0), "other")["y"], node[other])
    return loop


def title(block):
    return f"{type(block).__name__}-{type(block.precision).__name__}"


@pytest.mark.parametrize(
    ("block", "steps"),
    [
        *((block, 20_000) for block in BLOCKS[:2]),
        *(pytest.param(block, 1_000_000, marks=pytest.mark.slow) for block in BLOCKS),
    ],
    ids=lambda value: value if isinstance(value, int) else title(value),
)
def test_all_is_finite_and_well_a_second_later(block, steps, make_block, chance):
    result = diagram(block, make_block, chance, steps).simulate(
        steps * 0.02, seed=1, decimation=SECOND, engine="compiled"
    )
    last = {name.partition(".")[2]: result[name] for name in result if name.startswith("block.")}
    for name in FINITE & last.keys():
        assert np.isfinite(last[name]).all(), name
    # A sensor that is ignored has an infinite variance in R.
    assert not any(np.isinf(values).any() for name, values in last.items() if name != "R")
    assert abs(last["x_hat"][-1].item()) < 3.0
