"""The report of a campaign: its numbers beside those of pandas, SciPy and scikit-learn, its form, and campaigns of all kinds."""

import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
pytest.importorskip("jinja2", reason="reports need the extra 'campaign'")

from bayesftc import cosim
from bayesftc.cosim.base.numbers import with_half
from bayesftc.cosim.campaign.designs.plan import FAILED, OK, Outcome, Plan
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.cosim.errors import StoreError
from bayesftc.report import comparisons
from bayesftc.report.bands import error_bands
from bayesftc.report.contents import Contents
from bayesftc.report.detection import alarm_table, reliability_figure, roc_figure
from bayesftc.report.grids import over_grid
from bayesftc.report.page import report
from bayesftc.report.scores import read_detection

ROWS = 60
TIME = np.arange(ROWS) * 0.5
LOOP = {
    "duration": "29.5 s",
    "step": "1/2 s",
    "metrics": [{"kind": "RMSE", "signal": "plant.v", "reference": "reference.y", "shift": 1}],
    "roles": {"controller": "controller", "faults_of_sensors": [["freeze_0"], []]},
}
VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """What stands on a page: tables by heading, text, and what is wrong with its form."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.wrong, self.ids, self.elsewhere = [], [], [], []
        self.tables, self.headings, self.text, self.cell = {}, [], [], None
        self.feed(text)
        self.close()
        self.wrong += [f"{tag} is not closed" for tag in self.open]

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.ids += [attributes["id"]] if "id" in attributes else []
        for name in ("src", "href", "xlink:href", "action"):
            value = attributes.get(name) or "#"
            if not value.startswith(("#", "data:image/png;base64,")):
                self.elsewhere.append(value)
        if tag in VOID:
            return
        self.open.append(tag)
        if tag == "table":
            self.tables[self.headings[-1] if self.headings else ""] = []
        if tag == "tr":
            list(self.tables.values())[-1].append([])
        if tag in {"td", "th", "h1", "h2", "summary"}:
            self.cell = []

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(f"</{tag}> ends something else")
        if tag in {"td", "th"}:
            list(self.tables.values())[-1][-1].append("".join(self.cell))
        if tag in {"h1", "h2", "summary"}:
            self.headings.append("".join(self.cell))

    def handle_data(self, data):
        if "style" not in self.open:
            self.text.append(data)
        if self.cell is not None:
            self.cell.append(data)

    @property
    def words(self):
        return re.sub(r"\s+", " ", " ".join(self.text))


def read(text):
    """Return a page, after its form has been checked."""
    page = Page(text)
    assert not page.wrong, page.wrong
    assert len(page.ids) == len(set(page.ids))
    assert not page.elsewhere
    assert not re.search(r"@import|url\((?!#)", text)
    for target in re.findall(r'(?:href="#|url\(#)([^")]+)', text):
        assert target in page.ids
    return page


@pytest.fixture
def stored(tmp_path):
    """Return a function that writes a campaign with these points, seeds and numbers into a store."""

    def stored(points, seeds, metrics, signals=None, *, said=LOOP, failed=(), size=7, pieces=None, units=None):
        own = (
            tuple(tuple(each) for each in seeds) if not isinstance(seeds, int) else (tuple(range(seeds)),) * len(points)
        )
        plan = Plan(tuple(points), own, size)
        values = {name: np.where(np.isin(np.arange(plan.runs), failed), np.nan, v) for name, v in metrics.items()}
        signals = signals or {}
        known = {name: (array.shape[2:], "m/s" if array.ndim == 2 else None) for name, array in signals.items()}
        store = CampaignStore.create(tmp_path / "campaign", dict(said), plan, known, TIME, list(metrics), units=units)
        with store:
            for piece in plan.pieces[:pieces]:
                rows = slice(piece.begin, piece.end)
                bad = [run in failed for run in range(piece.begin, piece.end)]
                store.write(
                    Outcome(
                        piece,
                        {name: array[rows] for name, array in values.items()},
                        {name: array[rows] for name, array in signals.items()},
                        tuple(FAILED if b else OK for b in bad),
                        tuple("The plant gave <NaN> & stopped." if b else "" for b in bad),
                        np.where(bad, 3, ROWS - 1),
                        0.25,
                    )
                )
            if pieces is None:
                store.finish()
        return CampaignStore.open(tmp_path / "campaign")

    return stored


def grid(**factors):
    """Return all combinations of the values of factors, the last one changing fastest."""
    return list(cosim.Grid(factors).points())


def noisy(points, seeds, effect, scatter=0.3, seed=0):
    """Return a number for each run: its point's effect, noise of its seed, and a little of its own."""
    rng = np.random.default_rng(seed)
    common = rng.normal(size=seeds)
    return np.concatenate([effect(p) + scatter * common + 0.05 * rng.normal(size=seeds) for p in points])


PRECISIONS = grid(mass=[80.0, 100.0], precision=["fixed", "gamma", "switching"])
LEVEL = {"fixed": 3.0, "gamma": 1.0, "switching": 0.9}


def precisions(stored, seeds=12, **options):
    values = noisy(PRECISIONS, seeds, lambda p: LEVEL[p["precision"]] + p["mass"] / 100)
    return stored(PRECISIONS, seeds, {"rmse": values}, **options)


# Numbers


def test_means_are_those_of_pandas_and_their_intervals_students(stored):
    from scipy import stats

    store = precisions(stored)
    page = read(report(store))
    head, *rows = page.tables["Results"]
    assert head == ["mass", "precision", "runs", "rmse"]
    assert len(rows) == 6
    cells = store.table().groupby(["mass", "precision"])["rmse"]
    for mass, precision, runs, text in rows:
        values = cells.get_group((float(mass), precision))
        half = stats.t.interval(0.95, len(values) - 1, values.mean(), stats.sem(values))[1] - values.mean()
        assert (runs, text) == ("12", with_half(values.mean(), half))


def test_levels_are_compared_over_all_points_as_seeds_have_them(stored):
    """Over points with the same seeds the paired test of the means of each seed is the right one; SciPy has it."""
    from scipy import stats

    store = precisions(stored)
    table = store.table().pivot_table(index="seed", columns="precision", values="rmse")
    page = read(report(store))
    head, *rows = page.tables["Comparison"]
    assert head == ["precision", "combinations", "pairs of runs", "difference of rmse", "p"]
    for pair, combinations, runs, difference, p in rows:
        first, second = pair.split(" − ")
        test = stats.ttest_rel(table[first], table[second])
        half = test.confidence_interval(1 - 0.05 / 3)[1] - (table[first] - table[second]).mean()
        assert (combinations, runs) == ("2", "24")
        assert difference == with_half((table[first] - table[second]).mean(), half)
        corrected = min(1.0, 3 * test.pvalue)
        assert p == ("< 0.001" if corrected < 0.001 else f"{corrected:.3f}")
    # And in each combination, as Holm corrects all of them.
    head, *rows = page.tables["Comparison in each combination"]
    runs = store.table().set_index(["mass", "precision", "seed"])["rmse"]
    tests, apart = {}, {}
    for mass, pair, *_ in rows:
        first, second = pair.split(" − ")
        tests[mass, pair] = stats.ttest_rel(runs[float(mass), first], runs[float(mass), second])
        apart[mass, pair] = (runs[float(mass), first] - runs[float(mass), second]).mean()
    order = sorted(tests, key=lambda key: tests[key].pvalue)
    worst, corrected = 0.0, {}
    for i, key in enumerate(order):
        worst = max(worst, min(1.0, (len(order) - i) * tests[key].pvalue))
        corrected[key] = worst
    for mass, pair, difference, _, p in rows:
        assert p == ("< 0.001" if corrected[mass, pair] < 0.001 else f"{corrected[mass, pair]:.3f}")
        half = tests[mass, pair].confidence_interval().high - apart[mass, pair]
        assert difference == with_half(apart[mass, pair], half)


@pytest.mark.slow
def test_an_interval_over_points_with_the_same_seeds_covers_and_one_that_counts_runs_would_not():
    """Drawn again and again: the mean over 10 points, of runs whose seeds are all the same, strays as seeds do."""
    import pandas as pd

    from bayesftc.cosim.statistics import summary
    from bayesftc.report.pooling import pooled

    rng = np.random.default_rng(1)
    points, seeds = np.repeat(np.arange(10), 8), np.tile(np.arange(8), 10)
    truth, covered, naive = np.arange(10).mean(), 0, 0
    for _ in range(1000):
        values = points + rng.normal(size=8)[seeds] + 0.2 * rng.normal(size=80)
        found = pooled(values, points, seeds, np.zeros(80, int))
        covered += abs(found.value - truth) < found.half()
        own = summary(pd.DataFrame({"m": values - points}), "m").iloc[0]  # even without the points' own differences
        naive += own["low"] < 0 < own["high"]
    assert 930 <= covered <= 970
    assert naive < 700


def test_points_with_noise_of_their_own_count_each_by_itself():
    from scipy import stats

    from bayesftc.report.pooling import apart, pooled

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=6), 3.0 + 2.0 * rng.normal(size=6)
    whole = pooled(np.concatenate([a, b]), np.repeat([0, 1], 6), np.arange(12), np.repeat([0, 1], 6))
    variance = a.var(ddof=1) / 6 + b.var(ddof=1) / 6
    assert whole.error == pytest.approx(variance**0.5 / 2)
    test = stats.ttest_ind(a, b, equal_var=False)
    found = apart(*(pooled(v, np.zeros(6, int), np.arange(6), np.zeros(6, int)) for v in (a, b)))
    assert whole.freedom == pytest.approx(test.df)
    assert (found.freedom, found.p) == pytest.approx((test.df, test.pvalue))


def test_an_interval_of_a_positive_metric_does_not_reach_below_zero():
    from bayesftc.report.pooling import pooled
    from bayesftc.report.tables import NUMBER, mean_text

    def mean(*values):
        return pooled(np.array(values), np.zeros(len(values), int), np.arange(len(values)), np.zeros(len(values), int))

    skewed, near = mean(0.01, 0.02, 0.9), mean(0.5, 0.52, 0.51)
    assert skewed.bounds() == pytest.approx((skewed.value - skewed.half(), skewed.value + skewed.half()))
    assert skewed.bounds()[0] < 0
    assert skewed.bounds(positive=True) == (0.0, skewed.bounds()[1])
    assert near.bounds(positive=True) == near.bounds()
    assert np.isnan(mean(0.5).bounds(positive=True)).all()
    text = mean_text(skewed, positive=True)
    assert text == f"{skewed.value:.4g} (0 to {skewed.bounds()[1]:.2g})"
    assert NUMBER.fullmatch(text)
    assert "±" in mean_text(skewed)


def detected(score, seed=0, points=PRECISIONS, seeds=3):
    """Return signals of a loop, in which the first of two sensors has a fault from the 30th row on."""
    rng = np.random.default_rng(seed)
    runs = len(points) * seeds
    active = np.tile(np.arange(ROWS) >= 30, (runs, 1)).astype(float)
    both = np.stack([active, 0 * active], axis=2)
    rank = score(both, rng)
    reference = np.tile(np.sin(TIME), (runs, 1))
    return {
        "plant.v": reference + 0.1 * rng.normal(size=(runs, ROWS)),
        "reference.y": reference,
        "freeze_0.active": active,
        "sensor_faulty": both,
        "sensor_missing": 0 * both,
        "controller.beta": np.exp(rank),
        "controller.fault_probability": 1.0 / (1.0 + np.exp(-rank)),
    }, both


@pytest.mark.usefixtures("undrawn")
def test_areas_under_the_curve_are_those_of_scikit_learn(stored):
    from sklearn.metrics import roc_auc_score

    signals, truth = detected(lambda both, rng: 2.0 * both - 1.0 + rng.normal(size=both.shape))
    store = precisions(stored, seeds=3, signals=signals)
    contents = Contents(store)
    made, caption = roc_figure(contents, read_detection(contents))
    table = alarm_table(contents, read_detection(contents))
    assert "controller.fault_probability, in all 6 complete runs of each" in caption
    assert "dotted: detection by chance" in caption
    marks = [line for line in made.axes[1].get_lines() if line.get_markersize() > 5]
    assert len(marks) == 3
    assert not any(mark.get_clip_on() for mark in marks)  # a delay of 0 is at the edge of the panel
    labels = [line.get_label() for line in made.axes[0].get_lines()]
    precision = contents.table["precision"].to_numpy()
    for level in LEVEL:
        own = precision == level
        area = roc_auc_score(truth[own].ravel() > 0, signals["controller.fault_probability"][own].ravel())
        (label,) = (each for each in labels if each.startswith(f"{level}: "))
        found, low, high = map(float, re.findall(r"\d\.\d+", label))
        assert found == round(area, 3)
        assert low < found < high
        said = {row[1]: row[2:] for row in table.rows if row[0] == level}
        probability, faulty = signals["controller.fault_probability"][own], truth[own]
        alarms = [
            cosim.judge_alarms(p, f > 0, threshold=0.5, step=0.5) for p, f in zip(probability, faulty, strict=True)
        ]
        pooled = sum(alarms[1:], alarms[0])
        assert said["all"][1] == f"{pooled.missed_share:.1%}"
        assert said["all"][2:4] == [f"{0.5 * pooled.delay(q):.3g}" for q in (0.5, 0.9)]
        assert said["all"][4] == f"{(probability[faulty > 0] >= 0.5).mean():.1%}"
        assert said["all"][5] == f"{pooled.false_share:.2%}"
        for i, (p, f) in enumerate(zip(probability.transpose(2, 0, 1), faulty.transpose(2, 0, 1), strict=True)):
            (of_sensor,) = (row for name, row in said.items() if name.split()[0] == str(i))
            assert of_sensor[5] == f"{((p >= 0.5) & ~(f > 0)).sum() / (~(f > 0)).sum():.2%}"
    assert "Open mark: a fault probability of 0.5." in caption
    assert {"Detection", "Reliability"} <= set(read(report(store)).headings)


def test_a_level_without_probabilities_is_ranked_by_beta_and_one_without_either_is_named(stored):
    signals, _ = detected(lambda both, rng: 2.0 * both + rng.normal(size=both.shape))
    precision = np.repeat([p["precision"] for p in PRECISIONS], 3)
    signals["controller.fault_probability"][precision != "switching"] = np.nan
    signals["controller.beta"][precision == "fixed"] = 1.0
    contents = Contents(precisions(stored, seeds=3, signals=signals))
    found = read_detection(contents)
    names = {level: own.score_name for level, own in found.levels.items()}
    assert names == {"gamma": "controller.beta", "switching": "controller.fault_probability"}
    made, caption = roc_figure(contents, found)
    assert "fixed has no curves: the controller gives no fault probability." in caption
    # A level looks the same wherever it is drawn.
    bands, _ = error_bands(contents)
    colours = {line.get_label(): line.get_color() for line in bands.axes[0].get_lines()}
    drawn = {line.get_label().split(" ")[0]: line.get_color() for line in made.axes[0].get_lines()}
    assert all(drawn[level] == colours[level] for level in found.levels)
    made, _ = reliability_figure(contents, found)
    assert len(made.axes[0].get_legend_handles_labels()[1]) == 1


def judged_loop(fault):
    """Return a loop whose sensors 0 and 1 may fail."""
    import control

    from bayesftc import controllers

    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    return cosim.closed_loop(
        cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)),
        controllers.BayesianController(model, precision=controllers.SwitchingPrecision()),
        control="u", measured="y", sensors=cosim.Sensors(2, 0.2), faults=[fault], reference=1.0,
    )  # fmt: skip


FAULTS = {
    "first": cosim.Injection(sensor=0, start=3.0, stop=6.0, magnitude=3.0),
    "second": cosim.Freeze(sensor=1, start=2.0, stop=6.0),
    "short": cosim.Dropout(sensor=1, start="reference.y > 0.5", duration=0.1),
    "burst": cosim.Injection(sensor=1, start=2.0, stop=2.1, magnitude=0.01),
}


def test_each_point_is_judged_by_its_own_faults_as_in_the_table_of_runs(tmp_path):
    """The sensor, the kind, the start and the name of the fault differ from point to point."""
    from bayesftc.cosim.statistics import delay_curve

    campaign = cosim.Campaign(
        judged_loop, duration=8.0, seeds=4, grid={"fault": FAULTS}, record=["controller.fault_probability"],
        metrics=[cosim.LoopFigures()],
    )  # fmt: skip
    table = campaign.run(tmp_path / "judged").table
    contents = Contents(CampaignStore.open(tmp_path / "judged"))
    found = read_detection(contents)
    seen = table.groupby("fault")[["sensors.0.seen_as_missing", "sensors.1.seen_as_missing"]].sum().sum(axis=1)
    assert seen.to_dict() == {"first": 0, "second": 0, "short": 4, "burst": 0}
    assert found.without == {"short": "all faults (4) are seen as missing samples, which need no detector"}
    for level, own in found.levels.items():
        rows = table[table["fault"] == level]
        at = delay_curve(own.score, own.truth, step=0.1, thresholds=[0.5]).iloc[0]
        missed = rows[["sensors.0.missed", "sensors.1.missed"]].sum().sum()
        assert at["missed_share"] * at["faults"] == pytest.approx(missed)
        assert missed == (4 if level == "burst" else 0)
        healthy = 1.0 - rows[["sensors.0.fault_share", "sensors.1.fault_share"]].to_numpy()
        alarms = rows[["sensors.0.false_alarm_rate", "sensors.1.false_alarm_rate"]].to_numpy() * healthy
        assert at["false_share"] == pytest.approx(alarms.sum() / healthy.sum())
    caption = roc_figure(contents, found)[1]
    assert "short has no curves: all faults (4) are seen as missing samples, which need no detector." in caption


def test_faults_that_are_seen_as_missing_samples_are_counted_apart(stored):
    signals, _ = detected(lambda both, rng: 6.0 * both - 3.0 + 0.1 * rng.normal(size=both.shape))
    signals["sensor_faulty"][:, 10:12, 1] = signals["sensor_missing"][:, 10:12, 1] = (
        1.0  # a dropout of the other sensor
    )
    signals["sensor_missing"][:, 30:33, 0] = 1.0  # the fault begins with missing samples, and is seen after them
    contents = Contents(precisions(stored, seeds=3, signals=signals))
    found = read_detection(contents)
    assert {(*each.seen_as_missing, len(each.seeds)) for each in found.levels.values()} == {(0, 6, 6)}
    caption = roc_figure(contents, found)[1]
    table = alarm_table(contents, found)
    assert ["gamma", "all", "6", "0.0%", "0", "0", "100.0%", "0.00%", "6"] in table.rows
    assert [row[-1] for row in table.rows if row[0] == "gamma"] == ["6", "0", "6"]
    assert table.columns[-1] == "seen as missing samples"
    assert table.note.startswith("Alarms: a fault probability of 0.5 or more.")
    assert "it is neither detected nor missed, as in the table of runs." in caption


def test_a_slow_sensor_is_blamed_also_between_its_samples(stored):
    """The share was that of the samples alone; the table of runs counts all steps, as others may blame the sensor in between."""
    signals, _ = detected(lambda both, rng: 6.0 * both - 3.0 + 0.1 * rng.normal(size=both.shape))
    signals["sensor_missing"][:, np.arange(ROWS) % 5 > 0, 1] = 1.0
    signals["controller.fault_probability"][:, [*range(11, 15), *range(21, 23)], 1] = 0.9
    contents = Contents(precisions(stored, seeds=3, signals=signals))
    rows = alarm_table(contents, read_detection(contents)).rows
    healthy = ROWS - int((signals["sensor_faulty"][0, :, 0] > 0).sum())
    assert [row[7] for row in rows if row[0] == "gamma"] == [f"{6 / (ROWS + healthy):.2%}", "0.00%", f"{6 / ROWS:.2%}"]


def test_a_level_without_curves_has_its_reason(stored):
    signals, _ = detected(lambda both, rng: both + rng.normal(size=both.shape))
    precision = np.repeat([p["precision"] for p in PRECISIONS], 3)
    signals["sensor_faulty"][precision == "gamma"] = 0.0
    failed = np.flatnonzero(precision == "fixed")
    contents = Contents(precisions(stored, seeds=3, signals=signals, failed=failed))
    caption = roc_figure(contents, read_detection(contents))[1]
    assert "fixed has no curves: all runs failed. gamma has no curves: no sensor has a fault." in caption


def test_a_level_whose_true_faults_are_not_known_is_not_judged(stored):
    signals, _ = detected(lambda both, rng: both + rng.normal(size=both.shape))
    unknown = np.repeat([p["precision"] for p in PRECISIONS], 3) == "gamma"
    signals["sensor_faulty"][unknown] = signals["sensor_missing"][unknown] = np.nan
    found = read_detection(Contents(precisions(stored, seeds=3, signals=signals)))
    assert set(found.levels) == {"fixed", "switching"}
    assert found.without == {
        "gamma": "the diagram is no closed loop with sensors, so that their true faults are not known"
    }


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("score", "said"),
    [
        (np.nan, "There are no figures of detection: the controller gives no fault probability."),
        (0.0, "There are no figures of detection: the fault probability is 0 in all samples."),
    ],
)
def test_a_campaign_that_cannot_be_judged_says_why(stored, score, said):
    signals, both = detected(lambda both, rng: 0.0 * both, points=[{}])
    signals["controller.fault_probability"] = np.full_like(both, score)
    assert said in read(report(stored([{}], 3, {"rmse": np.ones(3)}, signals))).words


def test_of_many_runs_some_are_drawn_at_random_and_the_page_says_how_many(stored, monkeypatch):
    monkeypatch.setattr("bayesftc.report.scores.RUNS", 4)
    signals, _ = detected(lambda both, rng: 2.0 * both + rng.normal(size=both.shape))
    contents = Contents(precisions(stored, seeds=3, signals=signals))
    found = read_detection(contents)
    assert {len(own.seeds) for own in found.levels.values()} == {4}
    assert "in 4 of 6 complete runs of each, drawn at random" in roc_figure(contents, found)[1]


def test_runs_without_a_probability_count_in_no_figure_of_detection(stored):
    signals, _ = detected(lambda both, rng: 2.0 * both + rng.normal(size=both.shape))
    signals["controller.fault_probability"][::3] = (
        np.nan
    )  # those of one seed, as of a factor with a learner that has none
    signals["controller.beta"][:] = np.nan
    contents = Contents(precisions(stored, seeds=3, signals=signals))
    found = read_detection(contents)
    assert {(len(own.seeds), own.of) for own in found.levels.values()} == {(4, 6)}
    assert "in 4 of 6 complete runs of each; the others have no such number" in roc_figure(contents, found)[1]


def test_bands_are_the_quantiles_of_the_runs(stored):
    signals, _ = detected(lambda both, rng: rng.normal(size=both.shape))
    signals["plant.v"][5, 20:] = np.nan  # of a run that stops
    contents = Contents(precisions(stored, seeds=3, signals=signals, failed=(5,)))
    made, caption = error_bands(contents)
    error = np.abs(signals["plant.v"][:, 1:] - signals["reference.y"][:, :-1])
    precision = contents.table["precision"].to_numpy()
    (axis,) = made.axes
    assert axis.get_ylabel() == "|plant.v error| (m/s)"
    for line, band in zip(axis.get_lines(), axis.collections, strict=True):
        own = error[precision == line.get_label()]
        np.testing.assert_allclose(line.get_xdata(), TIME[1:])
        np.testing.assert_allclose(line.get_ydata(), np.nanmedian(own, axis=0))
        edge = band.get_paths()[0].vertices[:, 1]
        low, high = np.nanquantile(own, [0.05, 0.95], axis=0)
        assert edge.min() == pytest.approx(low.min())
        assert edge.max() == pytest.approx(high.max())
    assert "|plant.v − reference.y| of 1 step before" in caption


def test_maps_show_each_mean_where_its_factors_say(stored):
    points = grid(mass=[120.0, 80.0], gain=[1, 2, 3], kind=["a", "b"])
    values = noisy(points, 4, lambda p: p["mass"] * p["gain"] + (p["kind"] == "b"))
    contents = Contents(stored(points, 4, {"rmse": values}))
    made, _ = over_grid(contents)
    mean = contents.table.groupby(["kind", "mass", "gain"])["rmse"].mean()
    maps = [axis for axis in made.axes if axis.images]
    assert [axis.get_title() for axis in maps] == ["a", "b"]
    for axis in maps:
        down, across = (
            [label.get_text() for label in labels] for labels in (axis.get_yticklabels(), axis.get_xticklabels())
        )
        assert (down, across) == (["80", "120"], ["1", "2", "3"])
        for text in axis.texts:
            j, i = map(int, text.get_position())
            assert text.get_text() == f"{mean[axis.get_title(), float(down[i]), int(across[j])]:.3g}"


def test_an_axis_of_a_metric_that_hardly_varies_has_short_labels_without_an_offset(stored):
    points = grid(slope=[0.1, 0.2])
    values = 2.8969 + 1e-6 * np.random.default_rng(1).normal(size=8)
    made, _ = over_grid(Contents(stored(points, 4, {"rmse": values})))
    (axis,) = [each for each in made.axes if each.get_ylabel() == "rmse"]
    made.canvas.draw()
    assert axis.yaxis.get_offset_text().get_text() == ""
    assert all(len(label.get_text()) <= 8 for label in axis.get_yticklabels())
    low, high = axis.get_ylim()
    assert high - low >= 2.8e-4


def test_units_stand_in_headings_at_axes_and_behind_numbers(stored):
    units = {"rmse": "m/s", "mass": "kg"}
    store = precisions(stored, units=units)
    page = read(report(store))
    assert page.tables["Results"][0] == ["mass (kg)", "precision", "runs", "rmse (m/s)"]
    assert page.tables["Comparison"][0][-2:] == ["difference of rmse (m/s)", "p"]
    assert page.tables["The 5 runs with the largest rmse, and the worst one of each precision"][0][1:4] == [
        *("mass (kg)", "precision", "rmse (m/s)")
    ]
    assert [row[0] for row in page.tables["Factors"][1:]] == ["mass (kg)", "precision"]
    numbers = re.findall(r"[\d.]+( \S+)? (?:on average|with )", " ".join(comparisons.sentences(Contents(store))))
    assert set(numbers) == {" m/s"}
    (axis,) = over_grid(Contents(store))[0].axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("mass (kg)", "rmse (m/s)")
    of_masses = Contents(store, compare="mass")
    assert of_masses.name(80.0) == "mass = 80 kg"
    assert "rmse is lowest with mass = 80 kg, " in " ".join(comparisons.sentences(of_masses))


# What is claimed


def test_the_first_sentence_says_what_the_tests_carry(stored):
    store = precisions(stored)
    text = read(report(store)).words
    mean = store.table().groupby("precision")["rmse"].mean()
    assert mean.idxmin() == "switching"
    assert f"rmse is lowest with precision = switching, {mean['switching']:.4g} on average. It is higher " in text
    (shown,) = re.findall(r"by ([\d.]+) ± [\d.]+ with gamma", text)
    exact = mean["gamma"] - mean["switching"]
    assert shown == f"{exact:.{len(shown.partition('.')[2])}f}"
    assert re.search(r"It is higher by [\d.]+ ± [\d.]+ with gamma and by [\d.]+ ± [\d.]+ with fixed\.", text)
    assert (
        "The difference of switching and gamma is tested at each of the 2 values of mass (level 5 %, corrected for several "
        "tests)." in text
    )
    assert "switching is significantly lower at 2 of these 2." in text


def test_no_difference_is_claimed_that_noise_may_have_made(stored):
    points = grid(mass=[80.0, 100.0], precision=["a", "b"])
    values = np.random.default_rng(3).normal(size=4 * 8)
    text = read(report(stored(points, 8, {"rmse": values}))).words
    assert re.search(r"but not certainly: [ab] − [ab] is [\d.]+, with a 95 % interval from -[\d.]+ to [\d.]+", text)
    assert "It is higher" not in text


def test_levels_that_agree_in_every_run_are_the_same(stored):
    values = np.tile(np.random.default_rng(3).normal(size=8), 4)
    text = read(report(stored(grid(mass=[80.0, 100.0], precision=["a", "b"]), 8, {"rmse": values}))).words
    assert re.search(r"on average, the same as with (precision = )?[ab] in every run\.", text)
    assert "not certainly" not in text


@pytest.mark.slow
def test_false_claims_are_as_rare_as_they_say(stored):
    """Of campaigns whose levels do not differ, one in twenty at most says that they do."""
    from types import SimpleNamespace

    import pandas as pd

    from bayesftc.report.levels import pair, ranked

    rng, claims = np.random.default_rng(5), 0
    table = pd.DataFrame({"point": np.repeat(np.arange(6), 8), "seed": np.tile(np.arange(8), 6)})
    table["level"] = table["point"] % 3
    for _ in range(120):
        table["m"] = rng.normal(size=8)[table["seed"]] + rng.normal(size=48)
        contents = SimpleNamespace(
            metric="m", combinations=table["point"].to_numpy() // 3, seed_lists=np.zeros(6, int), levels=lambda: [0, 1, 2],
            runs_of=lambda level: table[table["level"] == level],
        )  # fmt: skip
        order = [level for level, _ in ranked(contents)]
        claims += any(pair(contents, level, order[0], 3).certain for level in order[1:])
    assert claims <= 13  # 6 are expected at most, and more than 13 in one case of 250


def test_levels_at_points_of_their_own_are_not_compared(stored):
    points = [{"kind": "a", "mass": 1.0}, {"kind": "b", "mass": 2.0}]
    text = read(report(stored(points, 4, {"rmse": noisy(points, 4, lambda p: p["mass"])}))).words
    assert "The levels have no point in common" in text
    assert "Comparison" not in text


def test_levels_with_noise_of_their_own_are_compared_as_independent(stored):
    from scipy import stats

    points, values = grid(kind=["a", "b"]), np.random.default_rng(4).normal(size=20)
    values[10:] += 3.0
    page = read(report(stored(points, (range(10), range(100, 110)), {"rmse": values})))
    ((_, _, _, difference, p),) = page.tables["Comparison"][1:]
    test = stats.ttest_ind(values[:10], values[10:], equal_var=False)
    mean = values[:10].mean() - values[10:].mean()
    assert difference == with_half(mean, test.confidence_interval().high - mean)
    assert p == ("< 0.001" if test.pvalue < 0.001 else f"{test.pvalue:.3f}")
    assert "independent runs" in page.words


def test_one_seed_tells_nothing_of_noise(stored):
    points = grid(kind=["a", "b"], mass=[1.0, 2.0])
    page = read(report(stored(points, 1, {"rmse": noisy(points, 1, lambda p: 1.0 + (p["kind"] == "b"))})))
    assert "with one seed this may be noise" in page.words
    assert all("±" not in cell for row in page.tables["Results"] for cell in row)


@pytest.mark.parametrize("learner", ["controller.precision", "controller", "precision"])
def test_learners_are_compared_before_faults(stored, learner):
    points = grid(**{"faults[0]": ["slip", "stuck"], "slope": [1.0, 2.0], learner: ["fixed", "switching"]})
    contents = Contents(stored(points, 2, {"rmse": noisy(points, 2, lambda p: 1.0)}))
    assert contents.compared == learner
    assert Contents(contents.store, compare="faults[0]").compared == "faults[0]"


def test_a_number_of_a_learner_does_not_come_before_names(stored):
    points = grid(**{"faults[0]": ["slip", "stuck"], "controller.precision": [1.0, 2.0]})
    assert Contents(stored(points, 2, {"rmse": noisy(points, 2, lambda p: 1.0)})).compared == "faults[0]"


# Campaigns of all kinds


def test_failures_come_first_with_their_reason_and_are_counted_nowhere_else(stored):
    from scipy import stats

    store = precisions(stored, failed=(0, 1, 40))
    page = read(report(store))
    assert page.headings[1] == "3 of 72 runs failed"
    (row,) = page.tables["3 of 72 runs failed"][1:]
    assert row[:3] == ["3", "2", "The plant gave <NaN> & stopped."]
    assert row[3] == f"bayesftc replay {store.path} 0"
    first = page.tables["Results"][1]
    left = store.table()["rmse"][2:12]
    half = stats.t.ppf(0.975, 9) * stats.sem(left)
    assert first[2:4] == ["12", "2"]
    assert first[4] == f"{with_half(left.mean(), half)} (n = 10)"


def test_a_campaign_whose_runs_have_all_failed(stored):
    signals, _ = detected(lambda both, rng: rng.normal(size=both.shape))
    gone = {name: np.full_like(array, np.nan) for name, array in signals.items()}
    page = read(report(precisions(stored, seeds=3, failed=range(18), signals=gone)))
    assert "No run has a value of rmse." in page.words
    assert page.headings[1] == "18 of 18 runs failed"
    assert not {"Results", "Comparison", "Over time", "Detection"} & set(page.headings)


def test_a_campaign_that_is_not_whole_says_so_and_compares_what_has_its_like(stored):
    store = precisions(stored, pieces=5)
    page = read(report(store))
    assert "35 runs of 72 (the campaign is not complete yet)" in page.words
    ((_, *cells),) = (row for row in page.tables["Comparison"][1:] if row[0] == "gamma − switching")
    assert cells[:2] == ["1", "11"]


@pytest.mark.parametrize("runs", [1, 5])
def test_neither_factor_nor_metric_nor_signal(stored, runs):
    page = read(report(stored([{}], runs, {}, said={})))
    assert f"{runs} run{'s' if runs > 1 else ''} at 1 point." in page.words
    assert page.headings == ["campaign", "Settings"]


def test_no_factor(stored):
    from scipy import stats

    values = np.random.default_rng(0).normal(size=9) + 5.0
    words = read(report(stored([{}], 9, {"rmse": values}))).words
    half = stats.t.ppf(0.975, 8) * stats.sem(values)
    assert f"rmse is {with_half(values.mean(), half)} on average over 9 runs." in words


def test_a_metric_that_is_nan_here_and_there_or_everywhere(stored):
    values = noisy(PRECISIONS, 4, lambda p: 1.0)
    values[[0, 9, 17]] = np.nan
    values[2] = np.inf
    nothing = np.full(24, np.nan)
    store = stored(PRECISIONS, 4, {"rmse": nothing, "delay": values})
    page = read(report(store))
    assert "n = 2" in page.tables["Results"][1][-1]
    assert "delay is lowest" in page.words
    assert "No run has a value" not in page.words
    page = read(report(store, metric="rmse"))
    assert "No run has a value of rmse." in page.words
    assert page.tables["Results"][0][-1] == "delay"


@pytest.mark.slow
def test_two_hundred_levels(stored):
    points = grid(kind=[f"level {i}" for i in range(200)])
    store = stored(points, 3, {"rmse": noisy(points, 3, lambda p: int(p["kind"][6:]))}, size=100)
    read(report(store))  # too many to compare by themselves
    page = read(report(store, compare="kind"))
    assert "rmse is lowest with kind = level 0" in page.words
    assert len(page.tables["Comparison"]) == 2
    assert "With so many levels only the two with the lowest means are compared." in page.words
    assert len(page.tables["Results"]) == 61
    assert "140 further rows are left out here." in page.words


@pytest.mark.usefixtures("undrawn")
def test_points_that_fill_ranges(stored):
    design = cosim.LatinHypercube({"mass": (80.0, 120.0), "gain": (0.0, 1.0), "n": range(1, 100)}, 40)
    points = [dict(p) for p in design.labels()]
    values = noisy(points, 3, lambda p: p["mass"] / 100)
    contents = Contents(stored(points, 3, {"rmse": values}))
    made, _ = over_grid(contents)
    panels = [axis for axis in made.axes if axis.get_visible()]
    assert [axis.get_xlabel() for axis in panels] == ["mass", "gain", "n"]
    means = contents.table.groupby("mass")["rmse"].mean()
    (line,) = panels[0].get_lines()
    np.testing.assert_allclose(means[np.asarray(line.get_xdata())], line.get_ydata())
    read(report(contents.store))


HOSTILE = ["<script>alert('x')</script>", "\"quoted\" & 'so'", "$x_{1$ %", "_hidden", "漢字 ünï → 🚗", "a" * 120]


@pytest.mark.slow
def test_labels_are_texts_whatever_is_in_them(stored):
    points = grid(**{'a <b> & "c"': HOSTILE, "加": [1.0, 2.0]})
    signals, _ = detected(lambda both, rng: both + rng.normal(size=both.shape), points=points)
    values = noisy(points, 3, lambda p: 1.0)
    text = report(stored(points, 3, {"$\\error_{<i>": values}, signals), title="<b>Is it & 'safe'?</b>")
    page = read(text)
    assert "<script" not in text
    assert "<b>Is it & 'safe'?</b>" in page.headings[0]
    for label in HOSTILE:
        assert any(label in row for row in page.tables["Results"])


@pytest.mark.usefixtures("undrawn")
def test_a_factor_that_is_called_like_a_signal_or_a_column(stored):
    points = grid(**{"plant.v": [1.0, 2.0], "seed": [7, 8], "rmse": ["x", "y"]})
    signals, _ = detected(lambda both, rng: rng.normal(size=both.shape), points=points)
    store = stored(points, 3, {"rmse": noisy(points, 3, lambda p: p["plant.v"])}, signals)
    page = read(report(store))
    assert page.tables["Factors"][1:] == [
        ["factor:plant.v", "2", "1, 2"],
        ["factor:seed", "2", "7, 8"],
        ["factor:rmse", "2", "x, y"],
    ]
    assert page.tables["Comparison"][1][0] == "x − y"


@pytest.mark.usefixtures("undrawn")
def test_values_that_are_missing_or_true_and_false(stored):
    points = [{"on": on, "model": model} for on in (True, False) for model in (None, "large")]
    store = stored(points, 5, {"rmse": noisy(points, 5, lambda p: 1.0 + p["on"] + 2.0 * (p["model"] is None))})
    assert "rmse is lowest with on = False" in read(report(store)).words
    page = read(report(store, compare="model"))
    assert "rmse is lowest with model = large" in page.words
    assert page.tables["Comparison"][1][1:3] == ["2", "10"]


def test_signals_that_are_vectors_and_a_loop_without_a_controller(stored):
    rng = np.random.default_rng(0)
    signals = {"filter.x": rng.normal(size=(6, ROWS, 3)), "filter.P": rng.normal(size=(6, ROWS, 2, 2))}
    page = read(report(stored(grid(gain=[1.0, 2.0]), 3, {"m": rng.normal(size=6)}, signals, said={})))
    assert not {"Over time", "Detection"} & set(page.headings)
    assert ["recorded", "filter.x, filter.P"] in page.tables["Settings"]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_store_of_an_earlier_version_without_the_true_faults(stored, tmp_path):
    signals, _ = detected(lambda both, rng: rng.normal(size=both.shape))
    del signals["sensor_faulty"], signals["sensor_missing"]
    page = read(report(precisions(stored, seeds=3, signals=signals)))
    assert "this store is of an earlier version, which did not keep the true faults of the sensors." in page.words
    assert "Reliability" not in page.headings
    shutil.rmtree(tmp_path / "campaign")
    del signals["controller.fault_probability"], signals["controller.beta"]
    assert "Detection" not in read(report(precisions(stored, seeds=3, signals=signals))).headings


@pytest.mark.slow
def test_a_loop_of_which_beta_alone_was_recorded(stored):
    signals, _ = detected(lambda both, rng: both + rng.normal(size=both.shape))
    del signals["controller.fault_probability"]
    page = read(report(precisions(stored, seeds=3, signals=signals)))
    assert "Detection of sensor faults by controller.beta" in page.words
    assert "Reliability" not in page.headings


@pytest.mark.slow
def test_pages_of_one_store_are_the_same_bytes(stored):
    signals, _ = detected(lambda both, rng: both + rng.normal(size=both.shape))
    store = precisions(stored, seeds=3, signals=signals)
    assert report(store) == report(CampaignStore.open(store.path))


def test_nothing_done_yet_and_names_that_are_none(stored):
    store = precisions(stored, pieces=0)
    with pytest.raises(StoreError, match="no run yet"):
        report(store)
