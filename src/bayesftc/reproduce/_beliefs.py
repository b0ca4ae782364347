"""Beyond the paper: how wrong the settings of `SwitchingPrecision` may be.

Nobody knows how often sensors will fail, for how long and by how much. So each row multiplies or divides some of the settings by
a factor, and is compared with the row in which they are as they were: by the tracking error with faults of all kinds and sizes,
and by the fault probabilities on the detection experiment's streams. A further part has coarse sensors, whose resolution is
known rightly or wrongly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.probabilities import reliability
from bayesftc.reproduce._car import model
from bayesftc.reproduce._ensemble import Ensemble, Progress
from bayesftc.reproduce._residuals import SWITCHING, switching
from bayesftc.reproduce._roc import auc as area
from bayesftc.reproduce._statistics import interval, rms_ratio
from bayesftc.reproduce._streams import Faults, Streams
from bayesftc.reproduce._tracking_bench import ORACLE, Bench, Errors, Scenario
from bayesftc.reproduce.settings import Beliefs, Car, Detection, Tracking

FORMS = {SWITCHING: True, f"{SWITCHING}, per sensor": False}
"""By name whether it is the joint form."""
UNCHANGED = "unchanged"
"""The row whose settings are as they were."""
PROBABILITY = "controller.fault_probability"
SETTINGS = {
    "to fault": ("time_to_fault",),
    "recovery": ("time_to_recovery",),
    "times": ("time_to_fault", "time_to_recovery"),
    "sizes": ("jump", "slope"),
}
"""What is wrong in a row, and the settings of the modes that this means."""
COARSE_SETTINGS = {"resolution": ("resolution",)}
"""The same where sensors are coarse."""

Learners = Mapping[str, controllers.SwitchingPrecision]
"""By the name of the row."""
Table = dict[str, dict[str, Any]]
"""By row and cell."""


def run(
    *,
    seed: int = 0,
    jobs: int = 1,
    runs: int | None = None,
    beyond: bool = True,
    settings: Beliefs | None = None,
    tracking: Tracking | None = None,
    detection: Detection | None = None,
    car: Car | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and return what ``beliefs.json`` holds.

    Parameters
    ----------
    seed : int
        Seed of all noise and faults.
    jobs : int
        Number of threads; the results are the same to the last bit for any.
    runs : int, optional
        Runs of each cell of tracking errors, instead of the settings'.
    beyond : bool
        Without effect, for nothing here is in the paper.
    settings, tracking, detection, car : Beliefs, Tracking, Detection, Car, optional
        Other settings than those of `bayesftc.reproduce.settings`; `tracking` has those of the runs, `detection` those of the
        streams.
    progress : callable, optional
        Called as ``progress(what, done, of)``.

    Raises
    ------
    ModelError
        If a seed, a number of jobs or a number of runs cannot be one.
    """
    settings, detection, car = Beliefs.of(settings, runs), detection or Detection(), car or Car()
    tracking = (tracking or Tracking()).of_size(settings.runs)
    ensemble = Ensemble(seed, jobs, progress)
    fine = Bench(tracking, car, ensemble)
    coarse = replace(fine, car=replace(car, resolution=settings.resolution))
    errors, oracle = _tracked(fine, settings.reference, settings.faults, {f: learners(settings, car, f) for f in FORMS})
    at_coarse, oracle_at_coarse = _tracked(
        coarse, settings.reference, settings.coarse_faults, {f: coarse_learners(settings, car, f) for f in FORMS}
    )
    return {
        "settings": {
            "seed": seed,
            **settings.to_dict(),
            "tracking": tracking.to_dict(),
            "detection": detection.to_dict(),
            "car": car.to_dict(),
        },
        "oracle": oracle,
        "errors": errors,
        "coarse": {"oracle": oracle_at_coarse, "errors": at_coarse},
        "worst": {form: _worst([errors[form], at_coarse[form]]) for form in FORMS},
        "detection": _detected(Streams(detection, car), ensemble, settings),
        "paper": {},
    }


def wrong(
    learner: controllers.SwitchingPrecision, car: Car, factor: float, of: Mapping[str, Sequence[str]] = SETTINGS
) -> dict[str, controllers.SwitchingPrecision]:
    """Return a learner as it is, and for each row with settings of all its modes multiplied and divided by a factor.

    Parameters
    ----------
    learner : SwitchingPrecision
        Whose settings they are.
    car : Car
        Whose actuator may fail.
    factor : float
        By how much they are wrong.
    of : mapping
        The settings of each row; modes without one stay as they are.
    """
    actuators = learner.actuator_modes_of(model(car))

    def times(names: Sequence[str], by: float) -> controllers.SwitchingPrecision:
        def changed(modes: Sequence[Any]) -> list[Any]:
            return [replace(m, **{n: by * getattr(m, n) for n in names if hasattr(m, n)}) for m in modes]

        return replace(learner, modes=changed(learner.modes), actuator_modes=changed(actuators))

    rows = {UNCHANGED: learner}
    for name, settings in of.items():
        rows |= {f"{name} x {factor:g}": times(settings, factor), f"{name} / {factor:g}": times(settings, 1.0 / factor)}
    return rows


def learners(settings: Beliefs, car: Car, form: str) -> Learners:
    """Return the rows of a form, about its default settings."""
    return wrong(controllers.SwitchingPrecision(joint=FORMS[form]), car, settings.factor)


def coarse_learners(settings: Beliefs, car: Car, form: str) -> Learners:
    """Return the rows of a form that knows the resolution of coarse sensors, rightly or wrongly."""
    default = controllers.SwitchingPrecision(joint=FORMS[form])
    told = [
        replace(m, resolution=settings.resolution) if isinstance(m, controllers.Frozen) else m for m in default.modes
    ]
    return wrong(replace(default, modes=told), car, settings.factor, COARSE_SETTINGS)


def _tracked(
    bench: Bench, reference: str, faults: Iterable[tuple[str, float]], forms: Mapping[str, Learners]
) -> tuple[dict[str, Table], dict[str, float]]:
    """Return for each form the errors of all rows over the oracle's and over the unchanged row's, and the oracle's in m/s."""
    scenarios = {_title(fault, size): Scenario(fault, reference, size or None) for fault, size in faults}
    cells = list(scenarios.values())
    oracles = bench.measure("The oracle", cells, {ORACLE: controllers.FixedPrecision()}, told=True).errors()
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
    """Return the entry that is largest over that of its unchanged row, with the names of its row and cell."""
    entries = [
        {"row": row, "cell": cell, **entry}
        for table in tables
        for row, cells in table.items()
        for cell, entry in cells.items()
    ]
    return max(entries, key=lambda entry: float(entry["over_unchanged"]))


def _detected(source: Streams, ensemble: Ensemble, settings: Beliefs) -> dict[str, Table]:
    """Return for each form, row and size of the faults AUC and calibration error; the unchanged row knows the true times."""
    rows = {
        form: wrong(switching(source.settings, joint), source.car, settings.factor) for form, joint in FORMS.items()
    }
    sizes = {_sizes(*size): Faults(*size) for size in settings.sizes}
    cells = [(form, row, size) for form in FORMS for row, size in product(rows[form], sizes)]
    own = {size: ensemble.seeds(f"beliefs/{size}", settings.streams) for size in sizes}
    every, _ = ensemble.each(
        "Streams",
        [source.loop(sizes[size], rows[form][row]) for form, row, size in cells],
        [own[size] for *_, size in cells],
        1,
        partial(_judged, source),
    )
    table: dict[str, Table] = {form: {row: {} for row in rows[form]} for form in FORMS}
    for (form, row, size), streams in zip(cells, every, strict=True):
        areas, errors = np.array([judged for few in streams for judged in few]).T
        table[form][row][size] = {
            name: {"mean": float(v.mean()), "ci": interval(v)} for name, v in (("auc", areas), ("ece", errors))
        }
    return table


def _sizes(injection: float, drift: float) -> str:
    return f"injection {injection:g}, drift {drift:g}"


def _judged(source: Streams, loop: cosim.Diagram, seeds: Sequence[int]) -> list[tuple[float, float]]:
    """Return AUC and expected calibration error of the fault probabilities of each stream."""
    found, rows = [], slice(source.settings.skipped, None)
    for stream in source.run(loop, seeds, [PROBABILITY]):
        probability, faulty = stream.result[PROBABILITY][rows], stream.faulty[rows]
        error = reliability(probability, faulty, bins=source.settings.bins).calibration_error
        found.append((area(faulty, probability), error))
    return found
