"""Scenario, campaign, model and recording files that are damaged, odd or nonsense."""

import re

import numpy as np
import pytest
from documents import LOOP, scenario
from harness import Case
from mutations import damaged, mutated, number

pytestmark = pytest.mark.slow

CAMPAIGN = """scenario = "loop.toml"
seeds = 2
piece = 3
record = ["plant.y", "controller.x_hat"]
duration = 0.1
[[metrics]]
kind = "rmse"
signal = "plant.y"
reference = "reference.y"
shift = 1
name = "rmse"
start = 0.02
[[metrics]]
kind = "max_absolute_error"
signal = "plant.y"
reference = "reference.y"
[factors]
"sensors.std" = [0.5, 1.0]
"part.limiter.rising" = [5.0]
[factors."controller.precision"]
gamma = { kind = "gamma_precision", forgetting = 0.9 }
fixed = { kind = "fixed_precision" }
"""
SAMPLES = """[[samples]]
kind = "latin_hypercube"
count = 2
seed = 3
ranges = { "model.process_covariance" = [0.001, 0.01] }
"""
MONITOR = """dt = 0.1
time = "t"
invalid = [-9999.0]
[model]
kind = "RandomWalk"
std = 0.1
initial_mean = 5.0
initial_std = 1.0
[sensors.a]
std = 0.1
unit = "m"
resolution = 0.01
[sensors.b]
std = 0.1
bias = 0.05
delay = 0.01
[sensors.c]
std = 0.2
invalid = [0.0]
[alarm]
threshold = 0.9
hold = 0.5
[precision]
kind = "SwitchingPrecision"
modes = [{ kind = "Frozen" }, { kind = "Offset", jump = 1.0 }]
"""
CELLS = (
    "",
    " ",
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1e400",
    "5e-324",
    "9" * 400,
    "1,5",
    '"',
    '"a',
    "true",
    "abc",
    "1;2",
    "é💥",
    "\0",
    "-",
    "0x10",
)


def few(slow):
    return [1, pytest.param(slow, marks=pytest.mark.slow)]


def check(line, cases):
    failures = line.failures(cases)
    assert not failures, f"{len(failures)}:\n" + "\n".join(failures)


def recording(rng):
    """Return a CSV file of three sensors."""
    t = 0.1 * np.arange(60)
    level = 5.0 + np.cumsum(0.02 * rng.standard_normal(60))
    rows = (
        f"{now:.1f}," + ",".join(f"{level[k] + 0.1 * rng.standard_normal():.3f}" for _ in "abc")
        for k, now in enumerate(t)
    )
    return "t,a,b,c\n" + "\n".join(rows) + "\n"


def spoilt(text, rng):
    """Return a CSV file with one to three mutations."""
    rows = [row.split(",") for row in text.splitlines()]
    for _ in range(rng.geometric(0.5)):
        way, k, other = int(rng.integers(8)), int(rng.integers(len(rows))), int(rng.integers(len(rows)))
        i = int(rng.integers(max(len(rows[k]), 1)))
        if way < 3 and rows[k]:
            rows[k][i] = str(rng.choice(CELLS)) if rng.random() < 0.6 else number(rng)
        elif way == 3:
            del rows[k][i:]
        elif way == 4:
            rows[k] = rows[k] * 2
        elif way == 5:
            rows[k], rows[other] = rows[other], rows[k]
        elif way == 6:
            rows.insert(k, list(rows[other]))
        elif i < 4:
            for row in rows[1:]:
                row[i : i + 1] = [str(rng.choice(CELLS[:8]))]
    data = "\n".join(",".join(row) for row in rows).encode()
    if rng.random() < 0.1:
        data = data.decode().encode(str(rng.choice(["utf-16", "utf-8-sig", "latin-1"])), errors="replace")
    return damaged(data, rng) if rng.random() < 0.1 else data


@pytest.mark.parametrize("count", few(1200))
def test_scenarios(line, chance, count):
    files = ({"case.toml": mutated(scenario(chance), chance)} for _ in range(count))
    check(line, ((f"{i}", Case(("run", "case.toml", "--json"), content)) for i, content in enumerate(files)))


@pytest.mark.parametrize("count", few(250))
def test_campaigns(line, chance, count):
    pytest.importorskip("zarr", reason="stores need the extra 'campaign'")

    def cases():
        for i in range(count):
            text = CAMPAIGN + (SAMPLES if chance.random() < 0.3 else "")
            campaign = re.sub(
                rb"(?m)^(count|seeds) = \d[\d_]{2,}$", rb"\1 = 40", mutated(text, chance)
            )  # else hours of runs
            files = {"case.toml": campaign, "loop.toml": LOOP}
            yield f"{i}", Case(("campaign", "case.toml", "--out", "store", "--json"), files, leaves=("store",))

    check(line, cases())


@pytest.mark.parametrize("count", few(300))
def test_model_files_of_monitors(line, chance, count):
    data = recording(chance)
    files = ({"model.toml": mutated(MONITOR, chance), "data.csv": data} for _ in range(count))
    arguments = ("monitor", "data.csv", "--model", "model.toml", "--json")
    check(line, ((f"{i}", Case(arguments, content)) for i, content in enumerate(files)))


@pytest.mark.parametrize("count", few(350))
def test_recordings(line, chance, count):
    def cases():
        for i in range(count):
            files = {"model.toml": MONITOR, "data.csv": spoilt(recording(chance), chance)}
            known = ("--model", "model.toml")
            yield (
                f"{i}",
                Case(
                    (
                        "monitor",
                        "data.csv",
                        "--json",
                        *(known if chance.random() < 0.7 else ("--fit", "--model", "new.toml")),
                    ),
                    files,
                    leaves=("new.toml",),
                ),
            )

    check(line, cases())


def rewritten(text, rng):
    """Return the same scenario, written otherwise."""
    head, *sections = re.split(r"(?m)^(?=\[)", text)
    alone = [s for s in sections if not s.startswith("[[")]
    others = [s for s in sections if s.startswith("[[")]  # of which the order counts
    text = head + "".join([alone[i] for i in rng.permutation(len(alone))] + others)
    text = re.sub(r"(?m)^([\w]+) = (\d+\.\d+)$", lambda m: f"  {m[1]}   =\t{float(m[2]):.17e} # as before", text)
    text = text.replace("\n", "\r\n") if rng.random() < 0.5 else text.replace("\n[", "\n\n# next\n[")
    return ("\ufeff" if rng.random() < 0.5 else "") + text


@pytest.mark.parametrize("count", few(60))
def test_what_means_the_same_gives_the_same_numbers(line, chance, count):
    for i in range(count):
        text = scenario(chance)
        outcomes = [
            line.run(Case(("run", "case.toml", "--json"), {"case.toml": content}))
            for content in (text, rewritten(text, chance))
        ]
        assert [o.code for o in outcomes] == [0, 0], (i, [o.err for o in outcomes])
        assert outcomes[0].out == outcomes[1].out, i
