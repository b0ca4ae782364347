"""Beyond the paper: every learner with a family of faults, most of which no learner models.

Real faults differ from those that a learner models. So every learner runs every case of `CASES`, all on the same noise, and its
error is compared with that of an oracle: fixed precision without the faulty samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import ModelError, SimulationError, UnknownNameError, did_you_mean
from bayesftc.cosim.judging.alarms import Alarms, judge_alarms
from bayesftc.cosim.judging.metrics import NAN, rmse, without_nan
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.run.repeat import repeat
from bayesftc.cosim.statistics import rms_ratio
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.family.cases import CASES, PLANTS, Case
from bayesftc.reproduce.experiments.family.groups import ratio_of
from bayesftc.reproduce.experiments.family.loop import family_loop, faulty_samples, goal_error, signals_of_goals
from bayesftc.reproduce.experiments.family.unseen import unseen_cases
from bayesftc.reproduce.experiments.tracking.bench import CHUNK, ORACLE, all_alarms
from bayesftc.reproduce.settings import Family, check_size
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import PER_SENSOR, SWITCHING
from bayesftc.reproduce.shared.runner import Report, experiment

LOST = 1e9
"""Multiple of the oracle's error at which a run has lost its plant, like a run that stopped."""
RESAMPLES = 2_000
"""Number of bootstrap samples: the ends of an interval are then known to a few percent of its width."""
Learners = Mapping[str, controllers.PrecisionLearner]


class Runs(NamedTuple):
    """The runs of one learner in one case."""

    # Of shape (runs,): root-mean-square error of the goal output in each run; infinite if the run stopped.
    rmse: Floats
    # All alarms of all sensors; None for a learner without a probability or a detection.
    alarms: Alarms | None


@experiment(
    Family,
    options="""
    cases : iterable of str or Case, optional
        Names or patterns such as ``"freeze*"``, or your own cases; by default all.
    learners : mapping of str to PrecisionLearner, or iterable of str, optional
        Learners by name, or names or patterns of the package's learners; by default all.
    unseen : int, optional
        Number of random cases to use instead, which were not used for tuning; see `unseen_cases`.""",
)
def run(
    ensemble: Ensemble,
    settings: Family,
    *,
    cases: Iterable[str | Case] | str | None = None,
    learners: Learners | Iterable[str] | str | None = None,
    unseen: int | None = None,
) -> Report:
    """Run learners in cases, the first run with the seed and each further run with the next seed.

    The settings have the seeds for tuning and for evaluating learners. It is an error if both unseen and other cases are given,
    if the oracle itself loses the plant in a case, or if a pattern matches no case or learner (`UnknownNameError`).
    """
    named_learners = chosen_learners(learners)
    chosen = chosen_cases(cases) if unseen is None else []
    if unseen is not None:
        check_size("unseen", unseen, 1, "the number of random cases")
        if cases is not None:
            raise ModelError("family has both unseen and cases. Give only one of them.")
    elif not chosen or not named_learners:
        raise ModelError("family has no case or no learner to run. Name at least one, or leave out cases and learners.")
    bench = _Bench(settings, ensemble, list(range(ensemble.seed, ensemble.seed + settings.runs)))
    if unseen is not None:
        chosen = bench.draw(unseen)
    oracle = bench.oracle(chosen)
    for case in chosen:
        if not np.isfinite(oracle[case.name].rmse).all():
            raise ModelError(
                f"The oracle loses the plant in the case {case.name!r}, so there is nothing to compare with. Leave more sensors "
                "healthy, or make the faults shorter."
            )
    found = {name: bench.measure(name, chosen, learner) for name, learner in named_learners.items()}
    table = {
        case.name: {name: _entry(found[name][case.name], oracle[case.name], settings.bar) for name in named_learners}
        for case in chosen
    }
    report: dict[str, Any] = without_nan(
        {
            "settings": {
                "learners": {name: repr(learner) for name, learner in named_learners.items()},
                "cases": {case.name: repr(case) for case in chosen},
            },
            "groups": {case.name: case.group for case in chosen},
            "oracle": {case.name: _rms(oracle[case.name].rmse) for case in chosen},
            "table": table,
            "summary": {name: _summary(name, table, settings) for name in named_learners},
        }
    )
    return report


def all_learners() -> dict[str, controllers.PrecisionLearner]:
    """Return every learner of the package with its default settings, by its class name."""
    first = {SWITCHING: controllers.SwitchingPrecision(), PER_SENSOR: controllers.SwitchingPrecision(joint=False)}
    return first | {cls.__name__: cls() for cls in controllers.LEARNERS if cls.__name__ != SWITCHING}


def chosen_learners(given: Learners | Iterable[str] | str | None) -> dict[str, controllers.PrecisionLearner]:
    """Return learners by name, see `run`."""
    if isinstance(given, Mapping):
        if not given or not all(isinstance(learner, controllers.PrecisionLearner) for learner in given.values()):
            raise ModelError(f"learners is {given!r}. It must have at least one precision learner, by its name.")
        return dict(given)
    named_learners = all_learners()
    return {name: named_learners[name] for name in _fitting("learner", given, list(named_learners))}


def chosen_cases(given: Iterable[str | Case] | str | None) -> list[Case]:
    """Return cases, see `run`."""
    own_cases = [] if given is None or isinstance(given, str) else [case for case in given if isinstance(case, Case)]
    names = given if given is None or isinstance(given, str) else [case for case in given if isinstance(case, str)]
    cases_by_name = {case.name: case for case in CASES}
    fitting = [] if own_cases and not names else _fitting("case", names, list(cases_by_name))
    return [cases_by_name[name] for name in fitting] + own_cases


def _fitting(what: str, patterns: Iterable[str] | str | None, names: Sequence[str]) -> list[str]:
    """Return the names that match one of the patterns, ignoring case, in the order of the names."""
    if patterns is None:
        return list(names)
    given = [patterns] if isinstance(patterns, str) else list(patterns)
    for pattern in given:
        if not any(fnmatchcase(name.lower(), pattern.lower()) for name in names):
            raise UnknownNameError(f"There is no {what} {pattern!r}; {did_you_mean(pattern, names)}")
    return [name for name in names if any(fnmatchcase(name.lower(), pattern.lower()) for pattern in given)]


@dataclass(frozen=True)
class _Bench:
    """Runs of learners in cases."""

    settings: Family
    ensemble: Ensemble
    seeds: Sequence[int]

    def oracle(self, cases: Sequence[Case]) -> dict[str, Runs]:
        """Return all runs of the oracle by case."""
        return self.measure(ORACLE, cases, controllers.FixedPrecision(), drop_faulty=True)

    def draw(self, count: int) -> list[Case]:
        """Return random cases; those in which the oracle loses the plant are replaced."""
        drawn, kept = unseen_cases(self.settings.unseen_seed), list[Case]()
        while len(kept) < count:
            few = list(islice(drawn, count - len(kept)))
            oracle, healthy = self.oracle(few), self.oracle([replace(case, faults=()) for case in few])
            most = {name: self.settings.oracle_lost * _rms(runs.rmse) for name, runs in healthy.items()}
            kept += [case for case in few if (oracle[case.name].rmse <= most[case.name]).all()]
        return kept

    def measure(
        self, name: str, cases: Sequence[Case], learner: controllers.PrecisionLearner, *, drop_faulty: bool = False
    ) -> dict[str, Runs]:
        """Return all runs of a learner by case; with `drop_faulty`, the samples of faulty sensors are missing."""
        loops = {case.name: family_loop(case, learner, drop_faulty=drop_faulty) for case in cases}
        signal = None if drop_faulty else alarm_signal(next(iter(loops.values())), learner)
        batches = {case.name: Batch(loops[case.name], self.seeds, partial(_run, case, signal)) for case in cases}
        every, _ = self.ensemble.each(name, batches, CHUNK)
        return {case: _pooled(parts) for case, parts in every.items()}


def alarm_signal(loop: cosim.Diagram, learner: controllers.PrecisionLearner) -> str | None:
    """Return the signal that indicates faults, a probability or a detection; None if a learner has neither."""
    if learner.why_no_probability is None:
        return "controller.fault_probability"
    detected = any(port.name == "detected" for port in learner.learner(_model(loop)).ports)
    return "controller.detected" if detected else None


def _model(loop: cosim.Diagram) -> controllers.LinearModel:
    return next(node.block for node in loop.nodes if node.name == "controller").model  # type: ignore[attr-defined, no-any-return]


def _run(case: Case, signal: str | None, loop: cosim.Diagram, seeds: Sequence[int]) -> Runs:
    """Make runs of one cell; a run that stops has lost its plant, and the others are repeated without it."""
    try:
        return _judged(case, loop, seeds, signal)
    except SimulationError:
        if len(seeds) > 1:
            return _pooled([_run(case, signal, loop, [seed]) for seed in seeds])
        return Runs(np.array([np.inf]), None)


def _judged(case: Case, loop: cosim.Diagram, seeds: Sequence[int], signal: str | None) -> Runs:
    duration, names = PLANTS[case.plant].duration, (*signals_of_goals(case), *([signal] if signal else []))
    errors, alarms = [], []
    for result in repeat(loop, duration, seeds, names):
        errors.append(rmse(goal_error(case, result)))
        if signal:
            truth, step = faulty_samples(case, result.time), float(result.step)
            alarms.append(judge_alarms(result[signal], truth, threshold=ALARM, step=step))
    return Runs(np.array(errors), all_alarms(alarms))


def _pooled(parts: Sequence[Runs]) -> Runs:
    return Runs(np.concatenate([part.rmse for part in parts]), all_alarms(part.alarms for part in parts))


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _entry(runs: Runs, oracle: Runs, bar: float) -> dict[str, Any]:
    """Return the report's entry of a cell, without a ratio if a run has lost its plant."""
    lost = int((~(runs.rmse < LOST * oracle.rmse)).sum())
    nothing = {"ratio": NAN, "ratio_ci": [NAN, NAN], "n": len(runs.rmse)}
    entry = nothing if lost else rms_ratio(runs.rmse, oracle.rmse, resamples=RESAMPLES)
    alarms = runs.alarms
    return {
        **entry,
        "lost": lost,
        "above_share": float(np.mean(~(runs.rmse <= bar * oracle.rmse))),
        "false_share": NAN if alarms is None else alarms.false_share,
        "delay": NAN if alarms is None else alarms.delay() * alarms.step,
        "missed_share": NAN if alarms is None else alarms.missed_share,
    }


def _summary(name: str, table: Mapping[str, Mapping[str, Any]], settings: Family) -> dict[str, Any]:
    """Return a learner's worst case, the cases above the bar, and those where it is too far behind the best learner."""
    ratios = {case: ratio_of(cells[name]) for case, cells in table.items()}
    best = {case: min(ratio_of(cell) for cell in cells.values()) for case, cells in table.items()}
    worst = max(ratios, key=ratios.__getitem__)
    return {
        "worst": {"case": worst, "ratio": ratios[worst]},
        "mean": float(np.exp(np.mean(np.log(list(ratios.values()))))),
        "above_the_bar": [case for case, ratio in ratios.items() if ratio > settings.bar],
        "behind_the_best": [case for case, ratio in ratios.items() if ratio > best[case] + settings.behind],
    }
