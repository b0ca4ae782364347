"""Random diagrams of every kind of block: the same bits interpreted, compiled, in campaigns, as FMU and as C."""

import inspect

import numpy as np
import pytest
from block_kinds import DT, NOT_DRAWN, SETTINGS, random_blocks
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from random_diagrams import build, plans

from bayesftc import cosim
from bayesftc.cosim.export.program import program_of

DURATION = 4.0
PLANS = plans(random_blocks().map(lambda block: (None, block)), DT)
SEEDS = st.integers(0, 2**64 - 1)


def test_every_public_kind_is_drawn_or_has_a_reason():
    public = {name: getattr(cosim, name) for name in cosim.__all__}
    kinds = {name for name, kind in public.items() if inspect.isclass(kind) and issubclass(kind, cosim.Block)}
    assert len(kinds) > 50
    assert {kind.__name__ for kind in SETTINGS} == kinds - NOT_DRAWN.keys()
    assert NOT_DRAWN.keys() < kinds


def few_and_many(few, many):
    """Try few diagrams by default, many in the long tests."""
    return pytest.mark.parametrize("count", [few, pytest.param(many, marks=pytest.mark.slow)])


def over_random_diagrams(count, check):
    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    @given(plan=PLANS, seed=SEEDS)
    def test(plan, seed):
        check(build(plan)[0], seed, plan)

    test()


def ran(diagram, seed, engine):
    """Return the signals of a run, up to the step at which a plant got a missing sample, and the reason."""
    try:
        return diagram.simulate(DURATION, seed=seed, engine=engine), ""
    except cosim.SimulationError as error:
        return error.result, str(error)


@few_and_many(6, 400)
def test_both_engines(count, same_bits):
    def check(diagram, seed, plan):
        (one, reason), (other, same) = ran(diagram, seed, "compiled"), ran(diagram, seed, "interpreted")
        assert reason == same
        assert list(one) == list(other)
        for name in one:
            same_bits(one[name], other[name], name)

    over_random_diagrams(count, check)


@few_and_many(2, 40)
def test_campaigns(count, campaign_as_alone):
    def check(diagram, seed, plan):
        points = {f"{plan.names[0]}.mean": [0.0, 1.5]}
        campaign_as_alone(diagram, DURATION, seeds=(seed % 2**32 + 9, 3, 1), points=points)

    over_random_diagrams(count, check)


@few_and_many(1, 40)
def test_exported_fmus(count, c_compiler, tmp_path_factory):
    def check(diagram, seed, plan):
        assume(not ran(diagram, seed, "interpreted")[1])
        path = cosim.export_fmu(diagram, tmp_path_factory.mktemp("random") / "random.fmu")
        found = cosim.verify_fmu(path, diagram, duration=DURATION, seed=seed, engine="interpreted")
        assert found.agrees(), found

    over_random_diagrams(count, check)


@few_and_many(3, 60)
def test_c(count, compiled_together, tmp_path_factory, same_bits):
    def check(diagram, seed, plan):
        program = program_of(diagram)
        drawn = [signal.name for signal in program.inputs]
        assume(not ran(diagram, seed, "interpreted")[1])
        result = diagram.simulate(DURATION, seed=seed, engine="interpreted", record=["*", *drawn])
        (c,) = compiled_together(tmp_path_factory.mktemp("random"), [program])
        every = int(program.step / diagram.step)  # no block need run at each step of the diagram
        rows = [c(**{name: result[name][k] for name in drawn}) for k in range(0, len(result.time), every)]
        for signal in program.outputs:
            got = np.array([row[signal.name] for row in rows])
            same_bits(got, result[signal.name][::every].reshape(got.shape), signal.name)

    over_random_diagrams(count, check)
