"""A goal on an output that no sensor measures has its errors, its panel and its unit, wherever a measured one has them."""

from types import SimpleNamespace

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.diagram.roles import find_roles, traits
from bayesftc.cosim.judging.roles import loop_signals


def cart():
    """A mass on a rail with a sensor of its position, and a point that a lever moves twice as far ahead, which has the goal."""
    A, B = [[0, 1], [0, -1]], [[0], [1]]
    return control.ss(A, B, [[1, 0], [2, 0]], 0, inputs=["force"], outputs=["position", "ahead"])


def made(**changed):
    return controllers.design(
        cart(), measured="position", actuated="force", goal="ahead", sensors=3, sensor_std=0.01, dt=0.05, **changed
    )


def looped(controller, reference=None, **changed):
    return cosim.closed_loop(
        cart(), controller, control="force", measured="position", sensors=cosim.Sensors(3, 0.01),
        reference=cosim.Step(time=1.0, after=1.0) if reference is None else reference, **changed,
    )  # fmt: skip


@pytest.fixture(scope="module")
def loop():
    return looped(made(), faults=[cosim.Freeze(sensor=0, start=2.0)])


@pytest.fixture(scope="module")
def result(loop):
    return loop.simulate(5.0, seed=1)


def test_its_errors_are_those_of_the_signals(result):
    errors = result.summary()["errors"]
    tracking = result["plant.ahead"] - result["reference.y"]
    assert errors.loc["tracking of ahead", "whole run"] == pytest.approx(np.sqrt(np.mean(tracking**2)))
    belief = 2.0 * result["controller.x_hat"][:, 0] - result["plant.ahead"]
    assert errors.loc["belief of ahead", "whole run"] == pytest.approx(np.sqrt(np.mean(belief**2)))
    assert "tracking of position" not in errors.index
    assert result["plant.ahead"][-1] == pytest.approx(1.0, abs=0.1)


def test_no_sensor_is_named_by_it(loop, result):
    signals = loop_signals(loop, result)
    assert [q.name for q in signals.quantities] == ["position", "ahead"]
    assert signals.quantities[1].sensors == ()
    assert signals.sensor_name(0) == "sensor 0"  # all measure one quantity


def test_the_figure_has_a_panel_with_its_reference(result):
    panels = {axis.get_ylabel(): axis for axis in result.plot().axes}
    assert "reference" in [line.get_label() for line in panels["ahead"].get_lines()]
    assert "reference" not in [line.get_label() for line in panels["position"].get_lines()]


def test_campaigns_and_comparisons_have_it(loop):
    table = cosim.Campaign(loop, duration=3.0, seeds=2, metrics=[cosim.LoopFigures()]).run().table
    assert (table["tracking.ahead.overall"] > 0).all()
    fixed = looped(made(precision=controllers.FixedPrecision()), faults=[cosim.Freeze(sensor=0, start=2.0)])
    compared = cosim.compare({"switching": loop, "fixed": fixed}, duration=3.0, seeds=2)
    assert any("ahead" in str(name) for name in compared.runs.columns)
    assert "ahead" in [axis.get_ylabel() for axis in compared.plot().axes]


@pytest.mark.slow
def test_an_exported_controller_says_what_its_goal_is_for(loop, tmp_path):
    path = cosim.export_fmu(loop, tmp_path / "controller.fmu", blocks="controller")
    roles = find_roles(looped(cosim.FMU(path)))
    assert [(q.name, q.goal) for q in roles.quantities] == [("position", None), ("ahead", 0)]


def test_the_goal_of_later_samples_says_so_and_what_it_is_for():
    goal = made(preview=20).port("goal")
    assert goal.element_descriptions == ("Goal of 20 samples later (ahead); NaN keeps the last",)


@pytest.mark.parametrize("names", [5, ["a", "b"], [1.0], None])
def test_names_of_another_form_in_a_block_of_somebody_else_are_left_out(names):
    block = SimpleNamespace(inputs=[cosim.Port("goal", (1,))], outputs=[cosim.Port("u", (1,))], goal_names=names)
    assert "goal_names" not in traits(block)
    block.goal_names = ["ahead"]
    assert traits(block)["goal_names"] == ("ahead",)


def test_a_name_that_is_no_output_of_the_plant_has_no_true_value():
    controller = controllers.LQGController(made().model, goal_on=[[2.0, 0.0]], goal_names=["elsewhere"])
    (_, quantity) = find_roles(looped(controller)).quantities
    assert (quantity.name, quantity.truth, quantity.belief) == ("elsewhere", None, (2.0, 0.0))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a", "b"], "2 names, but there are 1"),
        ("a", "must be a list of texts"),
        (5, "must be a list of texts"),
        (["a", "a"], "name each element once"),
    ],
)
def test_wrong_names_are_refused(names, said):
    with pytest.raises(cosim.ModelError, match=said):
        controllers.LQGController(made().model, goal_on=[[2.0, 0.0]], goal_names=names)


def test_a_block_between_plant_and_sensors_hides_no_signal_of_the_plant():
    diagram = cosim.Diagram(0.05)
    plant = diagram.add(cosim.StateSpace(cart()), "plant")
    gain, sensors = diagram.add(cosim.Gain(1.0)), diagram.add(cosim.Sensors(3, 0.01))
    controller, goal = diagram.add(made(), "controller"), diagram.add(cosim.Constant(1.0))
    diagram.connect(plant["position"], gain["u"])
    diagram.connect(gain["y"], sensors["u"])
    diagram.connect(sensors["y"], controller["y"])
    diagram.connect(goal["y"], controller["goal"])
    diagram.connect(controller["u"], plant["force"])
    assert find_roles(diagram).quantities[1].truth == ((1.0, ("plant.ahead", 0)),)


def test_a_reference_in_another_unit_is_refused():
    """Two masses and a spring between them: sensors of the first, the goal is for the second."""
    masses = cosim.FMU(fmus.path("TwoMasses"))
    controller = controllers.design(
        masses, measured="x1", actuated="force1", goal="x2", sensors=2, sensor_std=0.01, dt=0.02
    )

    def with_unit(unit):
        return cosim.closed_loop(
            masses, controller, control="force1", measured="x1", sensors=cosim.Sensors(2, 0.01),
            reference=cosim.Step(time=1.0, after=0.1, unit=unit),
        )  # fmt: skip

    assert find_roles(with_unit("m")).quantities[1].unit == "m"
    with pytest.raises(cosim.ConnectionError, match="the goal of x2, is in m"):
        with_unit("rad")
