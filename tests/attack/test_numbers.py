"""Numbers at the ends of double precision and beyond, in every place of a file; and sensors without noise."""

import json
import re

import numpy as np
import pytest
from documents import LEARNERS, LOOP, scenario
from harness import Case

from bayesftc import controllers

EXTREMES = ("1e300", "-1e300", "1e18", "1000000000000000000", "1e-300", "9" * 400, "-0.0", "nan")
NUMBER = re.compile(r"(?<![\w.\"])[-+]?\d[\w.+-]*")
MATRIX = re.compile(r"\[\[.*\]\]")
RAGGED = ("[[1.0], [1.0, 2.0]]", "[[1.0, 2.0], 3.0]", "[[], []]", "[[[1.0]]]", "[[1.0], []]")


def places(text):
    """Yield a text with an extreme number or a ragged matrix in each of the places that have one."""
    for pattern, values in ((NUMBER, EXTREMES), (MATRIX, RAGGED)):
        for match in pattern.finditer(text):
            for value in values:
                yield f"{value[:30]} for {match[0]}", text[: match.start()] + value + text[match.end() :]


def untold(outcome):
    """Return what a run prints that is no number without a word about it."""
    if outcome.code != 0:
        return []
    numbers = json.loads(outcome.out)
    bad = [
        f"{what} of {name}"
        for what in ("tracking", "belief")
        for name, v in numbers[what].items()
        if v["overall"] is None
    ]
    return [] if numbers["notes"] or numbers["stopped"] else bad


@pytest.mark.parametrize("count", [2, pytest.param(500, marks=pytest.mark.slow)])
def test_extremes_in_every_place(line, chance, count):
    found = []
    documents = [(text, list(places(text))) for text in (LOOP, *(scenario(chance) for _ in range(count // 20)))]
    for i in range(count):
        text, ways = documents[i % len(documents)]
        name, content = ways[int(chance.integers(len(ways)))]
        outcome = line.run(Case(("run", "case.toml", "--json"), {"case.toml": content}))
        wrong = outcome.wrong or untold(outcome)
        if wrong:
            found.append(f"{name}: {wrong}\n{outcome.err[-900:]}\n{text}")
    assert not found, "\n".join(found)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("learner", LEARNERS)
def test_two_sensors_that_agree_without_noise(line, learner):
    """Their samples are equal to the last bit, and the model believes in a variance of 1e-30."""
    text = LOOP.replace("std = 1.0", "std = 0.0").replace("sensor_covariance = 1.0", "sensor_covariance = 1e-30")
    text = text.replace(
        'precision = { kind = "FixedPrecision" }', f"initial_mean = 0.0\n[controller.precision]\n{learner}"
    )
    outcome = line.run(
        Case(("run", "case.toml", "--json"), {"case.toml": re.sub(r"(?s)\[\[faults\]\].*?(?=\[ref)", "", text)})
    )
    assert outcome.wrong == "", outcome.err
    if outcome.code == 0:
        belief = json.loads(outcome.out)["belief"]["y"]["overall"]
        assert belief < 1e-6, belief


@pytest.mark.parametrize("R", [1e-30, 1e-60, 1e40])
@pytest.mark.parametrize("precision", [cls() for cls in controllers.LEARNERS], ids=lambda p: type(p).__name__)
def test_an_estimate_is_what_two_equal_sensors_say(precision, R):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], R, R, 0.02)
    step = controllers.StateEstimator(model, precision, initial_mean=5.0, initial_covariance=R).online(compiled=False)
    for _ in range(40):
        out = step(y=[5.0, 5.0], u=25.0)  # which holds it
        assert all(np.isfinite(out[name]).all() for name in ("x_hat", "P"))
    assert abs(out.x_hat[0] - 5.0) < 1e-9
