"""A large stored campaign: the time to write it and to open and draw it, each in a separate process."""

from __future__ import annotations

import tempfile
from pathlib import Path

from bayesftc.bench._child import repeated
from bayesftc.bench._figures import Figure, Section
from bayesftc.cosim.base.extras import why_missing

RUNS = 10_000
PACKAGES = "zarr", "pyarrow", "jinja2"
SIGNALS = (
    *("plant.v", "reference.y", "freeze_0.y", "freeze_0.active", "controller.u", "controller.x_hat", "controller.beta"),
    "sensors.y",
)
"""Eight signals, some with two sensors."""
WRITE = """
import json, time
from bayesftc import controllers, cosim
from bayesftc.bench.measures.full_loop import EXPERIMENT, SETTING, full_diagram
from bayesftc.bench.measures.memory import peak
from bayesftc.bench.measures.report import SIGNALS

def campaign(seeds):
    learners = {{"gamma": controllers.GammaPrecision(forgetting=0.95), "fixed": controllers.FixedPrecision()}}
    return cosim.Campaign(
        full_diagram(), duration=EXPERIMENT * SETTING.step, seeds=seeds, record=SIGNALS,
        grid={{"controller.precision": learners, "freeze_0.start": [2.0, 4.0, 6.0, 8.0, 10.0]}},
        metrics=[cosim.RMSE("plant.v", "reference.y", shift=1, name="rmse")],
    )

campaign(1).run()  # loads the compiled code
began = time.perf_counter()
campaign({seeds}).run({folder!r})
print(json.dumps([time.perf_counter() - began, peak()]))
"""
DRAW = """
import json, time
began = time.perf_counter()
from bayesftc.bench.measures.memory import peak
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.report.page import report

page = report(CampaignStore.open({folder!r}))
print(json.dumps([time.perf_counter() - began, peak(), len(page)]))
"""


def measure(quick: bool = False) -> Section:
    """Write a campaign of 10,000 runs, eight signals and 1,000 steps, and draw its report."""
    runs = 200 if quick else RUNS
    with tempfile.TemporaryDirectory() as scratch:
        folder = str(Path(scratch) / "campaign")
        writing: list[list[float]] = []
        reason = why_missing(*PACKAGES, purpose="A stored campaign")
        if reason is None:
            writing, reason = repeated(WRITE.format(seeds=runs // 10, folder=folder))
        drawing: list[list[float]] = []
        if reason is None:
            drawing, reason = repeated(DRAW.format(folder=folder), 1 if quick else 3)
    written, memory = [seconds for seconds, _ in writing], [peak / 1e6 for _, peak in writing]
    drawn, meanwhile = [seconds for seconds, *_ in drawing], [peak / 1e6 for _, peak, _ in drawing]
    of = f"{runs} runs of 1000 steps, {len(SIGNALS)} signals"
    return Section(
        "report",
        "A stored campaign and its report",
        (
            Figure("write", f"{of}: run and written", "s", written, reason=reason),
            Figure("write_memory", "peak memory meanwhile", "MB", memory, reason=reason),
            Figure("report", f"{of}: opened and drawn", "s", drawn, at_most=60.0, reason=reason),
            Figure("report_memory", "peak memory meanwhile", "MB", meanwhile, at_most=2000.0, reason=reason),
        ),
    )
