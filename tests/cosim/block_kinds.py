"""Every public kind of block: examples, and random ones with other settings.

Controllers are in `BLOCKS` of the exports' conftest.py, beside these.
"""

from __future__ import annotations

import ast
import doctest
from dataclasses import MISSING, fields, replace

import control
import numpy as np
from hypothesis import strategies as st

from bayesftc import cosim
from bayesftc.cosim.blocks.faults.base import Fault

DT = "1/10"
WINDOWED = {f.name for f in fields(Fault)}
"""Settings of every fault."""
WINDOW = {"start": 3.0, "stop": 9.0, "channels": 2}


def _in_example(kind):
    """Return the settings of a fault, but those of every fault, in the example of its docstring."""
    own = {
        f.name: f.default is MISSING and f.default_factory is MISSING for f in fields(kind) if f.name not in WINDOWED
    }
    for example in doctest.DocTestParser().get_examples(kind.__doc__):
        for node in ast.walk(ast.parse(example.source)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == kind.__name__:
                given = {key.arg: key.value for key in node.keywords if key.arg in own}
                if all(name in given for name, needed in own.items() if needed):
                    return {} if "kinds" in given else {name: ast.literal_eval(value) for name, value in given.items()}
    raise AssertionError(f"the example in the docstring of {kind.__name__} must have all settings that have no default")


SIZES = {kind.__name__: _in_example(kind) for kind in cosim.FAULTS}
"""Settings of each kind of fault beside a window: those of the example in its docstring, which a new kind has anyway."""


def fault_of(kind, **settings):
    """Return a fault of this kind with its settings in `SIZES`, unless others are given."""
    return kind(**{**SIZES[kind.__name__], **settings})


def _subsystem():
    inside = cosim.Diagram(DT)
    gain, integral = inside.add(cosim.Gain(2.0), "gain"), inside.add(cosim.Integrator(low=-3.0), "integral", every=2)
    total = inside.add(cosim.Sum("++"), "total")
    inside.connect([gain["y"], integral["y"]], total["u"])
    return cosim.Subsystem(inside, {"e": ["gain.u", "integral.u"]}, {"u": "total.y"})


BLOCKS = {
    "subsystem": _subsystem(),
    "gain": cosim.Gain([[1.0, -2.0], [0.5, 3.0]]),
    "sum": cosim.Sum("+-+"),
    "delay": cosim.UnitDelay(size=2, initial=3.0),
    "saturation": cosim.Saturation(-1.0, 1.5, size=2),
    "sensors": cosim.Sensors(count=3, signals=2, std=0.3, bias=0.1, resolution=0.05, matrix=[[1, 0], [0, 1], [1, 1]]),
    "slow sensors": cosim.Sensors(count=2, std=0.3, every=[1, 3]),
    "sine": cosim.Sine(amplitude=1.0, period=0.7),
    "constant": cosim.Constant(2.0),
    "step": cosim.Step(time=1.0, before=2.0, after=3.0),
    "ramp": cosim.Ramp(slope=2.0, offset=1.0, start=1.0),
    "table": cosim.Table([0.0, 1.0, 2.5], [1.0, -1.0, 4.0]),
    "preview of a source": cosim.Preview(
        cosim.Sine(amplitude=1.0, period=0.7), 90.0
    ),  # a whole number of steps at any rate
    "noise": cosim.Gaussian(std=2.0, mean=1.0),
    "system": cosim.StateSpace(
        control.ss([[0.5, 0.2], [0.0, 0.9]], np.eye(2), [[1.0, 1.0]], 0, 0.1), process_noise=np.eye(2)
    ),
    "feedthrough": cosim.StateSpace(control.ss([[-1.0]], [[1.0, 0.5]], [[1.0], [2.0]], [[0, 0], [0, 3.0]])),
    "abs": cosim.Abs(2),
    "sign": cosim.Sign(2),
    "dead zone": cosim.DeadZone(-0.5, 0.3, size=2),
    "quantizer": cosim.Quantizer(0.25),
    "polynomial": cosim.Polynomial([1.0, -2.0, 0.5]),
    "lookup": cosim.LookupTable([-1.0, 0.0, 2.0], [3.0, 1.0, -1.0], size=2),
    "lookup held": cosim.LookupTable([-1.0, 0.0, 2.0], [3.0, 1.0, -1.0], interpolate=False),
    "lookup 2D": cosim.LookupTable2D([-1.0, 0.0, 2.0], [0.0, 1.0], [[3.0, 1.0], [-1.0, 0.5], [0.0, 2.0]]),
    "product": cosim.Product("*/*"),
    "minimum": cosim.Minimum(3),
    "maximum": cosim.Maximum(3),
    "switch": cosim.Switch(size=2),
    **{operation: cosim.Logic(operation) for operation in ("and", "or", "xor", "not")},
    "compare": cosim.Compare("<="),
    "integrator": cosim.Integrator(1.0, low=-2.0, high=3.0, size=2),
    "integrator with a reset": cosim.Integrator(1.0, reset=True),
    "exponential filter": cosim.ExponentialFilter(0.3, size=2),
    "moving average": cosim.MovingAverage(3, size=2),
    "rate limiter": cosim.RateLimiter(2.0, 1.0, size=2),
    "hysteresis": cosim.Hysteresis(0.5, -0.5),
    "sample and hold": cosim.SampleAndHold(2.0, size=2),
    "counter": cosim.Counter(limit=3.0),
    "variable delay": cosim.VariableDelay(0.4, size=2),
    "pulse": cosim.Pulse(2.0, period=0.4),
    "PRBS": cosim.PRBS(1.0, interval=0.2, order=5),
    "chirp": cosim.Chirp(1.0, 0.5, 2.0, 3.0),
    "exponential chirp": cosim.Chirp(1.0, 0.5, 2.0, 3.0, sweep="exponential"),
    "transfer function": cosim.TransferFunction([1.0, 2.0], [1.0, 0.6, 1.0]),
    **{kind.__name__: fault_of(kind, sensor=1, **WINDOW) for kind in cosim.FAULTS[:-1]},
    "RandomFaults": cosim.RandomFaults(channels=2, mean_time_to_fault=3.0, mean_time_to_recovery=2.0),
    "faults that remember": cosim.RandomFaults(
        kinds=(cosim.Lag(time_constant=0.5), cosim.Freeze(), cosim.Delay(delay=0.3)),
        channels=2,
        mean_time_to_fault=3.0,
        mean_time_to_recovery=2.0,
    ),
    "fault on a condition": cosim.Lag(
        time_constant=0.5,
        sensor=1,
        channels=2,
        start=cosim.when("plant.v", ">", 0.5),
        stop=cosim.when("plant.v", "<=", -0.5),
        duration=0.7,
    ),
    "random faults on a delayed condition": cosim.RandomFaults(
        channels=2,
        mean_time_to_fault=0.5,
        mean_time_to_recovery=2.0,
        start=cosim.when("controller.u", "<", 0.5, delayed=True),
        latching=False,
    ),
    "fault of a slow sensor": cosim.Delay(delay=0.3, sensor=1, spacing=3, **WINDOW),
    "random faults of a slow sensor": cosim.RandomFaults(
        kinds=(cosim.Lag(time_constant=0.5), cosim.Freeze(), cosim.Delay(delay=0.3)),
        channels=2,
        spacing=3,
        mean_time_to_fault=3.0,
        mean_time_to_recovery=2.0,
    ),
    "fault for a duration": cosim.Drift(slope=2.0, channels=2, start=3.0, duration=2.0),
}
"""An example of every kind of block, and of each of its forms; at steps of `DT`."""


NOT_DRAWN = {
    "Block": "a base class",
    "ExternalBlock": "a base class",
    "Fault": "a base class",
    "Source": "a base class",
    "FMU": "a file; tests/cosim/fmi has its tests",
    "Subsystem": "random diagrams nest their blocks in it",
}
"""Public kinds that `random_blocks` does not draw, with the reason."""

NUMBER = st.sampled_from([0.0, 1.0, -2.5, 0.1, 1e-300, 3e200, -1e308])
MODEST = st.floats(-3.0, 3.0, allow_nan=False)
BELOW, ABOVE = st.floats(-3.0, -0.1), st.floats(0.1, 3.0)
SIZE = {"size": st.integers(1, 3)}
SETTINGS = {
    cosim.Gain: {"offset": NUMBER},
    cosim.UnitDelay: {"initial": NUMBER, **SIZE},
    cosim.Saturation: {"low": BELOW, "high": ABOVE, **SIZE},
    cosim.Sensors: {"std": ABOVE, "bias": MODEST, "resolution": st.floats(0.01, 0.5)},
    cosim.Sine: {"amplitude": NUMBER, "period": ABOVE, "phase": MODEST},
    cosim.Constant: {"value": NUMBER},
    cosim.Step: {"before": NUMBER, "after": NUMBER, "time": ABOVE},
    cosim.Ramp: {"slope": NUMBER, "offset": NUMBER},
    cosim.Table: {"interpolate": st.booleans()},
    cosim.Preview: {},
    cosim.Gaussian: {"std": ABOVE, "mean": MODEST},
    cosim.StateSpace: {},
    cosim.TransferFunction: {},
    cosim.Abs: SIZE,
    cosim.Sign: SIZE,
    cosim.DeadZone: {"low": BELOW, "high": ABOVE, **SIZE},
    cosim.Quantizer: {"interval": ABOVE, **SIZE},
    cosim.Polynomial: {"coefficients": st.lists(MODEST, min_size=1, max_size=4), **SIZE},
    cosim.LookupTable: {"interpolate": st.booleans(), **SIZE},
    cosim.LookupTable2D: {},
    cosim.Sum: {"signs": st.text("+-", min_size=1, max_size=4)},
    cosim.Product: {"operations": st.text("*/", min_size=1, max_size=4)},
    cosim.Minimum: SIZE,
    cosim.Maximum: SIZE,
    cosim.Switch: {"threshold": MODEST, **SIZE},
    cosim.Logic: {},
    cosim.Compare: {"relation": st.sampled_from(["<", "<=", "==", "!=", ">=", ">"])},
    cosim.Integrator: {"initial": BELOW, "low": st.just(-3.0), "high": ABOVE, "reset": st.booleans(), **SIZE},
    cosim.ExponentialFilter: {"time_constant": ABOVE, **SIZE},
    cosim.MovingAverage: {"samples": st.integers(1, 5), **SIZE},
    cosim.RateLimiter: {"rising": ABOVE, "falling": ABOVE, "initial": NUMBER, **SIZE},
    cosim.Hysteresis: {"on": ABOVE, "off": BELOW, "high": NUMBER, "low": NUMBER, **SIZE},
    cosim.SampleAndHold: {"initial": NUMBER, **SIZE},
    cosim.Counter: {"limit": st.sampled_from([1.0, 3.0, np.inf]), **SIZE},
    cosim.VariableDelay: {"longest": ABOVE, "initial": NUMBER, **SIZE},
    cosim.Pulse: {"amplitude": NUMBER, "period": ABOVE, "offset": NUMBER},
    cosim.PRBS: {"amplitude": NUMBER, "order": st.sampled_from([3, 4, 9])},
    cosim.Chirp: {"amplitude": NUMBER, "sweep": st.sampled_from(["linear", "exponential"])},
    **{kind: {"sensor": st.integers(0, 1)} for kind in cosim.FAULTS},
}
"""Random settings of each kind that is drawn; those of its examples stay otherwise. Faults also have random windows."""


@st.composite
def windows(draw):
    """Settings of when a fault is present: times, a condition on the signal that the diagram chooses, at random."""
    condition = st.builds(
        cosim.When, st.just("any.signal"), st.sampled_from(["<", "<=", "==", "!=", ">=", ">"]), MODEST, st.booleans()
    )
    start = draw(st.floats(0.0, 3.0) | condition)
    stop = draw(st.sampled_from([np.inf, 5.0]) | condition)
    hazard = draw(st.sampled_from([None, 0.5, 2.0]))
    return {
        "start": start,
        "stop": stop,
        "duration": draw(st.sampled_from([np.inf, 0.05, 0.7])),
        "latching": draw(st.booleans()) if isinstance(start, cosim.When) else True,
        "mean_time_to_fault": hazard,
        "mean_time_to_recovery": hazard,
    }


@st.composite
def random_blocks(draw):
    """A block of any kind of `SETTINGS`, each as often as any other."""
    kind = draw(st.sampled_from(sorted(SETTINGS, key=lambda each: each.__name__)))
    block = draw(st.sampled_from([block for block in BLOCKS.values() if type(block) is kind]))
    settings = {name: draw(values) for name, values in SETTINGS[kind].items()}
    if isinstance(block, cosim.Fault):
        settings |= draw(windows())
        if kind is cosim.RandomFaults:
            settings |= {"mean_time_to_fault": 0.5, "mean_time_to_recovery": 0.5}
    return replace(block, **settings)
