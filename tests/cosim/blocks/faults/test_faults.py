"""Every kind of fault, scheduled and at random, against formulas over the whole time at once."""

import pickle
from dataclasses import dataclass, fields, replace
from math import inf, nan, pi

import numpy as np
import pytest
from block_kinds import fault_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from bayesftc import cosim
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.faults.kinds import FAULTS
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import numbers

STEPS, CHANNELS, SENSOR, SEED = 400, 3, 1, 6
DT = 0.02
WINDOW = {"start": 0.5, "stop": 6.5}
HAZARDS = {"mean_time_to_fault": 0.3, "mean_time_to_recovery": 0.1}

TIME = np.arange(STEPS + 1) / 50
SIGNAL = np.random.default_rng(1).normal(size=(STEPS + 1, CHANNELS)) + 10
SIGNAL[20:22], SIGNAL[24, SENSOR] = nan, nan  # missing samples, among them the last one before the window
SIGNAL[50, :], SIGNAL[51, :], SIGNAL[52, :] = inf, -inf, nan
SIGNAL[110], SIGNAL[111] = 0.0, -0.0


def followed(time_constant, u, held, age):
    """A low-pass filter's output: the held value, and from there the exact solution with each sample held for a step."""
    shown, last = np.array(u), nan
    for k in np.flatnonzero(np.isfinite(u)):
        last = held[k] if age[k] == 0 else last
        shown[k] = u[k] + np.exp(-DT / time_constant) * (last - u[k]) if np.isfinite(last) else u[k]
        last = shown[k]
    return shown


# Each kind with its formula: what it shows, given the samples u, the last one before the onset, the age in seconds, and the
# uniform and normal numbers of its streams.
KINDS = [
    (cosim.Freeze(), lambda f, u, held, age, chance, noise: held),
    (cosim.Stuck(at=7.5), lambda f, u, held, age, chance, noise: np.full(len(u), 7.5)),
    (
        cosim.Injection(magnitude=3.0, amplitude=2.0, period=0.7, phase=0.4),
        lambda f, u, held, age, chance, noise: u + 3.0 + 2.0 * np.sin(2 * pi * age / 0.7 + 0.4),
    ),
    (cosim.Bias(magnitude=-1.5), lambda f, u, held, age, chance, noise: u - 1.5),
    (cosim.Drift(slope=5.0), lambda f, u, held, age, chance, noise: u + 5.0 * age),
    (cosim.GainFault(factor=0.3), lambda f, u, held, age, chance, noise: 0.3 * u),
    (cosim.Dropout(), lambda f, u, held, age, chance, noise: np.full(len(u), nan)),
    (
        cosim.Spikes(magnitude=20.0, probability=0.25),
        lambda f, u, held, age, chance, noise: np.where(chance < 0.25, u + 20.0 * np.sign(noise), u),
    ),
    (
        cosim.Spikes(magnitude=20.0, probability=0.5, random_size=True, name="spikes_of_random_size"),
        lambda f, u, held, age, chance, noise: np.where(chance < 0.5, u + 20.0 * noise, u),
    ),
    (cosim.NoiseIncrease(std=4.0), lambda f, u, held, age, chance, noise: u + 4.0 * noise),
    (cosim.NoiseGrowth(slope=3.0), lambda f, u, held, age, chance, noise: u + 3.0 * age * noise),
    (cosim.Clipping(low=9.5, high=10.5), lambda f, u, held, age, chance, noise: np.clip(u, 9.5, 10.5)),
    (cosim.Clipping(high=10.0, name="clipping_above"), lambda f, u, held, age, chance, noise: np.minimum(u, 10.0)),
    (cosim.Rounding(resolution=0.5), lambda f, u, held, age, chance, noise: np.floor(u / 0.5 + 0.5) * 0.5),
    (cosim.Lag(time_constant=0.1), lambda f, u, held, age, chance, noise: followed(0.1, u, held, age)),
    (cosim.Delay(delay=0.1), lambda f, u, held, age, chance, noise: u[np.maximum(np.arange(len(u)) - 5, 0)]),
    (
        cosim.Delay(delay=0.1, initial=7.0, name="delay_from_seven"),
        lambda f, u, held, age, chance, noise: np.concatenate([np.full(min(5, len(u)), 7.0), u])[: len(u)],
    ),
    (
        cosim.Delay(delay=0.1, initial=nan, name="delay_from_nothing"),
        lambda f, u, held, age, chance, noise: np.concatenate([np.full(min(5, len(u)), nan), u])[: len(u)],
    ),
    (cosim.Delay(delay=0.0, name="no_delay"), lambda f, u, held, age, chance, noise: u),
]
FORMULAS = {type(fault): formula for fault, formula in KINDS if fault.name is None}
MIXED = tuple(fault for fault, _ in KINDS if fault.name is None)


def variants():
    """Every kind, scheduled and at random."""
    for fault, formula in KINDS:
        common = {**WINDOW, "sensor": SENSOR, "channels": CHANNELS}
        yield replace(fault, **common, name=f"{fault.name or fault.default_name}_scheduled"), formula
        yield replace(fault, **common, **HAZARDS, name=f"{fault.name or fault.default_name}_random"), formula


VARIANTS = list(variants())
RANDOM_FAULTS = cosim.RandomFaults(kinds=MIXED, sensor=SENSOR, channels=CHANNELS, **WINDOW, **HAZARDS, name="mixed")
everywhere = pytest.mark.parametrize(("fault", "formula"), VARIANTS, ids=[fault.name for fault, _ in VARIANTS])


def _table(k, table, y):
    for i in range(y.shape[0]):
        y[i] = table[k, i]


@dataclass(frozen=True, eq=False)
class Samples(Block):
    """The rows of a table, one after the other."""

    table: np.ndarray

    @property
    def outputs(self):
        return (cosim.Port("y", self.table.shape[1:]),)

    def define(self, step):
        return Definition(_table, parameters={"table": self.table})


def diagram_of(*faults, signal=SIGNAL, dt="1/50", chained=False):
    diagram = cosim.Diagram(dt=dt)
    source = diagram.add(Samples(signal), name="samples")
    for fault in faults:
        node = diagram.add(fault)
        diagram.connect(source["y"], node["u"])
        source = node if chained else source
    return diagram


@pytest.fixture(scope="module")
def runs():
    """All variants side by side, in both engines."""
    faults = [fault for fault, _ in VARIANTS] + [RANDOM_FAULTS]
    return {
        engine: diagram_of(*faults).simulate(STEPS * DT, seed=SEED, engine=engine)
        for engine in ("compiled", "interpreted")
    }


@pytest.fixture(scope="module")
def run(runs):
    return runs["compiled"]


def presence(fault, steps=STEPS, time=TIME):
    """The gate, from the numbers of its stream."""
    window = (time >= fault.start) & (time < fault.stop)
    if fault.mean_time_to_fault is None:
        return window
    drawn = numbers(SEED, f"{fault.default_name}.transition", steps + 1, uniform=True)
    on, present = False, []
    for inside, number in zip(window, drawn, strict=True):
        on = inside and (number >= DT / fault.mean_time_to_recovery if on else number < DT / fault.mean_time_to_fault)
        present.append(on)
    return np.array(present)


def onsets(present):
    """The step of the current onset, at every step at which the fault is present."""
    steps = np.arange(len(present))
    begins = present & ~np.concatenate([[False], present[:-1]])
    return np.maximum.accumulate(np.where(begins, steps, 0))


def shown(fault, formula, present, name):
    onset = onsets(present)
    u = SIGNAL[:, SENSOR]
    chance = numbers(SEED, f"{name}.chance", STEPS + 1, uniform=True)
    noise = numbers(SEED, f"{name}.noise", STEPS + 1)
    with np.errstate(invalid="ignore"):
        return formula(fault, u, u[np.maximum(onset - 1, 0)], (np.arange(STEPS + 1) - onset) * DT, chance, noise)


def test_every_kind_is_here():
    lacking = set(FAULTS) - {type(fault) for fault, _ in KINDS} - {cosim.RandomFaults}
    assert not lacking, f"add {', '.join(kind.__name__ for kind in lacking)} with a formula to KINDS of this file"
    assert all(issubclass(kind, cosim.Fault) and getattr(cosim, kind.__name__) is kind for kind in FAULTS)
    assert FAULTS[-1] is cosim.RandomFaults


def test_both_engines_agree_to_the_bit(runs):
    assert list(runs["compiled"]) == list(runs["interpreted"])
    for name in runs["compiled"]:
        assert_array_equal(
            runs["compiled"][name].view(np.uint64), runs["interpreted"][name].view(np.uint64), err_msg=name
        )


@everywhere
def test_values(fault, formula, run):
    present = presence(fault)
    assert_array_equal(run[f"{fault.name}.active"], present)
    assert present.sum() > 10
    expected = np.where(present, shown(fault, formula, present, fault.name), SIGNAL[:, SENSOR])
    assert_allclose(run[f"{fault.name}.y"][:, SENSOR], expected, rtol=1e-12)


@everywhere
def test_identity_where_and_when_the_fault_is_not(fault, formula, run):
    y = run[f"{fault.name}.y"]
    others = [i for i in range(CHANNELS) if i != SENSOR]
    plus_zero = SIGNAL + 0.0  # the one difference: a negative zero comes out positive
    assert_array_equal(y[:, others].view(np.uint64), plus_zero[:, others].view(np.uint64))
    absent = run[f"{fault.name}.active"] == 0
    assert_array_equal(y[absent, SENSOR].view(np.uint64), plus_zero[absent, SENSOR].view(np.uint64))


def test_random_faults_draw_one_kind_at_every_onset(run):
    present = presence(RANDOM_FAULTS)
    kind = run["mixed.kind"]
    assert_array_equal(run["mixed.active"], present)
    assert_array_equal(kind == -1, ~present)
    picked = np.floor(numbers(SEED, "mixed.pick", STEPS + 1, uniform=True)[onsets(present)] * len(MIXED))
    assert_array_equal(kind[present], picked[present])
    assert len(np.unique(picked[present])) > 2
    expected = SIGNAL[:, SENSOR].copy()
    for number, fault in enumerate(MIXED):
        chosen = kind == number
        expected[chosen] = shown(fault, FORMULAS[type(fault)], present, "mixed")[chosen]
    assert_allclose(run["mixed.y"][:, SENSOR], expected, rtol=1e-12)


@pytest.mark.parametrize(
    "fault", [fault for fault, _ in KINDS if not fault.draws], ids=lambda fault: fault.default_name
)
def test_a_fault_of_a_slow_sensor_acts_on_its_samples_alone(fault):
    # The oracle is a loop that runs only when the slow sensor has a sample.
    aged = isinstance(fault, cosim.Injection | cosim.Drift)  # a fault of these begins to grow between two samples
    every, at = 5, {"sensor": SENSOR, "channels": CHANNELS, "start": 0.7 if aged else 0.73, "stop": 2.2}
    steps = np.arange(STEPS + 1)
    slow = SIGNAL.copy()
    slow[steps % every > 0, SENSOR] = nan
    fault = replace(fault, **at, name="fault")
    y = diagram_of(replace(fault, spacing=every), signal=slow).simulate(STEPS * DT, engine="interpreted")["fault.y"]
    alone = diagram_of(fault, signal=SIGNAL[::every], dt="1/10").simulate(
        (STEPS // every) * every * DT, engine="interpreted"
    )
    np.testing.assert_allclose(y[::every, SENSOR], alone["fault.y"][:, SENSOR], rtol=1e-12)
    assert np.isnan(y[steps % every > 0, SENSOR]).all()
    others = np.arange(CHANNELS) != SENSOR
    np.testing.assert_array_equal(y[:, others], SIGNAL[:, others])


def test_freeze_holds_the_last_sample_exactly():
    freezes = [
        cosim.Freeze(sensor=0, channels=1, start=0.2, stop=0.6, name="held"),
        cosim.Freeze(sensor=0, channels=1, name="from_the_first_step"),
        cosim.Freeze(sensor=0, channels=1, start=22 * DT, name="missing"),
    ]
    result = diagram_of(*freezes, signal=SIGNAL[:, :1]).simulate(1, engine="compiled")
    signal = SIGNAL[:51, 0]
    assert_array_equal(result["held.y"][10:30, 0], np.full(20, signal[9]))
    assert_array_equal(result["held.y"][30:, 0], signal[30:])
    assert_array_equal(result["from_the_first_step.y"][:, 0], np.full(51, signal[0]))
    assert np.isnan(
        result["missing.y"][20:, 0]
    ).all()  # the last sample before the onset is missing, so it stays missing
    assert_array_equal(result["missing.y"][:20, 0], signal[:20])


@pytest.mark.parametrize(("dt", "start", "stop"), [("1/50", 0.06, 0.14), ("1/30", 0.1, 0.2), (0.1, 0.3, 0.7)])
def test_start_is_inclusive_and_stop_exclusive(dt, start, stop):
    diagram = diagram_of(cosim.Freeze(sensor=0, start=start, stop=stop, channels=1), signal=SIGNAL[:, :1], dt=dt)
    step = float(diagram.step)
    active = diagram.simulate(20 * diagram.step)["freeze_0.active"]
    assert_array_equal(np.flatnonzero(active), np.arange(round(start / step), round(stop / step)))


def test_chained_faults_leave_each_other_alone():
    chain = [
        cosim.Bias(sensor=0, magnitude=2.0, channels=CHANNELS),
        cosim.Freeze(sensor=2, start=0.1, channels=CHANNELS),
        cosim.Drift(sensor=0, slope=1.0, start=0.2, channels=CHANNELS),
    ]
    for order in (chain, chain[::-1]):
        y = diagram_of(*order, chained=True).simulate(0.3)[f"{order[-1].default_name}.y"]
        assert_allclose(y[:, 0], SIGNAL[:16, 0] + 2.0 + np.maximum(TIME[:16] - 0.2, 0), rtol=1e-12)
        assert_array_equal(y[:, 1], SIGNAL[:16, 1])
        assert_array_equal(y[:, 2], SIGNAL[np.minimum(np.arange(16), 4), 2])


def test_a_scalar_control_at_its_own_rate():
    diagram = cosim.Diagram(dt=0.1)
    ramp = diagram.add(cosim.Ramp(1.0))
    fault = diagram.add(cosim.Drift(slope=-1.0, start=0.4, channels=1), every=2)
    diagram.connect(ramp["y"], fault["u"])
    y = diagram.simulate(1.0)["drift_0.y"][::2, 0]
    assert_allclose(y, [0.0, 0.2, 0.4, 0.4, 0.4, 0.4], atol=1e-12)


def test_mean_times_and_share_of_faults():
    fault = cosim.Freeze(mean_time_to_fault=2.8, mean_time_to_recovery=0.4, channels=1)
    steps = 400_000
    active = long_run(fault, steps)["freeze_0.active"]
    changes = np.flatnonzero(np.diff(active)) + 1
    lengths = np.diff(changes)
    healthy, faulty = (lengths[active[changes[:-1]] == value] for value in (0, 1))
    rates = (DT / 2.8, DT / 0.4)
    for stay, rate in zip((healthy, faulty), rates, strict=True):
        assert abs(stay.mean() - 1 / rate) < 4 * np.sqrt(1 - rate) / rate / np.sqrt(len(stay))
    share, memory = rates[0] / sum(rates), 1 - sum(rates)
    assert share == pytest.approx(0.125)
    spread = np.sqrt(share * (1 - share) * (1 + memory) / (1 - memory) / steps)
    assert abs(active.mean() - share) < 4 * spread


@pytest.mark.parametrize("weights", [None, (2.0, 1.0, 1.0), (0.0, 5.0, 0.0)])
def test_kinds_come_as_often_as_their_weights_say(weights):
    result = long_run(cosim.RandomFaults(channels=1, weights=weights), 400_000)
    active, kind = result["random_faults_0.active"], result["random_faults_0.kind"]
    begins = np.flatnonzero((active[1:] == 1) & (active[:-1] == 0)) + 1
    within = np.flatnonzero((active[1:] == 1) & (active[:-1] == 1))
    assert_array_equal(kind[within], kind[within + 1])  # one at a time: no change without a recovery
    counts = np.bincount(kind[begins].astype(int), minlength=3)
    expected = np.ones(3) if weights is None else np.array(weights)
    possible = expected > 0
    assert not counts[~possible].any()
    if possible.sum() > 1:
        assert stats.chisquare(counts[possible], counts.sum() * expected[possible] / expected.sum()).pvalue > 1e-3


def long_run(fault, steps):
    diagram = cosim.Diagram(dt=DT)
    source = diagram.add(cosim.Constant(1.0))
    node = diagram.add(fault)
    diagram.connect(source["y"], node["u"])
    return diagram.simulate(
        steps * DT, seed=2, record=[f"{node.name}.active", f"{node.name}.kind"][: len(fault.outputs) - 1]
    )


def test_reproducible_and_unchanged_by_other_blocks():
    faults = [replace(fault, name=None) for fault, _ in VARIANTS if fault.name == "noise_increase_0_random"]
    (fault,) = faults
    name = f"{fault.default_name}.y"
    alone = diagram_of(fault).simulate(1, seed=3)[name]
    assert_array_equal(alone, diagram_of(fault).simulate(1, seed=3)[name])
    assert (alone != diagram_of(fault).simulate(1, seed=4)[name]).any()
    other = cosim.Spikes(magnitude=1.0, sensor=0, channels=CHANNELS)
    assert_array_equal(alone, diagram_of(other, fault).simulate(1, seed=3)[name])


def test_a_fixed_number_of_draws():
    for fault, _ in VARIANTS:
        ports = [port.name for port in fault.inputs if port.draw]
        assert ("transition" in ports) == (fault.mean_time_to_fault is not None)
        assert set(fault.draws) <= set(ports)
        assert len(diagram_of(fault).schedule.draws) == len(ports)


def test_names_depend_on_kind_and_sensor_alone():
    assert cosim.Freeze(start=3.0).default_name == "freeze_0"
    assert cosim.NoiseIncrease(std=1.0, sensor=2).default_name == "noise_increase_2"
    assert cosim.GainFault(factor=2.0).default_name == "gain_fault_0"
    assert cosim.Drift(slope=1.0, name="leak").default_name == "leak"


@pytest.mark.parametrize("kind", FAULTS)
def test_plain_settings(kind):
    """Fields of plain types: a fault can be made again from them, pickled, compared and hashed; unknown ones are refused."""
    fault = fault_of(kind, sensor=1)
    settings = {field.name: getattr(fault, field.name) for field in fields(kind)}
    assert kind(**settings) == fault
    assert pickle.loads(pickle.dumps(fault)) == fault
    assert hash(fault) == hash(replace(fault))
    with pytest.raises(TypeError, match="begin"):
        kind(**settings, begin=1.0)


@pytest.mark.parametrize(
    ("kind", "settings", "sentence"),
    [
        (cosim.Freeze, {"sensor": -1}, "number of a channel"),
        (cosim.Freeze, {"sensor": 0.5}, "number of a channel"),
        (cosim.Freeze, {"sensor": 2, "channels": 2}, "a number up to 1"),
        (cosim.Freeze, {"channels": 0}, "at least 1"),
        (cosim.Freeze, {"start": 2.0, "stop": 2.0}, "before the stop"),
        (cosim.Freeze, {"start": nan}, "before the stop"),
        (cosim.Freeze, {"start": -inf}, "start must be finite"),
        (cosim.Freeze, {"stop": nan}, "before the stop"),
        (cosim.Freeze, {"mean_time_to_fault": 1.0}, "or neither"),
        (cosim.Freeze, {"mean_time_to_fault": 0.0, "mean_time_to_recovery": 1.0}, "mean_time_to_fault=0.0"),
        (cosim.Freeze, {"mean_time_to_fault": 1.0, "mean_time_to_recovery": inf}, "mean_time_to_recovery=inf"),
        (cosim.Injection, {"magnitude": nan}, "magnitude=nan"),
        (cosim.Injection, {"period": 0.0}, "positive"),
        (cosim.Bias, {"magnitude": inf}, "finite"),
        (cosim.Stuck, {"at": nan}, "finite"),
        (cosim.Drift, {"slope": nan}, "finite"),
        (cosim.GainFault, {"factor": nan}, "finite"),
        (cosim.Spikes, {"magnitude": 1.0, "probability": 1.5}, "between 0 and 1"),
        (cosim.Spikes, {"magnitude": nan}, "finite"),
        (cosim.NoiseIncrease, {"std": -1.0}, "not be negative"),
        (cosim.NoiseGrowth, {"slope": -1.0}, "not be negative"),
        (cosim.Clipping, {"low": 2.0, "high": 1.0}, "must not be above"),
        (cosim.Clipping, {"low": nan}, "must not be above"),
        (cosim.Rounding, {"resolution": 0.0}, "positive"),
        (cosim.Lag, {"time_constant": -1.0}, "not be negative"),
        (cosim.Lag, {"time_constant": inf}, "finite"),
        (cosim.Delay, {"delay": -0.1}, "not be negative"),
        (cosim.Delay, {"delay": nan}, "finite"),
        (cosim.Delay, {"delay": 0.1, "initial": inf}, "must be a number, or NaN"),
        (cosim.RandomFaults, {"kinds": ()}, "at least one kind"),
        (cosim.RandomFaults, {"kinds": (cosim.RandomFaults(),)}, "at least one kind"),
        (cosim.RandomFaults, {"kinds": (cosim.Freeze(start=1.0),)}, "its own start=1.0"),
        (cosim.RandomFaults, {"kinds": (cosim.Freeze(sensor=2),), "sensor": 1}, "its own sensor=2"),
        (cosim.RandomFaults, {"weights": (1.0, 2.0)}, "weights"),
        (cosim.RandomFaults, {"weights": (1.0, -2.0, 1.0)}, "weights"),
        (cosim.RandomFaults, {"weights": (0.0, 0.0, 0.0)}, "weights"),
        (cosim.RandomFaults, {"weights": (0.0, nan, 0.0)}, "weights"),
    ],
)
def test_bad_settings(kind, settings, sentence):
    with pytest.raises(ModelError, match=sentence):
        kind(**settings)


def test_what_only_the_diagram_can_know():
    with pytest.raises(ModelError, match="length of its signal"):
        diagram_of(cosim.Freeze())
    hasty = cosim.Freeze(channels=CHANNELS, mean_time_to_fault=1.0, mean_time_to_recovery=0.01)
    with pytest.raises(ModelError, match="shorter than a step"):
        diagram_of(hasty).build()
