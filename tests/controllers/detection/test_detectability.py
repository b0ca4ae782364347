"""Detectability of beta: its law against SciPy and simulation, each figure against the real loop; ``python`` prints the drill."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import GammaPrecision, LinearModel, detectability
from bayesftc.controllers.detection.beta_law import beta_law
from bayesftc.controllers.detection.estimator_runs import EstimatorRuns
from bayesftc.controllers.detection.passage import Passage
from bayesftc.controllers.detection.weighted_chi_square import (
    Weights,
    equal_weights,
    geometric_weights,
    quantile,
    tails,
)
from bayesftc.controllers.estimation.innovation import response, steady_covariance
from bayesftc.cosim import ops
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.stepping.batch_ops import OPERATIONS

CAR = LinearModel([[0.999]], [[2e-4]], [[1], [1]], process_covariance=1e-3, sensor_covariance=1.0, dt=0.02)
CART = LinearModel(
    [[1, 0.1], [0, 0.95]], [[0], [0.1]], [[1, 0], [1, 0], [0, 1]], [[1e-4, 0], [0, 1e-3]], [0.04, 0.09, 0.25], dt=0.1
)


def test_equal_weights_are_the_chi_square_distribution():
    from scipy.stats import chi2

    for count in (1, 2, 7, 64, 2000):
        for p in (1e-14, 1e-8, 1e-3, 0.2, 0.5):
            assert tails(chi2.isf(p, count), equal_weights(count))[1] == pytest.approx(p, rel=1e-9)
            assert tails(chi2.ppf(p, count), equal_weights(count))[0] == pytest.approx(p, rel=1e-9)


@pytest.mark.parametrize("ratio", [0.05, 0.95, 0.995])
def test_geometric_weights_by_octaves_are_all_of_them_one_by_one(ratio):
    weights = ratio ** np.arange(int(np.log(1e-9) / np.log(ratio)))
    every = Weights(weights, np.ones(len(weights)), 1 / (1 - ratio))
    for p in (1e-9, 0.4):
        x = quantile(p, geometric_weights(ratio))
        assert tails(x, every)[1] == pytest.approx(p, rel=1e-7)


def test_the_law_of_weighted_squares_against_the_integral_along_the_imaginary_axis():
    """Imhof's formula, integrated by SciPy."""
    from scipy.integrate import quad

    weights = 0.8 ** np.arange(60)
    for x in (2.0, 6.0, 15.0):

        def imhof(u, x=x):
            angle = 0.5 * np.arctan(weights * u).sum() - 0.5 * x * u
            return np.sin(angle) / (u * np.prod((1 + (weights * u) ** 2) ** 0.25))

        above = 0.5 + quad(imhof, 0, 60, limit=500)[0] / np.pi
        assert tails(x, geometric_weights(0.8))[1] == pytest.approx(above, abs=1e-6)


def test_passage_with_hardly_any_memory_is_a_geometric_distribution():
    threshold = 9.0
    from scipy.stats import ncx2

    p = ncx2.sf(threshold, 1, 4.0)
    assert Passage(1e-4, threshold).mean_delay(np.full(1, 2.0), np.ones(1), settles=True) == pytest.approx(
        1 / p - 1, rel=0.01
    )


def streams(ratio, threshold, moments, runs=40_000, seed=5):
    """Return the share of independent streams without an alarm up to each faulty sample, by simulation."""
    rng = np.random.default_rng(seed)
    x = np.zeros(runs)
    for _ in range(int(15 / (1 - ratio))):
        x = ratio * x + rng.standard_normal(runs) ** 2
    x = x[x <= threshold]
    started, shares = len(x), []
    for mean, variance in moments:
        x = ratio * x + (mean + variance**0.5 * rng.standard_normal(len(x))) ** 2
        x = x[x <= threshold]
        shares.append(len(x) / started)
    return np.array(shares)


@pytest.mark.parametrize("ratio", [0.9])
def test_passage_against_simulated_streams(ratio):
    threshold = quantile(1e-2, geometric_weights(ratio))
    k = np.arange(120.0)
    for means, variances in ((0 * k + 1.2, 0 * k + 1), (0.05 * k, 0 * k + 1), (0 * k, 0 * k + 2.5)):
        ours = Passage(ratio, threshold).survival(means, variances)
        assert np.abs(ours - streams(ratio, threshold, zip(means, variances))).max() < 0.012  # 4 standard errors


def test_false_alarms_begin_as_often_as_in_a_stream():
    from scipy.signal import lfilter

    squares = np.random.default_rng(2).standard_normal(2_000_000) ** 2
    for precision in (GammaPrecision(forgetting=0.9), GammaPrecision(window=10)):
        law = beta_law(precision, 1.0, 1.0, 1.0, 100, 0)
        law.set_threshold((False, 0.01))
        kernel = ([1.0] + [0.0] * 9 + [-1.0], [1.0, -1.0]) if precision.window else ([1.0], [1.0, -0.9])
        alarm = 2.0 + 0.5 * lfilter(*kernel, squares)[500:] > law.threshold
        assert alarm.mean() == pytest.approx(0.01, rel=0.05)
        assert law.onset_of_alarms == pytest.approx(np.count_nonzero(alarm[1:] & ~alarm[:-1]) / len(alarm), rel=0.05)
        threshold, rate = law.threshold, law.onset_of_alarms
        law.set_threshold((True, rate))
        assert law.threshold == pytest.approx(threshold, rel=1e-3)
        assert law.exceedance(law.threshold) == pytest.approx(0.01, rel=0.01)


def test_smallest_fault_is_found_as_often_as_asked_and_what_a_result_says_fits_together():
    result = detectability(
        GammaPrecision(forgetting=0.9), dt=0.1, sensor_variance=4.0, within=2.0, detection_probability=0.8
    )
    for kind in ("offset", "drift", "noise"):
        size = getattr(result, kind)
        assert result.probability(kind, size)[0] == pytest.approx(0.8, abs=2e-3)
        assert result.delay(kind, size)[0] == pytest.approx(getattr(result, f"{kind}_delay"))
        assert (np.diff(result.delay(kind, size * np.array([0.8, 1, 2, 4]))) < 0).all()
        assert f"{size:.4g}" in str(result)
    assert result.exceedance(result.threshold)[0] == pytest.approx(1e-3, rel=1e-9)
    unit = detectability(GammaPrecision(forgetting=0.9), within=20, detection_probability=0.8)
    assert result.threshold == pytest.approx(4 * unit.threshold, rel=1e-9)
    assert result.offset == pytest.approx(2 * unit.offset, rel=1e-3)
    assert result.drift == pytest.approx(20 * unit.drift, rel=1e-3)


def test_response_is_the_filters_own():
    """The mean innovations of the package's Kalman filter when the same offset is added to one of its sensors."""
    filter_ = controllers.StateEstimator(CART, controllers.FixedPrecision(), initial_covariance=steady_covariance(CART))
    for sensor in range(3):
        step, ours = filter_.online(compiled=False), response(CART, sensor).offset(40)
        y = np.eye(3)[sensor]
        seen = [step(y=y, u=[0.0]).innovation[sensor] for _ in range(40)]
        np.testing.assert_allclose(ours, seen, rtol=1e-9)
    assert response(CAR, 0).offset(10_000)[-1] == pytest.approx(0.5114, abs=1e-3)  # the other sensor holds half of it


def test_operations_on_many_runs_are_the_plain_ones_for_each():
    import inspect

    values = [0.0, -0.0, 1.0, -1.5, 2.75, np.pi, 5e-324, 1e300, np.inf, -np.inf, np.nan]
    pairs = np.array([(a, b) for a in values for b in values])
    with np.errstate(all="ignore"):
        for name, batch in OPERATIONS.items():
            count = len(inspect.signature(getattr(ops, name)).parameters)
            truths = name in {"both", "either", "negate"}
            columns = [
                pairs[:, i % 2] > 0 if truths or (count == 3 and i == 0) else pairs[:, i % 2] for i in range(count)
            ]
            ours = np.asarray(batch(*columns), dtype=float)
            plain = [float(getattr(ops, name)(*row)) for row in zip(*columns, strict=True)]
            np.testing.assert_allclose(ours, plain, rtol=1e-15, atol=0, err_msg=name)


def test_runs_of_the_estimator_are_those_of_the_block(monkeypatch):
    """Its step functions on arrays of runs, the plant at rest, against one run of the block with a plant that moves."""
    monkeypatch.setattr("bayesftc.controllers.detection.estimator_runs.WARM", 1.0)
    A, C, root = CART.matrix("A"), CART.matrix("C"), np.linalg.cholesky(CART.matrix("sensor_covariance"))
    for precision in (
        GammaPrecision(window=5, belief_uncertainty=True),
        GammaPrecision(estimate="mode", forget_to="zero"),
    ):
        runs = EstimatorRuns(CART, precision, 1, 3, seed=9)
        step = controllers.StateEstimator(CART, precision, initial_covariance=steady_covariance(CART)).online(
            compiled=False
        )
        values, vectors = np.linalg.eigh(steady_covariance(CART))
        x = -(vectors * values**0.5) @ np.random.default_rng(9).standard_normal((2, 3))[:, 2]
        for k in range(runs.warm_steps):
            draw = np.random.default_rng([9, k]).standard_normal((6, 3))[:, 2]
            out = step(y=C @ x + root @ draw[:3], u=[1.0])
            x = A @ x + [0.0, 0.1] + np.sqrt([1e-4, 1e-3]) * draw[3:5]
        assert runs.warm_steps >= 10
        assert runs.beta[2] == pytest.approx(out.beta[1], rel=1e-9)
        assert len(set(runs.beta)) == 3


@pytest.mark.slow
def test_a_fixed_filter_finds_offsets_as_a_simulation_of_it_does():
    """Beta beside a filter that never learns; it is no block of the package, so it is simulated here."""
    result = detectability(model=CAR, learning=False)
    P, runs = float(steady_covariance(CAR)[0, 0]), 20_000
    K, rng = P / (2 * P + 1), np.random.default_rng(4)
    d, beta = P**0.5 * rng.standard_normal(runs), np.full(runs, 2.0)
    for k in range(250):
        e = d[:, None] + rng.standard_normal((runs, 2)) + [result.offset if k >= 200 else 0.0, 0.0]
        beta = 0.95 * beta + 0.05 * 2 + 0.5 * e[:, 0] ** 2
        d = 0.999 * (d - K * e.sum(axis=1)) + 1e-3**0.5 * rng.standard_normal(runs)
        if k >= 199:
            d, beta = d[beta <= result.threshold], beta[beta <= result.threshold]
            runs = len(d)
        if k == 199:
            started = runs
    assert runs / started == pytest.approx(0.1, abs=0.01)


def test_what_cannot_be_answered():
    for options, sentence in (
        ({"precision": GammaPrecision(forgetting=None)}, "grows without bound"),
        ({"precision": controllers.FixedPrecision()}, "GammaPrecision only"),
        ({"precision": CAR, "model": GammaPrecision()}, "The learner comes first: detectability"),
        ({"model": 3.0}, "needs a LinearModel"),
        ({"model": CAR, "dt": 0.1}, "leave dt out"),
        ({"model": CAR, "sensor": 2}, "at most 1"),
        ({"within": 1.0}, "at least two samples"),
        ({"false_alarm_probability": 0.3, "detection_probability": 0.5}, "Without any fault there is an alarm"),
        ({"false_alarm_probability": 0.1, "false_alarms_per_hour": 1.0}, "give one of them"),
        ({"false_alarm_probability": 0.0}, "at least 1e-12"),
        ({"model": CAR, "precision": GammaPrecision(window=5), "learning": False}, "learning=True"),
        ({"model": replace(CAR, A=[[1.0]], process_covariance=0.0)}, "no steady state"),
        ({"learning": 1}, "True or False"),
    ):
        with pytest.raises(ModelError, match=sentence):
            detectability(**options)
    joint = controllers.BayesianController(CAR, controllers.FixedPrecision(), belief="joint", control_covariance=1e6)
    with pytest.raises(ModelError, match="belief='filtered'"):
        detectability(model=joint)
    result = detectability(GammaPrecision(forgetting=0.5), within=10)
    with pytest.raises(ModelError, match="kind of fault 'bias' is unknown"):
        result.delay("bias", 1.0)
    with pytest.raises(ModelError, match="not negative"):
        result.probability("offset", -1.0)


def test_figure_has_a_line_for_each_result_and_no_delay_below_what_it_says():
    result = detectability(GammaPrecision(forgetting=0.5), within=10)
    figure = result.plot({"again": result})
    assert [len(axis.lines) for axis in figure.axes] == [4, 4, 4, 4]
    assert result.offset_delay in figure.axes[1].lines[1].get_ydata()


HEALTHY, FAULTY, RUNS = 500, 8000, 20_000
FAULTS = {
    "offset": lambda size, at: cosim.Injection(magnitude=size, start=at),
    "drift": lambda size, at: cosim.Drift(slope=size, start=at),
    "noise": lambda size, at: cosim.NoiseIncrease(std=size, start=at),
}


def real_loop(model, precision, fault, duration, seeds):
    """Yield beta of the first sensor in closed loops of plant, faulty sensors and the Bayesian controller, compiled."""
    import control

    n, names = model.states, [f"x{i}" for i in range(model.states)]
    plant = cosim.StateSpace(
        control.ss(
            *map(model.matrix, "AB"), np.eye(n), np.zeros((n, 1)), float(model.step), inputs=["u"], outputs=names
        ),
        process_noise=model.matrix("process_covariance"),
    )
    loop = cosim.closed_loop(
        plant=plant,
        controller=controllers.BayesianController(
            model, precision=precision, initial_covariance=steady_covariance(model), goal_on=[[1.0] + [0.5] * (n - 1)]
        ),
        control="u",
        measured=names,
        sensors=cosim.Sensors(
            count=model.sensors,
            signals=n,
            matrix=model.matrix("C").tolist(),
            covariance=model.matrix("sensor_covariance").tolist(),
        ),
        faults=[fault] if fault else [],
        reference=cosim.Sine(amplitude=5.0, period=8.0),
    )
    for result in repeat(loop, duration, seeds, ["controller.beta"]):
        yield result["controller.beta"][:, 0]


def drill(model, precision, runs=5000):
    """Return the ratio of each figure of `detectability` to the real loop's, and for delays its standard error.

    Where one fault in ten waits for a false alarm, the mean delay scatters by several times itself.
    """
    dt = model.step
    result = detectability(precision, model, runs=RUNS)
    long = np.concatenate([beta[HEALTHY:] for beta in real_loop(model, precision, None, 40_000 * dt, range(100, 140))])
    alarm = long > result.threshold
    count = np.count_nonzero(alarm[1:] & ~alarm[:-1])
    begins = count / len(alarm) * 3600 / float(dt)
    rows = {
        "threshold": (result.threshold / np.quantile(long, 1 - result.false_alarm_probability), 0.0),
        "false alarms per hour": (result.false_alarms_per_hour / begins, count**-0.5),
    }
    for kind in FAULTS:
        size, steps = getattr(result, kind), round(result.within / float(dt))
        chances, multiples = [], (0.9, 0.95, 1.0, 1.05, 1.1)
        for multiple in multiples:
            ages = alarm_ages(
                model, precision, result, kind, multiple * size, FAULTY if multiple == 1.0 else steps, runs
            )
            chances.append(np.mean(ages < steps))
            if multiple == 1.0:
                rows[f"{kind}, delay"] = delay_ratio(result, kind, ages)
        rows[f"{kind}, size"] = 1 / np.interp(result.detection_probability, chances, multiples), 0.0
    return rows


def alarm_ages(model, precision, result, kind, size, steps, runs):
    """Return at which faulty sample the real loop has its first alarm, ``steps`` for none, in runs without one just before."""
    fault, ages = FAULTS[kind](size, HEALTHY * model.step), []
    for beta in real_loop(model, precision, fault, (HEALTHY + steps) * model.step, range(runs)):
        alarm = beta[HEALTHY - 1 :] > result.threshold
        if not alarm[0]:
            ages.append(np.argmax(np.append(alarm[1 : steps + 1], True)))
    return np.array(ages)


def delay_ratio(result, kind, ages):
    """Return the ratio of the mean delay to the real loop's, and its standard error."""
    assert ages.max() < FAULTY
    scatter = ages.std() / ages.mean() * (1 / len(ages) + 1 / RUNS) ** 0.5
    return getattr(result, f"{kind}_delay") / (ages.mean() * result.dt), scatter


CASES = {
    "car, forgetting .95": (CAR, GammaPrecision()),
    "car, forgetting .7, prior shape .05": (CAR, GammaPrecision(forgetting=0.7, prior_shape=0.05)),
    "car, window 20": (CAR, GammaPrecision(window=20)),
    "cart, forgetting .95": (CART, GammaPrecision()),
    "car with process noise .1": (replace(CAR, process_covariance=0.1), GammaPrecision()),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES)[:4])
def test_every_figure_is_within_5_percent_of_the_real_loops(name):
    for figure, (ratio, error) in drill(*CASES[name]).items():
        assert abs(ratio - 1) <= 0.05 + 2 * error, (figure, ratio, error)


if __name__ == "__main__":
    import sys

    for title in [name for name in CASES if not sys.argv[1:] or name in sys.argv[1:]]:
        rows = drill(*CASES[title]).items()
        ratios = ", ".join(
            f"{figure} {ratio:.3f}" + (f" +- {error:.3f}" if error else "") for figure, (ratio, error) in rows
        )
        print(f"{title}: {ratios}", flush=True)  # noqa: T201
