"""Names of what sensors read, from the connections of a loop."""

import warnings

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import BayesianController, LinearModel, LQGController, SwitchingPrecision
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals, signals_of


@pytest.mark.parametrize(
    ("matrix", "names_of"),
    [
        ([[1.0, 1.0], [1.0, 0.0]], ["x + w", "x"]),
        ([[-1.0, 0.5], [0.0, -2.0]], ["-x + 0.5 w", "-2 w"]),
        ([[1.0, -0.1], [0.0, 1.0]], ["x - 0.1 w", "w"]),
    ],
)
def test_a_sensor_of_several_signals_is_named_by_what_it_reads(matrix, names_of):
    plant = control.ss(np.diag([0.9, 0.99]), [[0.1], [0.0]], np.eye(2), 0, 0.1, inputs=["u"], outputs=["x", "w"])
    model = LinearModel(np.diag([0.9, 0.99]), [[0.1], [0.0]], matrix, 1e-3, 0.01, dt=0.1)
    controller = LQGController(model, goal_on=[[1.0, 0.0]])
    loop = cosim.closed_loop(
        cosim.StateSpace(plant), controller, control="u", measured=["x", "w"], reference=1.0,
        sensors=cosim.Sensors(2, 0.1, signals=2, matrix=matrix),
    )  # fmt: skip
    run = loop_signals(loop, loop.simulate(2.0))
    assert [quantity.name for quantity in run.quantities] == names_of
    assert run.sensor_name(0) == f"sensor 0 ({names_of[0]})"


def slow_loop(every=(1, 5), loss=0.01, **options):
    model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    return cosim.closed_loop(
        cosim.StateSpace(control.ss([[-1.0]], [[1.0]], [[1.0]], 0)),
        BayesianController(model, SwitchingPrecision(loss=loss)), control="u", measured="y", reference=1.0,
        sensors=cosim.Sensors(2, 0.2, every=every), **options,
    )  # fmt: skip


def test_faults_and_learner_know_how_often_a_sensor_has_a_sample(same_bits):
    loop = slow_loop(faults=[cosim.Freeze(sensor=1, start=2.03, stop=6.0), cosim.Injection(sensor=0, magnitude=1.0)])
    assert (loop["freeze_1"].block.spacing, loop["injection_0"].block.spacing) == (5, 1)
    assert loop["controller"].block.precision.loss == pytest.approx((0.01, 1.0 - 0.99 / 5))
    result = loop.simulate(10.0, seed=1)
    y, due = result["injection_0.y"][:, 1], np.arange(101) % 5 == 0
    assert np.isnan(y[~due]).all()
    assert (y[due][5:12] == y[20]).all()  # the last sample before the onset, at 2 s
    for name, values in loop.simulate(1.0, seed=1, engine="interpreted").items():
        same_bits(values, result[name][:11], name)
    sensors = figures(signals_of(result.roles, result)).sensors
    assert [(each.missing_share, each.faults, each.seen_as_missing) for each in sensors] == [(0, 1, 0), (0, 1, 0)]
    assert "samples missing" not in str(result.summary())


def test_a_dead_time_of_a_sensor_is_no_fault():
    """The figures counted a fault from the first step to the last, of a sensor whose dead time the model knows."""
    late, frozen = cosim.Delay(sensor=1, delay=0.3), cosim.Freeze(sensor=0, start=2.0, stop=4.0)
    result = slow_loop(every=1, faults=[late, frozen]).simulate(10.0, seed=1)
    sensors = figures(signals_of(result.roles, result)).sensors
    assert [each.faults for each in sensors] == [1, 0]
    assert not result.summary()["errors"]["before faults"].isna().any()
    begun = cosim.Delay(sensor=1, delay=0.3, start=1.0)
    result = slow_loop(every=1, faults=[begun]).simulate(10.0, seed=1)
    assert figures(signals_of(result.roles, result)).sensors[1].faults == 1


def test_a_delay_of_a_slow_sensor_that_is_no_multiple_of_its_sample_time_is_warned_of():
    with pytest.warns(UserWarning, match=r"'delay_1' delays sensor 1 by 0.3 s.*every 0.5 s.*they are 0.5 s late"):
        loop = slow_loop(faults=[cosim.Delay(sensor=1, delay=0.3)])
    y = loop.simulate(2.0, seed=1, record=["sensors.y", "delay_1.y"])
    np.testing.assert_array_equal(y["delay_1.y"][5::5, 1], y["sensors.y"][:-5:5, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Sensor 1 .* later than another sensor of its quantity")
        slow_loop(faults=[cosim.Delay(sensor=1, delay=1.0), cosim.Delay(sensor=0, delay=0.3)])


def test_a_late_sensor_beside_others_that_the_model_does_not_know_is_warned_of(recwarn):
    late, other = cosim.Delay(sensor=1, delay=0.3), cosim.Delay(sensor=0, delay=0.3)
    with pytest.warns(UserWarning, match="Sensor 1") as caught:
        slow_loop(every=1, faults=[late])
    assert str(caught[0].message) == (
        "Sensor 1 (y) is 0.3 s later than another sensor of its quantity, which the controller's model does not know: it may be "
        "blamed while the quantity changes. Give the controller the delays of its sensors in samples: "
        "design(sensor_delays=[0, 3]), or model.with_delays."
    )
    recwarn.clear()
    slow_loop(every=1, faults=[late, other])
    slow_loop(every=1, faults=[cosim.Delay(sensor=1, delay=0.3, start=1.0)])
    model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1).with_delays(0, [0, 3])
    given = {"control": "u", "measured": "y", "reference": 1.0, "sensors": cosim.Sensors(2, 0.2)}
    plant = cosim.StateSpace(control.ss([[-1.0]], [[1.0]], [[1.0]], 0))
    cosim.closed_loop(plant, LQGController(model), faults=[late], **given)
    cosim.closed_loop(plant, LQGController(model), **given)
    assert not recwarn.list


def test_the_pauses_of_a_healthy_slow_sensor_are_no_dropouts():
    result = slow_loop().simulate(100.0, seed=1)
    assert result["controller.fault_probability"][:, 1].max() < 0.5
    assert len(result.findings()) == 0


@pytest.mark.parametrize(
    ("loss", "used"), [((0.01, 0.9), (0.01, 0.9)), ((0.2, 0.2), (0.2, 0.84)), ((0.01, 0.8), (0.01, 0.8))]
)
def test_a_loss_that_counts_the_pauses_is_kept(loss, used):
    assert slow_loop(loss=loss)["controller"].block.precision.loss == pytest.approx(used)


def test_a_loop_without_slow_sensors_does_not_change():
    assert slow_loop(every=1)["controller"].block.precision == SwitchingPrecision()


def test_slow_sensors_beside_a_controller_of_its_own_rate():
    loop = slow_loop(every=(2, 20), dt=0.025)  # the controller runs every four steps
    assert loop["controller"].block.precision.loss == pytest.approx((0.01, 1.0 - 0.99 / 5))
    samples = ~np.isnan(loop.simulate(2.0)["sensors.y"][::4])
    assert samples.sum(axis=0).tolist() == [21, 5]
    with pytest.raises(cosim.ConnectionError, match=r"every=6 for sensor 1, but the controller runs every 4 steps"):
        slow_loop(every=(1, 6), dt=0.025)


def test_a_sensor_of_many_signals_has_its_number_as_name():
    signals = ["x", "a", "b", "c"]
    plant = control.ss(0.9 * np.eye(4), np.eye(4)[:, :1], np.eye(4), 0, 0.1, inputs=["u"], outputs=signals)
    model = LinearModel(0.9 * np.eye(4), np.eye(4)[:, :1], np.ones((1, 4)), 1e-3, 0.01, dt=0.1)
    loop = cosim.closed_loop(
        cosim.StateSpace(plant), LQGController(model), control="u", measured=signals, reference=1.0,
        sensors=cosim.Sensors(1, 0.1, signals=4, matrix=np.ones((1, 4))),
    )  # fmt: skip
    assert [quantity.name for quantity in loop_signals(loop, loop.simulate(1.0)).quantities] == ["sensor 0"]


def designed_loop(**parts):
    """Return the loop of a plant of first order with two sensors, and the controller that `design` makes for it."""
    plant = control.ss([[-1.0]], [[1.0]], [[1.0]], 0, inputs=["u"], outputs=["y"])
    controller = controllers.design(plant, measured="y", actuated="u", sensors=2, sensor_std=0.1, dt=0.1)
    return cosim.closed_loop(
        plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), **{"reference": 0.0, **parts}
    )


@pytest.mark.parametrize(("delay", "late"), [(0.1, None), (0.13, "0.1"), (0.16, "0.2")])
def test_a_dead_time_between_two_steps_is_named(delay, late, recwarn):
    """A delay of 7 s at steps of 5 s became 5 s without a word, and margins were those of 5 s."""
    designed_loop(input_faults={"u": [cosim.Delay(delay=delay)]})
    said = [str(w.message) for w in recwarn]
    expected = f"'u_delay_0' delays by {late} s, not by {delay:g} s: a delay is a whole number of steps, here of 0.1 s."
    assert [text for text in said if "whole number" in text] == ([expected] if late else [])


def test_references_are_no_mapping():
    with pytest.raises(ModelError, match="Give a list with a source for each goal"):
        designed_loop(reference={"y": 0.0})


def test_noise_that_is_listed_signal_by_signal_for_sensors_in_turn_is_warned_of():
    """A position sensor got the noise of a current sensor, and the other way round."""
    plant = control.ss(np.diag([0.9, 0.99]), [[0.1], [0.1]], np.eye(2), 0, 0.1, inputs=["u"], outputs=["x", "w"])

    def warnings_of(std, count=4):
        C = np.tile(np.eye(2), (2, 1)) if count == 4 else np.repeat(np.eye(2), 2, axis=0)
        controller = LQGController(LinearModel(plant.A, plant.B, C, 1e-3, 0.01, dt=0.1), goal_on=[[1.0, 0.0]])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            cosim.closed_loop(
                plant, controller, control="u", measured=["x", "w"], sensors=cosim.Sensors(count, std), reference=1.0
            )
        return [str(each.message) for each in caught if "in turn" in str(each.message)]

    (said,) = warnings_of([0.002, 0.002, 5.0, 5.0])
    assert said.startswith("With count=4 the sensors read the 2 signals in turn, but std=[0.002, 0.002, 5.0, 5.0]")
    assert said.endswith("If they do, give count=(2, 2).")
    assert not warnings_of([0.002, 5.0, 0.002, 5.0])
    assert not warnings_of([0.1, 0.1, 0.5, 0.5])  # a pair of good sensors and a pair of poor ones
    assert not warnings_of([0.002, 5.0], count=(2, 2))


def test_a_controller_of_ones_own_with_a_measurement_matrix_needs_no_model(make_block):
    ports = {"inputs": [cosim.Port("y", (2,)), cosim.Port("goal", (1,))], "outputs": [cosim.Port("u", (1,))]}

    def zero(y, u):
        u[0] = 0.0 * y[0]

    block = make_block(**ports, output=zero)
    own = type("Own", (type(block),), {"measurement_matrix": np.ones((2, 1))})()
    plant = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"])
    late = [cosim.Delay(sensor=1, delay=0.3)]
    with pytest.warns(UserWarning, match="Sensor 1"):
        cosim.closed_loop(
            plant, own, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), reference=1.0, faults=late, dt=0.1
        )
