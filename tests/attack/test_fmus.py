"""Hostile FMUs: archives, descriptions, binaries, and FMUs that go wrong while they run."""

import itertools

import pytest
from harness import Case
from hostile_fmus import (
    BEHAVIOUR,
    KIND_WAYS,
    TEXTS,
    WAYS,
    build,
    fmu,
    hostile_archive,
    hostile_binary,
    hostile_description,
)

pytestmark = pytest.mark.slow

SCENARIO = """
[simulation]
duration = 0.4
engine = "ENGINE"
[plant]
fmu = "x.fmu"
control = "u"
measured = "y"
kind = "KIND"
isolate = ISOLATE
[sensors]
count = 1
std = 0.1
[reference]
kind = "Constant"
value = 1.0
[model]
A = [[0.98]]
B = [[0.02]]
C = [[1.0]]
process_covariance = 0.001
sensor_covariance = 0.01
dt = 0.02
[controller]
kind = "BayesianController"
precision = { kind = "FixedPrecision" }
"""


@pytest.fixture(scope="session")
def libraries(tmp_path_factory, c_compiler):
    """Return the binary of hostile.c for each version of FMI, built once."""
    return build(tmp_path_factory.mktemp("hostile"), c_compiler)


def scenario(kind="co-simulation", *, isolate=True, engine="interpreted"):
    text = SCENARIO.replace("KIND", kind).replace("ENGINE", engine)
    return text.replace("ISOLATE", "true\ntime_limit = 1.5" if isolate else "false")


def run(data, environment=None, **options):
    return Case(("run", "case.toml", "--quiet"), {"x.fmu": data, "case.toml": scenario(**options)}, environment or {})


def any_kind(rng):
    return {"kind": str(rng.choice(["co-simulation", "model exchange"]))}


def both(rng, i):
    """Return a version of FMI, and whether a file is looked into or run."""
    return ("2.0", "3.0")[i % 2], bool(rng.random() < 0.3)


COUNTS = [1, pytest.param(120, marks=pytest.mark.slow)]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("kind", list(BEHAVIOUR))
def test_without_hostility_it_runs(line, libraries, fmi, kind):
    """What the attacks below change is in order before."""
    for isolate in (False, True):
        outcome = line.run(run(fmu(fmi, libraries[fmi]), kind=kind, isolate=isolate))
        assert (outcome.wrong, outcome.code) == ("", 0), outcome.err


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("what", ["archive", "description", "binary"])
def test_hostile_files(line, libraries, chance, what, count):
    def cases():
        for i in range(count):
            fmi, look = both(chance, i)
            if what == "archive":
                data = hostile_archive(fmi, libraries[fmi], chance)
            elif what == "description":
                data = fmu(fmi, libraries[fmi], hostile_description(TEXTS[fmi], chance))
            else:
                data, look = hostile_binary(fmi, libraries, chance), False
            yield (
                f"{i}, FMI {fmi}",
                Case(("inspect", "x.fmu"), {"x.fmu": data}) if look else run(data, **any_kind(chance)),
            )

    failures = line.failures(cases())
    assert not failures, "\n".join(failures)


@pytest.mark.parametrize("count", [1, pytest.param(250, marks=pytest.mark.slow)])
def test_hostile_behaviour(line, libraries, chance, count):
    everything = [
        (fmi, kind, function, way, isolate)
        for fmi, kind in itertools.product(TEXTS, BEHAVIOUR)
        for function, way, isolate in itertools.product(BEHAVIOUR[kind], WAYS, (True, False))
        if isolate or way in KIND_WAYS
    ]

    def cases():
        for i in chance.choice(len(everything), count, replace=False):
            fmi, kind, function, way, isolate = everything[i]
            hostile = {"HOSTILE": f"{function} {chance.integers(1, 12)} {way}"}
            yield f"{everything[i]} {hostile}", run(fmu(fmi, libraries[fmi]), hostile, kind=kind, isolate=isolate)

    failures = line.failures(cases())
    assert not failures, "\n".join(failures)
