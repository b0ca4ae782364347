"""What is recorded besides outputs changes no run: it may be NaN, sets no step size, and is no part of a saved state."""

import pickle

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.fmus.build import build_fmu
from bayesftc.fmus.spec import Model, Variable

LAG = r"""
#include <math.h>
#include "model.h"

void model_initialize(double *x)
{
    x[X_odd] = NAN;
    x[X_fast] = 0.0;
}

int model_step(double *x, double h)
{
    x[X_y] += h * (x[X_u] - x[X_y]);
    x[X_odd] = x[X_TIME] < 0.35 ? NAN : x[X_TIME] < 0.65 ? INFINITY : 1.0;
    x[X_fast] = 1e3 * sin(1e4 * x[X_y] * x[X_TIME]);
    return 0;
}
"""
FURTHER = ["a.odd", "b.fast"]
COUPLINGS = [{}, {"coupling": "jacobi"}, {"coupling": "iterated"}, {"coupling": "iterated", "step_error": 1e-3}]


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def lag(request, tmp_path_factory, c_compiler):
    folder = tmp_path_factory.mktemp("lag")
    source = folder / "lag.c"
    source.write_text(LAG)
    variables = (
        Variable("u", "input", "Input", start=0.0),
        Variable("y", "output", "Output", start=1.0),
        Variable("odd", "local", "No number at first"),
        Variable("fast", "local", "What no step size follows"),
    )
    model = Model(name="Lag", description="A lag", source=source, variables=variables, step=0.1, libraries=("m",))
    return build_fmu(model, folder, fmi=request.param)


def pair(path, isolate=False, **coupling):
    diagram = cosim.Diagram(0.1)
    a, b = (diagram.add(cosim.FMU(path, isolate=isolate), name) for name in "ab")
    turned = diagram.add(cosim.Gain(-3.0), "turned")
    diagram.connect(a["y"], b["u"])
    diagram.connect(b["y"], turned["u"])
    diagram.connect(turned["y"], a["u"])
    return diagram.build(**coupling)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_it_may_be_nan_and_changes_nothing(lag, engine, coupling, same_bits):
    diagram = pair(lag, **coupling)
    plain = diagram.simulate(1.0, engine=engine)
    result = diagram.simulate(1.0, engine=engine, record=["*", *FURTHER])
    assert result.stopped is None
    for name in plain:
        same_bits(result[name], plain[name], name)
    odd = result["a.odd"]
    assert np.isnan(odd[:4]).all()
    assert np.isinf(odd[5:7]).all()
    assert (odd[8:] == 1.0).all()
    assert np.abs(result["b.fast"]).max() > 10.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("isolate", [False, True])
def test_what_something_depends_on_may_not(lag, isolate):
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.FMU(lag, outputs=["y", "odd"], isolate=isolate), "a")  # asked for as an output
    with pytest.raises(cosim.SimulationError, match=r"a.odd came out NaN"):
        diagram.simulate(1.0)


@pytest.mark.slow
def test_isolated_and_in_campaigns(lag, same_bits):
    here, there = (pair(lag, isolate).simulate(1.0, record=FURTHER) for isolate in (False, True))
    for name in FURTHER:
        same_bits(there[name], here[name], name)
    campaign = cosim.Campaign(pair(lag), duration=1.0, seeds=2, record=FURTHER, metrics=[cosim.Final("b.y")])
    found = campaign.run(executor=cosim.Threads(1))
    assert set(found.table["status"]) == {"ok"}
    same_bits(found.dataset["a.odd"].values[1], here["a.odd"])


@pytest.mark.sampled(12)
@pytest.mark.parametrize("coupling", COUPLINGS, ids=str)
@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("before", "after"), [(None, FURTHER), (FURTHER, None), (["a.odd"], ["b.fast", "a.odd"])], ids=str
)
def test_a_state_goes_to_a_run_that_records_something_else(lag, before, after, engine, coupling, same_bits):
    diagram = pair(lag, **coupling)
    whole = diagram.simulate(1.0, engine=engine, record=["*", *FURTHER])
    with diagram.start(engine=engine, record=before) as session:
        session.advance(0.5)
        state = pickle.loads(pickle.dumps(session.save_state()))
    with diagram.start(engine=engine, record=after) as session:
        session.advance(0.2)
        session.restore(state)
        rest = session.advance(0.5)
        for name in rest:
            same_bits(rest[name], whole[name][6:], name)
        assert (set(rest) & set(FURTHER)) == set(after or ())


def test_a_state_of_other_blocks_is_refused_all_the_same(lag):
    with pair(lag).start(record=FURTHER) as session:
        state = session.save_state()
    other = cosim.Diagram(0.1)
    for name in "ab":
        other.add(cosim.FMU(lag, outputs=["y", "odd"]), name)
    with other.start() as session, pytest.raises(cosim.ModelError, match="is not a saved state of this diagram"):
        session.restore(state)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_of_a_slower_fmu_it_is_unknown_until_its_next_step(lag, engine, same_bits):
    diagram = cosim.Diagram(0.1)
    slow = diagram.add(cosim.FMU(lag), "a", every=4)
    diagram.connect(diagram.add(cosim.Constant(1.0), "push")["y"], slow["u"])
    whole = diagram.simulate(1.6, engine=engine, record=["*", "a.odd", "a.fast"])
    with diagram.start(engine=engine, record=["*", "a.odd", "a.fast"]) as session:
        session.advance(0.9)
        state = session.save_state()
        session.restore(state)
        rest = session.advance(0.7)
    for name in ("a.odd", "a.fast"):
        assert np.isnan(rest[name][:2]).all()
    for name, first in (("a.odd", 2), ("a.fast", 2), ("a.y", 0)):
        same_bits(rest[name][first:], whole[name][10 + first :], name)
