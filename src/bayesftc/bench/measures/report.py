"""A large stored campaign: how fast it is written, opened and drawn, each in a process of its own."""

from __future__ import annotations

import tempfile
from pathlib import Path

from bayesftc.bench._child import ChildError, run_code
from bayesftc.bench._figures import Figure, Section

RUNS = 10_000
SIGNALS = (
    "plant.v", "reference.y", "freeze_0.y", "freeze_0.active", "controller.u", "controller.x_hat", "controller.beta",
    "sensors.y",
)  # fmt: skip
"""Eight signals, some of them of two sensors."""
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
    written: list[float] = []
    memory: list[float] = []
    drawn: list[float] = []
    drawing: list[float] = []
    reason = None
    with tempfile.TemporaryDirectory() as scratch:
        folder = str(Path(scratch) / "campaign")
        try:
            seconds, peak = run_code(WRITE.format(seeds=runs // 10, folder=folder)).said
            written, memory = [seconds], [peak / 1e6]
            for _ in range(1 if quick else 3):
                seconds, peak, _ = run_code(DRAW.format(folder=folder)).said
                drawn.append(seconds)
                drawing.append(peak / 1e6)
        except ChildError as error:
            reason = str(error)
    of = f"{runs} runs of 1000 steps, {len(SIGNALS)} signals"
    return Section(
        "report",
        "A stored campaign and its report",
        (
            Figure("write", f"{of}: run and written", "s", written, reason=reason),
            Figure("write_memory", "peak memory meanwhile", "MB", memory, reason=reason),
            Figure("report", f"{of}: opened and drawn", "s", drawn, at_most=60.0, reason=reason),
            Figure("report_memory", "peak memory meanwhile", "MB", drawing, at_most=2000.0, reason=reason),
        ),
    )
