"""FMUs that feed FMUs: who sees which instant, with either coupling, at any rates; and what they say of direct feedthrough."""

import warnings
import zipfile

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.fmi.fmu import FMU, describe

FMI = ("2.0", "3.0")
COUPLINGS = ("gauss-seidel", "jacobi")
RATES = [(1, 1), (3, 1), (1, 3), (3, 3), (2, 4)]
OUTPUT = {"2.0": '<Unknown index="3" dependencies="" />', "3.0": '<Output valueReference="2" dependencies="" />'}


def car(**options):
    return FMU(fmus.path("CruiseControl"), **options)


def chain(coupling, rates=(1, 1), reader="b", between=None):
    """Return a diagram in which the car a feeds b's disturbance, directly or through a block, and a gain beside."""
    diagram = cosim.Diagram(dt=1)
    a = diagram.add(car(parameters={"v0": 1.0, "force": 100.0}), "a", every=rates[0])
    seen = diagram.add(cosim.Gain(1.0), "seen")
    diagram.connect(a["v"], seen["u"])
    if reader:
        source = a["v"]
        if between is not None:
            middle = diagram.add(between, "middle")
            diagram.connect(source, middle["u"])
            source = middle["y"]
        b = diagram.add(car(), "b", every=rates[1])
        diagram.connect(source, b["disturbance"])
    return diagram.build(coupling)


def speeds(disturbances, b=5.0, m=100.0, h=1.0, v=0.0, force=0.0):
    rows = [v]
    for disturbance in disturbances:
        rows.append((1 - b / m * h) * rows[-1] + h / m * force + disturbance)
    return np.array(rows)


@pytest.mark.parametrize("rates", RATES)
def test_an_fmu_is_recorded_the_same_whoever_reads_it(rates, run_both):
    runs = [run_both(chain(coupling, rates), 12) for coupling in COUPLINGS] + [
        run_both(chain(None, rates, reader=None), 12)
    ]
    own = speeds(np.zeros(12 // rates[0]), h=float(rates[0]), v=1.0, force=100.0)
    for run in runs:
        np.testing.assert_allclose(run["a.v"], np.repeat(own, rates[0])[:13], rtol=1e-13)
        np.testing.assert_array_equal(run["seen.y"], run["a.v"])  # no sample from the future for anyone else


@pytest.mark.parametrize("every", [1, 3])
def test_at_one_rate_the_later_fmu_sees_the_end_of_its_step(every, run_both):
    steps = 12 // every
    for coupling in COUPLINGS:
        run = run_both(chain(coupling, (every, every)), 12, record=["*", "b.disturbance"])
        own = speeds(np.zeros(steps), h=float(every), v=1.0, force=100.0)
        seen = own[1:] if coupling == "gauss-seidel" else own[:-1]
        np.testing.assert_allclose(run["b.v"][::every], speeds(seen, h=float(every)), rtol=1e-13)
        np.testing.assert_array_equal(run["b.disturbance"], run["a.v"])  # inputs too are recorded as at t_k


@pytest.mark.parametrize("rates", [(3, 1), (1, 3), (2, 4)])
def test_at_different_rates_the_later_fmu_sees_what_everyone_sees(rates, run_both):
    gauss, jacobi = (run_both(chain(coupling, rates), 12) for coupling in COUPLINGS)
    np.testing.assert_array_equal(gauss["b.v"], jacobi["b.v"])
    seen = gauss["a.v"][: -rates[1] : rates[1]]
    np.testing.assert_allclose(gauss["b.v"][:: rates[1]], speeds(seen, h=float(rates[1])), rtol=1e-13)


def test_a_block_between_two_fmus_is_seen_as_at_the_beginning_of_the_step(run_both):
    jacobi = run_both(chain("jacobi"), 12)["b.v"]
    through = chain("gauss-seidel", between=cosim.Gain(1.0))
    np.testing.assert_array_equal(run_both(through, 12)["b.v"], jacobi)
    assert through.schedule.describe().splitlines()[-2:] == ["to t_k+1   a", "to t_k+1   b"]
    direct = chain("gauss-seidel").schedule.describe().splitlines()
    assert direct[-2:] == ["to t_k+1   a", "to t_k+1   b  (reads a at t_k+1)"]
    assert chain("jacobi").schedule.describe().splitlines()[-1] == "to t_k+1   b"


def test_three_in_a_row_and_back(run_both):
    diagram = cosim.Diagram(dt=1)
    a, b, c = (diagram.add(car(parameters={"v0": float(i)}), name) for i, name in enumerate("abc", 1))
    for source, target in ((a, b), (b, c), (c, a)):
        diagram.connect(source["v"], target["disturbance"])
    run = run_both(diagram, 6)
    v = np.array([1.0, 2.0, 3.0])
    for k in range(7):
        np.testing.assert_allclose([run[f"{n}.v"][k] for n in "abc"], v, rtol=1e-13)
        v[0] = 0.95 * v[0] + v[2]
        v[1] = 0.95 * v[1] + v[0]
        v[2] = 0.95 * v[2] + v[1]


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_what_is_seen_ahead_is_checked_and_named(engine):
    diagram = cosim.Diagram(dt=1)
    push = diagram.add(cosim.Step(time=3.0, after=1e308))
    more = diagram.add(cosim.Gain(100.0))
    a, b = diagram.add(car(parameters={"m": 1.0}), "a"), diagram.add(car(), "b")
    diagram.connect(push["y"], more["u"])
    diagram.connect(more["y"], a["force"])
    diagram.connect(a["v"], b["disturbance"])
    with pytest.raises(cosim.SimulationError, match=r"at t = 4 s \(step 4\): a\.v came out infinite") as caught:
        diagram.simulate(9, engine=engine)
    assert caught.value.result["a.v"].tolist() == [0.0] * 4


# --- direct feedthrough -------------------------------------------------------------------------------------------------------


@pytest.fixture
def through(tmp_path):
    """Return FMUs whose description says that the output depends at once on the force, or says nothing."""

    def make(fmi, declared):
        new = {
            "declared": OUTPUT[fmi].replace('""', '"1"' if fmi == "2.0" else '"0"'),
            "silent": OUTPUT[fmi].replace('dependencies="" ', ""),
        }[declared]
        path = tmp_path / f"{declared}{fmi[0]}.fmu"
        with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(path, "w") as edited:
            for name in old.namelist():
                content = old.read(name)
                if name == "modelDescription.xml":
                    assert OUTPUT[fmi].encode() in content
                    content = content.replace(OUTPUT[fmi].encode(), new.encode())
                edited.writestr(name, content)
        return path

    return make


@pytest.mark.parametrize("fmi", FMI)
def test_outputs_that_would_lag_are_named_in_a_warning(fmi, through):
    with pytest.warns(
        UserWarning, match=r"declares that at the same instant v depends on force, but a plant's"
    ) as caught:
        FMU(through(fmi, "declared"))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert "Such an output shows the inputs of the previous step. Give timing='sampled' if" in text
    with warnings.catch_warnings():  # most exporters declare nothing: a warning at every plant would be read by nobody
        warnings.simplefilter("error")
        FMU(through(fmi, "silent"))
    for declared in ("declared", "silent"):
        assert describe(through(fmi, declared)).feedthrough == {"v": ("force",) if declared == "declared" else None}


@pytest.mark.parametrize("fmi", FMI)
def test_no_warning_where_nothing_lags_or_timing_is_said(fmi, through):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shipped = FMU(fmus.path("CruiseControl", fmi=fmi))
        for declared in ("declared", "silent"):
            path = through(fmi, declared)
            for options in ({"timing": "plant"}, {"timing": "sampled"}, {"inputs": []}, {"outputs": []}):
                FMU(path, **options)
        FMU(through(fmi, "declared"), inputs=["disturbance"])  # what it depends on is no port
    assert shipped.description.feedthrough == {"v": ()}


@pytest.mark.parametrize("fmi", FMI)
def test_inspect_shows_which_outputs_feed_through(fmi, through):
    from typer.testing import CliRunner

    from bayesftc.cli.application import app

    def shown(path):
        lines = CliRunner().invoke(app, ["inspect", str(path)]).stdout.splitlines()
        return next(line.removeprefix("direct feedthrough").strip() for line in lines if line.startswith("direct feed"))

    assert shown(fmus.path("CruiseControl", fmi=fmi)) == "none"
    assert shown(through(fmi, "declared")) == "v <- force"
    assert shown(through(fmi, "silent")) == "v <- any input (not stated)"
