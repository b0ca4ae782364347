"""The two engines give the same bits, and those are what the diagram means."""

import math
import threading
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from random_diagrams import PATHS, build, elements_of, inputs_of, plans

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.ops import isnan, select, sin, sqrt
from bayesftc.cosim.random import numbers
from bayesftc.cosim.run import running as _running
from bayesftc.cosim.run.result import labels

STEP = Fraction(1, 30)


def integrate(u, total, y):
    for i in range(2):
        y[i] = total[i, 0] - total[i, 1]


def integrate_update(k, u, total, rate):
    total[0, 0] = total[0, 0] + rate[0] * u[0]
    total[0, 1] = total[1, 0]
    total[1, 0] = total[1, 0] + u[1] / (k + 1)
    total[1, 1] = total[1, 1] + rate[0]


class Integrator(cosim.Block):
    """A matrix for a state, an update, and its own count of steps."""

    inputs = (Port("u", (2,), feedthrough=False),)
    outputs = (Port("y", (2,)),)

    def define(self, step):
        return cosim.Definition(integrate_output, integrate_update, {"total": np.zeros((2, 2))}, {"rate": 0.5})


def integrate_output(total, y):
    for i in range(2):
        y[i] = total[i, 0] - total[i, 1]


# Each kind: what to add, and what its outputs are, in Python's own numbers, from its inputs at t_k, its own count, the time,
# and what it kept. Kinds with a fourth entry do not feed through: their inputs go into what they keep for the next step.
def _gain(a, u):
    total = np.float64(0.25)
    for x, g in zip(u, a):
        total = total + g * x
    return total


def _clip(x, low, high):
    return x if math.isnan(x) else min(max(x, low), high) + 0.0


def _integrate(u, kept, n):
    a, _, c, d = kept
    return (a + 0.5 * u[0], c, c + u[1] / np.float64(n + 1), d + 0.5)


def _sum_over_time(u, kept, n, step=1.0 / 30.0):
    return tuple(_clip(a + step * (0.0 if math.isnan(x) else x), -3.0, 1e300) for a, x in zip(kept, u))


NUMBER = st.sampled_from([0.0, 1.0, -2.5, 0.1, 1e-300, 3e200, -1e308])
ROWS = ((1.0, -2.0), (0.5, 3e150))
KINDS = {
    "constant": (0, lambda p: cosim.Constant(p), lambda p, u, t, n, kept, z: [p]),
    "step": (0, lambda p: cosim.Step(0.5, after=p), lambda p, u, t, n, kept, z: [p + 0.0 if t >= 0.5 else 0.0]),
    "ramp": (
        0,
        lambda p: cosim.Ramp(p, start=0.2),
        lambda p, u, t, n, kept, z: [p * (t - 0.2 if t > 0.2 else 0.0) + 0.0],
    ),
    "sine": (
        0,
        lambda p: cosim.Sine(p, period=0.7),
        lambda p, u, t, n, kept, z: [np.float64(p) * sin(2 * math.pi / 0.7 * t + 0.0) + 0.0],
    ),
    "noise": (
        0,
        lambda p: cosim.Gaussian((2.0, 0.5)),
        lambda p, u, t, n, kept, z: [2.0 * z[0] + 0.0, 0.5 * z[1] + 0.0],
    ),
    "gain": (1, lambda p: cosim.Gain(p, offset=0.25), lambda p, u, t, n, kept, z: [_gain([p], u)]),
    "matrix": (2, lambda p: cosim.Gain(ROWS, offset=0.25), lambda p, u, t, n, kept, z: [_gain(row, u) for row in ROWS]),
    "sum": (3, lambda p: cosim.Sum("+-+"), lambda p, u, t, n, kept, z: [u[0] - u[1] + u[2]]),
    "clip": (
        2,
        lambda p: cosim.Saturation(-1.5, 2.0, size=2),
        lambda p, u, t, n, kept, z: [_clip(x, -1.5, 2.0) for x in u],
    ),
    "dead zone": (
        2,
        lambda p: cosim.DeadZone(-1.5, 2.0, size=2),
        lambda p, u, t, n, kept, z: [x - _clip(x, -1.5, 2.0) if abs(x) > 1.5 or math.isnan(x) else 0.0 for x in u],
    ),
    "quotient": (2, lambda p: cosim.Product("*/"), lambda p, u, t, n, kept, z: [u[0] / u[1] + 0.0]),
    "least": (
        3,
        lambda p: cosim.Minimum(3),
        lambda p, u, t, n, kept, z: [min((x for x in u if not math.isnan(x)), default=math.nan)],
    ),
    "greater": (2, lambda p: cosim.Compare(">"), lambda p, u, t, n, kept, z: [float(u[0] > u[1])]),
    "sum over time": (
        2,
        lambda p: cosim.Integrator(1.0, low=-3.0, high=1e300, size=2),
        lambda p, u, t, n, kept, z: kept[:2],
        _sum_over_time,
        lambda p: (1.0, 1.0),
    ),
    "delay": (
        2,
        lambda p: cosim.UnitDelay(2, p),
        lambda p, u, t, n, kept, z: kept,
        lambda u, kept, n: tuple(u),
        lambda p: (p, p),
    ),
    "integral": (
        2,
        lambda p: Integrator(),
        lambda p, u, t, n, kept, z: [kept[0] - kept[1], kept[2] - kept[3]],
        _integrate,
        lambda p: (0.0,) * 4,
    ),
}


@st.composite
def known_blocks(draw):
    """A kind of `KINDS` and its number, and the block."""
    kind, number = draw(st.sampled_from(sorted(KINDS))), draw(NUMBER)
    return (kind, number), KINDS[kind][1](number)


def known_parts(plan):
    """Return kind, number and rate of each block, the sizes of their outputs, and what feeds each element of their inputs."""
    blocks = [(*known, every) for known, _, every in plan.blocks]
    wires = [
        [plan.wires[i, port.name, e][::2] for port, e in inputs_of(block)]
        for i, (_, block, _) in enumerate(plan.blocks)
    ]
    return blocks, [len(elements_of(i, block)) for i, (_, block, _) in enumerate(plan.blocks)], wires


def meaning(plan, steps, seed):
    """Outputs and inputs by block and element, computed on demand, without any schedule."""
    blocks, _, wires = known_parts(plan)
    noise = [
        [numbers(seed, f"{name}.noise", steps + 1, channel=c) for c in range(2)] if kind == "noise" else None
        for name, (kind, _, _) in zip(plan.names, blocks)
    ]
    kept = [KINDS[kind][4](number) if len(KINDS[kind]) > 3 else () for kind, number, _ in blocks]
    held, seen = {}, [[] for _ in blocks]
    rows = []
    for k in range(steps + 1):
        done = {}

        def output(i, k=k, done=done):
            if i not in done:
                kind, number, every = blocks[i]
                if k % every == 0:
                    feeds = len(KINDS[kind]) == 3
                    u = [np.float64(output(j)[e]) for j, e in wires[i]] if feeds else []
                    z = [stream[k] for stream in noise[i]] if kind == "noise" else None
                    held[i] = list(KINDS[kind][2](np.float64(number), u, np.float64(k / 30), k // every, kept[i], z))
                done[i] = held[i]
            return done[i]

        rows.append([x for i in range(len(blocks)) for x in output(i)])
        for i, (_, _, every) in enumerate(blocks):
            if k % every == 0:
                seen[i].append([held[j][e] for j, e in wires[i]])
        for i, (kind, _, every) in enumerate(blocks):
            if len(KINDS[kind]) > 3 and k % every == 0:
                further = [np.float64(x) for x in seen[i][-1]], kept[i], k // every
                kept[i] = KINDS[kind][3](*further, *[every / 30] * (kind == "sum over time"))
    return np.array(rows, dtype=float), seen


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=plans(known_blocks(), STEP), seed=st.integers(0, 2**64 - 1), pieces=st.booleans())
def test_random_diagrams(plan, seed, pieces, run_both, same_bits):
    steps, (blocks, widths, wires), levels, names = 70, known_parts(plan), plan.levels, plan.names
    diagram = build(plan)[0]
    record = [f"{name}.y" for name in names] + [f"{name}.u" for name, fed in zip(names, wires) if fed]
    record += [f"{PATHS[1]}y{i}_y" for i, level in enumerate(levels) if level]
    with pytest.MonkeyPatch.context() as patch:
        if pieces:
            patch.setattr(_running, "BREATH", 0.0)  # a return to Python at every step
        result = run_both(diagram, steps * STEP, seed=seed, record=record)
    with np.errstate(all="ignore"):
        rows, seen = meaning(plan, steps, seed)
    column = 0
    for i, width in enumerate(widths):
        for e in range(width):
            got = result[f"{names[i]}.y"].reshape(steps + 1, -1)[:, e]
            same_bits(got + 0.0, rows[:, column] + 0.0, f"b{i}.y[{e}] of {blocks[i]}")  # + 0.0: both zeros alike
            column += 1
        if wires[i]:
            every = blocks[i][2]
            got = result[f"{names[i]}.u"].reshape(steps + 1, -1)
            same_bits(got + 0.0, np.repeat(seen[i], every, axis=0)[: steps + 1] + 0.0, f"b{i}.u of {blocks[i]}")
        if levels[i]:
            same_bits(result[f"{PATHS[1]}y{i}_y"], result[f"{names[i]}.y"], "the output of the subsystem")


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=plans(known_blocks(), STEP), seed=st.integers(0, 2**64 - 1))
def test_random_diagrams_as_one_function(plan, seed, as_one, run_both):
    run_both(build(plan)[0], 70 * STEP, seed=seed)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=plans(known_blocks(), STEP), seed=st.integers(0, 2**63 - 20))
def test_random_diagrams_in_lock_step(plan, seed, lanes, campaign_as_alone):
    campaign_as_alone(build(plan)[0], 70 * STEP, tuple(range(seed, seed + 14)))
    assert lanes.pop() > 0


def test_decimation_keeps_every_nth_row(run_both, same_bits):
    diagram = cosim.Diagram("1/30")
    diagram.connect(diagram.add(cosim.Gaussian(1.0), "noise")["y"], diagram.add(cosim.UnitDelay(), "delay")["u"])
    whole = run_both(diagram, 3, seed=4)
    for n in (2, 7, 90, 91):
        part = run_both(diagram, 3, seed=4, decimation=n)
        for name in whole:
            same_bits(part[name], whole[name][::n])
        same_bits(part.time, whole.time[::n])


def affine(x, a):
    return a[0] * x + SHIFT


SHIFT = 0.125
LEVELS = (1.0, (2.0, -3.0))


def make_shape(power, gate):
    def shape(u, a, memory, peak, y, inputs, outputs, t, k):
        memory[0, 1] = memory[0, 1] + affine(u[0], a) * power
        memory[1, 0] = select(isnan(u[1]), memory[1, 0], u[1])
        y[0, 0] = memory[0, 1] / (k % 3)
        y[0, 1] = sqrt(memory[1, 0]) - LEVELS[1][0] * t
        y[1, 0] = gate(inputs[0] - inputs[1], a)
        y[1, 1] = 1.0 / k
        peak[0] = outputs[0] * y[1, 0]

    return shape


def test_custom_block(make_block, run_both):
    ports = {"inputs": [Port("u", (2,))], "outputs": [Port("y", (2, 2)), Port("peak")]}
    parts = {"state": {"memory": np.ones((2, 2))}, "parameters": {"a": [0.5]}}
    diagram = cosim.Diagram(0.1)
    noise = diagram.add(cosim.Gaussian((1.0, 3.0)), "noise")
    for i, power in enumerate((2, 2.5)):
        block = diagram.add(make_block(**ports, **parts, output=make_shape(power, affine)), f"block_{i}", every=i + 1)
        diagram.connect(noise["y"], block["u"])
    result = run_both(diagram, 30, seed=3, record=["*", "noise.noise"])
    u = result["noise.y"]
    assert np.isinf(result["block_0.y"][0, 1, 1])  # 1 / 0 at the first step
    assert np.isnan(result["block_0.y"]).any()  # the root of a negative number
    np.testing.assert_allclose(result["block_0.y"][:, 1, 0], 0.5 * (u[:, 0] - u[:, 1]) + SHIFT, rtol=1e-15)
    total = 1 + np.cumsum((0.5 * u[:, 0] + SHIFT) * 2)
    third = np.arange(301) % 3
    np.testing.assert_allclose(
        result["block_0.y"][third > 0, 0, 0] * third[third > 0], total[third > 0], rtol=0, atol=1e-10
    )
    assert not np.array_equal(result["block_1.y"], result["block_0.y"], equal_nan=True)  # another closure, another code


def test_division_of_two_plain_numbers_by_zero_is_a_sentence(make_block):
    def divide(y):
        x = 0.0
        y[0] = 1.0 / x

    diagram = cosim.Diagram(1)
    diagram.add(make_block(outputs=[Port("y")], output=divide), "d")
    assert np.isinf(diagram.simulate(0, engine="compiled")["d.y"][0])
    with pytest.raises(cosim.KernelError, match="'divide' divides a plain Python number by a plain zero"):
        diagram.simulate(0, engine="interpreted")


def blow_up(k, limit, y, z):
    y[0] = 1.0
    z[0] = 2.0
    z[1] = select(k == 7, limit[0], 3.0)


@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (-np.inf, "infinite")])
@pytest.mark.parametrize("every", [1, 3])
def test_not_finite(make_block, value, word, every):
    ports = [Port("y"), Port("z", (2,))]
    diagram = cosim.Diagram("1/50")
    diagram.add(
        make_block(outputs=ports, output=blow_up, parameters={"limit": value}, finite=True), "plant", every=every
    )
    step = 7 * every
    for engine in ("compiled", "interpreted"):
        with pytest.raises(cosim.SimulationError) as caught:
            diagram.simulate(2, engine=engine)
        assert str(caught.value).startswith(
            f"The run stopped at t = {step / 50:g} s (step {step}): plant.z[1] came out {word}. Check the plant's"
        )
        result = caught.value.result
        assert result.stopped == str(caught.value)
        assert len(result.time) == len(result["plant.y"]) == step
        np.testing.assert_array_equal(result["plant.z"], np.tile([2.0, 3.0], (step, 1)))
    harmless = cosim.Diagram("1/50")
    harmless.add(make_block(outputs=ports, output=blow_up, parameters={"limit": value}), "sensor")
    assert harmless.simulate(2).stopped is None


def test_not_finite_at_the_very_first_step(make_block):
    def zero_over_zero(t, y):
        y[0] = t / t

    for engine in ("compiled", "interpreted"):
        diagram = cosim.Diagram(1)
        diagram.add(make_block(outputs=[Port("y")], output=zero_over_zero, finite=True), "plant")
        with pytest.raises(cosim.SimulationError, match="step 0") as caught:
            diagram.simulate(3, engine=engine, decimation=2)
        assert len(caught.value.result.time) == 0
        assert len(caught.value.result["plant.y"]) == 0
        assert "0 rows" in repr(caught.value.result)


def test_two_runs_at_once_do_not_disturb_each_other(same_bits):
    def diagram(n):
        d = cosim.Diagram(0.001)
        noise, total = d.add(cosim.Gaussian((1.0, 1.0 + n))), d.add(Integrator(), "total")
        d.connect(noise["y"], total["u"])
        return d

    shared, others = diagram(0), [diagram(1), diagram(2)]
    jobs = [(shared, 1), (shared, 2), (shared, 1), (others[0], 1), (others[1], 1)]
    alone = [d.simulate(100, seed=seed)["total.y"] for d, seed in jobs]
    together, go = [None] * len(jobs), threading.Barrier(len(jobs))

    def work(i, job):
        go.wait()
        together[i] = job[0].simulate(100, seed=job[1])["total.y"]

    threads = [threading.Thread(target=work, args=(i, job)) for i, job in enumerate(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for a, b in zip(alone, together):
        same_bits(a, b)


def test_a_run_inside_a_run_of_the_same_diagram(same_bits):
    diagram = cosim.Diagram(0.01)
    noise, total = diagram.add(cosim.Gaussian((1.0, 2.0))), diagram.add(Integrator(), "total")
    diagram.connect(noise["y"], total["u"])
    for engine in ("compiled", "interpreted"):
        alone = [diagram.simulate(2, seed=seed, engine=engine)["total.y"] for seed in (1, 2)]
        inner = []

        def progress(k, steps, engine=engine, inner=inner):
            if not inner:
                inner.append(diagram.simulate(2, seed=2, engine=engine)["total.y"])

        outer = diagram.simulate(2, seed=1, engine=engine, progress=progress)["total.y"]
        same_bits(outer, alone[0])
        same_bits(inner[0], alone[1])


def test_noise_belongs_to_the_name(run_both, same_bits):
    def noise_of_a(*others, **changes):
        diagram = cosim.Diagram(0.1)
        for i, std in enumerate(others):
            diagram.add(cosim.Gaussian(std), f"other_{i}")
        diagram.add(cosim.Gaussian(changes.get("std", (1.0, 1.0))), changes.get("name", "a"))
        return run_both(diagram, 5, seed=changes.get("seed", 0))[changes.get("name", "a") + ".y"]

    plain = noise_of_a()
    same_bits(noise_of_a(1.0, (1.0, 2.0)), plain)
    same_bits(noise_of_a(std=(1.0, 1.0, 1.0))[:, :2], plain)  # a further channel leaves the others
    assert not np.isclose(noise_of_a(name="b"), plain).any()
    assert not np.isclose(noise_of_a(seed=1), plain).any()
    assert not np.isclose(plain[:, 0], plain[:, 1]).any()
    same_bits(np.stack([numbers(0, "a.noise", 51, channel=c) for c in range(2)], axis=1), plain)


def test_labels():
    assert labels("a.y", ()) == ["a.y"]
    assert labels("a.y", (2,)) == ["a.y[0]", "a.y[1]"]
    assert labels("a.y", (1, 2)) == ["a.y[0,0]", "a.y[0,1]"]
