"""Beyond the paper: every learner in a family of faults, of which most are in no learner's list.

A user's faults are not those that a learner expects. So every learner runs every case of `family_cases`, all on the same noise,
and its error is compared with that of an oracle: fixed precision that is told which samples are faulty and leaves them out.
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
"""Times the oracle's error: a run with more has lost its plant, as one that could not go on."""
RESAMPLES = 2_000
"""Of the bootstrap: an interval's ends are then known to a few percent of its width."""
Learners = Mapping[str, controllers.PrecisionLearner]


class Runs(NamedTuple):
    """The runs of one learner in one case."""

    # Of shape (runs,): root-mean-square error of the goal output in each whole run; infinite if the run could not go on.
    rmse: Floats
    # All alarms of all sensors; None of a learner that says neither a probability nor a detection.
    alarms: Alarms | None


@experiment(
    Family,
    options="""
    cases : iterable of str or Case, optional
        Which cases: names or patterns as ``"freeze*"``, or cases of your own; by default all.
    learners : mapping of str to PrecisionLearner, or iterable of str, optional
        Learners by name, or names or patterns of those of the package; by default all.
    unseen : int, optional
        So many cases that are drawn at random instead, on which nothing has been tuned; see `unseen_cases`.""",
)
def run(
    ensemble: Ensemble,
    settings: Family,
    *,
    cases: Iterable[str | Case] | str | None = None,
    learners: Learners | Iterable[str] | str | None = None,
    unseen: int | None = None,
) -> Report:
    """Run learners in cases, the first run with the seed and each further one with the next.

    The settings say on which seeds learners are tuned and judged. It is an error if there are both unseen and other cases, the
    oracle itself loses the plant in a case, or a pattern fits no case or no learner (`UnknownNameError`).
    """
    known = chosen_learners(learners)
    chosen = chosen_cases(cases) if unseen is None else []
    if unseen is not None:
        check_size("unseen", unseen, 1, "of cases that are drawn")
        if cases is not None:
            raise ModelError("family got both unseen and cases; give one of them.")
    elif not chosen or not known:
        raise ModelError("family has no case or no learner to run; name one at least, or leave cases and learners out.")
    bench = _Bench(settings, ensemble, list(range(ensemble.seed, ensemble.seed + settings.runs)))
    if unseen is not None:
        chosen = bench.draw(unseen)
    oracle = bench.oracle(chosen)
    for case in chosen:
        if not np.isfinite(oracle[case.name].rmse).all():
            raise ModelError(
                f"The oracle loses the plant in the case {case.name!r}, so there is nothing to compare with; leave more sensors "
                "healthy, or make the faults shorter."
            )
    found = {name: bench.measure(name, chosen, learner) for name, learner in known.items()}
    table = {
        case.name: {name: _entry(found[name][case.name], oracle[case.name], settings.bar) for name in known}
        for case in chosen
    }
    report: dict[str, Any] = without_nan(
        {
            "settings": {
                "learners": {name: repr(learner) for name, learner in known.items()},
                "cases": {case.name: repr(case) for case in chosen},
            },
            "groups": {case.name: case.group for case in chosen},
            "oracle": {case.name: _rms(oracle[case.name].rmse) for case in chosen},
            "table": table,
            "summary": {name: _summary(name, table, settings) for name in known},
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
            raise ModelError(f"learners is {given!r}; it must have at least one precision learner, by its name.")
        return dict(given)
    known = all_learners()
    return {name: known[name] for name in _fitting("learner", given, list(known))}


def chosen_cases(given: Iterable[str | Case] | str | None) -> list[Case]:
    """Return cases, see `run`."""
    own = [] if given is None or isinstance(given, str) else [case for case in given if isinstance(case, Case)]
    names = given if given is None or isinstance(given, str) else [case for case in given if isinstance(case, str)]
    known = {case.name: case for case in CASES}
    fitting = [] if own and not names else _fitting("case", names, list(known))
    return [known[name] for name in fitting] + own


def _fitting(what: str, patterns: Iterable[str] | str | None, known: Sequence[str]) -> list[str]:
    """Return the names that one of the patterns fits, whatever the case of their letters, in the order of the names."""
    if patterns is None:
        return list(known)
    given = [patterns] if isinstance(patterns, str) else list(patterns)
    for pattern in given:
        if not any(fnmatchcase(name.lower(), pattern.lower()) for name in known):
            raise UnknownNameError(f"There is no {what} {pattern!r}; {did_you_mean(pattern, known)}")
    return [name for name in known if any(fnmatchcase(name.lower(), pattern.lower()) for pattern in given)]


@dataclass(frozen=True)
class _Bench:
    """Runs learners in cases."""

    settings: Family
    ensemble: Ensemble
    seeds: Sequence[int]

    def oracle(self, cases: Sequence[Case]) -> dict[str, Runs]:
        """Return all runs of the oracle by case."""
        return self.measure(ORACLE, cases, controllers.FixedPrecision(), told=True)

    def draw(self, count: int) -> list[Case]:
        """Return cases that are drawn at random, in each of which the oracle keeps the plant; others are drawn again."""
        drawn, kept = unseen_cases(self.settings.unseen_seed), list[Case]()
        while len(kept) < count:
            few = list(islice(drawn, count - len(kept)))
            oracle, healthy = self.oracle(few), self.oracle([replace(case, faults=()) for case in few])
            most = {name: self.settings.oracle_lost * _rms(runs.rmse) for name, runs in healthy.items()}
            kept += [case for case in few if (oracle[case.name].rmse <= most[case.name]).all()]
        return kept

    def measure(
        self, name: str, cases: Sequence[Case], learner: controllers.PrecisionLearner, *, told: bool = False
    ) -> dict[str, Runs]:
        """Return all runs of a learner by case; if `told`, the samples of faulty sensors are missing."""
        loops = {case.name: family_loop(case, learner, told=told) for case in cases}
        signal = None if told else alarm_signal(next(iter(loops.values())), learner)
        batches = {case.name: Batch(loops[case.name], self.seeds, partial(_run, case, signal)) for case in cases}
        every, _ = self.ensemble.each(name, batches, CHUNK)
        return {case: _pooled(parts) for case, parts in every.items()}


def alarm_signal(loop: cosim.Diagram, learner: controllers.PrecisionLearner) -> str | None:
    """Return the signal that tells of faults: a probability or a detection; None if a learner says neither."""
    if learner.why_no_probability is None:
        return "controller.fault_probability"
    detected = any(port.name == "detected" for port in learner.learner(_model(loop)).ports)
    return "controller.detected" if detected else None


def _model(loop: cosim.Diagram) -> controllers.LinearModel:
    return next(node.block for node in loop.nodes if node.name == "controller").model  # type: ignore[attr-defined, no-any-return]


def _run(case: Case, signal: str | None, loop: cosim.Diagram, seeds: Sequence[int]) -> Runs:
    """Make runs of one cell; one that cannot go on has lost its plant, and the others are made without it."""
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
    """Return what the report has of a cell; of runs that have lost their plant there is no ratio."""
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
    """Return in which cases a learner is at its worst, above the bar, and further behind the best one than allowed."""
    ratios = {case: ratio_of(cells[name]) for case, cells in table.items()}
    best = {case: min(ratio_of(cell) for cell in cells.values()) for case, cells in table.items()}
    worst = max(ratios, key=ratios.__getitem__)
    return {
        "worst": {"case": worst, "ratio": ratios[worst]},
        "mean": float(np.exp(np.mean(np.log(list(ratios.values()))))),
        "above_the_bar": [case for case, ratio in ratios.items() if ratio > settings.bar],
        "behind_the_best": [case for case, ratio in ratios.items() if ratio > best[case] + settings.behind],
    }
