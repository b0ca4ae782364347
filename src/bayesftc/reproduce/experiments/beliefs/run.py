"""Beyond the paper: the effect of wrong settings of `SwitchingPrecision`.

In practice the frequency, length and size of faults are not known. Each row multiplies or divides some of the settings by a
factor. It is compared with the row of unchanged settings: by the tracking error with faults of all kinds and sizes, and by the
fault probabilities on the detection experiment's streams. A further part has coarse sensors with a right or wrong resolution in
the settings. Another part has settings that are learned from streams without labels of faults.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesftc import controllers
from bayesftc.cosim.statistics import rms_ratio
from bayesftc.reproduce.experiments.beliefs.streams import (
    DEFAULTS,
    LEARNED,
    TOLD,
    Learners,
    Scores,
    account,
    learn,
    score,
)
from bayesftc.reproduce.experiments.tracking.bench import ORACLE, Bench, Errors, Scenario
from bayesftc.reproduce.settings import Beliefs, Car, Detection, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble
from bayesftc.reproduce.shared.residuals import PER_SENSOR, SWITCHING, switching
from bayesftc.reproduce.shared.runner import Report, experiment
from bayesftc.reproduce.shared.streams import Streams

FORMS = {SWITCHING: True, PER_SENSOR: False}
"""Whether each form is the joint form."""
UNCHANGED = "unchanged"
"""The row with unchanged settings."""
SETTINGS = {
    "to fault": ("time_to_fault",),
    "recovery": ("time_to_recovery",),
    "times": ("time_to_fault", "time_to_recovery"),
    "sizes": ("jump", "slope"),
}
"""The wrong settings of a row, by its name."""
COARSE_SETTINGS = {"resolution": ("resolution",)}
"""The same for coarse sensors."""

Table = dict[str, dict[str, Any]]
"""Entries by row and cell."""


@experiment(Beliefs, tracking=Tracking, detection=Detection, car=Car)
def run(ensemble: Ensemble, settings: Beliefs, tracking: Tracking, detection: Detection, car: Car) -> Report:
    """Run rows of wrong settings, with the runs of `tracking` and the streams of `detection`."""
    tracking = tracking.of_size(settings.runs)
    fine = Bench(tracking, car, ensemble)
    coarse = replace(fine, car=replace(car, resolution=settings.resolution))
    errors, oracle = _tracked(fine, settings.reference, settings.faults, {f: learners(settings, f) for f in FORMS})
    at_coarse, oracle_at_coarse = _tracked(
        coarse, settings.reference, settings.coarse_faults, {f: coarse_learners(settings, f) for f in FORMS}
    )
    scores, learned = _detected(Streams(detection, car), ensemble, settings)
    return {
        "settings": {"tracking": tracking.to_dict()},
        "oracle": oracle,
        "errors": errors,
        "coarse": {"oracle": oracle_at_coarse, "errors": at_coarse},
        "worst": {form: _worst([errors[form], at_coarse[form]]) for form in FORMS},
        "detection": scores,
        "learned": learned,
    }


def wrong(
    learner: controllers.SwitchingPrecision, factor: float, of: Mapping[str, Sequence[str]] = SETTINGS
) -> dict[str, controllers.SwitchingPrecision]:
    """Return a learner unchanged, and for each row the learner with settings multiplied and divided by a factor.

    The settings are those of all modes of sensors, actuators and the process. Modes without a row's settings stay unchanged.
    """

    def times(names: Sequence[str], by: float) -> controllers.SwitchingPrecision:
        def changed(modes: Sequence[Any]) -> list[Any]:
            return [replace(m, **{n: by * getattr(m, n) for n in names if hasattr(m, n)}) for m in modes]

        return replace(
            learner,
            modes=changed(learner.modes),
            actuator_modes=changed(learner.actuator_modes),
            process_modes=changed(learner.process_modes) if learner.joint else learner.process_modes,
        )

    rows = {UNCHANGED: learner}
    for name, settings in of.items():
        rows |= {f"{name} x {factor:g}": times(settings, factor), f"{name} / {factor:g}": times(settings, 1.0 / factor)}
    return rows


def default(joint: bool) -> controllers.SwitchingPrecision:
    """Return a form with its default settings."""
    return controllers.SwitchingPrecision(joint=joint)


def learners(settings: Beliefs, form: str) -> Learners:
    """Return the rows of a form, about its default settings."""
    return wrong(default(FORMS[form]), settings.factor)


def coarse_learners(settings: Beliefs, form: str) -> Learners:
    """Return the rows of a form with a right or wrong resolution of coarse sensors."""
    start = default(FORMS[form])
    modes = [
        replace(m, resolution=settings.resolution) if isinstance(m, controllers.Frozen) else m for m in start.modes
    ]
    return wrong(replace(start, modes=modes), settings.factor, COARSE_SETTINGS)


def _tracked(
    bench: Bench, reference: str, faults: Iterable[tuple[str, float]], forms: Mapping[str, Learners]
) -> tuple[dict[str, Table], dict[str, float]]:
    """Return for each form the errors of all rows relative to the oracle and the unchanged row, and the oracle's in m/s."""
    scenarios = {_title(fault, size): Scenario(fault, reference, size or None) for fault, size in faults}
    cells = list(scenarios.values())
    oracles = bench.measure("The oracle", cells, {ORACLE: controllers.FixedPrecision()}, drop_faulty=True).errors()
    found = {form: bench.measure(form, cells, rows).errors() for form, rows in forms.items()}
    table: dict[str, Table] = {
        form: {
            row: {c: _entry(found[form][cell], row, oracles[cell][ORACLE]) for c, cell in scenarios.items()}
            for row in rows
        }
        for form, rows in forms.items()
    }
    return table, {c: float(np.sqrt(np.mean(oracles[cell][ORACLE] ** 2))) for c, cell in scenarios.items()}


def _entry(errors: Errors, row: str, oracle: Any) -> dict[str, Any]:
    over = rms_ratio(errors[row], errors[UNCHANGED])
    return {**rms_ratio(errors[row], oracle), "over_unchanged": over["ratio"], "over_unchanged_ci": over["ratio_ci"]}


def _title(fault: str, size: float) -> str:
    return f"{fault} {size:g}" if size else fault


def _worst(tables: Iterable[Table]) -> dict[str, Any]:
    """Return the entry with the largest ratio to its unchanged row, with the names of its row and cell."""
    entries = [
        {"row": row, "cell": cell, **entry}
        for table in tables
        for row, cells in table.items()
        for cell, entry in cells.items()
    ]
    return max(entries, key=lambda entry: float(entry["over_unchanged"]))


def _detected(
    source: Streams, ensemble: Ensemble, settings: Beliefs
) -> tuple[dict[str, Scores], dict[str, dict[str, Any]]]:
    """Return for each form the scores of all rows on streams, and the modes learned from other streams with their scores.

    Both parts are compared with the unchanged row, which has the true mean times.
    """
    learned = learn(source, ensemble, settings, {form: default(joint) for form, joint in FORMS.items()})
    forms: dict[str, dict[str, Learners]] = {}
    for form, joint in FORMS.items():
        alike = wrong(switching(source.settings, joint), settings.factor) | {DEFAULTS: default(joint)}
        forms[form] = {row: dict.fromkeys(learned[form], learner) for row, learner in alike.items()}
        forms[form][LEARNED] = {size: modes.precision for size, modes in learned[form].items()}
    scores, results = score(source, ensemble, settings, forms), {}
    for form, rows in scores.items():
        compared = {row: rows.pop(row) for row in (DEFAULTS, LEARNED)} | {TOLD: rows[UNCHANGED]}
        results[form] = {"scores": compared, "fits": {size: account(modes) for size, modes in learned[form].items()}}
    return scores, results
