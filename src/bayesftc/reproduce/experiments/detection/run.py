"""Experiment 3: fault detection with the beta residual and the state estimation residual (paper, section 5.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from math import sqrt
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.campaign.designs.seeds import hashed_seeds
from bayesftc.cosim.judging.metrics import auc as area
from bayesftc.cosim.statistics import interval, roc_curve, roc_rates
from bayesftc.cosim.types import Floats
from bayesftc.reproduce import paper
from bayesftc.reproduce.experiments.detection import filterpy as _filterpy
from bayesftc.reproduce.experiments.detection.detectors import Detectors
from bayesftc.reproduce.settings import Car, Detection
from bayesftc.reproduce.shared import residuals as _residuals
from bayesftc.reproduce.shared.calibration import Calibration, calibration
from bayesftc.reproduce.shared.ensemble import Batch, Ensemble
from bayesftc.reproduce.shared.residuals import Residual
from bayesftc.reproduce.shared.runner import Report, experiment
from bayesftc.reproduce.shared.streams import Faults, Stream, Streams

Bools = np.ndarray[Any, np.dtype[np.bool_]]

GROUP = 5
"""Streams of one task: a tenth of a second or two, after which it can be stopped."""


@experiment(Detection, car=Car)
def run(ensemble: Ensemble, settings: Detection, car: Car, *, beyond: bool) -> Report:
    """Evaluate residuals on streams of random faults, whose sizes give the baseline the paper's AUC.

    Further residuals, faults of other sizes, and other references are beyond the paper.
    """
    bench = Bench(settings, car, ensemble)
    factor, baseline = bench.factor()
    faults = Faults(settings.injection * factor, settings.drift * factor)
    seeds = bench.ensemble.seeds("detection/streams", settings.streams)
    beta, tried = bench.choose(faults, seeds)
    residuals = _residuals.known(settings, beta, car) if beyond else _residuals.papers(settings, beta)
    judged = bench.judge(faults, seeds, residuals)
    auc = {name: np.array([stream[name][0] for stream in judged]) for name in residuals}
    detectors = Detectors(bench.source, bench.ensemble, residuals)
    difference = auc["beta"] - auc["SER"]
    return {
        "chosen": {
            "f": factor,
            "f_auc": baseline,
            "faults": asdict(faults),
            "beta": {name: getattr(beta, name) for name in ("forgetting", "prior_shape")},
        },
        "settings": {"residuals": {name: r.text for name, r in residuals.items()}},
        "auc": {name: float(values.mean()) for name, values in auc.items()},
        "auc_ci": {name: interval(values) for name, values in auc.items()},
        "difference": {"mean": float(difference.mean()), "ci": interval(difference)},
        "filterpy": _filterpy.detect(bench, faults, seeds[: settings.filterpy_streams]),
        "streams": [
            {
                "seed": seeds[i],
                "faults": judged[i]["faults"][0],
                "auc": {name: float(auc[name][i]) for name in residuals},
            }
            for i in range(settings.streams)
        ],
        "roc": {
            "false_positive_rate": roc_rates().tolist(),
            "true_positive_rate": {name: np.mean([s[name][1] for s in judged], axis=0).tolist() for name in residuals},
        },
        "choice": tried,
        "calibration": {
            name: calibration([stream[name][2] for stream in judged], residual) for name, residual in residuals.items()
        },
        "alarms": detectors.report(faults) if beyond else None,
        "grid": bench.grid(residuals) if beyond else None,
        "paper": paper.AUC,
    }


@dataclass(frozen=True)
class Bench:
    """Streams of random faults in closed loops, and their evaluation."""

    settings: Detection
    car: Car
    ensemble: Ensemble

    def factor(self) -> tuple[float, float]:
        """Return the factor of the faults' sizes that gives the baseline the paper's AUC, and this AUC, by bisection."""
        s = self.settings
        seeds = hashed_seeds(s.factor_seed, "detection/factor", s.factor_streams)

        def baseline(factor: float) -> float:
            faults = Faults(s.injection * factor, s.drift * factor)
            return float(self.areas("Scaling the faults", [(faults, _residuals.ser(s))], seeds).mean())

        low, high = s.factor_range
        if not baseline(low) < s.baseline_auc < baseline(high):
            raise cosim.ModelError(
                f"No factor in {s.factor_range} gives the state estimation residual an AUC of {s.baseline_auc:g}. Widen "
                "factor_range."
            )
        while high / low > 1 + s.factor_tolerance:
            middle = sqrt(low * high)
            low, high = (middle, high) if baseline(middle) < s.baseline_auc else (low, middle)
        middle = sqrt(low * high)
        return middle, baseline(middle)

    def choose(self, faults: Faults, seeds: Sequence[int]) -> tuple[controllers.GammaPrecision, list[dict[str, Any]]]:
        """Return the learner whose beta has the highest mean AUC on the training parts, and the AUC of all candidates."""
        s = self.settings
        learners = [
            controllers.GammaPrecision(forgetting=rho, prior_shape=shape)
            for rho, shape in product(s.forgettings, s.prior_shapes)
        ]
        cases = [(faults, _residuals.beta(learner)) for learner in learners]
        means = self._areas("Choosing beta's memory", cases, seeds, self.parts()[0]).mean(axis=1)
        tried = [
            {"forgetting": learner.forgetting, "prior_shape": learner.prior_shape, "training_auc": float(mean)}
            for learner, mean in zip(learners, means, strict=True)
        ]
        return learners[int(np.argmax(means))], tried

    def judge(
        self, faults: Faults, seeds: Sequence[int], residuals: Mapping[str, Residual]
    ) -> list[dict[str, tuple[Any, ...]]]:
        """Return for each stream the number of faults, and each residual's test AUC, curve and calibration."""
        loops = {learner: self.loop(faults, learner) for r in residuals.values() for learner in r.learners}
        self.ensemble.prepare(list(loops.values()))
        tasks = [partial(self._judge_stream, loops, residuals, seed) for seed in seeds]
        return self.ensemble.run(tasks, "Judging residuals")

    def grid(self, residuals: Mapping[str, Residual]) -> list[dict[str, Any]]:
        """Return the AUC of the two residuals of the paper over sizes of the faults and references, on whole streams."""
        s = self.settings
        seeds = self.ensemble.seeds("detection/grid", s.grid_streams)
        cells = [Faults(i, d, r) for r, i, d in product(("fast", "slow", "constant"), s.grid_injections, s.grid_drifts)]
        names = _residuals.GRID
        cases = [(cell, residuals[name]) for cell in cells for name in names]
        means = self.areas("Other faults and references", cases, seeds).mean(axis=1)
        return [
            {**asdict(cell), "auc": dict(zip(names, row, strict=True))}
            for cell, row in zip(cells, means.reshape(len(cells), -1).tolist(), strict=True)
        ]

    def areas(self, what: str, cases: Sequence[tuple[Faults, Residual]], seeds: Sequence[int]) -> Floats:
        """Return the AUC over each whole stream, for residuals of one feature: cases x streams."""
        return self._areas(what, cases, seeds, self._whole)

    def _areas(self, what: str, cases: Sequence[tuple[Faults, Residual]], seeds: Sequence[int], rows: slice) -> Floats:
        """Return the AUC over some rows of each stream."""

        def areas(residual: Residual, loop: cosim.Diagram, few: Sequence[int]) -> list[float]:
            return [area(s.faulty[rows], residual.features([s])[rows, :, 0]) for s in self._streams(loop, few)]

        batches = {
            i: Batch(self.loop(faults, residual.learners[0]), seeds, partial(areas, residual))
            for i, (faults, residual) in enumerate(cases)
        }
        every, _ = self.ensemble.each(what, batches, GROUP)
        return np.array([np.concatenate(parts) for parts in every.values()])

    def _judge_stream(
        self,
        loops: Mapping[controllers.PrecisionLearner, cosim.Diagram],
        residuals: Mapping[str, Residual],
        seed: int,
    ) -> dict[str, tuple[Any, ...]]:
        streams = {learner: next(self._streams(loop, [seed])) for learner, loop in loops.items()}
        faulty = next(iter(streams.values())).faulty
        whole = self._whole
        found: dict[str, tuple[Any, ...]] = {"faults": (int((np.diff(faulty.astype(int), axis=0) > 0).sum()),)}
        for name, residual in residuals.items():
            truth, probability = self._classified(residual, [streams[learner] for learner in residual.learners])
            of_learner = residual.probability
            p, labels = probability, truth
            if of_learner is not None:
                p, labels = of_learner(streams[residual.learners[0]].result)[whole], faulty[whole]
            found[name] = (
                area(truth, probability),
                roc_curve(truth, probability),
                Calibration.of(p, labels, self.settings.bins),
            )
        return found

    def area(self, residual: Residual, streams: Sequence[Stream]) -> float:
        """Return the AUC of a residual on the test part of a stream, from its learners' runs."""
        return area(*self._classified(residual, streams))

    def _classified(self, residual: Residual, streams: Sequence[Stream]) -> tuple[Bools, Floats]:
        """Return for the test part the faults, and their probabilities from a classifier fitted to the training part."""
        training, test = self.parts()
        few = slice(training.start, training.stop, self.settings.training_stride)
        x, faulty = residual.features(streams), streams[0].faulty
        fit = controllers.FaultClassifier().fit(_rows(x[few]), faulty[few].ravel())
        return faulty[test].ravel(), fit.predict_proba(_rows(x[test]))[:, 1]

    @property
    def _whole(self) -> slice:
        return slice(self.settings.skipped, None)

    def parts(self) -> tuple[slice, slice]:
        """Return the rows of the training part and of the test part, with the gap between them."""
        s = self.settings
        cut = int(s.training_share * s.steps)
        return slice(s.skipped, cut - s.gap), slice(cut, None)

    def _streams(self, loop: cosim.Diagram, seeds: Sequence[int]) -> Iterator[Stream]:
        return self.source.run(loop, seeds, _residuals.SIGNALS)

    def loop(self, faults: Faults, learner: controllers.PrecisionLearner) -> cosim.Diagram:
        """Return the loop with random faults and a learner."""
        return self.source.loop(faults, learner)

    @property
    def source(self) -> Streams:
        """The source of streams."""
        return Streams(self.settings, self.car)


def _rows(x: Floats) -> Floats:
    """Return features with one row per sample of each sensor."""
    return x.reshape(-1, x.shape[-1])
