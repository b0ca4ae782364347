"""The units of the columns of a campaign's table: those that a run's signals and the FMU's variables have."""

import json
from dataclasses import dataclass

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.base.units import parse
from bayesftc.cosim.campaign.designs.factors import unit_of_factor
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.export.program import program_of


def lagged(scale=1.0, unit="m"):
    """Return a loop whose quantity is counted in a unit, of which a metre has `scale`."""
    model = controllers.LinearModel([[0.9]], [[0.1 * scale]], [[1.0], [1.0]], 1e-3 * scale**2, 0.04 * scale**2, dt=0.1)
    system = control.ss([[0.9]], [[0.1 * scale]], [[1.0]], 0, 0.1, inputs="force", outputs="x")
    return cosim.closed_loop(
        cosim.StateSpace(system, units={"force": "N", "x": unit}),
        controllers.BayesianController(
            model,
            precision=controllers.GammaPrecision(),
            goal_covariance=scale**2,
            control_covariance=1.0,
            initial_covariance=scale**2,
        ),
        control="force",
        measured="x",
        sensors=cosim.Sensors(2, 0.2 * scale),
        faults=[cosim.Drift(start=5.0, slope=0.5 * scale)],
        reference=cosim.Sine(amplitude=0.5 * scale, period=4.0),
    )


def run(loop, metrics, **options):
    return cosim.Campaign(loop, duration=10.0, metrics=metrics, **options).run(executor=cosim.Threads(1))


def test_a_number_from_a_signal_has_the_unit_that_a_result_has():
    metrics = [
        *(kind("sensors.y") for kind in (cosim.RMSE, cosim.MeanAbsoluteError, cosim.MaxAbsoluteError, cosim.Mean)),
        cosim.Final("sensors.y[1]"),
        cosim.RMSE("controller.u"),
        cosim.RMSE("controller.x_hat[0]", "plant.x", name="from the reference"),
        cosim.Mean("drift_0.active"),
        cosim.Mean("controller.fault_probability"),
    ]
    result, units = run(lagged(), metrics), lagged().simulate(1.0).units
    assert (units["sensors.y"], units["controller.u"]) == ("m", "N")
    named = {name: name.partition("(")[2].rstrip(")") for name in result.units}
    expected = {name: units[signal.removesuffix("[1]")] for name, signal in named.items() if signal}
    assert result.units == expected | {"from the reference": units["plant.x"]}
    assert len(result.units) == 7


def test_a_vector_of_several_units_has_one_only_by_its_elements():
    @dataclass(frozen=True)
    class Two(cosim.Block):
        inputs = ()
        outputs = (cosim.Port("y", (3,), units=("m", "rad", "m")),)

        def define(self, step):
            return cosim.Definition(output=lambda y: None)

    diagram = cosim.Diagram(dt=0.1)
    diagram.add(Two(), "two")
    metrics = [cosim.Mean("two.y"), cosim.Mean("two.y[1]"), cosim.Mean("two.y[2]"),
               cosim.RMSE("two.y[0]", "two.y[1]", name="length minus angle")]  # fmt: skip
    assert cosim.Campaign(diagram, duration=1.0, metrics=metrics).job.units == {
        "mean(two.y[1])": "rad",
        "mean(two.y[2])": "m",
    }


def test_figures_change_with_the_unit_of_the_loop_as_their_units_say():
    metres, millimetres = (run(lagged(*unit), cosim.LoopFigures()) for unit in ((1.0, "m"), (1e3, "mm")))
    names = [name for name in metres.table if name.partition(".")[0] in {"tracking", "belief", "sensors"}]
    assert {*metres.units} == {*millimetres.units} <= {*names}
    scaled = 0
    for name in names:
        units = [result.units.get(name, "1").replace("(", "").replace(")", "") for result in (metres, millimetres)]
        factor = parse(units[0]).factor / parse(units[1]).factor
        value, other = (result.table[name][0] for result in (metres, millimetres))
        assert other == pytest.approx(factor * value, rel=1e-6, nan_ok=True), name
        scaled += factor != 1.0 and value == value
    assert scaled >= 8
    assert metres.units["sensors.0.delay"] == "s"


def test_numbers_of_users_have_the_units_that_they_give():
    @dataclass(frozen=True)
    class Largest(cosim.Metric):
        def signals(self, diagram):
            return ("plant.x",)

        def columns(self, diagram):
            return ("largest",)

        def evaluate(self, runs):
            return {"largest": runs.columns("plant.x").max(axis=1)}

    class Measured(Largest):
        def columns(self, diagram):
            return ("measured",)

        def units(self, diagram):
            return {"measured": "m"}

        def evaluate(self, runs):
            return {"measured": runs.columns("plant.x").max(axis=1)}

    def settled(result):
        return float(result.time[-1])

    metrics = [Largest(), Measured(), settled, cosim.OfResult(settled, name="time to settle", unit="s")]
    result = run(lagged(), metrics)
    assert result.units == {"measured": "m", "time to settle": "s"}
    with pytest.raises(ModelError, match="The metric 'settled' has the unit 5; it must be a text, such as 'm/s'"):
        cosim.Campaign(lagged(), duration=1.0, metrics=[cosim.OfResult(settled, unit=5)])


def test_factors_have_the_units_of_settings_and_of_parameters():
    loop = cosim.closed_loop(
        cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controllers.LQGController(controllers.LinearModel([[0.99]], [[2e-4]], [[1.0]], 1e-3, 1.0, dt=0.1)),
        control="force",
        measured="v",
        sensors=cosim.Sensors(1, 1.0),
        faults=[cosim.Drift(start=1.0, slope=0.1)],
        reference=20.0,
    )
    factors = {
        "plant.m": [80.0, 100.0],
        "plant.parameters.b": [50.0],
        "plant.v0": ["72 km/h"],
        "drift_0.start": [1, 2],
        "drift_0.slope": [0.1],
        "drift_0.stop": {"never": np.inf},
        "drift_0.duration": {1: 10.0},
        "drift_0.latching": [True],
        "controller": {"same": next(node.block for node in loop.nodes if node.name == "controller")},
    }
    result = run(loop, [cosim.Final("plant.v")], grid=factors, record=["plant.m"])
    variables = {v.name: v.unit for v in cosim.FMU(fmus.path("CruiseControl")).description.variables}
    assert result.units == {
        "factor:plant.m": variables["m"],
        "plant.parameters.b": variables["b"],
        "drift_0.start": "s",
        "drift_0.slope": f"{variables['v']}/s",
        "final(plant.v)": variables["v"],
    }
    assert {*result.units} <= {*result.table}
    assert result.dataset["factor:plant.m"].attrs == {"units": variables["m"]}
    heads = result._repr_html_()
    assert "<th>drift_0.start (s)</th>" in heads
    assert f"<th>final(plant.v) ({variables['v']})</th>" in heads


@pytest.mark.parametrize(
    ("shared", "expected"),
    [
        ({}, {"reference_0.value": "m", "reference_1.after": "rad", "reference_1.time": "s"}),
        (
            {"connections": [(["reference_1.y", "reference_1.y"], "controller.goal")]},
            {"reference_0.value": None, "reference_1.after": None, "reference_1.time": "s"},
        ),
    ],
)
def test_a_factor_has_the_unit_of_the_sensor_or_goal_that_it_is_for(shared, expected):
    """Of sensors of several quantities the unit was not known, although a fault has one sensor."""
    system = control.ss(
        0.9 * np.eye(2), np.eye(2), np.eye(2), 0, 0.1, inputs=["force", "torque"], outputs=["x", "angle"]
    )
    model = controllers.LinearModel(
        0.9 * np.eye(2), np.eye(2), [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.eye(2), np.eye(3), dt=0.1
    )
    loop = cosim.closed_loop(
        cosim.StateSpace(system, units={"force": "N", "torque": "N m", "x": "m", "angle": "rad"}),
        controllers.LQGController(model, goal_covariance=np.eye(2)),
        control=["force", "torque"],
        measured=["x", "angle"],
        sensors=cosim.Sensors(count=[2, 1], std=[0.1, 0.2, 0.3]),
        faults=[cosim.Bias(sensor=1, magnitude=0.1), cosim.Drift(sensor=2, slope=0.1)],
        reference=[0.0, cosim.Step(time=1.0, after=1.0)],
        **shared,
    )
    sensors = [each.unit for each in find_roles(loop).sensors]
    assert sensors == ["m", "m", "rad"]
    units = {
        "bias_1.magnitude": sensors[1],
        "drift_2.slope": f"{sensors[2]}/s",
        "sensors.std[0]": sensors[0],
        "sensors.std[2]": sensors[2],
        "sensors.std": None,
        **expected,
    }
    assert {path: unit_of_factor(loop, path) for path in units} == units
    exported = {each.name: each.unit for each in program_of(loop, blocks=["bias_1", "drift_2"]).tunables}
    assert units.items() >= {path: exported[path] for path in ("bias_1.magnitude", "drift_2.slope")}.items()


def test_a_function_of_factors_of_any_names_has_no_units():
    assert run(lambda mass, **more: lagged(), [], grid={"mass": [1.0], "plant": [2.0], "none.x": [3.0]}).units == {}


def test_a_store_keeps_units_and_one_of_an_early_version_gets_them(tmp_path):
    pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
    import xarray as xr

    def share(result):
        return 1.0

    def campaign(unit=None):
        metrics = [cosim.RMSE("plant.x", name="size"), cosim.OfResult(share, unit=unit)]
        return cosim.Campaign(
            lagged(), duration=1.0, grid={"drift_0.slope": [0.1, 0.2]}, metrics=metrics, record=["plant.x"]
        )  # fmt: skip

    expected = {"drift_0.slope": "m/s", "size": "m"}
    assert campaign().run(tmp_path / "s").units == campaign().run().units == expected
    for data in (CampaignStore.open(tmp_path / "s").dataset(), xr.open_zarr(tmp_path / "s" / "signals.zarr")):
        assert data["drift_0.slope"].attrs == {"units": "m/s"}
    path = tmp_path / "s" / "campaign.json"
    early = json.loads(path.read_text())
    assert early.pop("units") == expected
    del early["sha256"]
    path.write_text(json.dumps(early))
    assert CampaignStore.open(tmp_path / "s").metadata.units == {}
    assert campaign("%").run(tmp_path / "s").units == expected | {"share": "%"}
    assert CampaignStore.open(tmp_path / "s").metadata.units == expected | {"share": "%"}
