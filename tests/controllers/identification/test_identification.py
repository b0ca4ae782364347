"""Models from recordings: systems of known matrices and noise come back, in open and closed loop, and poor fits are said."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

from bayesftc import cosim, fmus
from bayesftc.controllers import LinearModel, PoorFitWarning, design
from bayesftc.controllers.identification.excitation import nearly_sines, order_of_excitation
from bayesftc.controllers.identification.gaps import identify_with_gaps
from bayesftc.controllers.identification.gaps_kernels import smooth
from bayesftc.controllers.identification.independent_noise import independent_noise
from bayesftc.cosim.base import announcing
from bayesftc.cosim.errors import ModelError, RecordingError, StepSizeError, UnknownNameError

A = np.array([[0.9, 0.2], [-0.2, 0.8]])
UNSTABLE = np.array([[1.1, 0.2], [0.0, 0.9]])
B = np.array([[0.1], [0.5]])
C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
Q, R = np.diag([0.01, 0.02]), np.diag([0.1, 0.05, 0.2])


def record(rows, A=A, B=B, C=C, Q=Q, R=R, feedback=None, seed=1):
    """A recording of a known system, its input white, or under feedback with a dither."""
    rng, x, table = np.random.default_rng(seed), np.zeros(len(A)), []
    for k in range(rows):
        y = C @ x + rng.normal(size=len(C)) * np.sqrt(np.diag(R))
        u = rng.normal(size=B.shape[1]) - (0.0 if feedback is None else feedback @ y)
        table.append([0.1 * k, *(u + 3.0), *(y + 5.0)])
        x = A @ x + B @ u + rng.normal(size=len(A)) * np.sqrt(np.diag(Q))
    inputs, outputs = [f"u{i}" for i in range(B.shape[1])], [f"y{i}" for i in range(len(C))]
    return pd.DataFrame(table, columns=["time", *inputs, *outputs]), {"inputs": inputs, "outputs": outputs}


def of_known_states(model, C=C):
    """Matrices of the model in the states of the system whose outputs C are, which must determine its states."""
    moving = model.moving
    T = np.linalg.lstsq(C, moving.matrix("C"), rcond=None)[0]
    back = np.linalg.inv(T)
    Q = T @ moving.matrix("process_covariance") @ T.T
    return T @ moving.matrix("A") @ back, T @ moving.matrix("B"), Q, model.matrix("sensor_covariance")


@pytest.mark.slow
def test_known_matrices_and_noise_come_back_within_their_sampling_error():
    """Ten recordings: the mean of the estimates lies within four of its own standard errors, biases of 3 % allowed."""
    truth = np.concatenate([A.ravel(), B.ravel(), Q.ravel(), np.diag(R)])
    rows = []
    for seed in range(10):
        table, names = record(2500, seed=seed)
        found = LinearModel.identify(table, **names)
        assert found.model.moving.states == 2
        assert not found.poor
        a, b, q, r = of_known_states(found.model)
        rows.append(np.concatenate([a.ravel(), b.ravel(), q.ravel(), np.diag(r)]))
    error = np.mean(rows, axis=0) - truth
    allowed = 4 * np.std(rows, axis=0) / np.sqrt(len(rows)) + 0.03 * np.abs(truth) + 1e-3
    assert (np.abs(error) < allowed).all(), (error, allowed)
    # And each of them is as near as a recording of this length can be: 10 % for variances of 1,750 samples.
    assert np.std(rows, axis=0)[-3:] == pytest.approx(np.diag(R) * np.sqrt(2 / 1750), rel=0.8)


@pytest.mark.slow
def test_an_unstable_plant_is_identified_as_its_controller_holds_it():
    table, names = record(10_000, A=UNSTABLE, feedback=np.array([[0.2, 0.2, 0.3]]))
    found = LinearModel.identify(table, **names)
    a, b, q, r = of_known_states(found.model)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(a).real), [0.9, 1.1], atol=0.02)
    np.testing.assert_allclose(b, B, atol=0.02)
    np.testing.assert_allclose(q, Q, atol=0.003)
    np.testing.assert_allclose(np.diag(r), np.diag(R), rtol=0.05)
    assert found.whiteness.min() > 1e-3
    assert np.isnan(found.simulated_fit).all()
    assert "no simulation, because the model is unstable" in found.describe()
    found.plot()


def test_without_noise_the_model_is_the_system():
    moves = np.array([[1.0, 0.1, 0.0], [0.0, 0.9, 0.1], [0.0, -0.1, 0.8]])
    table, names = record(
        1500, moves, np.array([[0.0], [0.0], [1.0]]), np.eye(3)[:1], np.zeros((3, 3)), np.zeros((1, 1))
    )
    found = LinearModel.identify(table, **names)
    ours = np.sort_complex(np.linalg.eigvals(found.model.moving.matrix("A")))
    np.testing.assert_allclose(ours, np.sort_complex(np.linalg.eigvals(moves)), atol=1e-4)
    assert found.fit[0] > 99.9
    assert found.simulated_fit[0] > 99.0


@pytest.mark.sampled(1)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_independent_noise_is_found_behind_its_own_filter(order):
    """The innovations model of a Kalman filter leads back to the Q and R that it was made of."""
    rng = np.random.default_rng(order)
    A = np.diag(rng.uniform(0.5, 0.95, order)) + 0.05
    C = rng.normal(size=(order + 1, order))
    root = rng.normal(size=(order, order))
    Q, R = root @ root.T, np.diag(rng.uniform(0.1, 2.0, order + 1))
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    K = A @ P @ C.T @ np.linalg.inv(S)
    q, r = independent_noise(A, C, K, S)
    np.testing.assert_allclose(q, Q, atol=2e-3 * np.abs(Q).max())
    np.testing.assert_allclose(r, R, rtol=1e-2, atol=1e-3)


@pytest.mark.slow
def test_missing_samples_do_little_harm():
    table, names = record(4000)
    holes = table.copy()
    holes.loc[np.arange(50, 4000, 97), "y0"] = np.nan
    whole, holed = (LinearModel.identify(data, **names) for data in (table, holes))
    for one, other in zip(of_known_states(whole.model), of_known_states(holed.model), strict=True):
        np.testing.assert_allclose(one, other, atol=0.06)
    assert np.isfinite(holed.fit).all()


def dense(y, drive, A, C, Q, R, x0, P0):
    """Means and covariances of all states given all samples, and the samples' density, from one large Gaussian."""
    steps, n = len(y), len(A)
    ahead = np.eye(steps * n)
    for k in range(1, steps):
        ahead[k * n : (k + 1) * n, (k - 1) * n : k * n] = -A
    whole = np.linalg.inv(ahead)
    pushes = np.concatenate([x0, *drive[:-1]])
    noise = np.kron(np.eye(steps), Q)
    noise[:n, :n] = P0
    mean, cov = whole @ pushes, whole @ noise @ whole.T
    there = np.isfinite(y.ravel())
    read = np.kron(np.eye(steps), C)[there]
    S = read @ cov @ read.T + np.diag(np.tile(R, steps)[there])
    gain = cov @ read.T @ np.linalg.inv(S)
    e = y.ravel()[there] - read @ mean
    density = -0.5 * (np.linalg.slogdet(2 * np.pi * S)[1] + e @ np.linalg.solve(S, e))
    return (mean + gain @ e).reshape(steps, n), cov - gain @ S @ gain.T, density


def test_the_smoother_is_one_large_gaussian():
    rng = np.random.default_rng(0)
    steps, n = 12, 2
    y, drive = rng.normal(size=(steps, 3)), rng.normal(size=(steps, n))
    y[rng.uniform(size=y.shape) < 0.5] = np.nan
    x0, P0 = rng.normal(size=n), np.array([[2.0, 0.3], [0.3, 1.0]])
    expected, cov, density = dense(y, drive, A, C, Q, np.diag(R), x0, P0)
    ahead, P_ahead = np.zeros((steps + 1, n)), np.zeros((steps + 1, n, n))
    x, P, between = np.zeros((steps, n)), np.zeros((steps, n, n)), np.zeros((n, n))
    ahead[0], P_ahead[0] = x0, P0
    found = smooth(y, drive, A, C, Q, np.diag(R), ahead, P_ahead, x, P, between, np.zeros((5, n, n)))
    np.testing.assert_allclose(x, expected, atol=1e-12)
    blocks = cov.reshape(steps, n, steps, n)
    np.testing.assert_allclose(P, [blocks[k, :, k] for k in range(steps)], atol=1e-12)
    np.testing.assert_allclose(between, sum(blocks[k + 1, :, k] for k in range(steps - 1)), atol=1e-12)
    assert found == pytest.approx(density)


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize(("slow", "rows"), [(["y2"], 3000), (["y0", "y1", "y2"], 5000)])
def test_sensors_that_are_slower_than_the_rest(slow, rows):
    """They deliver at every fifth sample: no two rows that follow each other are whole."""
    table, names = record(rows)
    holes = table.copy()
    holes.loc[np.arange(rows) % 5 != 0, slow] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = LinearModel.identify(holes, **names)
    assert found.model.moving.states == 2
    assert not found.poor
    a, b, q, r = of_known_states(found.model)
    np.testing.assert_allclose(a, A, atol=0.05)
    np.testing.assert_allclose(b, B, atol=0.03)
    np.testing.assert_allclose(q, Q, atol=0.01)
    # Of a few hundred samples of a sensor; that of the process is taken for noise of the sensor and the other way round.
    np.testing.assert_allclose(np.diag(r), np.diag(R), rtol=0.25)
    assert found.whiteness.min() > 1e-3
    found.plot()


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize(("slow", "settings"), [([], {}), (["y0", "y1", "y2"], {}), ([], {"C": C[:1], "R": R[:1, :1]})])
def test_innovations_are_as_large_as_the_noise_promises(slow, settings):
    """On recordings that the models have not seen: the squares of normalised innovations against chi-square."""
    squares, count = 0.0, 0
    for seed in range(4):
        (table, names), (fresh, _) = (record(2000, seed=start + seed, **settings) for start in (0, 100))
        for recording in (table, fresh):
            recording.loc[np.arange(2000) % 5 != 0, slow] = np.nan
        model = LinearModel.identify(table, **names, order=2).model
        moves, reads, noise = model.matrix("A"), model.matrix("C"), model.matrix("sensor_covariance")
        x, P = np.array([0.0, 0.0, 1.0]), np.diag([10.0, 10.0, 0.0])
        for k, (u, y) in enumerate(
            zip(fresh[names["inputs"]].to_numpy(), fresh[names["outputs"]].to_numpy(), strict=True)
        ):
            there = np.isfinite(y)
            e, S = (y - reads @ x)[there], (reads @ P @ reads.T + noise)[np.ix_(there, there)]
            gain = np.linalg.solve(S, (reads @ P)[there]).T
            if k > 50:
                squares, count = squares + e @ np.linalg.solve(S, e), count + len(e)
            x, P = x + gain @ e, P - gain @ (reads @ P)[there]
            x, P = (
                moves @ x + model.matrix("B") @ u,
                moves @ (P + P.T) @ moves.T / 2 + model.matrix("process_covariance"),
            )
    # Where a model is from as many samples as it is judged by, its error counts as much as that of the mean.
    low, high = chi2.ppf([5e-4, 1 - 5e-4], count) / count
    assert 1 - 1.5 * (1 - low) < squares / count < 1 + 1.5 * (high - 1)


def test_without_gaps_both_ways_find_the_same():
    table, names = record(1500)
    u, y = table[names["inputs"]].to_numpy() - 3.0, table[names["outputs"]].to_numpy() - 5.0
    noisy, _, _ = identify_with_gaps(u, y, None, None, 48)
    model = LinearModel(noisy.A, noisy.B, noisy.C, noisy.Q, noisy.R, dt=0.1)
    one, other = of_known_states(model), of_known_states(LinearModel.identify(table, **names, held_out=0.1).model)
    for ours, theirs in zip(one, other, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=0.03)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("inputs", "order"),
    [
        (np.arange(3000) > 400, 1),
        (np.sin(0.3 * np.arange(3000)), 2),
        (np.arange(3000) / 3000, 1),
        (np.repeat(np.random.default_rng(0).choice([-1, 1], 60), 50), None),
    ],
)
def test_inputs_that_hardly_move_are_said(inputs, order):
    rng, x, rows = np.random.default_rng(1), np.zeros(2), []
    for k, u in enumerate(inputs):
        rows.append([0.1 * k, u, *(C @ x + 0.02 * rng.normal(size=3))])
        x = A @ x + B[:, 0] * u + 0.02 * rng.normal(size=2)
    table = pd.DataFrame(rows, columns=["time", "u0", "y0", "y1", "y2"])
    settings = {"inputs": "u0", "outputs": ["y0", "y1", "y2"], "order": 2}
    if order is None:
        assert not any("excitation" in said for said in LinearModel.identify(table, **settings).poor)
        return
    with pytest.warns(
        PoorFitWarning, match=rf"u0: the order of excitation is {order}, but .* needs 4.*Move the inputs at random"
    ):
        found = LinearModel.identify(table, **settings)
    still = any("nearly constant in the held-out part" in said for said in found.poor)
    assert still == (inputs[-900:].std() < 0.01)


def test_order_of_excitation_of_several_inputs():
    white, step = np.random.default_rng(0).normal(size=2000), (np.arange(2000) > 1000) * 2.0 - 1.0
    assert order_of_excitation(np.column_stack([white, white[::-1]]), 8) == (8, [])
    assert order_of_excitation(np.column_stack([white, step]), 8) == (1, [1])
    sines = np.sqrt(2) * np.sin(np.outer(np.arange(2000), [0.4, 1.7]))
    assert order_of_excitation(sines[:, :1], 8) == (2, [0])
    assert order_of_excitation(sines.sum(axis=1, keepdims=True), 8) == (4, [0])
    # The second is the first, one sample later.
    assert order_of_excitation(np.column_stack([white, np.roll(white, 1)]), 8) == (1, [0, 1])


def test_a_recording_under_feedback_alone_is_said():
    table, names = record(3000, feedback=np.array([[0.2, 0.2, 0.3]]))
    assert not LinearModel.identify(table, **names).poor  # its input has a dither
    rng, x, before, rows = np.random.default_rng(1), np.zeros(2), 0.0, []
    for k in range(3000):
        y = C @ x + rng.normal(size=3) * np.sqrt(np.diag(R))
        before = 0.5 * before - 0.2 * y.sum()  # a controller with a state, and nothing else
        rows.append([0.1 * k, before, *y])
        x = A @ x + B[:, 0] * before + rng.normal(size=2) * np.sqrt(np.diag(Q))
    with pytest.warns(PoorFitWarning, match="u0: follows from the outputs"):
        LinearModel.identify(pd.DataFrame(rows, columns=table.columns), **names)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("settings", [{}, {"held_out": 0.1}, {"past": 20}, {"order": 3}, {"order": 16}])
def test_how_long_a_recording_must_be_is_said_once(settings):
    table, names = record(4000)
    with pytest.raises(ModelError, match=r"need at least \d+") as told:
        LinearModel.identify(table[:10], **names, **settings)
    needed = int(re.search(r"at least (\d+)", str(told.value))[1])
    with pytest.raises(ModelError, match=f"at least {needed}"):
        LinearModel.identify(table[: needed - 1], **names, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of so short a recording
        LinearModel.identify(table[:needed], **names, **settings)


@pytest.mark.slow
def test_a_csv_file_a_figure_and_a_controller(tmp_path):
    table, names = record(3000)
    table.to_csv(tmp_path / "plant.csv", index=False)
    found = LinearModel.identify(tmp_path / "plant.csv", **names)
    assert float(found.model.step) == 0.1
    text = found.describe()
    assert text.startswith("Order 2, poles 0.8")
    assert "y2: " in text
    figure = found.plot()
    assert len(figure.axes) == 2 * 3 + 1
    figure.savefig(tmp_path / "fit.png")
    controller = design(found, goal="y2", acceptable_error=0.05)
    # In values: at the goal the output is the goal, by the control that holds it there.
    regulator, model = controller.regulator, found.model
    x = regulator.x_of_goal @ [6.0] + regulator.x_of_others @ [1.0]
    u = regulator.u_of_goal @ [6.0] + regulator.u_of_others @ [1.0]
    assert (model.matrix("C")[2] @ [*x, 1.0]) == pytest.approx(6.0)
    known = np.linalg.solve(np.block([[np.eye(2) - A, -B], [C[2:], np.zeros((1, 1))]]), [0.0, 0.0, 1.0])
    assert u[0] - 3.0 == pytest.approx(known[2], abs=0.3)
    with pytest.raises(UnknownNameError, match="did you mean 'y2'"):
        design(found, goal="y22")


def test_a_run_of_an_fmu_is_a_recording():
    servo = cosim.FMU(fmus.path("PositionServo"))
    diagram = cosim.Diagram(dt=0.02)
    plant, voltage = diagram.add(servo, "servo"), diagram.add(cosim.Gaussian(std=2.0), "voltage")
    sensors = diagram.add(cosim.Sensors(count=2, std=0.01), "sensors")
    diagram.connect(voltage["y"], plant["voltage"])
    diagram.connect(plant["speed"], sensors["u"])
    result = diagram.simulate(60.0, seed=3, engine="interpreted")
    found = LinearModel.identify(result, inputs="voltage.y", outputs="sensors.y")
    assert found.outputs == ("sensors.y[0]", "sensors.y[1]")
    known = np.exp(0.02 * np.linalg.eigvals(np.array([[-2.0, 10.0], [-2.0, -20.0]])))
    np.testing.assert_allclose(
        np.sort(np.linalg.eigvals(found.model.moving.matrix("A")).real), np.sort(known), atol=0.01
    )
    np.testing.assert_allclose(np.diag(found.model.matrix("sensor_covariance")), 1e-4, rtol=0.1)


def test_a_slow_identification_says_what_it_does(monkeypatch, caplog):
    monkeypatch.setattr(announcing, "PATIENCE", 0.0)
    table, names = record(3000)
    with caplog.at_level("INFO", logger="bayesftc"):
        LinearModel.identify(table, **names)
    assert "Identifying a model of the recording" in caplog.text


def test_a_poor_fit_is_said():
    table, names = record(3000)
    with pytest.warns(
        PoorFitWarning, match=r"y2: on held-out data the errors are .* times those of a long autoregression"
    ):
        found = LinearModel.identify(table, **names, order=1)
    assert found.poor
    assert f"p-value {found.whiteness[0]:.2g}." in found.describe()
    table["u0"] = np.random.default_rng(0).normal(size=3000)
    table["y0"] = np.random.default_rng(1).normal(size=3000)
    with pytest.warns(PoorFitWarning, match="% of it. Check whether the inputs move it"):
        LinearModel.identify(table, inputs="u0", outputs="y0", order=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LinearModel.identify(*record(3000)[:1], **names)


@pytest.mark.parametrize(
    ("change", "settings", "error", "words"),
    [
        ({}, {"inputs": "v"}, UnknownNameError, "no column 'v' for an input"),
        ({}, {"outputs": []}, ModelError, "outputs=.*at least one column"),
        ({}, {"held_out": 1.0}, ModelError, "held_out=1.0; it must be .* below 1"),
        ({}, {"order": 1.5}, ModelError, "order=1.5"),
        ({"u0": 1.0}, {}, ModelError, "'u0' is constant"),
        ({"u0": np.nan}, {}, ModelError, "'u0' has no numbers"),
        ({"y0": "high"}, {}, ModelError, "'y0' contains text"),
        ({"y0": np.inf}, {}, ModelError, "'y0' contains infinite values"),
        ({"y1": [*np.sin(np.arange(300.0)), *[np.nan] * 100]}, {}, ModelError, "'y1' has .* and 20 samples in the held-out part"),
        ({"time": 0.0}, {}, StepSizeError, "do not increase"),
        ({"time": np.arange(400.0) ** 2}, {}, StepSizeError, "not evenly spaced"),
        ({"time": "noon"}, {}, StepSizeError, "'time' does not contain numbers"),
        ({"time": pd.date_range("2024-01-01", periods=400, freq="-1s")}, {}, StepSizeError, "do not increase"),
        ({}, {"time": "t"}, StepSizeError, "no column 't'"),
        (None, {}, ModelError, r"has 20 samples\. 3 outputs and 1 input need at least \d+"),
        ({"y0": [1.0, np.nan, 2.0, np.nan] * 100, "u0": [np.nan, *np.sin(np.arange(399.0))]}, {}, ModelError, "'u0' has gaps as"),
    ],
)  # fmt: skip
def test_wrong_recordings_are_said_in_a_sentence(change, settings, error, words):
    table, names = record(20 if change is None else 400)
    table = table.assign(**(change or {}))
    with pytest.raises(error, match=words):
        LinearModel.identify(table, **(names | settings))


def test_what_is_no_recording(tmp_path):
    (tmp_path / "empty.csv").write_text("time,u,y\n")
    with pytest.raises(ModelError, match="no rows"):
        LinearModel.identify(tmp_path / "empty.csv", inputs="u", outputs="y")
    twice = pd.DataFrame(np.ones((3, 3)), columns=["time", "u", "u"])
    with pytest.raises(ModelError, match="several columns 'u'"):
        LinearModel.identify(twice, inputs="u", outputs="u")
    with pytest.raises(RecordingError, match=r"cannot be read: No such file or directory; give"):
        LinearModel.identify(tmp_path / "none.csv", inputs="u", outputs="y")
    with pytest.raises(ModelError, match="of the type int; give a Result"):
        LinearModel.identify(3, inputs="u", outputs="y")


@pytest.mark.parametrize("dt", [None, 0.1])
def test_missing_rows_are_no_steps_less(dt):
    """A recording without some rows gives the same as one in which they are empty, but for the inputs, which hold."""
    table, names = record(2500)
    gone = np.isin(np.arange(2500), [*range(300, 420), 700, 701, 1900])
    rows = np.where(gone, np.nan, 1.0)[:, None]
    inputs, outputs = names["inputs"], names["outputs"]
    empty = table.assign(**(table[outputs] * rows), **(table[inputs] * rows).ffill())
    found, known = (LinearModel.identify(t, **names, dt=dt) for t in (table[~gone], empty))
    for name in ("A", "B", "C", "process_covariance", "sensor_covariance"):
        np.testing.assert_array_equal(found.model.matrix(name), known.model.matrix(name))
    np.testing.assert_array_equal(found.time, known.time)


def test_each_row_is_at_the_nearest_step():
    """Times that jitter, and a step that is a part of the time between rows, leave the plant as it is."""
    table, names = record(4000, Q=0.01 * Q, R=0.01 * R)
    known = LinearModel.identify(table, **names)
    off = np.random.default_rng(0).uniform(-0.04, 0.04, len(table)) * (table["time"] > 0.0)
    jitter = table.assign(time=table["time"] + off)
    with pytest.raises(StepSizeError, match=r"not evenly spaced: .* Give dt=0\.\d+, the usual step"):
        LinearModel.identify(jitter, **names)
    found = LinearModel.identify(jitter, **names, dt=0.1)
    np.testing.assert_array_equal(found.model.matrix("A"), known.model.matrix("A"))
    with pytest.warns(UserWarning, match="50% of the rows are at the step of a later row"):
        LinearModel.identify(table, **names, dt=0.2)
    finer = LinearModel.identify(table, **names, dt=0.05, order=2)
    power = np.linalg.matrix_power(finer.model.moving.matrix("A"), 2)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(power)), np.sort_complex(np.linalg.eigvals(A)), atol=0.05
    )


@pytest.mark.parametrize(("what", "copied"), [("inputs", "u0"), ("outputs", "y0")])
def test_columns_that_follow_from_each_other_are_said(what, copied):
    table, names = record(400)
    table["copy"] = 3.0 - 2.0 * table[copied]
    with pytest.raises(ModelError, match=f"'{copied}' and 'copy' follow from each other"):
        LinearModel.identify(table, **names | {what: [*names[what], "copy"]})


def test_a_high_order_has_noise_of_one_shape_and_takes_no_time():
    """Of order 12, where a free covariance of the state's noise would have 78 numbers."""
    table, names = record(2000)
    found = LinearModel.identify(table, **names, order=12)
    usual = LinearModel.identify(table, **names)
    assert found.model.states == 12 + bool(found.model.constant)
    np.testing.assert_allclose(found.fit, usual.fit, atol=3.0)


def test_a_loop_that_follows_a_sine_does_not_excite_its_plant():
    """The control is a sine and the answer to noise: a model from such a recording made a loop swing between its limits."""
    rng, t = np.random.default_rng(0), np.arange(2000)
    noise = rng.standard_normal(2000)
    sine = np.sin(2 * np.pi * t / 400) + 0.1 * noise
    square = np.sign(np.sin(2 * np.pi * t / 400)) + 0.1 * noise
    assert nearly_sines(np.column_stack([sine, square, noise, sine + 0.5 * noise])) == [0]
