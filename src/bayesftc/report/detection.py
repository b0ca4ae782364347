"""How well faults were detected: receiver operating characteristics, delay against false alarms, the reliability diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.report.svg import COLOURS, INK, figure, legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.block import Floats
    from bayesftc.report.contents import Contents

RUNS = 200
"""Runs of each level that are looked at, evenly chosen: more would not be seen."""
SCORES = ("fault_probability", "beta")
"""Outputs of a controller that tell of faults, the better first."""


class Detection:
    """Scores and truth of some runs of each level of the compared factor.

    Attributes
    ----------
    score_name : str
        The signal that ranks samples.
    runs : dict
        For each level the scores and the truth, both of shape (runs, steps, sensors).
    """

    def __init__(self, score_name: str, runs: dict[Any, tuple[Floats, Any]], step: float):
        self.score_name, self.runs, self.step = score_name, runs, step

    @property
    def is_probability(self) -> bool:
        """Whether the score is a probability."""
        return self.score_name.endswith(SCORES[0])


def read_detection(contents: Contents) -> Detection | None:
    """Return what was recorded of faults and of their detection; None if that does not suffice."""
    roles, known = contents.description.get("roles", {}), contents.store.metadata.signals
    faults = sorted({name for chain in roles.get("faults_of_sensors", []) for name in chain})
    scores = [f"{roles.get('controller')}.{name}" for name in SCORES]
    scores = [name for name in scores if name in known]
    active = [f"{name}.active" for name in faults]
    if not faults or not set(active) <= set(known):
        return None
    for score in scores:
        runs = _read(contents, score, active, roles["faults_of_sensors"])
        kept = {level: (s, t) for level, (s, t) in runs.items() if np.isfinite(s).any() and t.any() and not t.all()}
        if kept:
            time = contents.store.time
            return Detection(score, kept, float(time[1] - time[0]) if len(time) > 1 else 1.0)
    return None


def _read(contents: Contents, score: str, active: list[str], chains: list[list[str]]) -> dict[Any, tuple[Floats, Any]]:
    chosen: dict[int, Any] = {}
    for level in contents.levels():
        rows = contents.runs_of(level)
        good = rows["run"][rows["status"] == "ok"].tolist()
        places: Any = np.unique(np.linspace(0, len(good) - 1, min(len(good), RUNS)).astype(int)) if good else []
        chosen |= {good[int(i)]: level for i in places}
    found: dict[Any, list[tuple[Floats, Any]]] = {}
    for piece, signals in contents.store.pieces_of_signals([score, *active]):
        for run in range(piece.begin, piece.end):
            if run not in chosen:
                continue
            own = {name: values[run - piece.begin] for name, values in signals.items()}
            scores = own[score].reshape(len(own[score]), -1)
            truth = [[_of(own[f"{name}.active"]) for name in chain] for chain in chains]
            columns = [np.any(flags, axis=0) if flags else np.zeros(len(scores), bool) for flags in truth]
            if len(columns) == scores.shape[1]:
                found.setdefault(chosen[run], []).append((scores, np.stack(columns, axis=1)))
    return {level: (np.array([s for s, _ in runs]), np.array([t for _, t in runs])) for level, runs in found.items()}


def _of(flags: Floats) -> Any:
    return flags.reshape(len(flags), -1).any(axis=1)


def roc_figure(detection: Detection) -> tuple[Figure, str]:
    """Return the curves of all levels: found faults against false alarms, and delay against false alarms an hour."""
    from bayesftc.cosim.statistics import delay_curve, roc

    made, (left, right) = figure(3.2, 1, 2)
    for (level, (score, truth)), colour in zip(detection.runs.items(), COLOURS, strict=False):
        curve = roc(score, truth)
        name = "" if level is None else f"{level}: "
        left.fill_between(curve.false_positive_rate, curve.lower, curve.upper, color=colour, alpha=0.18, lw=0)
        left.plot(
            curve.false_positive_rate,
            curve.true_positive_rate_pooled,
            color=colour,
            lw=1.5,
            label=f"{name}AUC {curve.auc:.3f}",
        )
        delays = delay_curve(score, truth, step=detection.step)
        right.plot(delays["false_alarms_per_hour"], delays["median_delay"], color=colour, lw=1.5)
    left.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    left.set(xlabel="false positive rate", ylabel="true positive rate", xlim=(0, 1), ylim=(0, 1.01))
    right.set_xscale("log")
    right.set(xlabel="false alarms per hour and sensor", ylabel="median detection delay (s)")
    legend(left)
    n = max(len(score) for score, _ in detection.runs.values())
    return made, (
        f"Detection by {detection.score_name}, of up to {n} runs of each: samples found against false positives (left, with the "
        "95 % band over runs), delay against false alarms at all thresholds (right)."
    )


def reliability_figure(detection: Detection) -> tuple[Figure, str] | None:
    """Return the reliability diagram of all levels; None where the score is no probability."""
    from bayesftc.cosim.statistics import calibration

    if not detection.is_probability:
        return None
    made, (axis,) = figure(3.2)
    axis.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    for (level, (score, truth)), colour in zip(detection.runs.items(), COLOURS, strict=False):
        found = calibration(score, truth, equal="widths")
        p, share = found.pooled.predicted, found.pooled.observed
        bars = np.clip([share - found.observed_low, found.observed_high - share], 0.0, None)
        name = "" if level is None else f"{level}: "
        axis.errorbar(
            p, share, yerr=bars, fmt="o-", ms=4, lw=1.2, color=colour, capsize=3,
            label=f"{name}calibration error {found.pooled.calibration_error:.3f}",
        )  # fmt: skip
    axis.set(xlabel="fault probability", ylabel="share of samples with the fault", xlim=(0, 1), ylim=(0, 1.01))
    axis.set_aspect("equal")
    legend(axis)
    return (
        made,
        "Reliability of the fault probability: on the dotted line it says what happens; 95 % intervals over runs.",
    )


__all__ = ["Detection", "read_detection", "reliability_figure", "roc_figure"]
