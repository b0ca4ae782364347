"""Sizes that nobody means: refused or done, in a minute and two gigabytes."""

import numpy as np
import pytest
from documents import LOOP
from harness import Case
from test_files import CAMPAIGN, MONITOR, SAMPLES

pytestmark = pytest.mark.slow

MANY_FAULTS = '[[faults]]\nkind = "Freeze"\nstart = 0.04\n'
MODE = "{ kind = 'Offset' }, "
LEARNER = 'precision = { kind = "FixedPrecision" }'


def changed(old, new, text=LOOP):
    assert old in text
    return text.replace(old, new)


SCENARIOS = {
    "a thousand million sensors": changed("count = 2", "count = 1000000000"),
    "a million sensors": changed("count = 2", "count = 1000000"),
    "a hundred thousand faults": changed(MANY_FAULTS, MANY_FAULTS * 100_000),
    "a run of 30,000 years": changed("duration = 0.2", "duration = 1e12"),
    "a run of a picosecond": changed("duration = 0.2", "duration = 1e-12"),
    "steps of a femtosecond": LOOP.replace("dt = 0.02", "dt = 1e-15"),
    "a decimation beyond the run": changed("duration = 0.2", "duration = 0.2\ndecimation = 1000000000000"),
    "a long window": changed(LEARNER, 'precision = { kind = "GammaPrecision", window = 1000000000, forgetting = 0.9 }'),
    "many iterations": changed(LEARNER, 'precision = { kind = "VariationalBayesKF", iterations = 1000000000 }'),
    "a thousand modes": changed(LEARNER, f"precision = {{ kind = 'SwitchingPrecision', modes = [{MODE * 1000}] }}"),
    "a long delay": changed('kind = "Freeze"', 'kind = "Delay"\ndelay = 1e9'),
    "a table of a hundred thousand": changed(
        '"Constant"\nvalue = 20.0', f'"Table"\ntimes = {list(range(10**5))}\nvalues = {[1] * 10**5}'
    ),
    "a thousand states": changed("A = [[0.999]]", f"A = {np.eye(1000).tolist()}"),
    "lists within lists": changed("[[0.999]]", "[" * 100_000 + "]" * 100_000),
    "a long name": changed('"Constant"', f'"{"x" * 10**7}"'),
}
CAMPAIGNS = {
    "a thousand million runs": changed("seeds = 2", "seeds = 1000000000", CAMPAIGN),
    "a piece beyond the campaign": changed("piece = 3", "piece = 1000000000000", CAMPAIGN),
    "a thousand million points": CAMPAIGN + changed("count = 2", "count = 1000000000", SAMPLES),
    "a hundred million points": changed("[0.5, 1.0]", str(list(range(1, 10_001))), CAMPAIGN)
    + f'"faults[0].start" = {[0.02 * k for k in range(10_000)]}\n',
}
RECORDINGS = {  # made by the test, and not by each process that collects it: a hundred megabytes
    "a million columns": lambda: "t," + ",".join(f"s{i}" for i in range(10**6)) + "\n" + ("1," * 10**6 + "1\n") * 3,
    "steps of a thousand years": lambda: "t,a,b,c\n0,1,1,1\n1e12,1,1,1\n",
    "a long cell": lambda: "t,a,b,c\n0,1,1,1\n1," + "1" * 10**7 + ",1,1\n",
    "a long line": lambda: "t,a,b,c\n0,1,1,1\n1" + "," * 10**7 + "\n",
    "one line": lambda: "x" * 10**8,
}


def check(line, case):
    outcome = line.run(case)
    assert outcome.wrong == "", outcome.err[-1500:]


SLOW = {
    "a hundred thousand faults",
    "a thousand modes",
    "a hundred thousand rows",
    "a million columns",
    "a thousand states",
    "one line",
}


def named(cases):
    return [
        pytest.param(content, id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name, content in cases.items()
    ]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("text", named(SCENARIOS))
def test_scenarios(line, text):
    check(line, Case(("run", "case.toml", "--json"), {"case.toml": text}))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("text", named(CAMPAIGNS))
def test_campaigns(line, text):
    pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
    check(
        line,
        Case(
            ("campaign", "case.toml", "--out", "store", "--json"),
            {"case.toml": text, "loop.toml": LOOP},
            leaves=("store",),
        ),
    )


@pytest.mark.sampled(1)
@pytest.mark.parametrize("text", named(RECORDINGS))
def test_recordings(line, text):
    check(
        line,
        Case(("monitor", "data.csv", "--model", "model.toml", "--json"), {"model.toml": MONITOR, "data.csv": text()}),
    )
