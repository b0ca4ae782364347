"""A source with its future: the values that it has later, to the last bit, in both engines."""

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError, StepSizeError

SOURCES = {
    "constant": cosim.Constant(2.0),
    "step": cosim.Step(0.8, after=3.0),
    "ramp": cosim.Ramp(2.0, start=0.5),
    "sine": cosim.Sine(1.0, 0.7, offset=1.0),
    "table": cosim.Table([0.0, 0.3, 0.8], [1.0, -1.0, 4.0]),
    "held table": cosim.Table([0.0, 0.3, 0.8], [1.0, -1.0, 4.0], interpolate=False),
    "pulse": cosim.Pulse(2.0, period=0.4),
    "chirp": cosim.Chirp(1.0, 0.5, 2.0, 3.0),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("dt", ["1/10", "1/30"])
@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_the_later_value_is_the_one_that_comes(source, dt, run_both):
    diagram = cosim.Diagram(dt)
    diagram.add(source, "source")
    diagram.add(cosim.Preview(source, 3 * diagram.step), "known")
    result = run_both(diagram, 40 * diagram.step)
    np.testing.assert_array_equal(result["known.y"], result["source.y"])
    np.testing.assert_array_equal(result["known.ahead"][:-3], result["source.y"][3:])


def test_no_preview_is_the_present(run_both):
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Preview(1.5, 0), "known")
    result = run_both(diagram, 1.0)
    np.testing.assert_array_equal(result["known.ahead"], result["known.y"])


@pytest.mark.parametrize(
    ("source", "why"),
    [
        (cosim.Gaussian(1.0), "Gaussian is not known, because it has noise"),
        (cosim.Gain(1.0), "Gain is not known, because it has inputs"),
        (cosim.PRBS(1.0, interval=0.2), "PRBS is not known, because it has a state"),
        ("sine", "must be a source with the one output y"),
        (True, "must be a source with the one output y"),
    ],
)
def test_an_unknown_future_is_refused(source, why):
    with pytest.raises(ModelError, match=why):
        cosim.Preview(source, 0.2).online(dt=0.1)


@pytest.mark.parametrize("time", [-1.0, "x", 0.15, float("nan")])
def test_a_wrong_time_is_refused(time):
    with pytest.raises(StepSizeError, match=r"(?i)a preview"):
        cosim.Preview(cosim.Ramp(1.0), time).online(dt=0.1)
