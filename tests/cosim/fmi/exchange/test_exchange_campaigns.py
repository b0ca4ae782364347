"""Campaigns of model exchange FMUs: what an integrator or an event leaves behind does not reach the next run."""

import pytest

from bayesftc import cosim
from bayesftc.cosim.fmi.fmu import FMU

INPUTS = {"heater": ("Ta", 10.0), "relay": ("u", 1.0), "gate": ("u", 1.0), "edge": ("u", 1.0)}


def noisy(path, model, **options):
    """The FMU, an input of which, if it has one, is noise."""
    diagram = cosim.Diagram(dt="1/50")
    plant = diagram.add(FMU(path, **options), "p")
    if model in INPUTS:
        name, size = INPUTS[model]
        diagram.connect(diagram.add(cosim.Gaussian(std=size), "noise")["y"], plant[name])
    return diagram


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["cvode", "rk45", "scipy:RK45"])
@pytest.mark.parametrize("save", ["true", "false"])
@pytest.mark.parametrize(
    "model", ["ball", "heater", "pulse", "relay", "counter", "gate", "clock", "edge", "stack", "slide", "alarm", "pol"]
)
def test_each_run_is_the_run_alone(built, model, save, solver, campaign_as_alone):
    fmi = "2.0" if save == "false" else "3.0"
    options = {} if model in {"gate", "clock", "alarm"} else {"solver": solver}
    table = campaign_as_alone(noisy(built(model, fmi, save), model, **options), 1.2)
    assert (table["status"] == ("failed" if model == "relay" else "ok")).all()  # noise has it switch without end


@pytest.mark.parametrize("model", ["endless", "ends", "nan", "fails", "past"])
def test_each_failure_is_the_failure_alone(built, model, campaign_as_alone):
    table = campaign_as_alone(noisy(built(model), model), 1.2, seeds=(1, 2))
    assert (table["status"] == "failed").any()


@pytest.mark.slow
def test_in_a_process_of_its_own(built, campaign_as_alone):
    assert (campaign_as_alone(noisy(built("heater"), "heater", isolate=True), 0.4)["status"] == "ok").all()
