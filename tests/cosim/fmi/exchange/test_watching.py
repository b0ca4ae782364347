"""Local variables and parameters of FMUs as outputs: where they are asked for, and nowhere else."""

import re
import zipfile

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers.models.linearization import linearize
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.fmi.fmu import FMU

ENGINES = ["compiled", "interpreted"]


def car(**options):
    return FMU(fmus.path("CruiseControl"), parameters={"m": 120.0, "force": 100.0}, **options)


def alone(block, dt=0.02):
    diagram = cosim.Diagram(dt=dt)
    diagram.add(block, "plant")
    return diagram


@pytest.mark.sampled(2)
@pytest.mark.parametrize("isolate", [False, True])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_parameter_is_an_output_where_it_is_wanted(engine, isolate):
    block = car(outputs=["m", "v"], isolate=isolate)
    assert [port.name for port in block.outputs] == ["m", "v"]
    result = alone(block).simulate(1.0, engine=engine)
    assert (result["plant.m"] == 120.0).all()
    np.testing.assert_array_equal(result["plant.v"], alone(car()).simulate(1.0)["plant.v"])
    assert [port.name for port in car().outputs] == ["v"]


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_recorded_need_be_no_output(engine):
    diagram = alone(car())
    result = diagram.simulate(1.0, record=["plant.m", "plant.v"], engine=engine)
    assert set(result) == {"plant.m", "plant.v"}
    assert (result["plant.m"] == 120.0).all()
    assert set(diagram.simulate(1.0)) == {"plant.v"}  # as it was
    with diagram.start(record=["plant.m"]) as session:
        assert session.advance(0.1)["plant.m"][-1] == 120.0
    with pytest.raises(UnknownNameError, match=r"plant\.mm"):
        diagram.simulate(1.0, record=["plant.mm"])
    assert diagram.watching(["plant.v", "plant.*", "other.m", 3, "plant"]) is diagram
    assert diagram.watching(None) is diagram


@pytest.mark.parametrize("engine", ENGINES)
def test_locals_of_model_exchange_are_seen_as_they_are(built, engine):
    """The ball's speed is a local variable, and a state: it depends on nothing of the same instant."""
    block = FMU(built("ball"), outputs=["h", "v", "der(v)"])
    result = alone(block, 0.01).simulate(0.3, engine=engine)
    np.testing.assert_allclose(result["plant.v"], -9.81 * result.time, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result["plant.der(v)"], -9.81)
    np.testing.assert_array_equal(result["plant.h"], alone(FMU(built("ball")), 0.01).simulate(0.3)["plant.h"])


def test_a_loop_may_measure_a_local_variable(built):
    """It is in no output of the FMU; the controller is designed and runs on it all the same."""
    lag = FMU(built("lag", "3.0"), outputs=[])
    linear = linearize(lag, measured="x", actuated="u", dt=0.1)
    np.testing.assert_allclose(linear.A, np.exp(-0.1) * np.eye(3), rtol=1e-6, atol=1e-12)
    model = controllers.LinearModel(
        linear.A, linear.B, np.eye(3), process_covariance=1e-4, sensor_covariance=1e-2, dt=0.1
    )
    controller = controllers.BayesianController(model, initial_mean=[1.0, 2.0, 3.0])
    loop = cosim.closed_loop(
        lag, controller, control="u", measured="x", sensors=cosim.Sensors(3, 0.1, signals=3), reference=[0.5, 0.5, 0.5]
    )
    result = loop.simulate(5.0, seed=1)
    assert np.abs(result["plant.x"][-20:] - 0.5).max() < 0.3


HEAT = 'causality="parameter" variability="fixed" initial="exact"><Real start="20.0"/>'
CALCULATED = 'causality="calculatedParameter" variability="fixed" initial="calculated"><Real/>'


@pytest.fixture
def heater(built, tmp_path):
    """Return a heater whose temperature is a local variable, whose heat P is a calculated parameter, and without outputs."""

    def hidden(text):
        assert HEAT in text
        text = re.sub(r"<Outputs>.*</Outputs>", "", text.replace(HEAT, CALCULATED).replace('"output"', '"local"'))
        return text.replace("<InitialUnknowns>", '<InitialUnknowns><Unknown index="8"/>')

    path = tmp_path / "heater.fmu"
    with zipfile.ZipFile(built("heater")) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, hidden(data.decode()) if name == "modelDescription.xml" else data)
    return FMU(path)


def test_design_measures_local_variables_and_calculated_parameters(heater):
    assert not heater.outputs
    model = controllers.design(heater, measured=["T", "P"], goal="T", actuated="Ta", dt=0.1).model
    decay = np.exp(-0.1 / 5.0)  # dT/dt = (Ta - T + P on) / tau
    np.testing.assert_allclose(model.moving.matrix("A"), [[decay]], rtol=1e-7)
    np.testing.assert_allclose(model.moving.matrix("B"), [[1.0 - decay]], rtol=1e-7)
    np.testing.assert_allclose(model.matrix("C"), [[1.0, 0.0], [0.0, 20.0]], atol=1e-9)  # the second never changes
    with pytest.raises(ModelError, match=r"no output that a sensor could measure.* local variables by name: .*T"):
        controllers.design(heater, measured="Ta", actuated="Ta", dt=0.1)


def test_a_campaign_keeps_it_as_well():
    campaign = cosim.Campaign(alone(car()), duration=0.1, grid={"plant.m": [80.0, 100.0]}, seeds=1, record=["plant.m"])
    kept = campaign.run(executor=cosim.Threads(1)).dataset["plant.m"].to_numpy()
    np.testing.assert_array_equal(kept, np.repeat([[80.0], [100.0]], 6, axis=1))


def test_watching_changes_nothing_else(built):
    """Neither which inputs feed through, nor what an indexed name means."""
    block = FMU(built("heater"))
    watched = block.watching(["T", "P", "none", "Ta"])
    assert watched.inputs == block.inputs
    assert [port.name for port in watched.outputs] == ["on", "y", "T", "P"]
    assert block.watching(["none[1]", "y"]) is block
    lag = FMU(built("lag", "3.0"), outputs=["y"])
    assert [port.name for port in lag.watching(["x[1]", "x[0]", "x"]).outputs] == ["y", "x"]
    result = alone(lag, 0.1).simulate(0.2, record=["plant.x"])
    assert result["plant.x"].shape == (3, 3)


def test_inputs_cannot_be_outputs():
    with pytest.raises(UnknownNameError, match="no output 'force'; it is of causality input"):
        car(outputs=["force"])
