"""Tight coupling: FMUs that feed each other, iterated; steps as small as the error asks."""

import math
import os
import signal
import zipfile

import numpy as np
import pytest
from scipy.linalg import expm

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.diagram.coupling import Coupling
from bayesftc.cosim.fmi.running.instance import Instance
from bayesftc.cosim.run.coupled import engines as _group_engines
from bayesftc.cosim.run.repeat import repeat
from bayesftc.examples.coupled_masses import study
from bayesftc.examples.coupled_masses.masses import Masses, sprung_mass
from bayesftc.fmus._compiler import why_no_compiler

pytestmark = pytest.mark.skipif(bool(why_no_compiler()), reason=why_no_compiler() or "there is a compiler")

MASSES = Masses()
DAMPED = Masses(c=4.0)
ENGINES = ("compiled", "interpreted")
WAYS = {
    "jacobi": Coupling("jacobi"),
    "gauss-seidel": Coupling("gauss-seidel"),
    "end": Coupling("iterated", tolerance=1e-13),
    "mean": Coupling("iterated", tolerance=1e-13, hold="mean"),
}


def built(masses, n, way, **settings):
    diagram = masses.diagram(f"1/{n}", settings.pop("fmi", ("2.0", "3.0")))
    return diagram.build(WAYS.get(way, way), **settings)


# --- two masses ---------------------------------------------------------------------------------------------------------------


def stepped(masses, n, way, steps=100):
    """Return the positions that a way of coupling must yield: each mass by its own matrix exponential, values held."""
    h = 1.0 / n
    flows = []
    for m in masses.m:
        a = np.array(
            [[0.0, 1.0, 0.0, 0.0], [-masses.k / m, -masses.c / m, masses.k / m, masses.c / m]] + [[0.0] * 4] * 2
        )
        flows.append(expm(a * h)[:2])
    own = np.block([[flows[0][:, :2], np.zeros((2, 2))], [np.zeros((2, 2)), flows[1][:, :2]]])
    other = np.block([[np.zeros((2, 2)), flows[0][:, 2:]], [flows[1][:, 2:], np.zeros((2, 2))]])
    z = np.array([masses.x0[0], masses.v0[0], masses.x0[1], masses.v0[1]])
    rows = [z]
    for _ in range(steps):
        if way == "jacobi":
            z = own @ z + other @ z
        elif way == "gauss-seidel":
            first = (own + other)[:2] @ z
            z = np.concatenate([first, own[2:] @ z + other[2:, :2] @ first])
        elif way == "end":
            z = np.linalg.solve(np.eye(4) - other, own @ z)
        else:
            z = np.linalg.solve(np.eye(4) - 0.5 * other, (own + 0.5 * other) @ z)
        rows.append(z)
    return np.array(rows)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("masses", [MASSES, DAMPED], ids=["spring", "damper"])
@pytest.mark.parametrize("way", WAYS)
def test_each_way_yields_what_it_must(masses, way, run_both):
    run = run_both(built(masses, 100, way), 1)
    found = np.array([run[f"{name}.{q}"] for name in ("one", "two") for q in "xv"]).T
    np.testing.assert_allclose(found, stepped(masses, 100, way), rtol=0, atol=2e-9)


@pytest.mark.parametrize(("way", "order"), [("jacobi", 1), ("gauss-seidel", 1), ("end", 1), ("mean", 2)])
def test_order_of_convergence(way, order):
    errors = [DAMPED.error(built(DAMPED, n, way).simulate(1)) for n in (200, 400, 800)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.1)
    assert WAYS[way].order == order


def test_energy_grows_falls_or_stays():
    ends = {}
    for way in WAYS:
        run = built(MASSES, 100, way).simulate(2)
        energy = MASSES.energy(*(run[name] for name in ("one.x", "two.x", "one.v", "two.v")))
        ends[way] = energy[-1] / energy[0]
    assert ends["jacobi"] > 1.5
    assert ends["end"] < 0.6
    assert abs(ends["gauss-seidel"] - 1.0) < 0.01
    assert abs(ends["mean"] - 1.0) < 1e-3


@pytest.mark.parametrize(("way", "pull"), [("jacobi", -1), ("gauss-seidel", 0), ("end", 1), ("mean", 0)])
def test_a_motion_of_both_masses_together(way, pull):
    """Where both move at v, a position that is held at one end of the step pulls each with k v h / 2 on average."""
    both = Masses(x0=(0.0, 0.0), v0=(1.0, 1.0))
    run = built(both, 200, way).simulate(1)
    speed = both.together(run["one.v"], run["two.v"])[-1]
    assert np.log(speed) / (both.k / 200 / sum(both.m)) == pytest.approx(pull, abs=0.02)


@pytest.mark.parametrize("acceleration", ["anderson", "aitken", None])
def test_every_acceleration_finds_the_same(acceleration, run_both):
    wanted = stepped(DAMPED, 100, "end")[:, 0]
    run = run_both(built(DAMPED, 100, "iterated", tolerance=1e-12, acceleration=acceleration, iterations=200), 1)
    np.testing.assert_allclose(run["one.x"], wanted, rtol=0, atol=1e-9)


def counted_sweeps(monkeypatch, acceleration, k):
    count = [0]
    usual = _group_engines.InterpretedGroup.sweep

    def sweep(self, *given):
        count[0] += 1
        return usual(self, *given)

    monkeypatch.setattr(_group_engines.InterpretedGroup, "sweep", sweep)
    stiff = Masses(k=k, c=0.02 * k)
    try:
        built(stiff, 20, "iterated", acceleration=acceleration, iterations=500).simulate(1, engine="interpreted")
    except cosim.SimulationError:  # it does not converge
        return math.inf
    return count[0] / 20


@pytest.mark.slow
def test_acceleration_pays_where_it_is_stiff(monkeypatch):
    counts = {a: counted_sweeps(monkeypatch, a, 1e3) for a in (None, "aitken", "anderson")}
    assert counts["anderson"] < counts[None]
    assert counts["anderson"] <= 8  # four values are guessed at most


def test_steps_as_small_as_the_error_asks(run_both):
    errors = []
    for step_error in (1e-3, 1e-5, 1e-7):
        diagram = built(DAMPED, 20, "mean", step_error=step_error)
        run = diagram.simulate(1) if errors else run_both(diagram, 1)
        assert len(run.time) == 21  # results stay on the base grid
        errors.append(DAMPED.error(run))
    assert errors[0] < DAMPED.error(built(DAMPED, 20, "mean").simulate(1))
    assert errors[0] > 5 * errors[1] > 25 * errors[2]
    assert errors[2] < 1e-4


@pytest.mark.parametrize("way", WAYS)
def test_a_loose_error_leaves_the_step_as_two_halves(way, same_bits):
    """Of a step that is accepted at once the two halves count."""
    coarse = built(DAMPED, 50, way, step_error=1e9).simulate(1)
    fine = built(DAMPED, 100, way).simulate(1)
    np.testing.assert_allclose(coarse["one.x"], fine["one.x"][::2], rtol=0, atol=1e-10)


def test_live_runs_of_coupled_fmus_go_back(same_bits):
    whole = built(DAMPED, 20, "mean", step_error=1e-5).simulate(1)
    for engine in ENGINES:
        with built(DAMPED, 20, "mean", step_error=1e-5).start(engine=engine) as session:
            session.advance(0.4)
            state = session.save_state()
            session.advance(0.3)
            session.restore(state)
            rest = session.advance(0.6)
            for name in whole:
                same_bits(rest[name], whole[name][9:], name)


def test_many_runs_of_coupled_fmus(same_bits):
    diagram = built(DAMPED, 50, "end")
    whole = diagram.simulate(0.2)
    for run in repeat(diagram, 0.2, range(3), ["one.x"]):
        same_bits(run["one.x"], whole["one.x"])


def test_no_saved_state_is_left(monkeypatch):
    """Each state that is saved is freed, of FMI 2 and 3, by the instance that gave it."""
    calls = []
    monkeypatch.setattr(Instance, "state_functions", None)  # the compiled loop then saves by way of Python
    for name in ("save", "forget"):
        usual = getattr(Instance, name)

        def counted(self, *given, name=name, usual=usual):
            calls.append(name)
            return usual(self, *given)

        monkeypatch.setattr(Instance, name, counted)
    for settings in ({}, {"step_error": 1e-5}):
        calls.clear()
        built(DAMPED, 20, "end", **settings).simulate(0.5, engine="compiled")
        assert calls.count("save") == calls.count("forget") >= 20


@pytest.mark.parametrize("settings", [{}, {"step_error": 1e-5}])
def test_states_saved_by_way_of_python_are_the_same(monkeypatch, same_bits, settings):
    whole = built(DAMPED, 20, "end", **settings).simulate(1, engine="compiled")
    monkeypatch.setattr(Instance, "state_functions", None)
    again = built(DAMPED, 20, "end", **settings).simulate(1, engine="compiled")
    for name in whole:
        same_bits(again[name], whole[name])


# --- what stands between and around FMUs --------------------------------------------------------------------------------------


def test_blocks_without_a_memory_are_computed_along(run_both):
    direct = run_both(built(DAMPED, 100, "end"), 0.5)
    diagram = cosim.Diagram("1/100")
    one, two = (add_mass(diagram, name, i) for i, name in enumerate(("one", "two")))
    for here, there in ((one, two), (two, one)):
        for port in "xv":
            half = diagram.add(cosim.Gain(0.5), f"{here.name}_{port}_half")
            twice = diagram.add(cosim.Sum("++"), f"{here.name}_{port}_twice")
            diagram.connect(here[port], half["u"])
            diagram.connect([half["y"], half["y"]], twice["u"])
            diagram.connect(twice["y"], there[f"{port}_other"])
    through = run_both(diagram.build("iterated", tolerance=1e-13), 0.5)
    for name in ("one.x", "two.v"):
        np.testing.assert_allclose(through[name], direct[name], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(through["one_x_twice.y"], through["one.x"])  # the others see t_k
    assert "(guessing " in diagram.schedule.describe().splitlines()[-1]


def add_mass(diagram, name, i, masses=DAMPED, fmi="2.0", every=1):
    start = {"m": masses.m[i], "k": masses.k, "c": masses.c, "x0": masses.x0[i], "v0": masses.v0[i]}
    return diagram.add(cosim.FMU(sprung_mass(fmi), parameters=start), name, every=every)


def test_a_delay_between_ends_the_iteration(run_both):
    """A block with a memory is seen as at t_k, so what feeds it is no part of a loop."""
    diagram = cosim.Diagram("1/100")
    one, two = (add_mass(diagram, name, i) for i, name in enumerate(("one", "two")))
    late = diagram.add(cosim.UnitDelay(2, initial=[0.0, 0.5]), "late")
    diagram.connect([two["x"], two["v"]], late["u"])
    diagram.connect(late["y"][0], one["x_other"])
    diagram.connect(late["y"][1], one["v_other"])
    for port in "xv":
        diagram.connect(one[port], two[f"{port}_other"])
    diagram.build("iterated")
    assert "guessing" not in diagram.schedule.describe()
    run = run_both(diagram, 0.5)
    gauss = cosim.Diagram("1/100")
    one, two = (add_mass(gauss, name, i) for i, name in enumerate(("one", "two")))
    late = gauss.add(cosim.UnitDelay(2, initial=[0.0, 0.5]), "late")
    gauss.connect([two["x"], two["v"]], late["u"])
    gauss.connect(late["y"][0], one["x_other"])
    gauss.connect(late["y"][1], one["v_other"])
    for port in "xv":
        gauss.connect(one[port], two[f"{port}_other"])
    np.testing.assert_array_equal(run["two.x"], run_both(gauss, 0.5)["two.x"])


def test_groups_keep_their_rate_and_inputs_are_recorded_as_at_t_k(run_both):
    slow = cosim.Diagram("1/300")
    one, two = (add_mass(slow, name, i, every=3) for i, name in enumerate(("one", "two")))
    for here, there in ((one, two), (two, one)):
        for port in "xv":
            slow.connect(here[port], there[f"{port}_other"])
    run = run_both(slow.build("iterated", tolerance=1e-13), 0.5, record=["*", "one.x_other"])
    direct = built(DAMPED, 100, "end", fmi=("2.0", "2.0")).simulate(0.5)
    np.testing.assert_array_equal(run["one.x"][::3], direct["one.x"])
    np.testing.assert_array_equal(run["one.x_other"], run["two.x"])


def without(fmi, capability, target):
    with zipfile.ZipFile(sprung_mass(fmi)) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                state = {"canGetAndSetFMU": "state" if fmi == "2.0" else "State"}.get(capability, "")
                said = f'{capability}{state}="true"'.encode()
                assert said in content
                content = content.replace(said, said.replace(b"true", b"false"))
                content = content.replace(b'generationTool="bayesftc"', b'generationTool="another tool"')
            new.writestr(name, content)
    return target


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_fmus_that_cannot_go_back_are_named(fmi, tmp_path):
    mute = without(fmi, "canGetAndSetFMU", tmp_path / "mute.fmu")
    rigid = without(fmi, "canHandleVariableCommunicationStepSize", tmp_path / "rigid.fmu")
    cases = [
        (
            mute,
            {},
            r"The FMU 'two' cannot save and restore its state .* which iterated coupling of one and two needs; put a Unit",
        ),
        (mute, {"step_error": 1e-3}, r"The FMU 'two' cannot save .* which step_error of one and two needs"),
        (
            rigid,
            {"step_error": 1e-3},
            r"The FMU 'two' makes steps of one size only .* varies those of one and two; leave",
        ),
    ]
    for path, settings, sentence in cases:
        diagram = pair(path, delayed=False)
        with pytest.raises(cosim.FMUError, match=sentence):
            diagram.build("iterated", **settings).simulate(0.1)
    pair(rigid, delayed=False).build("iterated").simulate(0.1)
    pair(mute, delayed=True).build("iterated").simulate(0.1)  # the delay that was asked for is there
    pair(mute, delayed=False).build().simulate(0.1)


def pair(path, *, delayed):
    diagram = cosim.Diagram("1/100")
    one, two = add_mass(diagram, "one", 0), diagram.add(cosim.FMU(path), "two")
    for port in "xv":
        diagram.connect(one[port], two[f"{port}_other"])
        source = two[port]
        if delayed:
            late = diagram.add(cosim.UnitDelay(), f"late_{port}")
            diagram.connect(source, late["u"])
            source = late["y"]
        diagram.connect(source, one[f"{port}_other"])
    return diagram


def test_a_chain_needs_no_way_back(tmp_path, same_bits):
    """FMUs that only feed on are stepped one after the other, as with Gauss-Seidel, whatever they can."""
    mute = without("2.0", "canGetAndSetFMU", tmp_path / "mute.fmu")
    runs = {}
    for way in ("iterated", "gauss-seidel"):
        diagram = cosim.Diagram("1/100")
        one, two = add_mass(diagram, "one", 0), diagram.add(cosim.FMU(mute), "two")
        diagram.connect(one["x"], two["x_other"])
        runs[way] = diagram.build(way).simulate(0.5)
        assert runs[way]["two.x"].std() > 0.1
    same_bits(runs["iterated"]["two.x"], runs["gauss-seidel"]["two.x"])


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize("settings", [{}, {"step_error": 1e-4}])
def test_isolated_fmus_are_iterated_with_the_same_bits(settings, same_bits, run_both):
    runs = []
    for isolate in (False, True):
        diagram = cosim.Diagram("1/20")
        start = {"m": 2.0, "k": 100.0, "c": 4.0, "v0": 0.5}
        one = add_mass(diagram, "one", 0)
        two = diagram.add(cosim.FMU(sprung_mass(), parameters=start, isolate=isolate), "two")
        for here, there in ((one, two), (two, one)):
            for port in "xv":
                diagram.connect(here[port], there[f"{port}_other"])
        runs.append(run_both(diagram.build("iterated", **settings), 0.5))
        with diagram.start() as session:
            session.advance(0.2)
            state = session.save_state()
            session.advance(0.1)
            session.restore(state)
            same_bits(session.advance(0.3)["one.x"], runs[-1]["one.x"][5:])
    for name in runs[0]:
        same_bits(runs[1][name], runs[0][name], name)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_an_isolated_fmu_that_is_gone_when_it_is_saved(engine):
    diagram = cosim.Diagram("1/20")
    one, two = add_mass(diagram, "one", 0), diagram.add(cosim.FMU(sprung_mass(), isolate=True), "two")
    for here, there in ((one, two), (two, one)):
        diagram.connect(here["x"], there["x_other"])
    with diagram.build("iterated").start(engine=engine) as session:
        session.advance(0.2)
        os.killpg(session._run.instances[1]._process._process.pid, signal.SIGKILL)
        with pytest.raises(cosim.FMUCrashed, match=r"at t = 0\.2 s \(step 4\): The FMU of 'two' ") as caught:
            session.advance(0.2)
        assert caught.value.step == 4
        assert "saved" not in str(caught.value)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("settings", [{}, {"step_error": 1e-4}])
def test_model_exchange_fmus_are_iterated_at_t_k_and_to_t_k_1(settings, casadi_fmu, run_both):
    """Two pendulums that pull each other, and whose outputs show the pull: an algebraic loop as well."""
    path = casadi_fmu(f"pulled{len(settings)}", lambda q, u: q + 0.1 * u)
    diagram = cosim.Diagram("1/50")
    one, two = (diagram.add(cosim.FMU(path, timing="direct"), name) for name in ("one", "two"))
    pull = diagram.add(cosim.Gain(-3.0), "pull")
    diagram.connect(one["y"], two["u"])
    diagram.connect(two["y"], pull["u"])
    diagram.connect(pull["y"], one["u"])
    diagram.build("iterated", tolerance=1e-12, **settings)
    run = run_both(diagram, 1, record=["*", "one.u", "two.u"])
    np.testing.assert_allclose(run["one.u"], -3.0 * run["two.y"], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(run["two.u"], run["one.y"], rtol=1e-10, atol=1e-12)
    q = run["one.y"] - 0.1 * run["one.u"], run["two.y"] - 0.1 * run["two.u"]
    assert q[0][0] == pytest.approx(0.5)
    fine = pulled(0.5, 50)
    np.testing.assert_allclose(q, [fine[0], fine[2]], atol=0.01 if settings else 0.05)
    with diagram.start() as session:
        session.advance(0.4)
        state = session.save_state()
        session.advance(0.1)
        session.restore(state)
        np.testing.assert_allclose(session.advance(0.6)["one.y"], run["one.y"][21:], rtol=1e-9)


def pulled(q, steps):
    """Return the angles and velocities of the pendulums, integrated together."""
    from scipy.integrate import solve_ivp

    def flow(t, z):
        # y1 = q1 + .1 u1, u1 = -3 y2, y2 = q2 + .1 u2, u2 = y1
        y1 = (z[0] - 0.3 * z[2]) / 1.03
        u1 = -3.0 * (z[2] + 0.1 * y1)
        return [z[1], -9.81 * np.sin(z[0]) - 0.1 * z[1] + u1, z[3], -9.81 * np.sin(z[2]) - 0.1 * z[3] + y1]

    return solve_ivp(flow, (0, 1), [q, 0, q, 0], t_eval=np.linspace(0, 1, steps + 1), rtol=1e-10, atol=1e-12).y


@pytest.mark.parametrize("engine", ENGINES)
def test_an_output_that_is_no_number_while_iterating_is_named(engine):
    diagram = cosim.Diagram("1/10")
    one, two = (add_mass(diagram, name, i, Masses(k=1e300, c=1e300)) for i, name in enumerate(("one", "two")))
    for here, there in ((one, two), (two, one)):
        diagram.connect(here["x"], there["x_other"])
    with pytest.raises(cosim.SimulationError, match=r"at t = 0\.1 s \(step 1\): one\.[xv] came out (NaN|infinite)"):
        diagram.build("iterated").simulate(1, engine=engine)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_output_that_jumps_ends_step_doubling_in_a_sentence(engine, make_block):
    """A block between the FMUs that is never the same twice lets no step be small enough."""

    def restless(t, u, y):
        y[0] = u[0] + 10.0 * ((t * 1e7) % 2.0)

    diagram = cosim.Diagram("1/10")
    one, two = (add_mass(diagram, name, i) for i, name in enumerate(("one", "two")))
    noise = diagram.add(make_block(inputs=(Port("u"),), outputs=(Port("y"),), output=restless), "noise")
    diagram.connect(one["x"], noise["u"])
    diagram.connect(noise["y"], two["x_other"])
    diagram.connect(two["x"], one["x_other"])
    with pytest.raises(
        cosim.SimulationError,
        match=r"no step of .* is small enough for step_error=1e-09: in one of 1\.53e-06 s the error of",
    ):
        diagram.build("jacobi", step_error=1e-9).simulate(1, engine=engine)


# --- any diagram ----------------------------------------------------------------------------------------------------------------


def any_diagram(seed):
    """Return a diagram of three masses, which move each other by blocks with a memory and without, at several rates."""
    rng = np.random.default_rng(seed)
    diagram = cosim.Diagram("1/10")
    outputs, inputs = [], []
    for i in range(3):
        block = cosim.FMU(sprung_mass(str(rng.choice(["2.0", "3.0"]))), parameters={"x0": 1.0 + i, "k": 5.0, "c": 0.5})
        node = diagram.add(block, f"mass{i}", every=int(rng.choice([1, 1, 1, 2])))
        outputs += [node["x"], node["v"]]
        inputs += [node["x_other"], node["v_other"]]
    for i in range(5):
        kind = rng.choice(["gain", "gain", "sum", "delay"])
        block = {"gain": cosim.Gain(0.5), "sum": cosim.Sum("+-"), "delay": cosim.UnitDelay()}[kind]
        node = diagram.add(block, f"block{i}", every=int(rng.choice([1, 1, 1, 2])))
        inputs += [node["u"][e] for e in range(len(node["u"]))]
        outputs += [node["y"]]
    for target in inputs:
        half = diagram.add(cosim.Gain(0.4), f"half{len(diagram.nodes)}")
        diagram.connect(outputs[rng.integers(len(outputs))], half["u"])
        diagram.connect(half["y"], target)
    return diagram


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(25))
def test_any_diagram_gives_the_same_bits_in_both_engines_and_goes_back(seed, run_both, same_bits):
    method = ["iterated", "iterated", "jacobi", "gauss-seidel"][seed % 4]
    settings = {"step_error": 1e-4} if seed % 3 == 0 else {}
    diagram = any_diagram(seed)
    try:
        diagram.build(method, **settings)
    except cosim.AlgebraicLoopError:
        assert method != "iterated"
        diagram.build("iterated", **settings)
    run = run_both(diagram, 2)
    with diagram.start() as session:
        session.advance(0.7)
        state = session.save_state()
        session.advance(0.4)
        session.restore(state)
        rest = session.advance(1.3)
        for name in run:
            same_bits(rest[name], run[name][8:], name)


# --- settings -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"method": "itterated"}, "coupling is 'itterated'; it must be 'gauss-seidel', 'jacobi' or 'iterated'"),
        ({"acceleration": "newton"}, "acceleration='newton'; it must be None, 'aitken' or 'anderson'"),
        ({"hold": "begin"}, "hold='begin'; it must be 'end' or 'mean'"),
        ({"tolerance": 0}, "tolerance=0; it must be a positive number"),
        ({"tolerance": None}, "tolerance=None; it must be a positive number"),
        ({"step_error": float("nan")}, "step_error=nan; it must be a positive number"),
        ({"iterations": 0}, "iterations=0; it must be a whole number"),
        ({"iterations": 2.5}, "iterations=2.5; it must be a whole number"),
        ({"hold": "mean"}, "hold='mean' works with iterated coupling only"),
    ],
)
def test_settings_that_cannot_be(settings, sentence):
    with pytest.raises(cosim.ModelError) as caught:
        Coupling(**settings)
    assert sentence in str(caught.value)


def test_a_diagram_is_built_with_one_coupling():
    diagram = cosim.Diagram(1).build("iterated", tolerance=1e-6)
    assert diagram.build() is diagram
    assert diagram.build(Coupling("iterated", tolerance=1e-6)) is diagram
    with pytest.raises(cosim.ModelError, match="built with iterated coupling; it cannot be built again with other"):
        diagram.build("iterated")
    with pytest.raises(TypeError, match="tol"):
        cosim.Diagram(1).build("iterated", tol=1e-6)


# --- the example --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_study_prints_the_orders_and_draws_them(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(study, "STEPS", (200, 400))
    monkeypatch.setattr(study, "ERRORS", (1e-3, 1e-4))
    orders = study.main(str(tmp_path / "figure.png"))
    assert {name: round(order) for name, order in orders.items()} == {
        "Jacobi": 1,
        "Gauss-Seidel": 1,
        "iterated, end held": 1,
        "iterated, mean held": 2,
    }
    assert (tmp_path / "figure.png").stat().st_size > 20_000
    assert len(capsys.readouterr().out.splitlines()) == 15


def test_a_drift_of_the_centre_of_mass_is_gauss_seidels_error():
    """The page on coupling says so."""
    exact = DAMPED.exact(np.arange(101) / 100)
    apart = {}
    for way in ("jacobi", "gauss-seidel"):
        run = built(DAMPED, 100, way).simulate(1)
        errors = run["one.x"] - exact[0], run["two.x"] - exact[1]
        apart[way] = np.abs(errors[0] - errors[1]).max()
        if way == "gauss-seidel":
            centre = np.abs(DAMPED.m[0] * errors[0] + DAMPED.m[1] * errors[1]).max() / sum(DAMPED.m)
            assert centre > 50 * apart[way]
    assert apart["gauss-seidel"] < apart["jacobi"]
