"""Every run of a campaign is the run that `simulate` makes alone, whatever happens to those beside it."""

import pickle
import warnings

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.base import announcing
from bayesftc.cosim.campaign.designs.plan import Plan
from bayesftc.cosim.run.many import StoppedFromOutside

MODEL = controllers.LinearModel(
    [[0.99]], [[0.0002]], [[1.0], [1.0]], process_covariance=1e-3, sensor_covariance=np.eye(2), dt=0.02
)


def loop(plant=None, precision=None, faults=None):
    """An FMU, noise and a random fault: all that has a state of its own, or numbers of its own."""
    return cosim.closed_loop(
        plant=plant or cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controller=controllers.BayesianController(MODEL, precision=precision or controllers.GammaPrecision()),
        control="force",
        measured="v",
        reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
        sensors=cosim.Sensors(count=2, std=1.0),
        faults=faults or [cosim.Injection(magnitude=5.0, mean_time_to_fault=0.5, mean_time_to_recovery=0.5)],
        noise={"disturbance": cosim.Gaussian(std=0.03)},
    )


SIGNALS = ["plant.v", "controller.precision", "injection_0.*"]


def assert_alone(campaign, result, runs, same_bits):
    """Each run has the bits of the same diagram and seed alone."""
    points, seeds = campaign.job.plan.of_runs()
    for run in runs:
        diagram = campaign.job.diagram(int(points[run]))
        alone = diagram.simulate(campaign.job.duration, seed=int(seeds[run]), record=SIGNALS)
        assert int(seeds[run]) == result.table["seed"][run]
        for name in alone:
            same_bits(result.dataset[name][run].values, alone[name], name)


def test_same_bits_as_single_runs_at_every_point(same_bits):
    grid = {
        "controller.precision": {"gamma": controllers.GammaPrecision(), "fixed": controllers.FixedPrecision()},
        "injection_0.magnitude": [2.0, 10.0],
        "plant.m": [90.0, 120.0],
    }
    campaign = cosim.Campaign(loop(), duration=4.0, grid=grid, seeds=5, record=SIGNALS, piece=7)
    result = campaign.run()
    assert len(result.table) == campaign.runs == 40
    assert_alone(campaign, result, range(0, 40, 3), same_bits)
    table = result.table
    assert (table["status"] == "ok").all()
    assert (table["steps"] == 200).all()
    assert table["factor:controller.precision"].tolist() == ["gamma"] * 20 + ["fixed"] * 20
    assert table["plant.m"][5] == 120.0
    # A point differs from another in nothing but its factors: the noise is shared.
    faults = result.dataset["injection_0.active"].values
    assert np.array_equal(faults[:5], faults[20:25])
    assert result.dataset["plant.v"].attrs["units"] == "m/s"


def test_metrics_are_what_numpy_says(same_bits):
    def last(result):
        return result["plant.v"][-1]

    metrics = [
        cosim.RMSE("plant.v", "reference.y", shift=1),
        cosim.MaxAbsoluteError("plant.v", 20.0, name="largest"),
        cosim.MeanAbsoluteError("plant.v", "reference.y", start=1.0, stop=3.0),
        cosim.Mean("controller.precision[1]"),
        cosim.Final("plant.v"),
        last,
        cosim.LoopFigures(only=["tracking.*", "sensors.0.auc"]),
    ]
    lacking = set(cosim.METRICS) - {type(metric) for metric in metrics}
    assert not lacking, (
        f"add {', '.join(cls.__name__ for cls in lacking)} to metrics above, and a formula to expected below"
    )
    campaign = cosim.Campaign(loop(), duration=4.0, seeds=4, metrics=metrics, record=["plant.v"], decimation=4)
    table = campaign.run().table
    for run in range(4):
        r = campaign.replay(run)
        v, goal = r["plant.v"], r["reference.y"]
        expected = {
            "rmse(plant.v)": np.sqrt(np.mean((v[1:] - goal[:-1]) ** 2)),
            "largest": np.abs(v - 20.0).max(),
            "mean_absolute(plant.v)": np.abs(v - goal)[50:150].mean(),
            "mean(controller.precision[1])": r["controller.precision"][:, 1].mean(),
            "final(plant.v)": v[-1],
            "last": v[-1],
        }
        for name, value in expected.items():
            assert table[name][run] == pytest.approx(value, rel=1e-12), name
        from bayesftc.cosim.judging.metrics import figures
        from bayesftc.cosim.judging.roles import loop_signals

        alone = figures(loop_signals(campaign.job.diagram(0), r))
        assert table["tracking.v.overall"][run] == alone.tracking["v"].overall
        assert table["sensors.0.auc"][run] == alone.sensors[0].auc


def test_the_figures_of_a_loop_are_all_that_a_run_has():
    from bayesftc.cosim.judging.metrics import figures, without_nan
    from bayesftc.cosim.judging.roles import loop_signals

    def flat(value, path=()):
        if isinstance(value, dict | list):
            for key, item in value.items() if isinstance(value, dict) else enumerate(value):
                named = isinstance(value, list) and "name" in item
                yield from flat(item, (*path, item["name"] if named else key))
        elif not isinstance(value, str | int) and path[-1] not in {"ranked_by", "unit", "kind"}:
            yield ".".join(map(str, path)), value

    diagram = loop()
    campaign = cosim.Campaign(
        diagram, duration=4.0, seeds=3, metrics=[cosim.LoopFigures()], grid={"plant.m": [90.0, 1e-300]}
    )
    table = campaign.run(executor=cosim.Threads(1)).table
    names = [name for name in table.columns if "." in name and name != "plant.m"]
    for run in range(3):
        result = campaign.replay(run)
        expected = dict(flat(figures(loop_signals(campaign.job.diagram(0), result)).to_dict()))
        assert {name: without_nan(float(table[name][run])) for name in names} == expected
    assert (table["status"][3:] == "failed").all()
    assert table[names][3:].isna().all(axis=None)


def test_a_run_that_fails_is_recorded_with_its_reason_and_the_others_go_on(same_bits):
    grid = {"plant.m": [100.0, 1e-300, 120.0]}
    campaign = cosim.Campaign(
        loop(), duration=4.0, grid=grid, seeds=3, record=SIGNALS, metrics=[cosim.Final("plant.v")]
    )
    result = campaign.run()
    table = result.table
    failed = table["status"] == "failed"
    assert failed.any()
    assert set(table["point"][failed]) == {1}
    for run in table["run"][failed]:
        with pytest.raises(cosim.SimulationError) as caught:
            campaign.replay(int(run))
        alone = caught.value
        assert str(alone).startswith(table["reason"][run])
        assert table["reason"][run] == alone.result.stopped
        rows = table["steps"][run] + 1
        same_bits(result.dataset["plant.v"][run].values[:rows], alone.result["plant.v"])
        assert np.isnan(result.dataset["plant.v"][run].values[rows:]).all()
        assert np.isnan(table["final(plant.v)"][run])
    assert_alone(campaign, result, table["run"][~failed], same_bits)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("way", ["ERROR", "NOT_A_NUMBER", "FATAL"])
def test_an_fmu_that_fails_is_made_anew_for_the_next_run(lying, way, same_bits):
    path, ways = lying("2.0")
    plant = cosim.FMU(path, parameters={"v0": 20.0})
    b = cosim.FMU(path).start_value("b")
    campaign = cosim.Campaign(
        loop(plant),
        duration=1.0,
        grid={"plant.b": {"well": b, "badly": ways[way], "well again": b}},
        seeds=3,
        record=SIGNALS,
        piece=9,
    )
    result = campaign.run()
    assert (result.table["status"] == np.repeat(["ok", "failed", "ok"], 3)).all()
    assert_alone(campaign, result, [0, 1, 2, 6, 7, 8], same_bits)


def test_an_fmu_that_cannot_begin_fails_only_its_own_runs(lying):
    grid = {"plant.m": [100.0, float("nan"), 120.0]}
    campaign = cosim.Campaign(loop(), duration=0.1, grid=grid, seeds=2)
    table = campaign.run().table
    assert table["status"].tolist() == ["ok"] * 2 + ["failed"] * 2 + ["ok"] * 2
    assert "m" in table["reason"][2]


def test_an_fmu_that_does_not_repeat_itself_is_found_out(lying):
    path, ways = lying("2.0")
    plant = cosim.FMU(path, parameters={"v0": 0.0, "b": ways["REMEMBERS"]})
    # Few runs are not compared, but get new FMUs, if one run takes longer than making those for all, as on a busy machine.
    campaign = cosim.Campaign(loop(plant), duration=1.0, seeds=40, record=["plant.v"])
    with pytest.warns(RuntimeWarning, match="gives other results after its initial state"):
        table = campaign.run(executor=cosim.Threads(1)).table
    assert (table["status"] == "ok").all()


def test_samples_of_ranges_run_each_point_with_its_own_parameters(same_bits):
    design = cosim.LatinHypercube({"plant.m": (80.0, 120.0), "injection_0.magnitude": (0.0, 10.0)}, count=6, seed=2)
    campaign = cosim.Campaign(loop(), duration=1.0, grid=design, record=SIGNALS)
    result = campaign.run()
    assert len(set(result.table["plant.m"])) == 6
    assert_alone(campaign, result, range(6), same_bits)


def test_a_function_of_the_factors_makes_the_loop(same_bits):
    campaign = cosim.Campaign(
        lambda mass, learner: loop(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0, "m": mass}), learner),
        duration=1.0,
        grid={"mass": [90.0, 110.0], "learner": {"fixed": controllers.FixedPrecision()}},
        seeds=[5, 6],
        record=SIGNALS,
    )
    result = campaign.run()
    assert result.table["seed"].tolist() == [5, 6, 5, 6]
    assert_alone(campaign, result, range(4), same_bits)


def test_interpreted_loops_run_too(make_block, same_bits):
    calls = []

    def output(u, y):
        calls.append(1)
        y[0] = 2.0 * u[0]

    twice = make_block(
        inputs=(cosim.Port("u"),), outputs=(cosim.Port("y"),), output=output, compiled=False, name="twice"
    )
    diagram = cosim.Diagram(0.1)
    noise, node = diagram.add(cosim.Gaussian(1.0), "noise"), diagram.add(twice, "twice")
    diagram.connect(noise["y"], node["u"])
    result = cosim.Campaign(diagram, duration=1.0, seeds=3, record=["twice.y"]).run(executor=cosim.Threads(2))
    for run, seed in enumerate(result.table["seed"]):
        same_bits(result.dataset["twice.y"][run].values, diagram.simulate(1.0, seed=int(seed))["twice.y"])
    assert calls


def test_noise_is_independent_only_where_it_is_asked_for():
    grid = {
        "controller.precision": {"a": controllers.FixedPrecision(), "b": controllers.GammaPrecision()},
        "plant.m": [90.0, 95.0],
    }
    paired = cosim.Campaign(loop(), duration=0.1, grid=grid, seeds=3)
    assert len(set(paired.job.plan.seeds)) == 1
    own = cosim.Campaign(loop(), duration=0.1, grid=grid, seeds=3, independent=["plant.m"])
    seeds = own.job.plan.seeds
    assert seeds[0] == seeds[2] != seeds[1] == seeds[3]
    assert not set(seeds[0]) & set(seeds[1])


def test_seeds_of_independent_points_never_meet():
    from bayesftc.cosim.campaign.designs.seeds import seeds_of_points

    texts = [{"a": "x/y", "b": "z"}, {"a": "x", "b": "y/z"}, {"a": "1", "b": "z"}, {"a": 1, "b": "z"}]
    crc32s = [{"a": "plumless", "b": ""}, {"a": "buckeroo", "b": ""}]  # of which CRC-32 is the same
    for labels, names in ((texts, ["a", "b"]), (crc32s, ["a"])):
        seeds = seeds_of_points(labels, 10, 0, names)
        assert len({seed for own in seeds for seed in own}) == 10 * len(labels)
        assert seeds == seeds_of_points(labels[::-1], 10, 0, names)[::-1]
    assert seeds_of_points(texts, 3, 1, ["a"]) != seeds_of_points(texts, 3, 2, ["a"])


def test_time_limit_is_a_reason(make_block):
    campaign = cosim.Campaign(loop(), duration=20_000.0, seeds=2, time_limit=0.06)
    table = campaign.run(executor=cosim.Threads(1)).table
    assert (table["status"] == "failed").all()
    assert table["reason"].str.contains("time limit of 0.06 s").all()


def test_the_hint_about_progress_can_be_followed(monkeypatch, caplog, capsys):
    monkeypatch.setattr(announcing, "PATIENCE", 0.0)
    campaign = cosim.Campaign(loop(), duration=1.0, seeds=30, piece=5)
    loops = {"gamma": loop(), "fixed": loop(precision=controllers.FixedPrecision())}
    for call in (campaign.run, lambda **more: cosim.compare(loops, duration=1.0, seeds=3, **more)):
        caplog.clear()
        call()
        hint = next(message for message in caplog.messages if "Making" in message)
        assert "give progress=print," in hint
        call(progress=print)
        done, of, failed = map(int, capsys.readouterr().out.split()[-3:])
        assert (done, failed) == (of, 0)


def test_progress_counts_runs_and_a_run_can_be_stopped_from_outside():
    campaign = cosim.Campaign(loop(), duration=1.0, seeds=30, piece=5)
    told = []
    campaign.run(progress=lambda *counts: told.append(counts))
    assert told[0] == (0, 30, 0)
    assert [done for done, *_ in told] == list(range(0, 31, 5))
    with pytest.raises(StoppedFromOutside):
        campaign.job.run(campaign.job.plan.pieces[0], lambda: False)


def test_a_job_that_travels_makes_the_same_runs(same_bits):
    job = cosim.Campaign(loop(), duration=1.0, seeds=3, record=SIGNALS, metrics=[cosim.Final("plant.v")]).job
    copy = pickle.loads(pickle.dumps(job))
    here, there = (j.run(j.plan.pieces[0]) for j in (job, copy))
    job.close()
    copy.close()
    for name in here.signals:
        same_bits(here.signals[name], there.signals[name])
    same_bits(here.metrics["final(plant.v)"], there.metrics["final(plant.v)"])


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=8), st.integers(1, 12))
def test_pieces_have_each_run_once(counts, size):
    seeds, n = [], 0
    for count in counts:
        seeds.append(tuple(range(n, n + count)))
        n += count
    plan = Plan(tuple({} for _ in counts), tuple(seeds), size)
    points, drawn = plan.of_runs()
    assert plan.runs == n
    seen = []
    for piece in plan.pieces:
        own = [(point, seed) for point, few in plan.groups(piece) for seed in few]
        assert len(own) == len(piece) <= size
        seen += own
    assert seen == list(zip(points.tolist(), drawn.tolist(), strict=True))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {"controler.precision": [1.0]}}, "did you mean 'controller'"),
        ({"grid": {"controller.precison": [1.0]}}, "has no setting 'precison'; did you mean 'precision'"),
        ({"grid": {"plant.mass": [1.0]}}, "has no variable 'mass'"),
        ({"grid": {"injection_0": [3.0]}}, "is a whole block"),
        ({"grid": {"controller": {"none": cosim.Constant(1.0)}}}, "cannot replace 'controller'"),
        ({"grid": {"injection_0.magnitude[0]": [1.0]}}, r"there is no element \[0\]"),
        (
            {"grid": {"injection_0.start": ["late"]}},
            "Injection has start='late'; it must be seconds, a condition",
        ),
        ({"grid": {"sensors.count": [3]}}, "has size 3 instead of 2. To change sizes, write a function"),
        ({"grid": {"controller.model.dt": [0.04]}}, "must run every 0.04 s, but the diagram runs it every 0.02 s"),
        ({"seeds": 0}, "at least one run"),
        ({"seeds": [1, 1]}, "one twice"),
        ({"seeds": "many"}, "must be the number of runs"),
        ({"independent": ["mass"], "grid": {"plant.m": [1.0]}}, "no factor; .*plant.m"),
        ({"record": ["plant.x"]}, "no signal 'plant.x'"),
        ({"metrics": ["rmse"]}, "'rmse' is no metric"),
        ({"metrics": [cosim.RMSE("plant.x", "reference.y")]}, "no signal 'plant.x'"),
        ({"metrics": [cosim.Final("plant.v")] * 2}, "Two metrics are called"),
        ({"metrics": [cosim.RMSE("plant.*")]}, "'plant.\\*' is a pattern"),
        ({"metrics": [cosim.RMSE("controller.x_hat[1]")]}, r"has the shape \(1,\), and no element \[1\]"),
        ({"metrics": [cosim.RMSE("plant.v[0]")]}, r"has the shape \(\), and no element \[0\]"),
        ({"metrics": [cosim.RMSE("sensors.y[0")]}, "not a signal or an element of one"),
        ({"metrics": [cosim.RMSE("sensors.y", "plant.v")]}, r"has the shape \(2,\) and 'plant.v' \(\)"),
        ({"metrics": [cosim.Final("sensors.y")]}, r"several; name an element, such as 'sensors.y\[0\]'"),
        ({"metrics": [cosim.Final("plant.v", name="status")]}, "A metric is called 'status', which is not allowed"),
        (
            {"metrics": [cosim.LoopFigures(only=["sensor.*"])]},
            "which matches no figure; the figures are tracking.v.overall",
        ),
        ({"duration": 0.03}, "duration"),
        ({"decimation": 0}, "decimation"),
        ({"piece": 0}, "piece"),
        ({"time_limit": 0.0}, "time_limit is 0.0; it must be a number of seconds, above 0"),
        ({"time_limit": "1 s"}, "time_limit is '1 s'"),
        ({"record": 3}, "no signal '3'"),
    ],
)
def test_what_cannot_be_is_told_before_anything_runs(changes, message):
    with pytest.raises(cosim.BayesFTCError, match=message):
        cosim.Campaign(loop(), **{"duration": 1.0, **changes})


def test_a_whole_block_takes_the_place_of_another_one():
    base = loop()
    other = cosim.varied(base, {"injection_0": cosim.Drift(sensor=1, slope=2.0, start=1.0)})
    assert other["injection_0"].block.channels == 2
    assert base["injection_0"].block != other["injection_0"].block
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (other.simulate(2.0)["injection_0.active"][-1] == 1.0).all()


def test_faults_and_learner_follow_the_rates_of_sensors():
    base = loop(precision=controllers.SwitchingPrecision())
    for start, every, loss in ((base, (1, 1), 0.01), (base, (10, 1), 0.901)):
        changed = cosim.varied(start, {"sensors.every": every})
        assert changed["injection_0"].block.spacing == every[0]
        assert np.broadcast_to(changed["controller"].block.precision.loss, 2)[0] == pytest.approx(loss)
        for other, share in (((4, 1), 1.0 - 0.99 / 4), ((1, 1), 0.01)):  # of a loop that knows other rates
            back = cosim.varied(changed, {"sensors.every": other})
            assert back["injection_0"].block.spacing == other[0]
            assert np.broadcast_to(back["controller"].block.precision.loss, 2)[0] == pytest.approx(share)


def test_a_delay_that_a_factor_makes_no_multiple_of_a_sample_time_is_warned_of():
    base = loop(faults=[cosim.Delay(sensor=0, delay=0.06)])
    with pytest.warns(UserWarning, match=r"'delay_0' delays sensor 0 by 0\.06 s.*every 0\.1 s"):
        cosim.varied(base, {"sensors.every": (5, 1)})


def test_what_is_inside_of_another_factor_is_changed_after_it():
    whole, part = "controller.precision", "controller.precision.forgetting"
    for order in ([whole, part], [part, whole]):
        values = {whole: controllers.GammaPrecision(forgetting=0.5, prior_shape=3.0), part: 0.7}
        precision = cosim.varied(loop(), {name: values[name] for name in order})["controller"].block.precision
        assert (precision.forgetting, precision.prior_shape) == (0.7, 3.0)
    plant = cosim.FMU(fmus.path("CruiseControl", fmi="3.0"))
    changed = cosim.varied(loop(), {"plant.m": 90.0, "plant": plant, "plant.parameters.v0": 3.0})["plant"].block
    assert (changed.path, changed.parameters) == (plant.path, {"m": 90.0, "v0": 3.0})


def test_settings_that_fit_only_together_change_together():
    changed = cosim.varied(loop(), {"injection_0.start": 20.0, "injection_0.stop": 30.0})
    back = cosim.varied(changed, {"injection_0.start": 1.0, "injection_0.stop": 2.0})["injection_0"].block
    assert (back.start, back.stop) == (1.0, 2.0)
    values = {"controller.model.A[0,0]": 0.5, "controller.model.B": [[1.0]], "controller.initial_mean": 3.0}
    block = cosim.varied(loop(), values)["controller"].block
    assert (block.model.A[0][0], block.model.B[0][0], block.initial_mean) == (0.5, 1.0, 3.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"signal": 3}, "signal=3; it must be a text"),
        ({"shift": -1}, "shift=-1; it must be a whole number"),
        ({"shift": 1.5}, "shift=1.5"),
        ({"start": "early"}, "start='early'; it must be a number"),
        ({"stop": float("nan")}, "stop=nan"),
        ({"reference": [1.0]}, "it must be a number, or a signal"),
    ],
)
def test_what_a_metric_cannot_be_is_told_when_it_is_made(settings, message):
    with pytest.raises(cosim.errors.ModelError, match=message):
        cosim.RMSE(**{"signal": "plant.v", **settings})


TIMES = st.sampled_from([None, *(k / 10 for k in range(-2, 14)), *(0.1 * k for k in range(12)), 0.25, 0.449])


@settings(max_examples=60, deadline=None)
@given(TIMES, TIMES, st.integers(0, 12))
def test_metrics_are_of_the_times_that_they_say(start, stop, shift):
    from fractions import Fraction

    from bayesftc.cosim.campaign.runs.metrics import Runs

    values, other = np.random.default_rng(1).normal(size=(2, 3, 11))
    runs = Runs(None, np.arange(11) / 10, {"y": values, "r": other}, list, 3)
    metric = cosim.Mean("y", "r", shift=shift, start=start, stop=stop)
    begin, end = (None if t is None else Fraction(t).limit_denominator(1000) for t in (start, stop))
    rows = [
        k for k in range(shift, 11)
        if (begin is None or Fraction(k, 10) >= begin) and (end is None or Fraction(k, 10) < end)
    ]  # fmt: skip
    expected = [
        np.mean([y[k] - r[k - shift] for k in rows]) if rows else np.nan for y, r in zip(values, other, strict=True)
    ]
    np.testing.assert_allclose(metric.evaluate(runs)["mean(y)"], expected, rtol=1e-12)


def test_what_does_not_fit_into_memory_is_told_before_anything_runs(monkeypatch):
    monkeypatch.setattr("bayesftc.cosim.campaign.outcomes.memory", lambda: 1e6)
    campaign = cosim.Campaign(loop(), duration=10.0, seeds=1000, record=["plant.v"])
    with pytest.raises(
        cosim.errors.ModelError, match=r"1000 runs take 0.00401 GB, more .* give run\(\) the folder of a store"
    ):
        campaign.run(progress=lambda *told: pytest.fail("It has begun."))


def test_few_runs_are_for_all_cores_as_well():
    campaign = cosim.Campaign(loop(), duration=0.1, seeds=np.arange(64))
    assert [len(piece) for piece in campaign.job.plan.pieces] == [2] * 32


def test_an_fmu_is_made_once_for_all_pieces_of_a_point(monkeypatch, same_bits):
    from bayesftc.cosim.run import many

    made = []
    usual = many.open_run
    monkeypatch.setattr(many, "open_run", lambda *given: made.append(1) or usual(*given))
    campaign = cosim.Campaign(loop(), duration=0.1, seeds=6, piece=1, record=SIGNALS)
    result = campaign.run(executor=cosim.Threads(1))
    assert len(made) == 1
    assert_alone(campaign, result, range(6), same_bits)


def test_signals_of_more_rows_than_any_memory_holds_are_refused(car, tmp_path):
    with pytest.raises(
        cosim.ModelError, match=r"Recording 1 numbers at 5\d+ steps takes 4e\+06 GB, more than this machine has"
    ):
        cosim.Campaign(car(), duration=1e13, record=["plant.v"]).run(tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_a_part_of_what_is_not_set_cannot_be_changed():
    system = control.nlsys(lambda t, x, u, params: -x + u, lambda t, x, u, params: x, inputs=1, outputs=1, states=1)
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.StateSpace(system), "plant")
    with pytest.raises(cosim.ModelError, match=r"plant\.params is not set in the loop\. Give it there"):
        cosim.varied(diagram, {"plant.params.tau": 2.0})
