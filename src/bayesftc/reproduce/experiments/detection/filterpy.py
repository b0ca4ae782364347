"""The SER baseline with filterpy's Kalman filter, compared with ours: in the loop of tracking, on the samples of detection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers import SERFDI, ser_reference
from bayesftc.reproduce.shared import residuals as _residuals
from bayesftc.reproduce.shared.car import model
from bayesftc.reproduce.shared.streams import Faults
from bayesftc.reproduce.shared.tables import listed

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bayesftc.reproduce.experiments.detection.run import Bench as DetectionBench
    from bayesftc.reproduce.experiments.tracking.bench import Bench as TrackingBench, Errors, Scenario

SER_FT = "SER FT"
"""The technique's name in the tracking experiment."""


def track(bench: TrackingBench, ours: Mapping[Scenario, Errors]) -> dict[str, Any]:
    """Return the tracking errors of the first runs of each scenario with filterpy's filter in the loop, and ours.

    The entries are ``runs``, and for each scenario ``ours`` and ``filterpy`` (means over these runs in m/s) and
    ``largest_difference`` (of a run, relative).
    """
    s = bench.settings
    runs = min(s.runs, s.filterpy_runs)
    fewer = replace(bench, settings=replace(s, runs=runs))
    learner = SERFDI(threshold=s.ser_threshold, filter="filterpy")
    theirs = fewer.measure("SER by filterpy", list(ours), {SER_FT: learner}).errors()
    cells = {}
    for scenario, errors in theirs.items():
        first, reference = ours[scenario][SER_FT][:runs], errors[SER_FT]
        cells[scenario.kind] = {
            "ours": float(first.mean()),
            "filterpy": float(reference.mean()),
            "largest_difference": float(np.max(np.abs(first / reference - 1.0))),
        }
    return {"runs": runs, "scenarios": cells}


def detect(bench: DetectionBench, faults: Faults, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Return the AUC of the innovation of filterpy's filter on the samples of the SER baseline's loop, and ours.

    The entries for each stream are ``seed``, ``ours`` and ``filterpy`` (AUC on the test part), and ``largest_difference`` of an
    innovation, in standard deviations of a sensor.
    """
    s, car = bench.settings, bench.car
    residual = _residuals.ser(s)
    loop = bench.loop(faults, residual.learners[0])
    samples = f"fault_{car.sensors - 1}.y"
    found = []
    for seed, stream in zip(
        seeds, bench.source.run(loop, seeds, (*_residuals.SIGNALS, samples, "controller.u")), strict=True
    ):
        reference = ser_reference(
            model(car),
            stream.result[samples],
            stream.result["controller.u"],
            threshold=s.ser_threshold,
            initial_mean=s.offset,
            initial_covariance=car.initial_variance,
        )
        difference = np.abs(stream.result["controller.innovation"] - reference.innovation) / car.sensor_variance**0.5
        theirs = deepcopy(stream)
        theirs.result["controller.innovation"][:] = reference.innovation
        found.append(
            {
                "seed": seed,
                "ours": bench.area(residual, [stream]),
                "filterpy": bench.area(residual, [theirs]),
                "largest_difference": float(difference.max()),
            }
        )
    return found


def show_tracking(report: Mapping[str, Any]) -> RenderableType:
    """Return the table of the tracking errors with filterpy and ours."""
    return listed(
        f"SER FT with filterpy's Kalman filter in the loop, on the same noise: root-mean-square tracking error (m/s), mean over "
        f"the first {report['runs']} runs, and the largest relative difference of a run",
        report["scenarios"],
        [(SER_FT, "{ours:.3f}"), ("filterpy", "{filterpy:.3f}"), ("difference", "{largest_difference:.0e}")],
        corner="fault/reference",
    )


def show_detection(streams: Sequence[Mapping[str, Any]]) -> RenderableType:
    """Return the table of the AUC with filterpy and ours."""
    return listed(
        "SER with filterpy's Kalman filter on the same samples: AUC on the test part, and the largest difference of an "
        "innovation in standard deviations of a sensor",
        dict(enumerate(streams)),
        [("SER", "{ours:.4f}"), ("filterpy", "{filterpy:.4f}"), ("difference", "{largest_difference:.0e}")],
        corner="stream",
    )
