"""Each run of a campaign has the bits that it has alone, whatever the loop is made of."""

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.examples.coupled_masses.masses import Masses
from bayesftc.fmus._compiler import why_no_compiler


def with_noise(block, port, dt=0.02, every=1, size=10.0, slower=1):
    """A block, an input of which is noise that has failed at random."""
    diagram = cosim.Diagram(dt)
    noise = diagram.add(cosim.Gaussian(std=size), "noise", every=slower)
    fault = diagram.add(
        cosim.Injection(magnitude=5.0, mean_time_to_fault=0.5, mean_time_to_recovery=0.5, channels=1), "fault"
    )
    plant = diagram.add(block, "plant", every=every)
    diagram.connect(noise["y"], fault["u"])
    diagram.connect(fault["y"], plant[port])
    return diagram


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "options", [{}, {"timing": "sampled"}, {"isolate": True}, {"isolate": True, "timing": "sampled"}], ids=str
)
def test_shipped_plants(fmi, options, campaign_as_alone):
    for name in (
        fmus.names() if not options.get("isolate") else ["CruiseControl"]
    ):  # a process for each run alone takes time
        block = cosim.FMU(fmus.path(name, fmi=fmi), **options)
        port = next(p for p in block.inputs if not p.shape)
        table = campaign_as_alone(with_noise(block, port.name, size=0.01), 0.4)  # a crane whose rope is torn fails
        assert name != "CruiseControl" or (table["status"] == "ok").all()


def test_several_rates(campaign_as_alone):
    car = cosim.FMU(fmus.path("CruiseControl"))
    assert (campaign_as_alone(with_noise(car, "force", every=3, slower=2), 1.2)["status"] == "ok").all()


@pytest.mark.sampled(3)
@pytest.mark.skipif(bool(why_no_compiler()), reason=why_no_compiler() or "there is a compiler")
@pytest.mark.parametrize(
    "settings",
    [
        {"coupling": "jacobi"},
        {"coupling": "gauss-seidel"},
        {"coupling": "iterated"},
        {"coupling": "iterated", "acceleration": "aitken"},
        {"coupling": "iterated", "acceleration": "anderson", "hold": "mean"},
        {"coupling": "iterated", "step_error": 1e-6},
        {"coupling": "iterated", "iterations": 3, "tolerance": 1e-14, "acceleration": None},
    ],
    ids=str,
)
def test_coupled_plants(settings, campaign_as_alone):
    diagram = cosim.Diagram("1/50")
    parts = Masses(c=4.0).diagram("1/50", ("2.0", "3.0"))
    nodes = [diagram.add(parts[name].block, name) for name in ("one", "two")]
    wind = diagram.add(cosim.Gaussian(std=1.0), "wind")
    push = diagram.add(cosim.Sum("++"), "push")
    diagram.connect([nodes[0]["v"], wind["y"]], push["u"])
    diagram.connect(push["y"], nodes[1]["v_other"])
    diagram.connect(nodes[0]["x"], nodes[1]["x_other"])
    diagram.connect(nodes[1]["x"], nodes[0]["x_other"])
    diagram.connect(nodes[1]["v"], nodes[0]["v_other"])
    table = campaign_as_alone(diagram.build(**settings), 1.0)
    assert (table["status"] == ("failed" if "iterations" in settings else "ok")).all()


@pytest.mark.parametrize("options", [{"decimation": 7}, {"record": []}, {"piece": 1}, {"piece": 3}], ids=str)
def test_whatever_is_kept(options, campaign_as_alone):
    diagram = with_noise(cosim.FMU(fmus.path("CruiseControl")), "force")
    table = campaign_as_alone(diagram, 1.0, points={"noise.std": [1.0, 2.0, 3.0]}, **options)
    assert table["steps"].tolist() == [50] * 12


def test_one_step_and_large_seeds(campaign_as_alone):
    diagram = with_noise(cosim.FMU(fmus.path("CruiseControl")), "force")
    table = campaign_as_alone(diagram, 0.02, seeds=(0, 2**63 - 1, 2**62 + 1))
    assert table["seed"].tolist() == [0, 2**63 - 1, 2**62 + 1]
    with pytest.raises(cosim.BayesFTCError, match=r"2\*\*63 - 1"):
        cosim.Campaign(diagram, duration=0.02, seeds=[2**63])


@pytest.mark.slow
def test_interpreted_blocks_beside_fmus(make_block, campaign_as_alone):
    def output(u, y):
        y[0] = float(np.tanh(u[0]))

    diagram = cosim.Diagram(0.02)
    block = make_block(inputs=(cosim.Port("u"),), outputs=(cosim.Port("y"),), output=output, compiled=False)
    noise, law = diagram.add(cosim.Gaussian(std=3.0), "noise"), diagram.add(block, "law")
    for name, options in {"here": {}, "there": {"isolate": True}, "sampled": {"timing": "sampled"}}.items():
        plant = diagram.add(cosim.FMU(fmus.path("CruiseControl", fmi="3.0"), **options), name)
        diagram.connect(law["y"], plant["force"])
    diagram.connect(noise["y"], law["u"])
    assert (campaign_as_alone(diagram, 0.6)["status"] == "ok").all()
