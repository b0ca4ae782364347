"""Loops compared with the same seeds, against runs made one by one and SciPy's paired t-test."""

from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest
from scipy import stats

from bayesftc import controllers, cosim
from bayesftc.controllers import SERFDI, FixedPrecision
from bayesftc.cosim.comparison.pairing import alike
from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals

MODEL = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
SYSTEM = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)
FAULT = cosim.Bias(sensor=0, magnitude=3.0, start=2.0, stop=4.0)


def loop_of(precision, **options):
    settings = {
        "control": "u", "measured": "y", "sensors": cosim.Sensors(2, 0.2), "faults": [FAULT],
        "reference": cosim.Sine(amplitude=1.0, period=3.0),
    }  # fmt: skip
    plant = cosim.StateSpace(SYSTEM, process_noise=[[1e-3]])
    controller = controllers.LQGController(MODEL, precision=precision, goal_covariance=0.01)
    return cosim.closed_loop(plant, options.pop("controller", controller), **settings | options)


def pid_about(rest):
    """A PID controller of the mean, with its control at rest as a source inside."""
    inside = cosim.Diagram(dt=0.1)
    mean = inside.add(cosim.Gain([[0.5, 0.5]]), "mean")
    pid = inside.add(controllers.PID(1.0, integral_gain=0.5), "pid")
    offset, total = inside.add(cosim.Constant(rest), "rest"), inside.add(cosim.Sum(), "total")
    inside.connect(mean["y"], pid["x_hat"])
    inside.connect([pid["u"], offset["y"]], total["u"])
    return cosim.Subsystem(inside, inputs={"y": "mean.u", "goal": "pid.goal"}, outputs={"u": "total.y"})


@pytest.fixture(scope="module")
def compared():
    loops = {"fixed": loop_of(FixedPrecision()), "SER": loop_of(SERFDI())}
    return cosim.compare(loops, duration=5.0, seeds=[3, 1, 4, 15, 9])


def test_the_table_is_that_of_runs_made_one_by_one(compared):
    errors, alarms = {}, {}
    for name, precision in {"fixed": FixedPrecision(), "SER": SERFDI()}.items():
        loop = loop_of(precision)
        found = [
            figures(loop_signals(loop, loop.simulate(5.0, seed=seed, engine="interpreted")))
            for seed in (3, 1, 4, 15, 9)
        ]
        errors[name] = np.array([(each.tracking["y"].overall, each.tracking["y"].during) for each in found])
        alarms[name] = np.mean([[s.false_alarm_rate for s in each.sensors] for each in found])
    fixed, ser = (compared.table.iloc[i] for i in (0, 1))
    assert list(compared.table["loop"]) == ["fixed", "SER"]
    for row, name in ((fixed, "fixed"), (ser, "SER")):
        assert (row["runs"], row["failed"]) == (5, 0)
        assert [row["error"], row["error_in_faults"]] == pytest.approx(errors[name].mean(axis=0))
        assert row["false_alarm_rate"] == pytest.approx(alarms[name], nan_ok=True)
    for k, ending in enumerate(("", "_in_faults")):
        t = stats.ttest_rel(errors["SER"][:, k], errors["fixed"][:, k])
        interval = t.confidence_interval(0.95)
        found = [ser[f"{name}{ending}"] for name in ("difference", "low", "high")]
        assert found == pytest.approx([(errors["SER"] - errors["fixed"])[:, k].mean(), interval.low, interval.high])
        assert ser[f"wins{ending}"] == (errors["SER"] < errors["fixed"])[:, k].sum()
        assert ser[f"pairs{ending}"] == 5
        assert np.isnan(fixed[f"difference{ending}"])


def test_loops_have_the_same_noise_and_faults(compared):
    one, other = (compared.loops[name].simulate(2.0, seed=3, engine="interpreted") for name in ("fixed", "SER"))
    for result in (one, other):
        noise = result["sensors.y"] - result["plant.y"][:, None]
        np.testing.assert_allclose(noise, one["sensors.y"] - one["plant.y"][:, None], atol=1e-12)


def test_a_comparison_is_shown_as_its_table(compared):
    lines = [line.split() for line in repr(compared).splitlines()]
    assert lines[0] == list(compared.table["loop"])
    shown = {line[0]: line[1:] for line in lines[2:]}
    np.testing.assert_allclose(list(map(float, shown["error"])), compared.table["error"], rtol=1e-3)
    assert len(shown["wins"]) == len(lines[0]) - 1  # the first loop has no difference to itself
    assert "<table" in compared._repr_html_()


def test_the_figure_has_medians_reference_and_faults(compared):
    figure = compared.plot()
    (axis,) = figure.axes
    lines = {line.get_label(): line for line in axis.lines}
    assert set(lines) == {"fixed", "SER", "reference"}
    runs = [
        compared.loops["SER"].simulate(5.0, seed=seed, engine="interpreted")["plant.y"] for seed in (3, 1, 4, 15, 9)
    ]
    np.testing.assert_allclose(lines["SER"].get_ydata(), np.median(runs, axis=0), atol=1e-12)
    (shade,) = axis.images
    np.testing.assert_array_equal(np.asarray(shade.get_array())[0] > 0, (np.arange(51) >= 20) & (np.arange(51) < 40))
    assert axis.get_ylim()[0] < -1.0
    assert axis.get_ylabel() == "y"


def with_failed(compared, *seeds):
    """Return the comparison as if the runs of "fixed" with these seeds had failed."""
    runs, dataset = compared.runs.copy(), compared.result.dataset.copy(deep=True)
    failed = ((runs["loop"] == "fixed") & runs["seed"].isin(seeds)).to_numpy()
    runs.loc[failed, "status"] = "failed"
    runs.loc[failed, [name for name in runs if name.startswith(("tracking.", "sensors."))]] = np.nan
    dataset["status"] = dataset["status"].dims, np.where(failed, "failed", dataset["status"].values)
    return replace(compared, result=SimpleNamespace(table=runs, dataset=dataset))


@pytest.mark.parametrize(("seeds", "interval"), [([1, 4], True), ([3, 1, 4], False)])
def test_runs_that_failed_are_named_and_more_than_half_leave_no_interval(compared, seeds, interval):
    some = with_failed(compared, *seeds)
    ser = some.table.iloc[1]
    assert ser["pairs"] == 5 - len(seeds)
    assert np.isfinite([ser["low"], ser["high"], ser["low_in_faults"]]).tolist() == [interval] * 3
    assert np.isfinite(ser["difference"])
    text = f"{len(seeds)} runs of fixed failed. Errors are those of the other runs"
    assert text in repr(some)
    assert text in some._repr_html_()
    figure = some.plot()
    assert figure.get_suptitle().startswith("Median of the runs that did not fail")
    (axis,) = figure.axes
    assert {line.get_label() for line in axis.lines} == {f"fixed\n({5 - len(seeds)} of 5 runs)", "SER", "reference"}


def test_a_loop_of_which_all_runs_failed_is_in_the_legend(compared):
    (axis,) = with_failed(compared, 3, 1, 4, 15, 9).plot().axes
    assert "fixed\n(0 of 5 runs)" in axis.get_legend_handles_labels()[1]
    assert "failed" not in repr(compared).splitlines()[-1]
    assert compared.plot().get_suptitle().startswith("Median of 5 runs")


REFUSED = [
    ({"a": loop_of(FixedPrecision())}, "at least two loops by name"),
    ({"a": loop_of(FixedPrecision()), "b": 3}, "give a mapping from names"),
    (
        {"a": loop_of(FixedPrecision()), "b": cosim.Diagram(0.1)},
        "and 'b' does not. A comparison needs the same faults",
    ),
    ({"a": cosim.Diagram(0.1), "b": cosim.Diagram(0.1)}, "A closed loop has one controller"),
    ({"a": loop_of(SERFDI()), "b": loop_of(SERFDI(), sensors=cosim.Sensors(2, 0.3))}, "'sensors' has other settings"),
    (
        {"a": loop_of(SERFDI()), "b": loop_of(SERFDI(), faults=[])},
        r"The loop 'a' has the block 'bias_0' \(Bias\), and ",
    ),
    ({"a": loop_of(SERFDI()), "b": loop_of(SERFDI(), reference=1.0)}, "'reference' has other settings"),
    ({"a": loop_of(SERFDI()), "b": loop_of(SERFDI(), dt=0.05)}, "run at 0.1 s and 0.05 s"),
]


def test_a_lost_loop_does_not_squeeze_the_others():
    system = control.ss([[0, 1], [20, 0]], [[0], [1]], [[1, 0]], 0, inputs=["force"], outputs=["gap"])

    def loop(**settings):
        controller = controllers.design(
            system, dt=0.01, measured="gap", actuated="force", sensors=2, sensor_std=2e-3, noise={"force": 0.1},
            acceptable_error=0.01, acceptable_control=1.0, **settings,
        )  # fmt: skip
        return cosim.closed_loop(
            system, controller, control="force", measured="gap", sensors=cosim.Sensors(2, 2e-3), reference=0.02,
            faults=cosim.Drift(sensor=0, start=1.0, slope=0.3),
        )  # fmt: skip

    compared = cosim.compare({"default": loop(), "filter": loop(precision=FixedPrecision())}, duration=3.0, seeds=3)
    axis = compared.plot().axes[0]
    assert compared.table["error"][1] > 10 * compared.table["error"][0]
    assert axis.get_ylim()[1] - axis.get_ylim()[0] < 0.05
    assert any(each.get_text().startswith("filter cut off: ") for each in axis.texts)


@pytest.mark.parametrize(("loops", "sentence"), REFUSED, ids=[sentence for _, sentence in REFUSED])
def test_what_is_no_pair_is_refused(loops, sentence):
    with pytest.raises(BayesFTCError, match=sentence):
        cosim.compare(loops, duration=1.0, seeds=2)


def test_sources_inside_a_controller_may_differ():
    loops = {"LQG": loop_of(FixedPrecision()), "PID": loop_of(FixedPrecision(), controller=pid_about(0.0))}
    loops["about 1"] = loop_of(FixedPrecision(), controller=pid_about(1.0))
    compared = cosim.compare(loops, duration=5.0, seeds=3)
    assert compared.table["failed"].tolist() == [0, 0, 0]
    assert compared.table["pairs"].tolist()[1:] == [3, 3]


def with_preview(preview, **options):
    controller = controllers.LQGController(MODEL, precision=FixedPrecision(), goal_covariance=0.01, preview=preview)
    return loop_of(FixedPrecision(), controller=controller, **options)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("lengths", [(0, 3), (3, 0), (3, 5)])
def test_previews_of_one_reference_are_compared_with_the_present_goal(lengths):
    compared = cosim.compare({str(n): with_preview(n) for n in lengths}, duration=5.0, seeds=[3, 1])
    assert compared.table["pairs"].tolist()[1:] == [2]
    drawn = compared.signals(str(lengths[1]))[0]
    np.testing.assert_allclose(drawn.quantities[0].reference, np.sin(2.0 * np.pi * drawn.time / 3.0), atol=1e-12)
    for i, n in enumerate(lengths):
        runs = [with_preview(n).simulate(5.0, seed=seed, engine="interpreted") for seed in (3, 1)]
        errors = [np.sqrt(np.mean((run["plant.y"] - run["reference.y"]) ** 2)) for run in runs]
        assert compared.table["error"][i] == pytest.approx(np.mean(errors), rel=1e-9)
    noise = [
        loop.simulate(5.0, seed=3)["sensors.y"] - loop.simulate(5.0, seed=3)["plant.y"][:, None]
        for loop in map(with_preview, lengths)
    ]
    np.testing.assert_allclose(*noise, atol=1e-12)


def test_previews_of_other_references_are_refused():
    sine, other = cosim.Sine(amplitude=1.0, period=3.0), cosim.Sine(amplitude=2.0, period=3.0)
    for one, two in ((0, 3), (3, 3)):
        loops = {"a": with_preview(one, reference=sine), "b": with_preview(two, reference=other)}
        with pytest.raises(ModelError, match="'reference' has other settings in the loop 'b'"):
            cosim.compare(loops, duration=1.0, seeds=2)


@pytest.mark.parametrize("seeds", [1, [7], np.array([7])])
def test_one_seed_has_no_interval(seeds):
    with pytest.raises(ModelError, match="compare has one seed; intervals and tests need at least two"):
        cosim.compare({"a": loop_of(FixedPrecision()), "b": loop_of(SERFDI())}, duration=1.0, seeds=seeds)


def test_another_seed_of_random_faults_is_the_same_in_each_loop():
    faults = [cosim.RandomFaults(mean_time_to_fault=1.0, mean_time_to_recovery=0.5)]
    loops = {"a": loop_of(FixedPrecision(), faults=faults), "b": loop_of(SERFDI(), faults=faults)}
    found = cosim.compare(loops, duration=3.0, seeds=3)
    (one, *_), (other, *_) = found.signals("a"), found.signals("b")
    np.testing.assert_array_equal(one.faulty, other.faulty)
    assert found.table["error_in_faults"].notna().any()


def test_settings_are_alike_whatever_they_are_made_of():
    def measure(u, clean):
        clean[0] = u[0]

    def scaled(gain):
        def function(u, clean):
            clean[0] = gain * u[0]

        return function

    assert alike(scaled(2.0), scaled(2.0))
    assert not alike(scaled(2.0), scaled(3.0))
    one = cosim.Sensors(1, function=measure, bias=[0.5])
    assert alike(one, cosim.Sensors(1, function=measure, bias=(0.5,)))
    assert not alike(one, cosim.Sensors(1, function=measure, bias=[0.6]))
    assert not alike(one, cosim.Gain(2.0))
    assert alike(np.array([1.0, np.nan]), np.array([1.0, np.nan]))
    assert not alike({"a": 1.0}, {"a": 1.0, "b": 2.0})


def test_plants_of_other_names_are_refused():
    model = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["level"])
    other = cosim.closed_loop(
        cosim.StateSpace(model), controllers.LQGController(MODEL, goal_covariance=0.01), control="u", measured="level",
        sensors=cosim.Sensors(2, 0.2), faults=[FAULT], reference=cosim.Sine(amplitude=1.0, period=3.0),
    )  # fmt: skip
    first = loop_of(SERFDI(), faults=[FAULT])
    with pytest.raises(ModelError, match="The loop 'a' has the block 'plant' "):
        cosim.compare({"a": first, "b": other}, duration=1.0, seeds=2)


def around(controller, scale):
    """A subsystem around a controller that scales its samples and scales them back: the same but for rounding."""
    inside = cosim.Diagram(dt=0.1)
    there, back = inside.add(cosim.Gain(scale * np.eye(2)), "there"), inside.add(cosim.Gain(np.eye(2) / scale), "back")
    law = inside.add(controller, "law")
    inside.connect(there["y"], back["u"])
    inside.connect(back["y"], law["y"])
    return cosim.Subsystem(inside, inputs={"y": "there.u", "goal": "law.goal"}, outputs={"u": "law.u"}, goals=["y"])


def test_rounding_is_no_win_and_a_subsystem_around_a_controller_is_one_controller():
    """The inner block was counted as a second controller, and 6 of 6 runs were won by 1e-15."""
    loop = loop_of(FixedPrecision())
    same = loop_of(FixedPrecision(), controller=around(loop.nodes[-1].block, 3.0))
    table = cosim.compare({"block": loop, "subsystem": same}, duration=5.0, seeds=4).table
    row = table.iloc[1]
    assert row["error"] == pytest.approx(table.iloc[0]["error"], rel=1e-12)
    assert (row["difference"], row["low"], row["high"], row["wins"], row["pairs"]) == (0, 0, 0, 0, 4)


def difference(y, goal, u):
    u[0] = goal[0] - y[1]


class Own(cosim.Block):
    """A law of a user for one goal, with sensors of two quantities."""

    inputs = (cosim.Port("y", (2,)), cosim.Port("goal", (1,)))
    outputs = (cosim.Port("u", (1,)),)
    goal_names = ("v",)

    def define(self, step):
        return cosim.Definition(difference)


def test_a_block_of_ones_own_says_by_goal_names_what_its_goal_is_for():
    system = control.ss([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]], np.eye(2), 0, 0.1, inputs=["u"], outputs=["x", "v"])
    loop = cosim.closed_loop(
        system, Own(), control="u", measured=["x", "v"], dt=0.1, sensors=cosim.Sensors(2, 0.1, signals=2), reference=1.0
    )
    result = loop.simulate(2.0, seed=1)
    tracking = figures(loop_signals(loop, result)).tracking
    assert tracking["v"].overall == pytest.approx(np.sqrt(np.mean((result["plant.v"] - 1.0) ** 2)), rel=1e-9)
    assert np.isnan(tracking["x"].overall)
