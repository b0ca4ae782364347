"""closed_loop wires reference, controller, plant, sensors and faults as it says."""

import re
import warnings
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from control import nlsys, ss

from bayesftc import controllers, cosim
from bayesftc.cosim import Port


def drive(v, position, speed, both):
    speed[0] = v[0]
    position[0] = v[1]
    both[0] = v[0]
    both[1] = v[1]


def drive_on(v, force, gust, h):
    v[1] = v[1] + h[0] * v[0]
    v[0] = v[0] + h[0] * (force[0] - v[0]) + gust[0]


class Car(cosim.Block):
    inputs = (Port("force", feedthrough=False), Port("gust", feedthrough=False, default=0.0))
    outputs = (Port("speed"), Port("position"), Port("both", (2,)))

    def define(self, step):
        return cosim.Definition(drive, drive_on, {"v": np.zeros(2)}, {"h": float(step)})


class Sampled(Car):
    sample_time = Fraction(1, 25)


def control(y, goal, u):
    total = 0.0 * y[0]
    for i in range(y.shape[0]):
        total = total + (goal[0] - y[i])
    for i in range(u.shape[0]):
        u[i] = 4.0 * total


@dataclass(frozen=True)
class Proportional(cosim.Block):
    sensors: int = 1
    controls: int = 1
    goals: int = 1
    sample_time = Fraction(1, 50)

    @property
    def inputs(self):
        return (Port("y", (self.sensors,)), Port("goal", (self.goals,)))

    @property
    def outputs(self):
        return (Port("u", (self.controls,)),)

    def define(self, step):
        return cosim.Definition(control)


class Hasty(Proportional):
    sample_time = None


def loop(**changes):
    settings = {
        "plant": Car(),
        "controller": Proportional(),
        "control": "force",
        "measured": "speed",
        "reference": 2.0,
        **changes,
    }
    return cosim.closed_loop(**settings)


def test_is_what_one_would_write_by_hand(run_both):
    result = run_both(loop(), 4)
    v, rows = 0.0, []
    for _ in range(201):
        rows.append(v)
        v = v + 0.02 * (4.0 * (2.0 - v) - v)
    np.testing.assert_allclose(result["plant.speed"], rows, rtol=1e-12)
    assert [n.name for n in loop().nodes] == ["reference", "plant", "sensors", "controller"]


def test_noise_sensors_and_faults_in_their_places(run_both):
    faults = [cosim.Freeze(sensor=0, start=1.0, stop=2.0), cosim.Bias(sensor=1, start=0.5, magnitude=3.0)]
    diagram = loop(
        controller=Proportional(sensors=2),
        sensors=cosim.Sensors(count=2, std=0.1),
        faults=faults,
        noise={"gust": cosim.Gaussian(0.01)},
        reference=cosim.Sine(1.0, 2.0),
    )
    names = [n.name for n in diagram.nodes]
    assert names == ["reference", "plant", "sensors", "freeze_0", "bias_1", "controller", "gust_noise"]
    result = run_both(diagram, 3, seed=2, record=["*", "controller.y", "plant.gust"])
    np.testing.assert_array_equal(result["controller.y"], result["bias_1.y"])
    np.testing.assert_array_equal(result["plant.gust"], result["gust_noise.y"])
    inside = (result.time >= 1.0) & (result.time < 2.0)
    assert len(np.unique(result["bias_1.y"][inside, 0])) == 1
    late = result.time >= 0.5
    np.testing.assert_allclose(result["bias_1.y"][late, 1], result["sensors.y"][late, 1] + 3.0, rtol=1e-12)
    assert abs((result["sensors.y"] - result["plant.speed"][:, None]).std() - 0.1) < 0.02


def test_several_signals(run_both):
    diagram = loop(
        controller=Proportional(sensors=2, goals=2), measured=["position", "speed"], reference=[1.0, cosim.Ramp(0.1)]
    )
    assert [n.name for n in diagram.nodes][:2] == ["reference_0", "reference_1"]
    result = run_both(diagram, 1, record=["controller.goal", "sensors.y", "plant.*"])
    np.testing.assert_array_equal(result["sensors.y"], np.stack([result["plant.position"], result["plant.speed"]], 1))
    np.testing.assert_array_equal(result["controller.goal"][:, 0], np.ones(51))
    shared = loop(controller=Proportional(sensors=4), measured=["position", "speed"], sensors=cosim.Sensors(count=4))
    assert run_both(shared, 1)["sensors.y"].shape == (51, 4)


@pytest.mark.parametrize("dt", ["1/200", 0.005, Fraction(1, 200)])
def test_a_smaller_step_leaves_the_controller_its_own(dt, run_both):
    diagram = loop(
        dt=dt, sensors=cosim.Sensors(count=1, std=0.1), faults=[cosim.Bias(sensor=0, start=1.0, magnitude=1.0)]
    )
    every = {n.name: n.every for n in diagram.nodes}
    assert every == {"reference": 1, "plant": 1, "sensors": 1, "bias_0": 1, "controller": 4}
    result = run_both(diagram, 2)
    held = result["controller.u"][:-1].reshape(100, 4)
    assert (held == held[:, :1]).all()
    np.testing.assert_array_equal(held[:, 0], 4.0 * (2.0 - result["bias_0.y"][:-1:4, 0]))
    assert len(np.unique(result["sensors.y"])) == len(result.time)  # a sample at every base step
    assert np.ptp(result["plant.speed"][:4]) > 0


def test_a_plant_with_a_sample_time_of_its_own(run_both):
    diagram = loop(plant=Sampled())
    assert {n.name: n.every for n in diagram.nodes}["plant"] == 2
    speed = run_both(diagram, 1)["plant.speed"][:-1].reshape(25, 2)
    assert (speed[:, 0] == speed[:, 1]).all()
    assert loop(dt=0.02).nodes[-1].every == 1


def test_a_disturbance_is_added_to_the_control_as_the_error_says():
    """The remedy in the message is run as it stands; the plant gets the sum of both."""
    with pytest.raises(cosim.ConnectionError, match="put a sum before the plant") as found:
        loop(noise={"force": cosim.Gaussian(1.0)})
    remedy = re.search(r"closed_loop(\(.*\))\. On the left", str(found.value))[1]
    mended = eval(f"loop{remedy}", {"loop": loop, "cosim": cosim})
    run = mended.simulate(1, seed=1, record=["controller.u", "disturbance.y", "total.y"])
    assert run["disturbance.y"].std() > 0.05
    assert np.array_equal(run["total.y"], run["controller.u"].ravel() + run["disturbance.y"])
    assert mended.source_of(mended["plant"], mended["plant"].port("force"), 0)[0].node.name == "total"


@pytest.mark.parametrize(
    "reference", [2, 2.0, np.float32(2.0), np.int64(2), [2.0], (2,), np.array([2.0]), cosim.Constant(2.0)]
)
def test_references(reference):
    assert loop(reference=reference).simulate(1)["reference.y"].tolist() == [2.0] * 51


@pytest.mark.parametrize(
    ("changes", "error", "sentence"),
    [
        (
            {"measured": "sped"},
            cosim.UnknownNameError,
            r"='sped'. Block 'plant' has no port 'sped'; did you mean 'speed'",
        ),
        ({"control": "froce", "sensors": 2}, cosim.ModelError, r"must be one Sensors"),
        (
            {"control": "froce", "reference": [1.0, 2.0]},
            cosim.UnknownNameError,
            r"has control='froce'. .* did you mean 'force'",
        ),
        ({"noise": {"gsut": cosim.Gaussian(1.0)}}, cosim.UnknownNameError, r"did you mean 'gust'"),
        ({"measured": []}, cosim.ModelError, r"measured= is empty"),
        ({"control": ()}, cosim.ModelError, r"control= is empty"),
        (
            {"measured": "force"},
            cosim.ConnectionError,
            r"plant\.force is an input, but the source must be an output; known names: both, p",
        ),
        ({"control": "speed"}, cosim.ConnectionError, r"plant\.speed is an output, but the target must be an input"),
        (
            {"control": ["force", "gust"]},
            cosim.ConnectionError,
            r"The controller has 1 control, but control= names 2 of the plant",
        ),
        (
            {"noise": {"force": cosim.Gaussian(1.0)}},
            cosim.ConnectionError,
            r"a control already.*put a sum before the plant",
        ),
        (
            {"sensors": cosim.Sensors(count=2)},
            cosim.ConnectionError,
            r"The controller has 1 sensor, but the loop has 2",
        ),
        ({"faults": ["freeze"]}, cosim.ModelError, r"faults must contain only faults, such as Freeze"),
        ({"faults": 3}, cosim.ModelError, r"faults must contain only faults, .* not 3"),
        (
            {"input_faults": {"wind": [cosim.Bias(magnitude=1.0)]}},
            cosim.UnknownNameError,
            r"^input_faults names 'wind', which is no input of the plant; known names: force, gust\.$",
        ),
        (
            {"noise": {"gusts": cosim.Gaussian(1.0)}},
            cosim.UnknownNameError,
            r"^noise names 'gusts', which is no input of the plant; did you mean 'gust'\?$",
        ),
        ({"input_faults": {"force": None}}, cosim.ModelError, r"faults must contain only faults, .* not None"),
        ({"faults": [cosim.Freeze(sensor=1, start=1.0)]}, cosim.ModelError, r"refers to sensor 1, but there are 1"),
        (
            {"reference": [1.0, 2.0]},
            cosim.ConnectionError,
            r"The goal has one element, but the reference has 2\. Give one",
        ),
        (
            {"controller": Proportional(goals=3)},
            cosim.ConnectionError,
            r"The goal has 3 elements, but the reference has 1\. .* one \[\[reference\]\] for each in a scenario file",
        ),
        ({"reference": "up"}, cosim.ModelError, r"reference is 'up'\. Only blocks can be added"),
        ({"reference": None}, cosim.ModelError, r"reference is None\. .* cosim\.Table\(times, values\) for a course"),
        (
            {"reference": np.ones(50)},
            cosim.ConnectionError,
            r"the reference has 50\. .* A course over time is one source",
        ),
        (
            {"noise": {"gust": 0.1}},
            cosim.ModelError,
            r"noise\['gust'\] is 0\.1\. Only blocks .* cosim\.Gaussian\(std=0\.1\)",
        ),
        ({"faults": "freeze"}, cosim.ModelError, r"only faults, such as Freeze\(.* not 'freeze'"),
        ({"plant": cosim.Constant(1.0)}, cosim.UnknownNameError, r"Block 'plant' has no port 'speed'"),
        (
            {"controller": Hasty()},
            cosim.StepSizeError,
            r"Hasty has no sample time; give closed_loop\(dt=",
        ),
        (
            {"controller": cosim.Gain(1.0), "dt": 0.1},
            cosim.UnknownNameError,
            r"controller, of the kind Gain, has no input 'y'.*whether plant and controller are exchanged",
        ),
        ({"plant": "car.fmu"}, cosim.ModelError, r"plant must be a block, not 'car.fmu'; use cosim.FMU\(path\)"),
        ({"plant": np.eye(2)}, cosim.ModelError, r"not array\(\[\[1.*use cosim"),
        ({"controller": control}, cosim.ModelError, r"controller must be a block, not <function control"),
        (
            {"sensors": 2},
            cosim.ModelError,
            r"sensors is 2; it must be one Sensors block, such as .*one of the second, cosim\.Sensors\(count=\(2, 1\)",
        ),
        ({"noise": cosim.Gaussian(1.0)}, cosim.ModelError, r"it must be a mapping from inputs of the plant to sources"),
        (
            {"dt": 0.1},
            cosim.StepSizeError,
            r"The controller must run every 0.02 s, which is no whole multiple of dt, 0.1 s; give closed_loop a dt that div",
        ),
        (
            {"dt": 0.015},
            cosim.StepSizeError,
            r"The controller must run every 0.02 s, which is no whole multiple of dt, 0.015 s",
        ),
        (
            {"plant": Sampled(), "controller": Hasty(), "dt": 0.03},
            cosim.StepSizeError,
            r"The plant must run every 0.04 s, which is no whole multiple of dt, 0.03 s",
        ),
    ],
)
def test_what_does_not_fit(changes, error, sentence):
    with pytest.raises(error, match=sentence):
        loop(**changes)


def test_a_system_of_python_control_is_a_plant():
    system = ss([[-1.0]], [[1.0]], [[1.0]], 0, inputs=["force"], outputs=["speed"])
    runs = [loop(plant=plant).simulate(1)["plant.speed"] for plant in (system, cosim.StateSpace(system))]
    np.testing.assert_array_equal(*runs)
    assert runs[0].any()


ROOMS = ss(
    [[-0.3, 0.1], [0.1, -0.2]], [[1.0, 0.0], [0.0, 1.0]], np.eye(2), 0,
    inputs=["heat", "vent"], outputs=["T1", "T2"], states=["T1", "T2"],
)  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        (
            {"measured": ["T2", "T1"]},
            r"T1, T2, T1, T2, but the loop has T2, T1, T2, T1 .* measured=\['T1', 'T2'\]",
        ),
        ({"measured": "T1"}, r"sensors T1, T2, T1, T2, but the loop has T1, T1, T1, T1"),
        (
            {"control": ["vent", "heat"]},
            r"the controls heat, vent, but the loop has vent, heat .* control=\['heat', 'vent'\]",
        ),
    ],
)
def test_signals_in_another_order_than_those_of_the_model_are_warned_of(changes, words):
    controller = controllers.design(ROOMS, measured=["T1", "T2"], actuated=["heat", "vent"], dt=0.1, sensors=4)
    given = {"control": ["heat", "vent"], "measured": ["T1", "T2"], "sensors": cosim.Sensors(4, 0.1), **changes}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cosim.closed_loop(ROOMS, controller, reference=[1.0, 2.0], **given)
    assert len(caught) == bool(words)
    assert all(re.search(words, str(each.message)) and each.filename == __file__ for each in caught)


@pytest.mark.parametrize(("designed", "given", "remedy"), [([3, 1], 4, [3, 1]), (4, [3, 1], 4), ([3, 1], [3, 1], None)])
def test_other_numbers_of_sensors_than_those_of_the_model_are_named(designed, given, remedy):
    controller = controllers.design(ROOMS, measured=["T1", "T2"], actuated=["heat", "vent"], dt=0.1, sensors=designed)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cosim.closed_loop(
            ROOMS, controller, control=["heat", "vent"], measured=["T1", "T2"], sensors=cosim.Sensors(given, 0.1),
            reference=[1.0, 2.0],
        )  # fmt: skip
    said = [str(each.message) for each in caught]
    assert len(said) == (remedy is not None)
    assert all(
        f"Give sensors=Sensors(count={remedy}, ...)" in each and "or design the controller" in each for each in said
    )


@pytest.mark.parametrize(
    ("order", "given", "remedy"),
    [
        ([0, 0, 0, 1, 1], [3, 2], None), ([0, 0, 0, 1, 1], [2, 3], "[3, 2]"), ([0, 0, 0, 1, 1], [1, 4], "[3, 2]"),
        ([0, 1, 0, 1], [2, 2], "4"), ([0, 1, 0, 1], 4, None),
    ],
)  # fmt: skip
def test_a_model_without_names_shows_by_its_rows_which_sensors_measure_one_quantity(order, given, remedy):
    rows = np.eye(2)[order]
    model = controllers.LinearModel([[0.97, 0.01], [0.01, 0.98]], 0.1 * np.eye(2), rows, 1e-3, 0.01, dt=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cosim.closed_loop(
            ROOMS, controllers.LQGController(model), control=["heat", "vent"], measured=["T1", "T2"],
            sensors=cosim.Sensors(given, 0.1), reference=[1.0, 2.0],
        )  # fmt: skip
    said = [str(each.message) for each in caught if "by the rows of C" in str(each.message)]
    assert len(said) == (remedy is not None)
    assert all(f"Give sensors=Sensors(count={remedy}, ...)" in each for each in said)


def tank(t, x, u, params):
    return np.array([0.1 * u[0] + u[1] - 0.2 * np.sqrt(max(x[0], 1e-3))])


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        ({}, r"with inflow = 0\.05, but inflow of the plant has no source and stays at 0\. .*Constant\(0\.05\)"),
        ({"inflow": cosim.Constant(0.05)}, ""),
    ],
)
def test_an_input_that_stays_away_from_the_operating_point_is_warned_of(noise, words):
    system = nlsys(tank, lambda t, x, u, params: x, inputs=["pump", "inflow"], outputs=["level"], states=["h"])
    plant = cosim.StateSpace(system, initial=[0.25])
    controller = controllers.design(
        plant, measured="level", actuated="pump", sensors=2, dt=0.5, at={"pump": 0.5, "inflow": 0.05}
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        diagram = cosim.closed_loop(
            plant, controller, control="pump", measured="level", sensors=cosim.Sensors(2, 0.01), reference=0.25, noise=noise
        )  # fmt: skip
    assert len(caught) == bool(words)
    assert all(re.search(words, str(each.message)) and each.filename == __file__ for each in caught)
    described = controller.describe().split("filter's included: ")[1].split(";")[0]
    poles = sorted(float(pole) for pole in described.split(", "))
    np.testing.assert_allclose(np.sort(diagram.poles().real), poles, rtol=1e-4)


@pytest.mark.parametrize(
    ("designed_at", "spread", "learner", "words"),
    [
        (0.25, 10.0, {"start_doubt": 0.0}, ""),
        (0.75, 1e5, {"joint": False}, ""),
        (0.75, 10.0, {}, ""),
        (0.75, 10.0, {"process_modes": ()}, "give or take"),
        (0.75, 10.0, {"joint": False}, "give or take"),
        (
            0.75, 10.0, {"start_doubt": 0.0},
            r"level = 0\.75 m, give or take 0\.0\d+ m, but the plant begins at 0\.25 m.* initial=\[0\.25\]",
        ),
    ],
)  # fmt: skip
def test_a_plant_that_starts_where_the_belief_excludes_it_is_warned_of(designed_at, spread, learner, words):
    system = nlsys(tank, lambda t, x, u, params: x, inputs=["pump", "inflow"], outputs=["level"], states=["h"])
    plant, other = (cosim.StateSpace(system, initial=[level]) for level in (0.25, designed_at))
    controller = controllers.design(
        other, measured="level", actuated="pump", sensors=2, dt=0.5, noise={"pump": 0.05}, initial_spread=spread,
        precision=controllers.SwitchingPrecision(**learner),
    )  # fmt: skip
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cosim.closed_loop(
            plant, controller, control="pump", measured="level", sensors=cosim.Sensors(2, 0.01, unit="m"), reference=0.25
        )  # fmt: skip
    assert len(caught) == bool(words)
    assert all(re.search(words, str(each.message)) and each.filename == __file__ for each in caught)


def test_one_fault_needs_no_list():
    freeze = cosim.Freeze(sensor=0, start=1.0)
    assert [n.name for n in loop(faults=freeze).nodes] == [n.name for n in loop(faults=[freeze]).nodes]


def test_further_faults_of_a_kind_on_a_sensor_are_numbered():
    twice = [cosim.Freeze(sensor=0, start=1.0, stop=2.0), cosim.Freeze(sensor=0, start=3.0)]
    assert [n.name for n in loop(faults=twice).nodes if "freeze" in n.name] == ["freeze_0", "freeze_0_2"]
    taken = [*twice, cosim.Freeze(sensor=0, start=5.0), cosim.Freeze(sensor=0, start=7.0, name="freeze_0_2")]
    names = [n.name for n in loop(faults=taken).nodes if "freeze" in n.name]
    assert names == ["freeze_0", "freeze_0_3", "freeze_0_4", "freeze_0_2"]
    with pytest.raises(cosim.ModelError, match=r"already has a block 'again'"):
        loop(faults=[cosim.Freeze(name="again")] * 2)
    named = [twice[0], cosim.Freeze(sensor=0, start=3.0, name="again")]
    assert "again" in [n.name for n in loop(faults=named).nodes]


def test_further_blocks_and_their_connections(same_bits):
    blocks = {"late": cosim.UnitDelay(), "slow": (cosim.Gain(2.0), 5)}
    given = loop(
        blocks=blocks, connections=[("controller.u", "late.u"), ("late.y", "plant.force"), ("plant.force", "slow.u")]
    )
    assert [node.name for node in given.nodes][-2:] == ["late", "slow"]
    assert given["slow"].every == 5
    result = given.simulate(1.0, engine="interpreted")
    by_hand = cosim.Diagram("1/50")
    names = ("plant", "sensors", "controller", "reference", "late")
    nodes = {name: by_hand.add(given[name].block, name) for name in names}
    for source, target in (
        ("plant.speed", "sensors.u"), ("sensors.y", "controller.y"), ("reference.y", "controller.goal"),
        ("controller.u", "late.u"), ("late.y", "plant.force"),
    ):  # fmt: skip
        (one, out), (other, into) = source.split("."), target.split(".")
        by_hand.connect(nodes[one][out], nodes[other][into])
    other = by_hand.simulate(1.0, engine="interpreted")
    for name in other:
        same_bits(result[name], other[name], name)
    same_bits(
        result["slow.y"][::5], 2.0 * result["controller.u"].ravel()[::5]
    )  # what the loop itself feeds to the force


def test_an_input_can_be_connected_anew():
    diagram = cosim.Diagram(1)
    one, two, gain = (
        diagram.add(b, n) for b, n in ((cosim.Constant(1.0), "a"), (cosim.Constant(2.0), "b"), (cosim.Gain(1.0), "g"))
    )
    diagram.connect(one["y"], gain["u"])
    diagram.disconnect(gain["u"])
    diagram.connect(two["y"], gain["u"])
    assert diagram.simulate(1)["g.y"][-1] == 2.0
    with pytest.raises(cosim.ModelError, match="to disconnect ports, do so before build"):
        diagram.disconnect(gain["u"])


def in_units(speed, position, reference, **changes):
    """Return a loop of two quantities in these units, with goals for both."""

    class Known(Car):
        outputs = (Port("speed", unit=speed), Port("position", unit=position), Port("both", (2,)))

    return loop(
        plant=Known(),
        controller=Proportional(sensors=2, goals=2),
        measured=["speed", "position"],
        reference=reference,
        **changes,
    )


@pytest.mark.parametrize(
    ("unit", "gap"),
    [
        ("km", "; put Gain(1000) between them."),
        ("K", ": their dimensions differ; put a block between them that computes one from the other."),
    ],
)
def test_a_reference_in_another_unit_than_its_quantity_is_refused(unit, gap):
    sentence = f"reference_1.y is in {unit}, but controller.goal[1], the goal of position, is in m{gap}"
    with pytest.raises(cosim.ConnectionError, match=re.escape(sentence)):
        in_units("m/s", "m", [1.0, cosim.Constant(3.0, unit=unit)])
    in_units("m/s", "m", [cosim.Constant(1.0, unit="m s-1"), cosim.Constant(3.0, unit="m")])
    in_units("m/s", None, [1.0, cosim.Constant(3.0, unit=unit)])  # not known


def test_a_reference_is_checked_in_a_loop_wired_by_hand():
    class Known(Car):
        outputs = (Port("speed", unit="K"), Port("position"), Port("both", (2,)))

    for unit in ("K", "degC"):
        diagram = cosim.Diagram(0.02)
        goal, plant = diagram.add(cosim.Constant(20.0, unit=unit), "goal"), diagram.add(Known(), "plant")
        sensors = diagram.add(cosim.Sensors(1), "sensors")
        controller = diagram.add(Proportional(sensors=1, goals=1), "controller")
        diagram.connect(plant["speed"], sensors["u"])
        diagram.connect(sensors["y"], controller["y"])
        diagram.connect(goal["y"], controller["goal"])
        diagram.connect(controller["u"], plant["force"])
        if unit == "K":
            diagram.simulate(0.1, engine="interpreted")
    with pytest.raises(
        cosim.ConnectionError, match=r"^goal\.y is in degC, but controller\.goal, .* of speed, is in K; put"
    ):
        diagram.simulate(1.0)


def test_a_reference_is_checked_through_blocks_and_by_the_units_of_sensors():
    limited = {
        "blocks": {"limiter": cosim.RateLimiter(1.0)},
        "connections": [("reference_0.y", "limiter.u"), ("limiter.y", "controller.goal[0]")],
    }
    with pytest.raises(
        cosim.ConnectionError, match=re.escape("limiter.y is in km/h, but controller.goal[0], the goal of")
    ):
        in_units("m/s", "m", [cosim.Constant(1.0, unit="km/h"), 3.0], **limited)
    converted = {
        "blocks": {"si": cosim.Gain(1 / 3.6, 0.0, "km/h", "m/s")},
        "connections": [("reference_0.y", "si.u"), ("si.y", "controller.goal[0]")],
    }
    in_units("m/s", "m", [cosim.Constant(1.0, unit="km/h"), 3.0], **converted)
    sensors = cosim.Sensors(2, unit=["m/s", "m"])
    with pytest.raises(cosim.ConnectionError, match=re.escape("reference_1.y is in K, but")):
        in_units(None, None, [1.0, cosim.Constant(3.0, unit="K")], sensors=sensors)
    with pytest.raises(
        cosim.ConnectionError, match=re.escape("plant.position is in km, but sensors.u[1] is in m; put")
    ):
        in_units("m/s", "km", [1.0, 3.0], sensors=sensors)


def test_all_units_that_differ_are_named_at_once():
    sentence = (
        "plant.v is in km/h, but sensors.u[0] is in m/s; put Gain(0.277777777778) between them. plant.position is in km, but "
        "sensors.u[1] is in m; put Gain(1000) between them."
    )
    with pytest.raises(cosim.ConnectionError) as caught:
        in_units("km/h", "km", [1.0, 3.0], sensors=cosim.Sensors(2, unit=["m/s", "m"]))
    assert str(caught.value).replace("speed", "v") == sentence


def test_the_advised_gain_stands_between_plant_and_sensors():
    sensors = cosim.Sensors(2, unit=["m/s", "m"])
    sentence = "plant.position is in km, but sensors.u[1] is in m; put Gain(1000) between them."
    with pytest.raises(cosim.ConnectionError, match=re.escape(sentence)):
        in_units("m/s", "km", [1.0, 3.0], sensors=sensors)
    between = [("plant.position", "si.u"), ("si.y", "sensors.u[1]")]
    converted = in_units(
        "m/s", "km", [1.0, 3.0], sensors=sensors, blocks={"si": cosim.Gain(1000.0)}, connections=between
    )
    run = converted.simulate(0.1, engine="interpreted")
    np.testing.assert_allclose(run["sensors.y"][:, 1], 1000.0 * run["plant.position"])
    wrong = [("plant.position", "si.u"), ("si.y", "sensors.u[0]")]
    with pytest.raises(cosim.ConnectionError, match=re.escape(sentence)):
        in_units("m/s", "km", [1.0, 3.0], sensors=sensors, blocks={"si": cosim.Gain(1000.0)}, connections=wrong)


def test_elements_of_one_port_keep_their_own_units():
    diagram = in_units("m/s", None, [cosim.Constant(1.0, unit="m/s"), 3.0])
    units = diagram.simulate(0.04, engine="interpreted", record=["*", "*.*"]).units
    assert units["reference_0.y"] == "m/s"
    assert not {"reference_1.y", "plant.position", "sensors.y"} & units.keys()


def test_a_reference_has_the_unit_of_the_samples_that_the_controller_receives():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    plant = ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"])

    def loop(gain, unit):
        return cosim.closed_loop(
            plant, controllers.LQGController(model), control="u", measured="y", sensors=cosim.Sensors(2, 0.1, unit="V"),
            reference=cosim.Constant(1.0, unit=unit), blocks={"scale": gain},
            connections=[("sensors.y", "scale.u"), ("scale.y", "controller.y")],
        )  # fmt: skip

    ten = 10.0 * np.eye(2)
    loop(cosim.Gain(ten), "m")  # in what the gain gives is not known
    converted = loop(cosim.Gain(ten, input_unit="V", output_unit="m"), "m")
    assert [sensor.unit for sensor in converted.simulate(0.5).roles.sensors] == ["m", "m"]
    with pytest.raises(cosim.ConnectionError, match=r"reference\.y is in km, .* is in m; put Gain\(1000\)"):
        loop(cosim.Gain(ten, input_unit="V", output_unit="m"), "km")


@pytest.mark.parametrize("kind", ["linear", "nonlinear", "block"])
def test_a_controller_of_python_control_has_its_vectors_in_numbers(kind):
    """An observer and a gain, in the names of python-control; the loop's signals are those of the matrices."""
    plant = ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["x"])
    A, B, C, D = np.array([[0.5]]), np.array([[0.2, 0.1, 0.3]]), np.array([[-1.0]]), np.array([[-0.5, -0.25, 2.0]])
    names = {"inputs": ["y[0]", "y[1]", "goal"], "outputs": ["u"]}
    own = ss(A, B, C, D, 0.1, **names)
    if kind == "nonlinear":
        own = nlsys(lambda t, x, u, p: A @ x + B @ u, lambda t, x, u, p: C @ x + D @ u, states=1, dt=0.1, **names)
    loop = cosim.closed_loop(
        plant, cosim.StateSpace(own) if kind == "block" else own, control="u", measured="x", sensors=cosim.Sensors(2, 0.1),
        reference=1.0, dt=0.1,
    )  # fmt: skip
    result = loop.simulate(3.0, seed=1)
    x, z = 0.0, np.zeros(1)
    for at, y, u in zip(result["plant.x"], result["sensors.y"], result["controller.u"], strict=True):
        assert at == pytest.approx(x, abs=1e-12)
        given = np.array([*y, 1.0])
        assert np.ravel(u) == pytest.approx(C @ z + D @ given, abs=1e-12)
        x, z = 0.9 * x + 0.1 * float(np.ravel(u)[0]), A @ z + B @ given


def test_a_controller_of_python_control_without_names_is_told_them():
    own = ss([[0.5]], [[0.2, 0.1, 0.3]], [[-1.0]], [[0, 0, 0]], 0.1)
    with pytest.raises(cosim.UnknownNameError, match=r"inputs=\['y\[0\]', 'y\[1\]', 'goal'\], outputs=\['u'\]"):
        cosim.closed_loop(Car(), own, control="force", measured="speed", sensors=cosim.Sensors(2, 0.1), reference=1.0)


@pytest.mark.parametrize("goal_names", ["x", ["x"]])
def test_the_goal_of_a_controller_of_python_control_is_named(goal_names):
    plant = ss([[0, 1], [0, -1]], [[0], [1]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"])
    own = ss([], [], [], [[-2.0, -2.0, 2.0]], 0.1, inputs=["y[0]", "y[1]", "goal"], outputs=["u"])
    parts = {"control": "force", "measured": ["x", "v"], "sensors": cosim.Sensors([1, 1], 0.01), "reference": 1.0}
    law = cosim.StateSpace(own, goal_names=goal_names)
    plain, named = (cosim.closed_loop(plant, each, **parts).simulate(3.0, seed=1) for each in (own, law))
    assert "tracking of x" not in plain.summary()["errors"].index
    error = named.summary()["errors"].loc["tracking of x", "whole run"]
    assert error == pytest.approx(np.sqrt(np.mean((plain["plant.x"] - 1.0) ** 2)))


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"goal_names": 5}, "goal_names=5"),
        ({"goal_names": ["x", "v"]}, "must be 1 name"),
        ({"arrays": "yes"}, "arrays='yes'"),
    ],
)
def test_wrong_settings_of_a_controller_of_python_control_are_refused(setting, said):
    own = ss([], [], [], [[-2.0, -2.0, 2.0]], 0.1, inputs=["y[0]", "y[1]", "goal"], outputs=["u"])
    with pytest.raises(cosim.ModelError, match=said):
        cosim.StateSpace(own, **setting)
