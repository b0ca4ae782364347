"""Experiment 2: nine scenarios of fault and reference, every technique on the same noise (paper, section 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from bayesftc import controllers
from bayesftc.cosim.statistics import merit_counts, outcomes, total_merit
from bayesftc.reproduce import paper
from bayesftc.reproduce.experiments.detection import filterpy as _filterpy
from bayesftc.reproduce.experiments.tracking.bench import (
    ORACLE,
    PAPERS,
    REFERENCES,
    Bench,
    Errors,
    Measured,
    Scenario,
    effdi,
    summary,
    techniques,
)
from bayesftc.reproduce.experiments.tracking.oracle import over_oracle
from bayesftc.reproduce.settings import Car, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble
from bayesftc.reproduce.shared.residuals import SWITCHING
from bayesftc.reproduce.shared.runner import Report, experiment

CURVES = "injection/sine"
"""The scenario for which the paper shows the mean absolute error over time."""
USER_STEPS = 5_000
"""Steps for which the loop with fmpy and filterpy is timed."""


@experiment(Tracking, car=Car)
def run(ensemble: Ensemble, settings: Tracking, car: Car, *, beyond: bool) -> Report:
    """Run every technique in every scenario; all results but ``speed`` are the same for any number of jobs.

    Further techniques, faults of other sizes, and the comparison with the oracle are beyond the paper.
    """
    bench = Bench(settings, car, ensemble)
    learners = techniques(settings)
    papers = {name: learners[name] for name in PAPERS}
    learners = learners if beyond else papers
    headline = [Scenario(fault, r, size) for (fault, size), r in product(_headline(settings).items(), REFERENCES)]
    table = bench.measure("The paper's table", headline, papers)
    speed = _speed(table, ensemble.jobs)
    others = bench.measure("Further techniques", headline, {n: learners[n] for n in learners if n not in papers})
    oracle_runs = bench.measure("The oracle", headline, {ORACLE: controllers.FixedPrecision()}, drop_faulty=True)
    cells, further, oracle = table.errors(), others.errors(), oracle_runs.errors()
    everything = {s: cells[s] | further[s] for s in headline}
    of_papers, of_all = (
        merit_counts(list(errors.values()), names, settings.significance)
        for errors, names in ((cells, PAPERS), (everything, tuple(learners)))
    )
    curves = [part.runs[s] for part in (table, others, oracle_runs) for s in headline if s.kind == CURVES]
    return {
        "settings": {"techniques": {name: repr(learner) for name, learner in learners.items()}},
        "scenarios": {s.kind: {name: summary(e) for name, e in everything[s].items()} for s in headline},
        "merit": of_papers,
        "total_merit": total_merit(of_papers),
        "filterpy": _filterpy.track(bench, cells),
        "oracle": {s.kind: summary(oracle[s][ORACLE]) for s in headline},
        "paper": {"merit": paper.MERIT, "total_merit": paper.TOTAL_MERIT},
        "merit_of_all": of_all,
        "total_merit_of_all": total_merit(of_all),
        "lost": _lost(headline, everything, settings.significance),
        "mean_absolute_error": {name: r.absolute.tolist() for runs in curves for name, r in runs.items()},
        "grid": _grid(bench, cells, papers) if beyond else None,
        "over_oracle": over_oracle(bench, learners, [n for n in learners if n.startswith(SWITCHING)])
        if beyond
        else None,
        "speed": speed,
    }


def _speed(measured: Measured, jobs: int) -> dict[str, float]:
    """Return the closed-loop steps per second of our runs, and those of a loop with fmpy and filterpy."""
    from bayesftc.bench.measures.full_loop import user_rate

    ours, users = measured.steps / measured.seconds, user_rate(USER_STEPS)
    return {
        "steps": measured.steps,
        "seconds": measured.seconds,
        "jobs": jobs,
        "steps_per_second": ours,
        "user_loop_steps_per_second": users,
        "ratio": ours / users,
    }


def _headline(settings: Tracking) -> dict[str, float | None]:
    return {"freeze": None, "injection": settings.injection, "drift": settings.drift}


def _lost(
    scenarios: Sequence[Scenario], errors: Mapping[Scenario, Errors], significance: float
) -> dict[str, list[str]]:
    """Return the scenarios in which precision learning is significantly worse than others, with these techniques."""
    worse = {}
    for s in scenarios:
        rivals = [name for name in errors[s] if name != "PL"]
        lost = outcomes([errors[s]["PL"]] * len(rivals), [errors[s][name] for name in rivals], significance) < 0
        worse[s.kind] = [name for name, worst in zip(rivals, lost, strict=True) if worst]
    return {kind: names for kind, names in worse.items() if names}


def _grid(
    bench: Bench, measured: Mapping[Scenario, Errors], papers: Mapping[str, controllers.PrecisionLearner]
) -> dict[str, Any]:
    """Return the errors for faults of other sizes, and the merit table for each pair of sizes and duration of EF-FDI."""
    s = bench.settings
    injections, drifts = sorted({s.injection, *s.injections}), sorted({s.drift, *s.drifts})
    sizes = [("injection", size) for size in injections] + [("drift", size) for size in drifts]
    scenarios = [Scenario(fault, r, size) for (fault, size), r in product([("freeze", None), *sizes], REFERENCES)]
    others = {f"EF-FDI {d:g} s": effdi(s, d) for d in s.effdi_durations}
    sized = bench.measure("Faults of other sizes", [c for c in scenarios if c not in measured], papers)
    errors = sized.errors() | dict(measured)
    longer = bench.measure("EF-FDI of other durations", scenarios, others).errors()
    tables = []
    for injection, drift, column in product(injections, drifts, ("EF-FDI", *others)):
        chosen = [c for c in scenarios if c.size in {None, injection if c.fault == "injection" else drift}]
        cells = [errors[c] | {"EF-FDI": (errors[c] | longer[c])[column]} for c in chosen]
        table = merit_counts(cells, PAPERS, s.significance)
        duration = s.effdi_duration if column == "EF-FDI" else others[column].duration
        tables.append(
            {
                "injection": injection,
                "drift": drift,
                "effdi_duration": duration,
                "merit": table,
                "total_merit": total_merit(table),
            }
        )
    cells_of = {c.name: {n: summary(e) for n, e in (errors[c] | longer[c]).items()} for c in scenarios}
    return {"scenarios": cells_of, "tables": tables}
