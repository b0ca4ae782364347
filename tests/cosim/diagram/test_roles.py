"""Roles in a closed loop: faults belong to the sensors or to the inputs of the plant, whatever blocks lie in between."""

import json

import control
import pytest

from bayesftc import cosim
from bayesftc.controllers import LinearModel, LQGController
from bayesftc.cosim.diagram.roles import LoopRoles, find_roles, units_of
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import signals_of, true_faults

FAULTS = {0: ("freeze_0",), 1: ("injection_1",)}


def loop(blocks, connections, **options):
    model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    return cosim.closed_loop(
        cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)), LQGController(model), control="u", measured="y",
        sensors=cosim.Sensors(2, 0.2), reference=1.0, faults=[cosim.Freeze(sensor=0), cosim.Injection(sensor=1, magnitude=1.0)],
        blocks=blocks, connections=connections, **options,
    )  # fmt: skip


FILTER = cosim.Gain([[1.0, 0.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("blocks", "connections"),
    [
        ({"filter": FILTER}, [("controller.y", "filter.u"), ("filter.y", "controller.y")]),
        ({"filter": FILTER}, [("sensors.y", "filter.u"), ("filter.y", "freeze_0.u")]),
        ({"filter": cosim.Gain([[0.5]])}, [("controller.y[0]", "filter.u"), (["filter.y", "controller.y[1]"], "controller.y")]),
        (
            {"first": FILTER, "second": FILTER},
            [("controller.y", "first.u"), ("first.y", "second.u"), ("second.y", "controller.y")],
        ),
        ({"logged": cosim.UnitDelay()}, [("controller.y[1]", "logged.u")]),
    ],
    ids=["behind", "before", "one sensor", "two filters", "a block beside the controller"],
)  # fmt: skip
def test_a_block_behind_the_sensors_makes_their_faults_none_of_the_plant(blocks, connections):
    roles = find_roles(loop(blocks, connections))
    assert {i: sensor.faults for i, sensor in enumerate(roles.sensors)} == FAULTS
    assert roles.inputs == ()


def test_a_fault_of_the_input_stays_one_beside_a_filter():
    wiring = [("controller.y", "filter.u"), ("filter.y", "controller.y")]
    roles = find_roles(loop({"filter": FILTER}, wiring, input_faults={"u": cosim.GainFault(factor=0.5)}))
    assert {i: sensor.faults for i, sensor in enumerate(roles.sensors)} == FAULTS
    assert [(each.name, each.faults, each.control) for each in roles.inputs] == [("u", ("u_gain_fault_0",), 0)]


def test_a_sensor_that_also_damps_the_plant_keeps_the_fault_of_the_input():
    blocks = {"damping": cosim.Gain([[-0.1]]), "total": cosim.Sum()}
    wiring = [
        ("freeze_0.y[0]", "damping.u"), (["controller.u", "damping.y"], "total.u"), ("total.y", "u_gain_fault_0.u"),
    ]  # fmt: skip
    roles = find_roles(loop(blocks, wiring, input_faults={"u": cosim.GainFault(factor=0.5)}))
    assert {i: sensor.faults for i, sensor in enumerate(roles.sensors)} == FAULTS
    assert [(each.name, each.faults) for each in roles.inputs] == [("u", ("u_gain_fault_0",))]


def test_a_control_behind_a_sum_and_a_limit_has_the_name_and_unit_of_the_plants_input():
    """Its panel was called "u[0]", the input of the sum, and had no unit."""
    plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["force"]), units={"force": "N"})
    model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    blocks = {
        "noise": cosim.Gaussian(1.0),
        "total": cosim.Sum(),
        "limit": cosim.Saturation(-5.0, 5.0),
        "scaled": cosim.Gain(2.0),
    }
    wiring = [
        (["controller.u", "noise.y"], "total.u"), ("total.y", "limit.u"), ("limit.y", "force_gain_fault_0.u"),
        ("controller.u", "scaled.u"),
    ]  # fmt: skip
    behind = cosim.closed_loop(
        plant, LQGController(model), control="force", measured="y[0]", sensors=cosim.Sensors(2, 0.2), reference=1.0,
        input_faults={"force": cosim.GainFault(factor=0.5)}, blocks=blocks, connections=wiring,
    )  # fmt: skip
    (role,) = find_roles(behind).controls
    assert (role.name, role.unit, role.faults) == ("force", "N", ("force_gain_fault_0",))


def test_the_unit_of_a_plain_number_is_not_shown():
    model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    plant = cosim.StateSpace(
        control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"]), units={"y": "1"}
    )
    diagram = cosim.closed_loop(
        plant, LQGController(model), control="u", measured="y", sensors=cosim.Sensors(2, 0.2), reference=1.0
    )
    roles = find_roles(diagram)
    assert [each.unit for each in (*roles.quantities, *roles.sensors, *roles.controls)] == [None] * 4
    summary = str(diagram.simulate(1.0, seed=1, engine="interpreted").summary())
    assert "tracking of y " in summary
    assert "(1)" not in summary
    assert units_of(diagram)["plant", "y"] == "1"  # of connections that do not fit


def test_an_invalid_value_is_a_missing_sample_in_all_figures():
    """The controller left it out, but tables, reports and figures counted it as a sample of -9999."""

    def sensor_of(fault, invalid):
        model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
        plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
        diagram = cosim.closed_loop(
            plant, LQGController(model), control="u", measured="y", sensors=cosim.Sensors(2, 0.2, invalid=invalid),
            faults=fault, reference=1.0,
        )  # fmt: skip
        result = diagram.simulate(4.0, seed=1, engine="interpreted")
        roles = LoopRoles.from_dict(json.loads(json.dumps(result.roles.to_dict())))
        _, missing = true_faults(roles, result)
        return figures(signals_of(roles, result)).sensors[0], missing[:, 0].sum()

    named, count = sensor_of(cosim.Stuck(sensor=0, at=-9999.0, start=1.0, stop=2.0), [-9999.0, 65535.0])
    assert (named, count) == (sensor_of(cosim.Dropout(sensor=0, start=1.0, stop=2.0), [])[0], 10)
    assert named.seen_as_missing == 1
