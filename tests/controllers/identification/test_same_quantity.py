"""Redundant columns of a recording: they become sensors of one quantity, with their own noise."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from bayesftc.controllers import LinearModel, PoorFitWarning, design
from bayesftc.cosim.errors import ModelError, UnknownNameError

A = np.array([[0.9, 0.2], [-0.2, 0.8]])
B = np.array([[0.1], [0.5]])
C = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
Q, R = np.array([0.01, 0.02]), np.array([0.1, 0.05, 0.4, 0.2])
OUTPUTS = {"level": ["a", "b", "c"], "flow": "d"}


def record(rows=3000, seed=1):
    """A recording of the system about readings of 5; its columns a, b and c measure the same."""
    rng, x, table = np.random.default_rng(seed), np.zeros(2), []
    for k in range(rows):
        u = rng.normal(size=1)
        table.append([0.1 * k, *u, *(5.0 + C @ x + rng.normal(size=4) * np.sqrt(R))])
        x = A @ x + B @ u + rng.normal(size=2) * np.sqrt(Q)
    return pd.DataFrame(table, columns=["time", "u", "a", "b", "c", "d"])


def check(found, atol=0.03, rtol=0.12, of_process=0.35):
    model = found.model
    assert model.alike == ((0, 1, 2), (3,))
    np.testing.assert_array_equal(model.matrix("C")[0], model.matrix("C")[1])
    moving = model.moving
    poles = np.sort_complex(np.linalg.eigvals(moving.matrix("A")))
    np.testing.assert_allclose(poles, np.sort_complex(np.linalg.eigvals(A)), atol=atol)
    np.testing.assert_allclose(np.diag(model.matrix("sensor_covariance")), R, rtol=rtol)
    to_states = moving.matrix("C")[[0, 3]]  # the system's states are the level and the flow
    process = np.diag(to_states @ moving.matrix("process_covariance") @ to_states.T)
    np.testing.assert_allclose(process, Q, rtol=of_process)


def test_a_known_system_comes_back_with_the_noise_of_each_sensor():
    found = LinearModel.identify(record(), inputs="u", outputs=OUTPUTS)
    check(found)
    assert not found.poor
    assert found.quantities == {"level": ("a", "b", "c"), "flow": ("d",)}
    assert "Sensors of level: a, b, c." in found.describe()
    assert "Sensors of flow" not in found.describe()
    assert "move alike" not in found.describe()
    by_quantity, by_column = (design(found, goal=goal) for goal in ("level", "b"))
    assert "4 sensors (a, b, c, d) of 2 quantities, every" in by_quantity.describe()
    np.testing.assert_array_equal(by_quantity.goal_matrix, by_column.goal_matrix)
    # A quantity of one sensor is a goal as well: it had to be named by its column.
    np.testing.assert_array_equal(design(found, goal="flow").goal_matrix, design(found, goal="d").goal_matrix)
    with pytest.raises(UnknownNameError, match="'flw'; did you mean 'flow'"):
        design(found, goal="flw")


def test_sensors_with_gaps_share_them():
    table, rng = record(), np.random.default_rng(5)
    for column in "abc":
        table.loc[rng.random(len(table)) < 0.3, column] = np.nan
    check(LinearModel.identify(table, inputs="u", outputs=OUTPUTS, order=2), of_process=0.7)


@pytest.mark.slow
def test_slow_sensors_are_bridged():
    table = record(6000)
    for column in "abcd":
        table.loc[table.index % 3 > 0, column] = np.nan
    check(LinearModel.identify(table, inputs="u", outputs=OUTPUTS, order=2), atol=0.06, rtol=0.3, of_process=0.5)


def test_two_sensors_have_their_own_noise():
    table = record().drop(columns=["a", "d"])
    model = LinearModel.identify(table, inputs="u", outputs={"level": ["b", "c"]}, order=2).model
    assert model.alike == ((0, 1),)
    np.testing.assert_allclose(np.diag(model.matrix("sensor_covariance")), [0.05, 0.4], rtol=0.2)


def test_a_quantity_of_one_column_each_changes_nothing():
    table = record(800)
    plain = LinearModel.identify(table, inputs="u", outputs=["a", "d"])
    named = LinearModel.identify(table, inputs="u", outputs={"level": "a", "flow": "d"})
    for name in ("A", "B", "C", "process_covariance", "sensor_covariance"):
        np.testing.assert_array_equal(named.model.matrix(name), plain.model.matrix(name))
    assert "move alike" not in plain.describe()


def test_columns_that_move_alike_are_pointed_out():
    found = LinearModel.identify(record(), inputs="u", outputs=["a", "b", "c", "d"])
    assert found.model.alike == ((0,), (1,), (2,), (3,))
    assert "a, b, c move alike." in found.describe()
    assert "outputs={'quantity': ['a', 'b', 'c']}" in found.describe()


def readings(table, outputs):
    """Return the sentences on what sensors read beside the others of their quantity."""
    with pytest.warns(PoorFitWarning):
        found = LinearModel.identify(table, inputs="u", outputs=outputs)
    return [sentence for sentence in found.poor if " of the sensors of level" in sentence]


def test_what_a_sensor_reads_more_is_what_is_to_be_subtracted():
    table = record()
    table["b"] += 2.0
    (named,) = readings(table, OUTPUTS)
    more = re.match(r"b: reads (\S+) more than the median of the sensors of level .* Subtract that", named)
    assert float(more[1]) == pytest.approx(2.0, abs=0.05)
    table["b"] -= float(more[1])
    found = LinearModel.identify(table, inputs="u", outputs=OUTPUTS)
    assert not any("b: reads" in sentence for sentence in found.poor)


def test_of_two_sensors_both_are_named_with_their_distances_from_the_mean():
    table = record()
    table["b"] += 2.0
    named = readings(table, {"level": ["a", "b"]})
    less, more = (
        float(re.match(rf"{x}: reads (\S+) {way} than the mean of", sentence)[1])
        for x, way, sentence in zip("ab", ("less", "more"), named, strict=True)
    )
    assert less + more == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("start", [0.1, 0.3, 0.5])
def test_a_difference_that_changes_is_not_to_be_subtracted(start):
    """Sensor b drifts in a third of the part for learning, from 1 to 9, and returns to 1."""
    table = record()
    rows = slice(int(start * len(table)), int((start + 0.25) * len(table)))
    drift = np.ones(len(table))
    drift[rows] = np.linspace(1.0, 9.0, rows.stop - rows.start)
    table["b"] += drift
    (named,) = readings(table, OUTPUTS)
    least, largest = re.match(
        r"b: its difference .* changes: .* is from (\S+) to (\S+)\. .*do not subtract", named
    ).groups()
    assert float(least) == pytest.approx(1.0, abs=0.2)
    assert float(largest) > 5.0


@pytest.mark.parametrize(
    ("outputs", "words"),
    [
        ({}, "at least one quantity"),
        ({"level": ["a", "b"], "flow": "b"}, "name the column 'b' twice"),
        ({"level": ["a", "b", "e"]}, "'a' and 'e' are sensors of one quantity, but fewer than 40 rows"),
        ({"level": ["a", "f"]}, "follow from each other"),
    ],
)
def test_bad_outputs(outputs, words):
    table = record(800)
    table["e"], table["f"] = table["a"].where(table.index % 50 == 0), table["a"]
    with pytest.raises(ModelError, match=words):
        LinearModel.identify(table, inputs="u", outputs=outputs)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("first", [5.0, 0.0])
def test_a_difference_between_sensors_is_not_blamed_on_order_or_plant(first):
    """The difference is constant, or begins at 0. Without it, a model of order 2 has no deficiency."""
    table, outputs = record(), {"level": ["a", "b"], "flow": "d"}
    assert not LinearModel.identify(table, inputs="u", outputs=outputs, order=2).poor
    table["b"] += np.linspace(first, 5.0, len(table))
    with pytest.warns(PoorFitWarning):
        poor = LinearModel.identify(table, inputs="u", outputs=outputs, order=2).poor
    compared = [sentence for sentence in poor if "long autoregression" in sentence]
    assert [sentence[:2] for sentence in compared] == ["a:", "b:"]
    assert all(
        sentence.endswith("The difference between the sensors of level may be the cause.") for sentence in compared
    )
    assert not any("higher order" in sentence for sentence in poor)
    with pytest.warns(PoorFitWarning, match="d: on held-out data .* Try a higher order; else"):
        LinearModel.identify(table, inputs="u", outputs=outputs, order=1)


@pytest.mark.slow
@pytest.mark.parametrize("invalid", [False, True])
def test_a_drift_in_the_held_out_part_is_not_blamed_on_the_inputs(invalid):
    """The drift begins after the part for learning. A few cells with -9999 make the noise of their sensor very large."""
    table = record()
    begin = round(0.72 * len(table))
    table.loc[begin:, "b"] += np.linspace(0.0, 60.0, len(table) - begin)
    if invalid:
        table.loc[300:310, "a"] = -9999.0
    with pytest.warns(PoorFitWarning):
        poor = LinearModel.identify(table, inputs="u", outputs={"level": ["a", "b"], "flow": "d"}, order=2).poor
    assert sum("its difference from the mean of the sensors of level changes" in sentence for sentence in poor) == 2
    of_level = [sentence for sentence in poor if sentence.startswith(("a:", "b:"))]
    assert any(": the model explains -" in sentence for sentence in of_level)
    assert not any("inputs move it" in sentence or "higher order" in sentence for sentence in of_level)
