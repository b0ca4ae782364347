"""Differences of the fault probabilities of `SwitchingPrecision` from the exact ones, by mode, on short sequences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from bayesftc import controllers
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.probabilities.exact import (
    Kind,
    Regressed,
    Shifted,
    Silent,
    Stuck,
    World,
    on_a_grid,
    probabilities,
)
from bayesftc.reproduce.settings import Probabilities
from bayesftc.reproduce.shared.ensemble import Ensemble

NEVER = 1e15
"""Mean time in seconds to an offset that only the joint form needs, which has no hypotheses without one."""
PERIOD = 10
"""Period of an oscillation in samples."""
JOINT, APART = "joint", "per sensor"
DEFAULT, OFTEN = "default times", "frequent faults"


@dataclass(frozen=True)
class Row:
    """A mode, and the kind of fault for the exact probability."""

    mode: controllers.FaultMode  # with its default times
    # From the mode to the kind of fault; None for an unknown noise, which is summed over a grid.
    kind: Callable[[Any], Kind] | None

    def exact(self, world: World, samples: Floats) -> Floats:
        """Return the exact fault probabilities of a sequence."""
        if self.kind is None:
            return on_a_grid(world, self.mode, samples)  # type: ignore[arg-type]
        return probabilities(world, self.kind(self.mode), samples)

    @property
    def forms(self) -> dict[str, controllers.SwitchingPrecision]:
        """The forms of the learner with only this mode, with known noise and without process modes."""
        mode = self.mode
        alone = isinstance(mode, controllers.Offset) or mode.own_hypothesis
        beside = () if alone else (controllers.Offset(NEVER),)
        common = controllers.SwitchingPrecision((mode, *beside), duration_shape=inf, noise_factor=1.0, process_modes=())
        forms = {JOINT: common}
        return forms if mode.joint_only else forms | {APART: replace(common, modes=(mode,), joint=False)}


ROWS: Mapping[str, Row] = {
    "Frozen(healthy_repeats=0)": Row(controllers.Frozen(healthy_repeats=0.0), Stuck),
    "Frozen": Row(controllers.Frozen(), Stuck),
    "Offset": Row(controllers.Offset(), Shifted),
    "Offset, as large as seen": Row(controllers.Offset(), partial(Shifted, as_large_as_seen=True)),
    "Drifting(slope=0.5)": Row(controllers.Drifting(slope=0.5), Shifted),
    "Ramping": Row(controllers.Ramping(), Shifted),
    "Unmodelled": Row(controllers.Unmodelled(), Regressed),
    "Noisier": Row(controllers.Noisier(), None),
    "DroppedOut": Row(controllers.DroppedOut(), Silent),
}
"""The compared modes by name; `Offset` twice: with the size of its settings, and at least as large as its first innovation."""


def paces(settings: Probabilities, row: Row) -> dict[str, Row]:
    """Return a row with the default mean times, and with those of frequent faults."""
    fault, recovery = settings.often
    often = replace(row.mode, time_to_fault=fault, time_to_recovery=recovery)
    return {DEFAULT: row, OFTEN: replace(row, mode=often)}


def distances(
    settings: Probabilities, model: controllers.LinearModel, mean: float, ensemble: Ensemble
) -> dict[str, dict[str, Any]]:
    """Return for each row, pace and form the differences between our fault probabilities and the exact ones.

    The model has a scalar state with the given mean at the start; its variance is that of a filter in the steady state. The
    entries by row, pace and form are ``largest`` and ``rms``; ``by_size``, the same for each size of the fault; and ``between``,
    the share of the failing sensor's samples with an exact probability from .05 to .95.
    """
    sizes, variance = dict(settings.sizes), settled_variance(model)
    cells = [(name, pace, row) for name, plain in ROWS.items() for pace, row in paces(settings, plain).items()]
    tasks: list[Callable[[], dict[str, Any]]] = []
    for _, _, row in cells:
        mode = type(row.mode).__name__
        sequences = {
            size: [
                sequence(settings, model, row.mode, size, mean, variance, seed)
                for seed in ensemble.seeds(f"probabilities/{mode}/{size:g}", settings.sequences)
            ]
            for size in sizes[mode]
        }
        tasks.append(partial(_compared, row, model, mean, variance, sequences))
    table: dict[str, dict[str, Any]] = {name: {} for name in ROWS}
    for (name, pace, _), found in zip(cells, ensemble.run(tasks, "Exact probabilities"), strict=True):
        table[name][pace] = found
    return table


def settled_variance(model: controllers.LinearModel) -> float:
    """Return the variance of a filter's prediction of a scalar state in the steady state."""
    decay, added = (float(model.matrix(name)[0, 0]) for name in ("A", "process_covariance"))
    information = float((1 / np.diag(model.matrix("sensor_covariance"))).sum())
    variance, before = added, 0.0
    while abs(variance - before) > 1e-12 * variance:
        before, variance = variance, decay**2 / (1 / variance + information) + added
    return variance


def sequence(
    settings: Probabilities,
    model: controllers.LinearModel,
    mode: controllers.FaultMode,
    size: float,
    mean: float,
    variance: float,
    seed: int,
) -> Floats:
    """Return the samples of a sequence, of shape (samples, sensors); the first sensor fails if the size is not 0."""
    rng, steps = np.random.default_rng(seed), settings.samples
    decay, added = (float(model.matrix(name)[0, 0]) for name in ("A", "process_covariance"))
    deviations = np.sqrt(np.diag(model.matrix("sensor_covariance")))
    begin = int(rng.integers(1, steps - 1))
    end = int(rng.integers(begin + 2, steps + 1)) if size else begin
    x, samples = mean + variance**0.5 * rng.normal(), np.zeros((steps, len(deviations)))
    for k in range(steps):
        samples[k] = x + deviations * rng.normal(size=len(deviations))
        noise, repeats = rng.normal(size=2), rng.random() < 0.9
        if begin <= k < end:
            samples[k, 0] = _failed(mode, size, samples[:, 0], k, begin, x, deviations[0], noise, repeats)
        x = decay * x + added**0.5 * rng.normal()
    return samples


def _failed(
    mode: controllers.FaultMode,
    size: float,
    samples: Floats,
    k: int,
    begin: int,
    x: float,
    deviation: float,
    noise: Floats,
    repeats: bool,
) -> float:
    """Return the sample of a failed sensor."""
    if isinstance(mode, controllers.Frozen):
        return float(samples[k - 1] + (not repeats) * mode.dither * deviation * (noise[0] - noise[1]))
    if isinstance(mode, controllers.DroppedOut):
        return float(np.nan)
    if isinstance(mode, controllers.Noisier):
        return float(x + size * deviation * noise[0])
    if isinstance(mode, controllers.Unmodelled):
        return float(samples[k] + size * deviation * np.sin(2 * np.pi * (k - begin + 1) / PERIOD))
    grows = 1 if mode.jump > 0 else k - begin + 1  # type: ignore[attr-defined]
    return float(samples[k] + size * deviation * grows)


def _compared(
    row: Row, model: controllers.LinearModel, mean: float, variance: float, sequences: Mapping[float, Sequence[Floats]]
) -> dict[str, Any]:
    """Return the differences of both forms from the exact probabilities."""
    forms = row.forms
    one = next(iter(forms.values()))
    world = World.of(model, replace(one, modes=(row.mode,)), mean, variance)
    exact = {size: np.array([row.exact(world, samples) for samples in of]) for size, of in sequences.items()}
    middle = [(p[..., 0] > 0.05) & (p[..., 0] < 0.95) for p in exact.values()]
    found: dict[str, Any] = {"between": float(np.mean(middle))}
    for form, precision in forms.items():
        estimator = controllers.StateEstimator(model, precision, initial_mean=mean, initial_covariance=variance)
        apart = {size: _ours(estimator, of) - exact[size] for size, of in sequences.items()}
        found[form] = {
            **_sizes_of(np.array(list(apart.values()))),
            "by_size": {f"{size:g}": _sizes_of(values) for size, values in apart.items()},
        }
    return found


def _ours(estimator: controllers.StateEstimator, sequences: Sequence[Floats]) -> Floats:
    """Return the fault probabilities of an estimator, of shape (sequences, samples, sensors)."""
    step = estimator.online(compiled=False)  # compilation would take longer than these few samples
    control, probability = np.zeros(estimator.model.controls), []
    for samples in sequences:
        step.reset()
        probability.append([step(y=y, u=control).fault_probability.copy() for y in samples])
    return np.array(probability)


def _sizes_of(apart: Floats) -> dict[str, float]:
    return {"largest": float(np.abs(apart).max()), "rms": float(np.sqrt(np.mean(np.square(apart))))}
