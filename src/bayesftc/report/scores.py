"""The scores of controllers and the true faults of sensors in a stored campaign, for the figures of detection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import OK
from bayesftc.cosim.campaign.runs.truth import FAULTY, MISSING
from bayesftc.cosim.judging.metrics import samples_in_faults
from bayesftc.cosim.judging.signals import ALARM, SCORES, SensorSignals

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats
    from bayesftc.report.contents import Contents

RUNS = 200
"""Largest number of runs of each level, drawn at random; more would not change the figures visibly."""
FAILED, HEALTHY = "all runs failed", "no sensor has a fault"
"""Reasons why a level has no curve that say nothing about its detection."""


@dataclass(frozen=True)
class Level:
    """Scores and truth of some runs of a level of the compared factor."""

    score_name: str  # the signal that ranks samples
    # One array per run, of shape (steps, sensors).
    score: list[Floats]
    truth: list[Any]
    seeds: list[int]  # one per run; runs with the same seed have the same noise
    of: int  # number of complete runs, of which at most `RUNS` are drawn
    seen_as_missing: list[int]  # number of faults of each sensor whose samples are all missing
    # 1 at a fault-free step with an alarm, else 0; NaN during faults and where a due sample is missing.
    blamed: list[Floats]

    @property
    def is_probability(self) -> bool:
        """Whether the score is a probability."""
        return self.score_name.endswith(SCORES[0])

    @property
    def drawn(self) -> bool:
        """Whether not all complete runs were read."""
        return self.of > RUNS

    def by_seed(self) -> tuple[list[Floats], list[Any]]:
        """Return scores and truth, with the runs of a seed joined: intervals count seeds, because only these are independent."""
        place: dict[int, list[int]] = {}
        for i, seed in enumerate(self.seeds):
            place.setdefault(seed, []).append(i)
        return tuple(
            [np.concatenate([all_[i] for i in runs]) for runs in place.values()] for all_ in (self.score, self.truth)
        )  # type: ignore[return-value]


@dataclass(frozen=True)
class Found:
    """The detection of the levels of the compared factor, and why the others have none."""

    levels: dict[Any, Level]
    without: dict[Any, str]

    def __bool__(self) -> bool:
        return bool(self.levels)


@dataclass(frozen=True)
class _Run:
    """The scores of a run, without those of missing samples, and its true faults."""

    scores: dict[str, Floats]
    truth: Any
    faults: int
    seen_as_missing: list[int]  # of each sensor
    seed: int
    blamed: dict[str, Floats]  # of each score

    def valid(self, score: str) -> Any:
        """Return the samples with a score; None if it has no column for each sensor."""
        values = self.scores[score]
        return np.isfinite(values) if values.shape == self.truth.shape else None


def recorded_scores(contents: Contents) -> list[str]:
    """Return the recorded outputs of the controller that rank samples, in order of preference."""
    return [
        name
        for name in (f"{contents.controller}.{score}" for score in SCORES)
        if name in contents.store.metadata.signals
    ]


def read_detection(contents: Contents) -> Found:
    """Return recorded scores and true faults of each level for which these suffice."""
    scores, found = recorded_scores(contents), Found({}, {})
    if not scores or FAULTY not in contents.store.metadata.signals:
        return found
    runs_of_levels = _read(contents, scores)
    for level in contents.drawn():
        runs, good = runs_of_levels.get(level, []), int((contents.runs_of(level)["status"] == OK).sum())
        why = [_why_not(runs, score) if good else FAILED for score in scores]
        if "" not in why:
            found.without[level] = why[0]
            continue
        name = scores[why.index("")]
        fit = [run for run in runs if (valid := run.valid(name)) is not None and valid.any()]
        found.levels[level] = Level(
            name,
            [run.scores[name] for run in fit],
            [run.truth for run in fit],
            [run.seed for run in fit],
            good,
            [sum(counts) for counts in zip(*(run.seen_as_missing for run in fit), strict=True)],
            [run.blamed[name] for run in fit],
        )
    return found


def _why_not(runs: list[_Run], score: str) -> str:
    """Return why a score gives no curve; nothing if it does."""
    if not runs:
        return "the diagram is no closed loop with sensors, so that their true faults are not known"
    if not any(run.truth.any() for run in runs):
        return HEALTHY
    what = "fault probability" if score.endswith(SCORES[0]) else SCORES[1]
    valid = [(run, run.valid(score)) for run in runs]
    valid = [(run, where) for run, where in valid if where is not None and where.any()]
    if not valid:
        return f"the controller gives no {what}"
    faults = sum(run.faults for run in runs)
    if faults == sum(sum(run.seen_as_missing) for run in runs):
        return f"all faults ({faults}) are seen as missing samples, which need no detector"
    truth = np.concatenate([run.truth[where] for run, where in valid])
    if not truth.any():
        return f"no sample with a fault has a {what}"
    if truth.all():
        return f"no sample without a fault has a {what}"
    values = np.concatenate([run.scores[score][where] for run, where in valid])
    return "" if np.ptp(values) > 0 else f"the {what} is {values[0]:.3g} in all samples"


def _read(contents: Contents, scores: list[str]) -> dict[Any, list[_Run]]:
    """Return some complete runs of each level; of a point whose true faults are not known, none."""
    chosen: dict[int, tuple[Any, int]] = {}
    rng = np.random.default_rng(0)
    for level in contents.drawn():
        rows = contents.runs_of(level)
        rows = rows[rows["status"] == OK]
        if len(rows) > RUNS:
            rows = rows.iloc[np.sort(rng.choice(len(rows), RUNS, replace=False))]
        chosen |= {int(run): (level, int(seed)) for run, seed in zip(rows["run"], rows["seed"], strict=True)}
    runs: dict[Any, list[_Run]] = {}
    for piece, signals in contents.store.pieces_of_signals([*scores, FAULTY, MISSING]):
        for run in range(piece.begin, piece.end):
            if run not in chosen:
                continue
            level, seed = chosen[run]
            of_run = {name: values[run - piece.begin] for name, values in signals.items()}
            if not np.isnan(of_run[FAULTY]).any():
                runs.setdefault(level, []).append(_judged(of_run, scores, seed))
    return runs


def _judged(signals: dict[str, Floats], scores: list[str], seed: int) -> _Run:
    """Return a run with the definitions of `bayesftc.cosim.judging.metrics`: a missing sample counts in no figure."""
    faulty, missing = signals[FAULTY] > 0, signals[MISSING] > 0
    ranks = {name: signals[name].reshape(len(faulty), -1).copy() for name in scores}
    sensors = [
        SensorSignals(i, np.where(column, np.nan, 0.0), None, None, None, None) for i, column in enumerate(missing.T)
    ]
    apart = faulty | np.transpose([sensor.lost for sensor in sensors])
    blamed = {
        name: np.where(apart | np.isnan(values), np.nan, values >= ALARM)
        for name, values in ranks.items()
        if values.shape == missing.shape
    }
    for name in blamed:
        ranks[name][missing] = np.nan
    faults = [samples_in_faults(*column) for column in zip(faulty.T, ~missing.T, strict=True)]
    unseen = [sum(not len(samples) for samples in of_sensor) for of_sensor in faults]
    return _Run(ranks, faulty, sum(map(len, faults)), unseen, seed, blamed)


__all__ = ["FAILED", "HEALTHY", "Found", "Level", "read_detection", "recorded_scores"]
