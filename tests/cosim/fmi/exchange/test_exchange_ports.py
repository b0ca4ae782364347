"""Model exchange FMUs with ports of every numeric type, and with tunable parameters that change while they run."""

import pickle
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU

FMI = ("2.0", "3.0")
# From one number that the type holds to another, at its ends where a double has them.
RANGES = {
    "s": (-1.5, 0.25), "i8": (-128, 127), "u8": (0, 255), "i16": (-32768, 32767), "u16": (0, 65535),
    "i32": (-(2**31), 2**31 - 1), "u32": (0, 2**32 - 1), "i64": (-(2**53) + 1, 2**53 - 1), "u64": (0, 2**53 - 1), "b": (0, 1),
    "e": (1, 2),
}  # fmt: skip


def driven(path, sources, dt=0.25, **options):
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(FMU(path, name="p", **options), "p")
    for name, block in sources.items():
        diagram.connect(diagram.add(block, f"to_{name}")["y"], plant[name])
    return diagram


@pytest.mark.sampled(3)
@pytest.mark.parametrize("solver", ["cvode", "scipy:RK45"])
@pytest.mark.parametrize("fmi", ["1.0", *FMI])
def test_every_type_is_converted_exactly_at_the_same_instant(built, fmi, solver, run_both):
    block = FMU(built("typed", fmi))
    ports = {p.name: p.shape for p in block.inputs}
    chosen = {name: ends for name, ends in RANGES.items() if name in ports}
    assert set(ports) - set(chosen) == ({"u", "a"} if fmi == "3.0" else {"u"})
    steps = {name: cosim.Step(time=0.5, before=float(low), after=float(high)) for name, (low, high) in chosen.items()}
    start = {"a": [3, -4]} if fmi == "3.0" else {}
    result = run_both(driven(built("typed", fmi), steps, solver=solver, parameters=start), 1)
    for name in chosen:
        np.testing.assert_array_equal(result[f"p.{name}_out"], result[f"to_{name}.y"], name)
    if fmi == "3.0":
        assert ports["a"] == (2,)
        np.testing.assert_array_equal(result["p.a_out"], np.tile([3.0, -4.0], (5, 1)))
        np.testing.assert_array_equal(result["p.y"], result["to_s.y"])  # a Float32 that feeds through


@pytest.mark.parametrize("timing", ["direct", "plant", "sampled"])
@pytest.mark.parametrize("solver", ["rk45", "scipy:RK45"])
@pytest.mark.parametrize("fmi", FMI)
def test_tunable_parameters_change_between_steps(built, fmi, solver, timing, run_both):
    options = {"tunable": ["k", "m"], "outputs": ["x", "y"], "inputs": ["u"], "solver": solver, "timing": timing}
    sources = {"k": cosim.Step(time=0.5, before=1.0, after=3.0), "m": cosim.Step(time=0.75, before=2.0, after=-1.0)}
    result = run_both(driven(built("typed", fmi), sources, **options), 1.5)
    k, m = result["to_k.y"], result["to_m.y"]
    x = np.cumsum(0.25 * m)  # x' = m, at the end of each step
    at_t_k = np.concatenate([[0.0], x[:-1]])
    seen, gain = {"direct": (at_t_k, k), "plant": (at_t_k, [1.0, *k[:-1]]), "sampled": (x, k)}[timing]
    np.testing.assert_allclose(result["p.x"], seen, atol=1e-9)
    np.testing.assert_allclose(result["p.y"], seen * np.asarray(gain), atol=1e-9)


def test_a_tunable_parameter_counts_as_feeding_through(built):
    block = FMU(built("typed"), tunable=["k"], inputs=["u"], outputs=["x"])
    assert (block.timing, {p.name: p.feedthrough for p in block.inputs}) == ("direct", {"u": False, "k": True})
    assert pickle.loads(pickle.dumps(block)) == block
    with pytest.raises(FMUError, match="only tunable parameters that are numbers can change during a run"):
        FMU(built("ball"), tunable=["g"])


@pytest.mark.parametrize(
    ("fmi", "name", "value", "sentence"),
    [
        ("2.0", "i32", 2.5, r"The input 'i32' is Integer and must be a whole number from -2147483648 to 2147483647"),
        ("2.0", "b", 2.0, r"The input 'b' is Boolean and must be a whole number from 0 to 1"),
        ("2.0", "e", 3.0, r"The input 'e' is Enumeration and must be a whole number from 1 to 2"),
        ("3.0", "u8", 256.0, r"The input 'u8' is UInt8 and must be a whole number from 0 to 255"),
        ("3.0", "s", 1e39, r"The input 's' is Float32 and must be a number up to 3\.40282e\+38"),
        ("3.0", "m", 0.5, r"The tunable parameter 'm' is Int32 and must be a whole number"),
        ("3.0", "i64", 2.0**53, r"The output 'i64_out' is connected, but its value is a whole number"),
    ],
)
def test_values_that_a_type_does_not_hold_stop_the_run(built, fmi, name, value, sentence):
    for engine, solver in (("compiled", "cvode"), ("interpreted", "scipy:RK45")):
        tunable = ["m"] if name == "m" else []
        diagram = driven(
            built("typed", fmi), {name: cosim.Step(time=0.5, after=value, before=1.0)}, tunable=tunable, solver=solver
        )
        if name == "i64":  # else it is rounded
            diagram.connect(diagram["p"]["i64_out"], diagram.add(cosim.Gain(1.0), "needs")["u"])
        with pytest.raises(SimulationError, match=r"(?s)The run stopped at t = 0\.5 s.*" + sentence):
            diagram.simulate(1, engine=engine)


@pytest.mark.parametrize("solver", ["cvode", "scipy:RK45"])
def test_saved_with_whole_numbers_and_tunables_it_goes_on_with_the_same_bits(built, solver, same_bits):
    block = FMU(built("typed", "3.0"), tunable=["k", "m"], solver=solver)
    size = sum(p.size for p in block.outputs)

    def steps(instance, begin, end):
        rows = []
        for k in range(begin, end):
            u = np.concatenate(
                [np.ravel(np.full(p.shape, {"b": k % 2, "e": 1 + k % 2}.get(p.name, k))) for p in block.inputs]
            )
            y = np.zeros(size)
            assert instance.output(u.astype(float), y, k / 10) == instance.update(u.astype(float), y, k / 10) == 0
            rows.append(y)
        return np.array(rows)

    instance = block.instantiate(Fraction(1, 10), "p")
    steps(instance, 0, 4)
    saved = instance.save()
    first = steps(instance, 4, 9)
    instance.restore(saved)
    same_bits(steps(instance, 4, 9), first)
    other = FMU(built("typed", "3.0"), inputs=["u"], solver=solver).instantiate(Fraction(1, 10), "other")
    with pytest.raises(FMUError, match=r"from a block of the FMU 'typed' with other inputs or sizes \(u, s, i8"):
        other.restore(saved)
    instance.forget(saved)
    for one in (instance, other):
        one.close()


@pytest.mark.slow
def test_the_same_bits_in_a_process_of_its_own(built, same_bits):
    sources = {"i8": cosim.Step(time=0.5, after=7.0), "m": cosim.Step(time=0.5, after=2.0)}
    runs = [
        driven(built("typed", "3.0"), sources, tunable=["m"], isolate=isolate).simulate(1, engine="compiled")
        for isolate in (False, True)
    ]
    for name in runs[0]:
        same_bits(runs[1][name], runs[0][name], name)


def test_equations_with_whole_numbers(built):
    with ModelEquations(FMU(built("typed"), tunable=["k"], inputs=["u"], outputs=["x", "y"])) as model:
        assert model.input_names == ("u", "k")
        assert model.outputs([2.0], [0.5, 3.0]).tolist() == [2.0, 6.0]
        A, B, C, D = model.jacobians([2.0], [0.5, 3.0])
        np.testing.assert_allclose(np.block([[A, B], [C, D]]), [[0, 1, 0], [1, 0, 0], [3, 0, 2]], atol=1e-9)
    with (
        ModelEquations(FMU(built("typed"), inputs=["u", "i32"])) as model,
        pytest.raises(
            ModelError, match=r"no derivative with respect to 'i32', which is a whole number.*Leave it out of inputs"
        ),
    ):
        model.jacobians([0.0], [0.0, 1.0])


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("solver", ["rk45", "scipy:RK45"])
def test_an_fmu_that_remembers_nothing_goes_back_beyond_an_event(built, fmi, solver, same_bits):
    # Its binary refuses, as FMI says, a time before the last event: a changed parameter is one.
    instance = FMU(built("tuned", fmi, "false"), tunable=["k"], solver=solver).instantiate(Fraction(1, 4), "p")

    def steps(begin, end):
        rows = []
        for k in range(begin, end):
            u, y = np.array([1.0 + k]), np.zeros(1)
            assert instance.output(u, y, k / 4) == instance.update(u, y, k / 4) == 0
            rows.append(y)
        return np.array(rows)

    assert instance.can_save
    steps(0, 2)
    saved = instance.save()
    first = steps(2, 5)
    np.testing.assert_allclose(first[:, 0], np.exp([-0.75, -1.5, -2.5]), rtol=1e-5)
    for _ in range(2):
        instance.restore(pickle.loads(pickle.dumps(saved)))
        same_bits(steps(2, 5), first)
    instance.close()


@pytest.mark.parametrize("solver", ["cvode", "scipy:RK45"])
def test_nominal_values_that_cannot_be_had_are_said_when_restoring(built, solver):
    instance = FMU(built("scale"), parameters={"quiet": 2.0}, solver=solver).instantiate(Fraction(1, 1), "p")
    nothing, x = np.zeros(0), np.zeros(1)
    assert instance.update(nothing, x, 0.0) == 0
    saved = instance.save()
    with pytest.raises(FMUError, match=r"'p' could not be restored: fmi2GetNominalsOfContinuousStates returned Error"):
        instance.restore(saved)
    instance.close()
