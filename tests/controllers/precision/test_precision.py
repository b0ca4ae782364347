"""Precision learners: conjugacy against numerical integration, the update rules against NumPy, and the whole list in the loop."""

from dataclasses import dataclass, fields
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import integrate, stats

from bayesftc import controllers, cosim
from bayesftc.controllers import (
    EFFDI,
    SERFDI,
    Calibration,
    ExplicitDetection,
    FittedThreshold,
    FixedPrecision,
    GammaPrecision,
    Noisier,
    Offset,
    PointMassPrecision,
    StudentTUpdate,
    SwitchingPrecision,
    VariationalBayesKF,
    WeightedLikelihood,
    WishartPrecision,
)
from bayesftc.controllers.bayesian.validation import compare, ser_reference
from bayesftc.cosim.diagram.memory import arrange, bind
from bayesftc.cosim.errors import BayesFTCError, ModelError
from bayesftc.cosim.ops import either, select

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], 0.02)

# Each way to write a learning step is compiled with its controller, for about ten seconds; examples that differ in numbers alone
# share one.
EXAMPLES = [
    FixedPrecision(),
    GammaPrecision(forgetting=0.9),
    GammaPrecision(forgetting=None),
    GammaPrecision(forgetting=0.8, forget_to="zero", belief_uncertainty=True),
    GammaPrecision(window=5, estimate="mode", calibration=Calibration(0.5, -3.0, "linear")),
    PointMassPrecision(),
    PointMassPrecision(rate=0.5, lower_bound=0.01, variance_bound=0.25, parameterization="direct"),
    PointMassPrecision(rate=0.3, lower_bound=1e-2, variance_bound=0.5, full=True),
    WishartPrecision(calibration=Calibration(2.0, -3.0)),
    WishartPrecision(
        forgetting=None, degrees_of_freedom=3.5, belief_uncertainty=True, calibration=Calibration(2.0, -3.0)
    ),
    WishartPrecision(forgetting=0.8, forget_to="zero", estimate="mode", calibration=Calibration(2.0, -3.0)),
    VariationalBayesKF(iterations=2),
    VariationalBayesKF(forgetting=0.8, iterations=2, covariance="full", calibration=Calibration(2.0, -3.0)),
    StudentTUpdate(iterations=2),
    StudentTUpdate(degrees_of_freedom=1.0, iterations=2, joint=True),
    WeightedLikelihood(),
    WeightedLikelihood(c=1.0, joint=True),
    SwitchingPrecision(joint=False),
    SwitchingPrecision(modes=(Noisier(), Offset(jump=0.0, slope=0.1)), loss=0.5, joint=False),
    EFFDI(),
    SERFDI(),
    SERFDI(filter="filterpy"),
    ExplicitDetection(GammaPrecision(calibration=Calibration(2.0, -3.0)), threshold=3.0),
    ExplicitDetection(
        GammaPrecision(window=5), threshold=FittedThreshold([0.0, 0.0], [1.0, 4.0], 4.0), groups=[[0, 1]]
    ),
]
"""Learners with settings that matter; those that are not among them follow with their default settings."""
EXAMPLES += [cls() for cls in controllers.LEARNERS if cls not in {type(each) for each in EXAMPLES}]


def samples(steps=300):
    """Two sensors around 20: the first jumps by 8 and returns, the second drops out at times."""
    rng = np.random.default_rng(2)
    y = 20.0 + rng.normal(size=(steps, 2)) * [1.0, 2.0]
    y[100:200, 0] += 8.0
    y[rng.random(steps) < 0.1, 1] = np.nan
    return y


def run(precision, y, compiled=True, **options):
    controller = controllers.BayesianController(MODEL, precision=precision, initial_mean=20.0, **options)
    step = controller.online(compiled=compiled)
    return [step(y=row, goal=[20.0]) for row in y]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", EXAMPLES, ids=repr)
def test_compiled_and_plain_agree_to_the_last_bit_and_stay_finite(precision):
    y = samples()
    for a, b in zip(run(precision, y), run(precision, y, compiled=False), strict=True):
        for name in a:
            np.testing.assert_array_equal(a[name], b[name])
        assert np.isfinite(a.u).all()
        assert np.isfinite(a.x_hat).all()
        assert (np.linalg.eigvalsh(a.P) > 0).all()
        probability = a.fault_probability[np.isfinite(a.fault_probability)]
        assert ((probability >= 0) & (probability <= 1)).all()


FORGETFUL = [
    GammaPrecision(forget_to=to, estimate=estimate, forgetting=rho)
    for to in ("prior", "zero")
    for estimate in ("mean", "mode")
    for rho in (0.6, 0.95)
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", [*EXAMPLES, *FORGETFUL], ids=repr)
def test_long_dropouts_are_survived(precision):
    """Both sensors fall silent for a long time and return: precisions stay positive, the belief finds the car again."""
    y = 20.0 + np.random.default_rng(3).normal(size=(700, 2))
    y[50:600] = np.nan
    outs = run(precision, y, compiled=False)
    for out in outs:
        assert (np.diag(out.R) > 0).all()
        assert (out.precision >= 0).all()
        assert np.isfinite(out.P).all()
    silent = outs[300].fault_probability  # known, not inferred, unless a dropout is one of several faults to tell apart
    assert np.isnan(silent).all() != isinstance(precision, SwitchingPrecision)
    assert abs(outs[-1].x_hat[0] - 20.0) < 1.5


@pytest.mark.sampled(8)
@pytest.mark.parametrize("precision", EXAMPLES, ids=repr)
def test_the_belief_is_filterpys_given_the_covariances_that_are_reported(precision):
    """Also for learners that leave sensors out: their R is infinite there."""
    y = samples()
    y[150, 0] += 40.0
    outs = run(precision, y)
    u, x_hat, P, R = (np.array([out[name] for out in outs]) for name in ("u", "x_hat", "P", "R"))
    check = compare(x_hat, P, ser_reference(MODEL, y, u, R=R, initial_mean=20.0))
    assert max(check.mean_difference, check.covariance_difference) < 1e-9
    if isinstance(precision, EFFDI | SERFDI):
        assert np.isinf(R[150, 0, 0])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("precision", FORGETFUL, ids=repr)
def test_sensors_that_agree_exactly_for_ever_stay_finite(precision):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], 0.02)
    step = controllers.BayesianController(model, precision=precision).online()
    for _ in range(20_000):
        out = step(y=[0.0, 0.0], goal=[0.0])
    for _ in range(500):
        out = step(y=[5.0, 5.0], goal=[5.0])
    assert np.isfinite(out.P).all()
    assert (out.R[[0, 1], [0, 1]] > 0).all()
    assert abs(out.x_hat[0] - 5.0) < 0.5


@pytest.mark.parametrize("precision", EXAMPLES, ids=repr)
def test_absurd_samples_are_survived(precision):
    y = samples(120)
    y[20], y[25], y[30], y[40:60], y[70] = 1e300, [np.inf, -np.inf], [np.nan, 1e300], np.nan, [-1e300, 20.0]
    for out in run(precision, y):
        assert np.isfinite(out.P).all()
        assert (np.linalg.eigvalsh(out.P) > 0).all()
        assert np.isfinite(out.x_hat).all()


INF, NAN = float("inf"), float("nan")


def write_absurd_samples(k, noise, y):
    """Noise with 1e300 and infinities in it, long and short silences, and long times of exact agreement."""
    phase = k % 100_000
    for i in range(y.shape[0]):
        y[i] = 20.0 + select(phase >= 40_000, 0.0, noise[i])
        y[i] = select(phase >= 80_000, 20.0 + 3.0 * noise[0], y[i])
    y[0] = select(k % 9973 == 17, 1e300, y[0])
    y[1] = select(k % 9973 == 17, -1e300, y[1])
    y[1] = select(k % 7919 == 29, INF, select(k % 7919 == 31, 1e9, y[1]))
    silent = k % 50_000 < 3_000
    y[0] = select(either(silent, k % 13 == 0), NAN, y[0])
    y[1] = select(either(silent, k % 30_000 < 2_000), NAN, y[1])


@dataclass(frozen=True)
class AbsurdSamples(cosim.Block):
    """Two sensors at their worst."""

    @property
    def inputs(self):
        return (cosim.Port("noise", (2,), draw="normal"),)

    @property
    def outputs(self):
        return (cosim.Port("y", (2,)),)

    def define(self, step):
        return cosim.Definition(write_absurd_samples)


@pytest.mark.slow
@pytest.mark.parametrize("precision", [e for e in EXAMPLES if e.learner(MODEL).compiled], ids=repr)
def test_a_million_steps_leave_beliefs_finite_and_covariances_positive_definite(precision):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [[1.0, 0.6], [0.6, 4.0]], 0.02)
    diagram = cosim.Diagram(dt=0.02)
    samples, goal = diagram.add(AbsurdSamples()), diagram.add(cosim.Constant(20.0))
    controller = diagram.add(controllers.BayesianController(model, precision=precision), name="controller")
    diagram.connect(samples["y"], controller["y"])
    diagram.connect(goal["y"], controller["goal"])
    own = [port.name for port in precision.learner(model).ports]
    always = ("P", "x_hat", "u", "precision")
    result = diagram.simulate(1_000_000 * model.step, record=[f"controller.{name}" for name in ("R", *always, *own)])
    R = result["controller.R"].copy()
    for i in range(2):  # a sensor that a baseline leaves out has an infinite variance
        ignored = np.isinf(R[:, i, i])
        R[ignored, i, :] = R[ignored, :, i] = 0.0
        R[ignored, i, i] = 1.0
    np.testing.assert_array_equal(R, R.transpose(0, 2, 1))
    np.linalg.cholesky(R)  # an error, where one is not positive definite
    assert (result["controller.P"][:, 0, 0] > 0).all()
    for name in (*always, *own):
        values = result[f"controller.{name}"]
        if name in {"fault_size", "fault_onset"}:  # which a healthy sensor does not have
            values = values[result["controller.fault_kind"] > 0]
            assert len(values)
            assert not np.isinf(values).any()
        else:
            assert np.isfinite(values).all(), name
    for name in {"precision_scale", "precision_mean"} & set(own):
        if result[f"controller.{name}"].ndim == 3:
            np.linalg.cholesky(result[f"controller.{name}"])


def prior_predictions(y, outs):
    """Recover each step's innovation and predicted variance from the outputs of the step before."""
    mean, variance = 20.0, 1.0
    for row, out in zip(y, outs, strict=True):
        yield row - mean, variance
        mean = 0.999 * out.x_hat[0] + 2e-4 * out.u[0]
        variance = 0.999**2 * out.P[0, 0] + 0.001


@pytest.mark.parametrize("belief", [False, True])
@pytest.mark.parametrize("forget_to", ["prior", "zero"])
def test_gamma_update_with_forgetting(forget_to, belief):
    y, rho, a0, R = samples(), 0.9, 3.0, np.array([1.0, 4.0])
    outs = run(GammaPrecision(forgetting=rho, prior_shape=a0, forget_to=forget_to, belief_uncertainty=belief), y)
    a, b = np.full(2, a0), a0 * R
    for (e, variance), out in zip(prior_predictions(y, outs), outs, strict=True):
        present = np.isfinite(e)
        back = (1 - rho) if forget_to == "prior" else 0.0
        keep = rho if forget_to == "prior" else np.where(present, rho, 1.0)  # towards zero only with a sample
        a, b = keep * a + back * a0, keep * b + back * a0 * R
        a = a + 0.5 * present
        b = b + np.where(present, 0.5 * (e**2 + belief * variance), 0.0)
        np.testing.assert_allclose(out.beta, b, rtol=1e-9)
        np.testing.assert_allclose(out.precision, a / b, rtol=1e-9)
        np.testing.assert_allclose(np.diag(out.R), b / a, rtol=1e-9)
    # The shape converges to 1 / (2 (1 - rho)), plus the prior's where it forgets to the prior.
    assert a[0] == pytest.approx(0.5 / (1 - rho) + (a0 if forget_to == "prior" else 0.0), rel=1e-9)


def test_gamma_update_with_a_window():
    y, length = samples(60), 7
    outs = run(GammaPrecision(window=length, prior_shape=2.5, estimate="mode"), y, compiled=False)
    history = []
    for (e, _), out in zip(prior_predictions(y, outs), outs, strict=True):
        history.append(e)
        last = np.array(history[-length:])
        a = 2.5 + 0.5 * np.isfinite(last).sum(axis=0)
        b = 2.5 * np.array([1.0, 4.0]) + 0.5 * np.nansum(last**2, axis=0)
        np.testing.assert_allclose(out.beta, b, rtol=1e-9)
        np.testing.assert_allclose(out.precision, (a - 1) / b, rtol=1e-9)


def test_the_literal_update_never_forgets():
    y = samples()
    outs = run(GammaPrecision(forgetting=None, prior_shape=1.0), y)
    errors = np.array([e for e, _ in prior_predictions(y, outs)])
    assert outs[-1].beta[0] == pytest.approx(1.0 + 0.5 * np.sum(errors[:, 0] ** 2), rel=1e-9)
    assert all(later.beta[0] >= earlier.beta[0] for earlier, later in pairwise(outs))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.floats(0.5, 20.0), st.floats(0.2, 30.0), st.floats(-6.0, 6.0))
def test_gamma_is_conjugate_by_numerical_integration(a, b, e):
    """Prior times likelihood, integrated numerically, has the moments of Gamma(a + 1/2, b + e^2/2)."""
    posterior = stats.gamma(a + 0.5, scale=1 / (b + e * e / 2))
    end = posterior.ppf(1 - 1e-13)

    def weight(w):
        return stats.gamma.pdf(w, a, scale=1 / b) * stats.norm.pdf(e, scale=w**-0.5)

    def moment(power):
        points = posterior.ppf([0.01, 0.5, 0.99])
        return integrate.quad(lambda w: w**power * weight(w), 0, end, points=points, limit=200)[0]

    total = moment(0)
    assert moment(1) / total == pytest.approx(posterior.mean(), rel=1e-6)
    assert moment(2) / total - (moment(1) / total) ** 2 == pytest.approx(posterior.var(), rel=1e-5)


def test_the_step_function_makes_that_conjugate_update():
    """One sample of a sensor with known mean: shape + 1/2, rate + e^2/2, read off the block's outputs."""
    model = controllers.LinearModel([[1.0]], [[1.0]], [[1.0]], 1e-12, 2.0, 1.0)
    controller = controllers.BayesianController(
        model, precision=GammaPrecision(forgetting=None, prior_shape=3.0), initial_mean=5.0, initial_covariance=1e-12
    )
    out = controller.online(compiled=False)(y=[8.0], goal=[0.0])
    assert out.beta[0] == pytest.approx(3.0 * 2.0 + 0.5 * 9.0)
    assert out.precision[0] == pytest.approx(3.5 / 10.5)


def test_logistic_map():
    for feature, x in (("log", lambda r: np.log(r)), ("linear", lambda r: r)):
        precision = GammaPrecision(prior_shape=2.0, calibration=Calibration(1.5, -2.0, feature))
        y = samples(50)
        for row, out in zip(y, run(precision, y, compiled=False), strict=True):
            expected = 1 / (1 + np.exp(-(1.5 * x(out.beta / (2.0 * np.array([1.0, 4.0]))) - 2.0)))
            expected[np.isnan(row)] = np.nan  # a missing sample is known, not inferred
            np.testing.assert_allclose(out.fault_probability, expected, rtol=1e-12)
        assert precision.why_no_probability is None
    assert "calibrate" in str(GammaPrecision().why_no_probability)
    assert np.isnan(run(GammaPrecision(), samples(3), compiled=False)[-1].fault_probability).all()


def test_effdi_ignores_a_jump_for_its_duration_and_cannot_see_a_freeze():
    sd, steps = np.array([1.0, 2.0]), 200
    rng = np.random.default_rng(0)
    y = 20 + 0.1 * rng.normal(size=(steps, 2))
    y[50:, 0] += 12.0
    y[100:, 1] = y[99, 1]
    outs = run(EFFDI(duration=0.4), y)
    decided = np.array([o.fault_probability for o in outs])
    r = np.abs(y[2:] - 2 * y[1:-1] + y[:-2])
    R = np.full((steps, 2), np.nan)
    R[4:] = r[2:] + r[1:-1] + r[:-2]
    expected = np.zeros((steps, 2))
    for k, i in np.argwhere(EFFDI().threshold * sd < R):
        expected[k : k + 20, i] = 1.0
    np.testing.assert_array_equal(decided, expected)
    assert expected[:, 0].sum() >= 20
    assert not decided[:, 1].any()
    assert all(o.precision[0] == 0 for o, d in zip(outs, decided, strict=True) if d[0])


def test_effdi_threshold_is_the_statistics_quantile():
    y = np.random.default_rng(1).normal(size=2_000_000)
    r = np.abs(np.diff(y, 2))
    R = r[2:] + r[1:-1] + r[:-2]
    assert np.quantile(R, 0.999) == pytest.approx(EFFDI().threshold, rel=0.01)


def test_serfdi_compares_with_the_innovations_deviation():
    y = samples()
    outs = run(SERFDI(3.0), y)
    for (e, variance), out in zip(prior_predictions(y, outs), outs, strict=True):
        expected = np.abs(e) > 3.0 * np.sqrt(variance + np.array([1.0, 4.0]))
        np.testing.assert_array_equal(out.fault_probability > 0.5, expected)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: GammaPrecision(forgetting=0.0),
            "GammaPrecision has forgetting=0.0; .* above 0 and at most 1, or None",
        ),
        (lambda: GammaPrecision(forgetting=1.2), "above 0 and at most 1"),
        (lambda: GammaPrecision(forgetting=NAN), "above 0 and at most 1"),
        (lambda: GammaPrecision(forgetting=True), "must be a finite number"),
        (lambda: GammaPrecision(window=0), "must be a whole number at least 1 and at most 64"),
        (lambda: GammaPrecision(window=2.5), "must be a whole number"),
        (lambda: GammaPrecision(prior_shape=0.0), "number above 0"),
        (lambda: GammaPrecision(prior_shape=INF), "finite number above 0"),
        (lambda: GammaPrecision(prior_shape=1.0, estimate="mode"), "number above 1"),
        (lambda: GammaPrecision(estimate="median"), "'mean' or 'mode'"),
        (lambda: GammaPrecision(forget_to="zero", estimate="mode", forgetting=0.5), "forgetting factor above 0.5"),
        (lambda: EFFDI(threshold=-1.0), "number above 0"),
        (lambda: SERFDI(threshold=0.0), "number above 0"),
        (lambda: Calibration(NAN, 0.0), "slope=nan; it must be a finite number"),
        (lambda: Calibration(1.0, 0.0, "root"), "'log' or 'linear'"),
        (lambda: controllers.BayesianController(MODEL, precision=EFFDI(duration=0.03)), "no whole number of steps"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(BayesFTCError, match=words):
        make()


SETTINGS = [(cls, field) for cls in controllers.LEARNERS for field in fields(cls)]


@pytest.mark.parametrize(("cls", "field"), SETTINGS, ids=[f"{cls.__name__}-{field.name}" for cls, field in SETTINGS])
def test_what_is_no_value_for_a_setting_is_refused_by_name(cls, field):
    for value in ("abc", None):
        if value is not None or "None" not in field.type:
            with pytest.raises(ModelError, match=f"^{cls.__name__} has {field.name}={value!r}[;,]"):
                cls(**{field.name: value})


# --- scratch space ------------------------------------------------------------------------------------------------------------


def swings(x, u, following):
    following[0] = 0.98 * x[0] + 0.1 * u[0]


def reads(x, y):
    y[0] = x[0]
    y[1] = x[0] + 0.01 * x[0] * x[0]


def all_controllers(precision):
    """Every controller and the estimator with a learner, where it takes that one."""
    bent = controllers.NonlinearModel(swings, reads, 1, 1, 2, 0.001, [1.0, 4.0], 0.02)
    sensors = controllers.Modality("speed", matrix=[[1.0], [1.0]], std=(1.0, 2.0), precision=(1.0, 0.25))
    law, known = controllers.Proportional(1.0), {"initial_mean": 20.0, "precision": precision}
    makers = (
        lambda: controllers.StateEstimator(MODEL, **known),
        lambda: controllers.BayesianController(MODEL, posterior_outputs=True, control_covariance=1e6, **known),
        lambda: controllers.BayesianController(MODEL, belief="joint", **known),
        lambda: controllers.LQGController(MODEL, control_covariance=1e6, **known),
        lambda: controllers.NonlinearBayesianController(bent, posterior_outputs=True, iterations=3, **known),
        lambda: controllers.UnbiasedActiveInference(sensors, law, 0.02, 0.1, control="law", **known),
        lambda: controllers.UnbiasedActiveInference(sensors, law, 0.02, 0.1, control="gradient", **known),
    )
    for make in makers:
        try:
            yield make()
        except ModelError:
            continue  # it does not take this learner


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", [*EXAMPLES, SwitchingPrecision()], ids=repr)
def test_what_is_in_scratch_space_before_a_step_function_means_nothing(precision, same_bits):
    found = list(all_controllers(precision))
    for block in found:
        definition = block.define(Fraction(1, 50))
        (slots, initial), ports = arrange(block, definition, 0), {port.name for port in block.inputs}
        kernels = [kernel for kernel in (definition.output, definition.update) if kernel is not None]
        runs = []
        for spoilt in (False, True):
            memory, rows = initial.copy(), []
            steps = [bind(kernel, slots, memory) for kernel in kernels]
            for k, y in enumerate(samples()[90:110]):
                given = {"y": y, "speed": y, "goal": [21.0], "u": [100.0]}
                for name in ports:
                    begin = slots.offset(name)
                    memory[begin : begin + len(given[name])] = given[name]
                for step in steps:
                    for name in definition.scratch if spoilt else ():
                        begin = slots.offset(name)
                        memory[begin : begin + np.prod(slots.sections[name][2])] = np.nan
                    with np.errstate(all="ignore"):
                        step(0.02 * k, k)
                begin, (_, _, shape) = slots.offset("outputs"), slots.sections["outputs"]
                rows.append(memory[begin : begin + shape[0]].copy())
            runs.append(np.array(rows))
        same_bits(*runs)
    assert len(found) >= 3
