"""An exported controller in place of the controller: in a closed loop, a scenario file, and a diagram by hand."""

import dataclasses
import re
import zipfile

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.scenario import load_scenario

CAR = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})
MODEL = controllers.LinearModel(
    [[0.999]], [[2e-4]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
)
CONTROLLER = controllers.BayesianController(
    MODEL, controllers.GammaPrecision(forgetting=0.95), initial_mean=20.0, u_max=3000.0
)

SCENARIO = """
[simulation]
duration = 2.0
[plant]
fmu = "CruiseControl"
control = "force"
measured = "v"
[sensors]
count = 2
std = 1.0
[reference]
kind = "Constant"
value = 3.0
[controller]
fmu = "controller.fmu"
"""


SINE = cosim.Sine(amplitude=5.0, period=8.0, offset=20.0)


def loop(controller, reference=SINE, **settings):
    return cosim.closed_loop(
        plant=CAR,
        controller=controller,
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=[cosim.Drift(sensor=0, start=1.0, slope=1.0)],
        reference=reference,
        **settings,
    )


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def path(request, tmp_path_factory, c_compiler):
    folder = tmp_path_factory.mktemp("exported")
    return cosim.export_fmu(CONTROLLER, folder / "controller.fmu", fmi=request.param)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("dt", [None, 0.01])
def test_a_loop_takes_the_fmu_in_place_of_the_controller_with_the_same_numbers(path, dt):
    runs = [loop(each, dt=dt).simulate(2.0, seed=1) for each in (CONTROLLER, cosim.FMU(path))]
    for signal in ("plant.v", "controller.u", "controller.x_hat", "controller.P", "controller.precision"):
        assert np.array_equal(runs[0][signal], runs[1][signal]), signal
    assert runs[1].roles is not None
    assert [role.name for role in runs[1].roles.quantities] == ["v"]


def test_an_fmu_of_numbers_has_arrays_as_its_controller_does(path):
    fmu = cosim.FMU(path, arrays=True)
    for side in ("inputs", "outputs"):
        of_controller = {port.name: (port.shape, port.unit) for port in getattr(CONTROLLER, side)}
        of_fmu = {port.name: (port.shape, port.unit) for port in getattr(fmu, side)}
        assert of_controller.items() <= of_fmu.items()


def test_its_tunable_numbers_stay_inputs_when_it_is_copied(path):
    fmu = cosim.FMU(path, arrays=True, tunable=["precision.forgetting"])
    changed = dataclasses.replace(fmu, parameters={"precision.forgetting": 0.9})
    names = ["y", "goal", "precision.forgetting"]
    assert [port.name for port in fmu.inputs] == [port.name for port in changed.inputs] == names
    assert "y(2), goal(1), precision.forgetting -> u(1)" in repr(changed)
    campaign = cosim.Campaign(
        loop(cosim.FMU(path)),
        duration=0.1,
        grid={"controller.parameters.precision.forgetting": [0.5, 0.9]},
        metrics=[cosim.RMSE("plant.v", "reference.y", name="rmse")],
    )
    assert len(campaign.run().table) == 2


def test_a_scenario_takes_the_fmu(path, tmp_path):
    (tmp_path / "controller.fmu").write_bytes(path.read_bytes())
    file = tmp_path / "mine.toml"
    file.write_text(SCENARIO)
    assert load_scenario(file).simulate()["controller.u"].shape == (101, 1)
    file.write_text(SCENARIO + '[model]\nkind = "from_fmu"\n')
    with pytest.raises(cosim.ScenarioError, match="'model' cannot be used with an FMU as controller"):
        load_scenario(file)


@pytest.mark.slow
def test_a_diagram_by_hand_says_how_numbers_become_one_port(tmp_path, c_compiler):
    path = cosim.export_fmu(CONTROLLER, tmp_path / "controller.fmu")
    diagram = cosim.Diagram(0.02)
    sensors = diagram.add(cosim.Gaussian(std=(1.0, 1.0)))
    with pytest.raises(cosim.UnknownNameError, match=r"no port 'y', but y\[0\] and y\[1\].*arrays=True"):
        diagram.connect(sensors["y"], diagram.add(cosim.FMU(path), "scalars")["y"])
    diagram.connect(sensors["y"], diagram.add(cosim.FMU(path, arrays=True), "controller")["y"])
    assert diagram.simulate(0.1)["controller.u"].shape == (6, 1)


@pytest.mark.slow
def test_elements_in_another_order_stay_numbers(tmp_path, c_compiler):
    path = cosim.export_fmu(CONTROLLER, tmp_path / "controller.fmu")
    fmu = cosim.FMU(path, arrays=True, inputs=["y[1]", "y[0]", "goal[0]"])
    assert [port.name for port in fmu.inputs] == ["y[1]", "y[0]", "goal"]
    with pytest.raises(cosim.ModelError, match="arrays=1; it must be True or False"):
        cosim.FMU(path, arrays=1)


@pytest.mark.slow
def test_a_loop_with_the_fmu_has_the_same_findings_and_summary(tmp_path, c_compiler):
    """It called faults "kind 3" and had no belief."""
    controller = controllers.BayesianController(MODEL, initial_mean=20.0)
    path = cosim.export_fmu(controller, tmp_path / "controller.fmu")
    block, fmu = (loop(each).simulate(10.0, seed=1) for each in (controller, cosim.FMU(path)))
    assert fmu.findings().equals(block.findings())
    assert str(fmu.summary()) == str(block.summary())
    assert "Drifting" in str(fmu.summary())
    described = {v.name: v.description for v in cosim.FMU(path).description.variables}
    assert "1 Frozen, 2 Offset, 3 Drifting" in described["fault_kind[1]"]
    assert described["mode_probability[1,3]"].endswith("(Drifting)")


AHEAD = controllers.LQGController(
    MODEL, controllers.FixedPrecision(), goal_covariance=0.1, control_covariance=1e6, initial_mean=20.0, preview=100
)


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def ahead(request, tmp_path_factory, c_compiler):
    folder = tmp_path_factory.mktemp("ahead")
    return cosim.export_fmu(loop(AHEAD), folder / "controller.fmu", blocks="controller", fmi=request.param)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("dt", [None, 0.01])
def test_an_fmu_with_preview_gets_the_later_goal(ahead, dt):
    given = {
        "source": SINE,
        "preview": cosim.Preview(SINE, 2.0),
        "sources": [SINE],
    }
    block = loop(AHEAD, dt=dt).simulate(6.0, seed=1)
    for name, reference in given.items():
        again = loop(cosim.FMU(ahead), dt=dt, reference=reference)
        assert again["reference"].block == cosim.Preview(SINE, 2.0), name
        run = again.simulate(6.0, seed=1)
        np.testing.assert_array_equal(run["plant.v"], block["plant.v"])
        np.testing.assert_array_equal(run["reference.y"], block["reference.y"])
        assert str(run.summary()) == str(block.summary())


def test_an_fmu_with_preview_is_refused_where_its_goal_is_the_present_one(ahead):
    controller = cosim.FMU(ahead)
    with pytest.raises(cosim.ConnectionError, match=r"must lie 100 samples ahead .* Connect 'reference.ahead'"):
        loop(controller, connections=[("reference.y", "controller.goal")])
    with pytest.raises(cosim.ConnectionError, match=r"lies 1 s ahead, but .* preview is 2 s. Give Preview the time 2"):
        loop(controller, reference=cosim.Preview(SINE, 1.0))
    with pytest.raises(cosim.ModelError, match="A factor changes the preview of 'controller'"):
        cosim.varied(loop(CONTROLLER), {"controller": cosim.FMU(ahead, arrays=True)})
    with_it = cosim.varied(loop(dataclasses.replace(AHEAD, preview=1)), {"controller": cosim.FMU(ahead, arrays=True)})
    assert with_it["reference"].block == cosim.Preview(SINE, 2.0)


def test_an_fmu_with_preview_whose_outputs_are_read_as_a_plants_has_its_own_step(ahead):
    late = loop(cosim.FMU(ahead, timing="plant"), dt="0.04")
    assert late["reference"].block.time == 2


def test_a_scenario_takes_an_fmu_with_preview(ahead, tmp_path):
    (tmp_path / "controller.fmu").write_bytes(ahead.read_bytes())
    file = tmp_path / "car.toml"
    file.write_text(SCENARIO)
    assert load_scenario(file).loop()["reference"].block.time == 2


def test_a_block_without_a_sample_time_has_its_preview_in_steps_of_the_loop():
    @dataclasses.dataclass(frozen=True)
    class Late(cosim.Block):
        preview: float = 5
        inputs = (cosim.Port("y", (2,)), cosim.Port("goal", (1,)))
        outputs = (cosim.Port("u", (1,)),)

        def define(self, step):
            return cosim.Definition(follow)

    run = loop(Late(), dt=0.05).simulate(2.0, seed=1, engine="interpreted")
    np.testing.assert_array_equal(run["controller.u"][:-5, 0], run["reference.y"][5:])


def follow(y, goal, u):
    u[0] = goal[0]


DAMAGED = [
    "{{",
    '{"fault_kinds": 5, "lag": 0.1}',
    '{"fault_kinds": [1, 2], "fault_sizes": "unit"}',
    '{"measurement_matrix": 7, "goal_matrix": "abc"}',
    '{"preview": "4"}',
    '{"preview": -4}',
    '{"preview": 2.5}',
    '{"preview": 1e999}',
    '{"preview": [4]}',
    '{"measurement_matrix": [[1.0], [1.0, 2.0]], "goal_matrix": [[1.0, 2.0]]}',
    "[" * 100_000,
]


@pytest.fixture(scope="module")
def without_estimate(tmp_path_factory, c_compiler):
    block = controllers.BayesianController(MODEL, initial_mean=20.0)
    path = tmp_path_factory.mktemp("less") / "less.fmu"
    return cosim.export_fmu(loop(block), path, blocks="controller", outputs=["u", "fault_probability", "fault_kind"])


@pytest.mark.slow
def test_an_fmu_without_its_estimate_still_runs(without_estimate):
    traits = cosim.FMU(without_estimate).description.traits
    assert traits["fault_kinds"][0] == "Frozen"
    assert traits["measurement_matrix"] == [[1.0], [1.0]]
    assert "tracking of v" in str(loop(cosim.FMU(without_estimate)).simulate(2.0, seed=1).summary())


@pytest.mark.sampled(2)
@pytest.mark.parametrize("damaged", DAMAGED, ids=range(len(DAMAGED)))
def test_traits_of_another_form_are_left_out(tmp_path, without_estimate, damaged):
    """A file is of somebody else: it was a TypeError of the figures."""
    path = tmp_path / "damaged.fmu"
    with zipfile.ZipFile(without_estimate) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            text = damaged.replace('"', "&quot;").encode()
            new.writestr(name, re.sub(rb'traits="[^"]*"', b'traits="' + text + b'"', old.read(name)))
    result = loop(cosim.FMU(path)).simulate(4.0, seed=1)
    assert "tracking of v" in str(result.summary())
    assert set(result.findings()["kind"]) <= {"kind 3", "kind 2", "kind 4"}
    result.plot()


def peak(u, y, gain):
    y[0] = gain[0] * u[0]


@dataclasses.dataclass(frozen=True)
class Lagged(cosim.Block):
    """A block whose settings have the names of traits, but are none."""

    lag: float = 0.1
    traits: tuple[str, ...] = ("a",)
    inputs = (cosim.Port("u"),)
    outputs = (cosim.Port("y"),)

    def define(self, step):
        return cosim.Definition(peak, parameters={"gain": self.lag})


def test_other_blocks_have_no_traits(tmp_path, c_compiler):
    assert dict(cosim.FMU(cosim.export_fmu(Lagged(), tmp_path / "lagged.fmu", dt=0.1)).description.traits) == {}
