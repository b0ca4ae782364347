"""The search for parameters: many points of the ranges, then least squares (trust region) from the best of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.numbers import reals
from bayesftc.cosim.campaign.designs.samples import SobolSequence
from bayesftc.cosim.errors import ModelError, SimulationError, brief
from bayesftc.cosim.fitting.settings import FitSettings
from bayesftc.cosim.fitting.simulator import Simulator
from bayesftc.cosim.types import Floats

FAR = 1e6
"""Residual, in standard deviations, of each sample of a failed run: such a step is rejected."""

Loss = Literal["linear", "soft_l1"]


@dataclass(frozen=True, eq=False)
class Box:
    """The ranges of the parameters. The search is in the unit cube: a place is between 0 and 1 of each range."""

    names: tuple[str, ...]
    low: Floats
    high: Floats

    @classmethod
    def of(cls, ranges: Mapping[str, Any]) -> Box:
        """Return the box of ranges by name.

        Raises
        ------
        ModelError
            If there is none, or one is not two rising finite numbers.
        """
        if not isinstance(ranges, Mapping) or not ranges:
            raise ModelError(
                f"fit() has parameters={brief(ranges)}; give a range for each name, as {{'m': (80, 120)}}."
            )
        for name, given in ranges.items():
            bounds = reals(given)
            if bounds.shape != (2,) or not np.isfinite(bounds).all() or not bounds[0] < bounds[1]:
                raise ModelError(
                    f"The parameter {name!r} has the range {brief(given)}; give (low, high) with low < high."
                )
        bounds = np.array([reals(given) for given in ranges.values()])
        return cls(tuple(ranges), bounds[:, 0], bounds[:, 1])

    @property
    def width(self) -> Floats:
        """Widths of the ranges."""
        return np.asarray(self.high - self.low)

    def at(self, place: Floats) -> dict[str, float]:
        """Return the parameters at a place."""
        return dict(zip(self.names, (self.low + self.width * place).tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Problem:
    """The least squares of a fit.

    Attributes
    ----------
    simulator, box, settings
        What runs, within which ranges, and how it is searched.
    y : ndarray, rows x sensors
        The samples that are fitted.
    output_of : ndarray, sensors
        The number of each sensor's output.
    scale : ndarray, rows x sensors
        What a residual is multiplied with: the root of the sample's weight, divided by the sensor's noise.
    common : ndarray, sensors
        Standard deviation of a constant error that the sensors of an output have in common; NaN for sensors that do not differ.
    free : bool
        Whether constant differences between such sensors are free: only if faulty samples do not count.
    """

    simulator: Simulator
    box: Box
    settings: FitSettings
    y: Floats
    output_of: Any
    scale: Floats
    common: Floats
    free: bool = False

    def weighted(self, weights: Floats, noise: Floats) -> Problem:
        """Return the problem with these weights (rows x sensors) and standard deviations (sensors)."""
        return replace(self, scale=np.sqrt(weights) / noise)

    def runs(self, places: Floats) -> list[Floats | str]:
        """Return the outputs at each of some places (points x parameters), or why the run failed."""
        return self.simulator.runs([self.box.at(place) for place in places], len(self.y))

    def residuals(self, outputs: Floats | str) -> Floats:
        """Return the weighted residuals of a run, all sensors at a step side by side.

        A common error of a normal distribution makes them correlated, and they are whitened: with the scales s and the error's
        standard deviation t, their covariance is I + t^2 s s'. Free offsets are those that fit
        best at this run.
        """
        if isinstance(outputs, str):
            return np.where(self.scale > 0, FAR, 0.0).ravel()
        found = self._scaled(outputs)
        for sensors, own, mean, signal in self._offsets(found):
            found[:, sensors] -= self.scale[:, sensors] * (own - mean / np.sqrt(1.0 + signal))
        return found.ravel()

    def offsets(self, outputs: Floats) -> Floats:
        """Return the offset of each sensor that is free or common to those of its output, from a run; 0 for the others."""
        errors = np.zeros(len(self.output_of))
        for sensors, own, mean, signal in self._offsets(self._scaled(outputs)):
            errors[sensors] = own - mean / (1.0 + signal)
        return errors

    def offsets_at_same_times(self, outputs: Floats) -> Floats:
        """Return the offsets with which sensors are judged: a common one, and what each reads more than the others.

        `offsets` compares each sensor with the FMU instead. If it counts at other steps than the others, its offset contains the
        error of the FMU at these steps, and it would look faulty.
        """
        apart, errors = np.zeros(len(self.output_of)), np.nan_to_num(self.y) - outputs[:, self.output_of]
        for output in np.unique(self.output_of[np.isfinite(self.common)]):
            sensors = self.output_of == output
            weights, own = self.scale[:, sensors] ** 2, errors[:, sensors]
            share = weights / np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
            # Least squares with an error of the FMU at each step that is free.
            normal = np.diag(weights.sum(axis=0)) - share.T @ weights
            apart[sensors] = np.linalg.pinv(normal) @ np.sum(
                weights * (own - np.sum(share * own, axis=1, keepdims=True)), axis=0
            )
            apart[sensors] -= np.average(apart[sensors], weights=weights.sum(axis=0) + np.finfo(float).tiny)
        return apart + replace(self, y=self.y - apart, free=False).offsets(outputs)

    def _scaled(self, outputs: Floats) -> Floats:
        return np.where(self.scale > 0, (np.nan_to_num(self.y) - outputs[:, self.output_of]) * self.scale, 0.0)

    def _offsets(self, residuals: Floats) -> Iterator[tuple[Any, Floats, float, float]]:
        """Give the sensors of each output that differ, their mean errors, the common one, and its prior over its noise."""
        for output in np.unique(self.output_of[np.isfinite(self.common)]):
            sensors = self.output_of == output
            sums, weights = (self.scale[:, sensors] * np.stack([residuals[:, sensors], self.scale[:, sensors]])).sum(
                axis=1
            )
            if weights.any():
                mean = float(sums.sum() / weights.sum())
                own = np.where(weights > 0, sums / np.where(weights > 0, weights, 1.0), mean)
                signal = float(self.common[sensors][0] ** 2 * weights.sum())
                yield sensors, own if self.free else np.full_like(own, mean), mean, signal

    def jacobian(self, place: Floats, outputs: Floats | str, *, central: bool) -> Floats:
        """Return the derivatives of the residuals by the place, as differences; all runs on all cores.

        Parameters
        ----------
        place : ndarray
            The place.
        outputs : ndarray or str
            The run there.
        central : bool
            Whether differences are central. One-sided ones take half as many runs, and suffice on the way.
        """
        size, h = len(place), self.settings.difference
        inward = np.where(place > 0.5, -h, h)
        steps = [np.diag(inward), *([np.diag(-inward)] if central else [])]
        ends = np.clip(place + np.concatenate(steps), 0.0, 1.0)
        runs = self.runs(ends)
        columns = []
        for i in range(size):
            near, far = (
                ((ends[k, i], runs[k]) for k in (i, i - size))
                if central
                else ((ends[i, i], runs[i]), (place[i], outputs))
            )
            # An end where the run has failed is replaced by the place itself.
            (a, run), (b, other) = ((place[i], outputs) if isinstance(r, str) else (z, r) for z, r in (near, far))
            columns.append((self.residuals(run) - self.residuals(other)) / (a - b) if a != b else np.zeros(self.y.size))
        return np.column_stack(columns)

    def descend(self, place: Floats, loss: Loss, *, coarse: bool = False) -> Any:
        """Return scipy's result of least squares from a place, by default with all digits that matter."""
        from scipy.optimize import least_squares

        last: dict[bytes, Floats | str] = {}  # the run at the last place, which a derivative needs again

        def outputs(z: Floats) -> Floats | str:
            if z.tobytes() not in last:
                last.clear()
                (last[z.tobytes()],) = self.runs(z[None])
            return last[z.tobytes()]

        tolerance = 1e-3 if coarse else 1e-8
        return least_squares(
            lambda z: self.residuals(outputs(z)),
            place,
            jac=lambda z: self.jacobian(z, outputs(z), central=not coarse),
            bounds=(0.0, 1.0),
            method="trf",
            loss=loss,
            ftol=tolerance,
            xtol=tolerance,
            max_nfev=self.settings.steps,
        )

    def search(self, known: Floats, loss: Loss) -> Floats:
        """Return the best place: of the least squares from the best points of the ranges, and from a known place.

        Raises
        ------
        SimulationError
            If the FMU runs at none of the points.
        """
        box, settings = self.box, self.settings
        ranges = dict(zip(box.names, zip(box.low, box.high, strict=True), strict=True))
        design = SobolSequence(ranges, count=settings.screened, seed=settings.seed)
        places = np.concatenate([known[None], design.unit_points()])
        runs = self.runs(places)
        reasons = [run for run in runs if isinstance(run, str)]
        if len(reasons) == len(runs):
            raise SimulationError(
                f"The FMU runs at none of {len(runs)} points of the ranges. At the first: {reasons[0]}"
            )
        costs = [_cost(self.residuals(run), loss) for run in runs]
        best = np.argsort(costs, kind="stable")[: settings.starts]
        ends = [self.descend(place, loss, coarse=True) for place in places[best]]
        end = min(ends, key=lambda end: float(end.cost))
        place = np.asarray(end.x)
        for i in without_slope(end.jac):
            along, runs = self.along(place, i)
            costs = [_cost(self.residuals(run), loss) for run in runs]
            # The last one is the place itself, which stays if no other is better.
            place = along[len(costs) - 1 - int(np.argmin(costs[::-1]))]
        return place

    def along(self, place: Floats, i: int) -> tuple[Floats, list[Floats | str]]:
        """Return places that differ in parameter `i` only, over its range, and the place itself, with the outputs at each."""
        places = np.tile(place, (self.settings.screened + 1, 1))
        places[:-1, i] = np.linspace(0.0, 1.0, self.settings.screened)
        return places, self.runs(places)


def without_slope(jacobian: Floats) -> list[int]:
    """Return the parameters that the FMU may round: a small change of one changes no output."""
    return np.flatnonzero(~jacobian.any(axis=0)).tolist()


def _cost(residuals: Floats, loss: Loss) -> float:
    squares = residuals**2
    return float(np.sum(squares if loss == "linear" else 2.0 * (np.sqrt(1.0 + squares) - 1.0)))
