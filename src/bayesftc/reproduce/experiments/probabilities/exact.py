"""The exact fault probability of each sensor for short sequences, which `SwitchingPrecision` approximates.

There is one kind of fault. At each sample the m sensors of a scalar state have 2^m patterns of failed and healthy sensors. Given
a sequence of patterns, a Kalman filter of the state and the offsets of failed sensors gives the exact density of the samples. All
sequences are kept; none are merged. If each fault has an unknown noise, state and noise are summed over grids (`on_a_grid`).

This module does not use the code that it checks, neither the step functions nor their layout.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from bayesftc import controllers
from bayesftc.cosim.types import Floats

Bools = np.ndarray[Any, np.dtype[np.bool_]]

LOG_2_PI = float(np.log(2 * np.pi))

STRENGTH = 10.0
"""Weight, in samples, of the expected share of samples that a healthy sensor repeats (see `Frozen`)."""


@dataclass(frozen=True)
class World:
    """A random scalar state, its sensors, and their probabilities of failure and recovery."""

    # Factor of the state from one sample to the next, and variance of the added noise.
    decay: float
    process_variance: float
    # Distribution of the state at the first sample.
    mean: float
    variance: float
    noise: Floats  # variance of each sensor, of shape (sensors,)
    # Probability per sample that a healthy sensor fails, and that a failed one is healthy again.
    begins: float
    ends: float
    loss: float  # share of missing samples of a healthy sensor

    @classmethod
    def of(
        cls, model: controllers.LinearModel, precision: controllers.SwitchingPrecision, mean: float, variance: float
    ) -> World:
        """Return the assumptions of a learner with one mode."""
        (mode,), step = precision.modes, float(model.step)
        noise = np.diag(model.matrix("sensor_covariance"))
        decay, added = (float(model.matrix(name)[0, 0]) for name in ("A", "process_covariance"))
        begins, ends = step / mode.time_to_fault, step / mode.time_to_recovery
        return cls(decay, added, mean, variance, noise, begins, ends, float(precision.loss))  # type: ignore[arg-type]

    @property
    def patterns(self) -> Bools:
        """All patterns of failed sensors, of shape (2^m, m)."""
        return np.array(list(product((False, True), repeat=len(self.noise))))

    def log_transitions(self, before: Bools, now: Bools) -> Floats:
        """Return the logarithm of the transition probabilities between patterns, summed over the last axis."""
        into_fault = np.where(before, 1 - self.ends, self.begins)
        chances: Floats = np.log(np.where(now, into_fault, 1 - into_fault)).sum(axis=-1)
        return chances


@dataclass
class Courses:
    """All histories of faults up to a sample, with the belief in each."""

    log: Floats  # of shape (N,): logarithm of the joint probability of a history and the samples so far
    # Of shape (N, m): which sensors have failed now, and which of them at this sample.
    failed: Bools
    fresh: Bools
    # Of shape (N, n) and (N, n, n): of [state, offset of the first sensor, its change per sample, offset of the second, ...].
    mean: Floats
    covariance: Floats
    own: dict[str, Floats]  # further arrays of the kind of fault, for each history

    def part(self) -> Floats:
        """Return the probability that each sensor has failed."""
        weights = np.exp(self.log - self.log.max())
        share: Floats = weights @ self.failed / weights.sum()
        return share

    def followed(self, world: World) -> Courses:
        """Return all successors of these histories."""
        patterns = world.patterns
        count, each = len(self.log), len(patterns)
        came, now = np.repeat(np.arange(count), each), np.tile(patterns, (count, 1))
        before = self.failed[came]
        log = self.log[came] + world.log_transitions(before, now)
        own = {name: values[came] for name, values in self.own.items()}
        return Courses(log, now, now & ~before, self.mean[came], self.covariance[came], own)

    def moved(self, world: World) -> None:
        """Predict the state and the offsets of failed sensors for the next sample."""
        F = np.zeros_like(self.covariance)
        F[:, 0, 0] = world.decay
        for i, c in enumerate(range(1, self.mean.shape[1], 2)):
            F[:, c, c] = F[:, c, c + 1] = F[:, c + 1, c + 1] = self.failed[:, i]
        self.mean = np.einsum("nab,nb->na", F, self.mean)
        self.covariance = F @ self.covariance @ F.swapaxes(1, 2)
        self.covariance[:, 0, 0] += world.process_variance

    def read(self, y: float, direction: Floats, noise: float) -> Floats:
        """Condition the histories on a sample of ``direction`` times the state; return the log density of each."""
        reach = np.einsum("nab,nb->na", self.covariance, direction)
        total = np.einsum("na,na->n", direction, reach) + noise
        error = y - np.einsum("na,na->n", direction, self.mean)
        gain = reach / total[:, None]
        self.mean = self.mean + gain * error[:, None]
        self.covariance = self.covariance - gain[:, :, None] * reach[:, None, :]
        log_density: Floats = -0.5 * (error**2 / total + np.log(total) + LOG_2_PI)
        return log_density


class Kind:
    """The effect of a kind of fault on samples."""

    offsets: ClassVar[bool] = False
    """Whether a failed sensor has an offset, which is estimated with the state."""

    def start(self, sensors: int) -> dict[str, Floats]:
        """Return the further arrays before the first sample."""
        return {}

    def begin(self, courses: Courses, world: World) -> None:
        """Predict the contributions of failed sensors, after the state."""

    def weigh(self, row: Floats, change: Floats, courses: Courses, world: World) -> None:
        """Condition all histories on the samples of all sensors; ``change`` is their difference from the last ones."""
        for i, y in enumerate(row):
            courses.log = courses.log + self.log_arrives(i, not np.isnan(y), courses, world)
            if not np.isnan(y):
                courses.log = courses.log + self.log_density(i, float(y), float(change[i]), courses, world)

    def log_arrives(self, i: int, present: bool, courses: Courses, world: World) -> Floats:
        """Return the logarithm of the probability that a sensor's sample is present, or missing."""
        return np.full(len(courses.log), np.log(1 - world.loss if present else world.loss))

    def log_density(self, i: int, y: float, change: float, courses: Courses, world: World) -> Floats:
        """Condition all histories on a sample of sensor ``i``; return the logarithm of its density."""
        return normal(courses, i, y, world)


def probabilities(world: World, kind: Kind, samples: Floats) -> Floats:
    """Return the probability that each sensor has failed at each sample, given the samples so far.

    `samples` (steps x sensors) is NaN where a sample is missing. With k steps there are 2^(k m) histories.
    """
    m = samples.shape[1]
    n = 1 + 2 * m * kind.offsets
    mean, covariance = np.zeros((1, n)), np.zeros((1, n, n))
    mean[0, 0], covariance[0, 0, 0] = world.mean, world.variance
    nobody = np.zeros((1, m), bool)
    courses = Courses(np.zeros(1), nobody, nobody, mean, covariance, kind.start(m))
    last, said = np.full(m, np.nan), []
    for k, row in enumerate(samples):
        courses = courses.followed(world)
        courses.moved(replace(world, decay=1.0, process_variance=0.0) if k == 0 else world)
        kind.begin(courses, world)
        kind.weigh(row, row - last, courses, world)
        last = np.where(np.isnan(row), last, row)
        said.append(courses.part())
    return np.array(said)


def normal(courses: Courses, i: int, y: float, world: World, where: Bools | bool = True) -> Floats:
    """Condition the histories in which a sensor reads the state on its sample; return the log density of each."""
    direction = np.zeros_like(courses.mean)
    direction[:, 0] = where
    if direction.shape[1] > 1:
        direction[:, 1 + 2 * i] = where & courses.failed[:, i]
    return courses.read(y, direction, float(world.noise[i]))


@dataclass(frozen=True)
class Shifted(Kind):
    """An offset, of an `Offset` or a subclass of it."""

    mode: controllers.Offset  # with the settings
    # Whether the variance at its onset is at least the square of its first innovation.
    as_large_as_seen: bool = False

    offsets: ClassVar[bool] = True

    def begin(self, courses: Courses, world: World) -> None:
        """See `Kind`."""
        for i, noise in enumerate(world.noise):
            c, fresh = 1 + 2 * i, courses.fresh[:, i]
            slope, walk = self.mode.slope**2 * noise, self.mode.walk**2 * noise
            for at in (c, c + 1):
                courses.mean[fresh, at] = 0.0
                courses.covariance[fresh, at, :] = courses.covariance[fresh, :, at] = 0.0
            courses.covariance[fresh, c, c] = self.mode.jump**2 * noise + slope
            courses.covariance[fresh, c, c + 1] = courses.covariance[fresh, c + 1, c] = slope
            courses.covariance[fresh, c + 1, c + 1] = slope
            courses.covariance[courses.failed[:, i] & ~fresh, c, c] += walk
        courses.own = {"expected": courses.mean[:, 0].copy()}

    def log_density(self, i: int, y: float, change: float, courses: Courses, world: World) -> Floats:
        """See `Kind`."""
        if self.as_large_as_seen and self.mode.jump > 0:
            c, fresh = 1 + 2 * i, courses.fresh[:, i]
            seen = (y - courses.own["expected"][fresh]) ** 2
            courses.covariance[fresh, c, c] += np.maximum(seen - self.mode.jump**2 * world.noise[i], 0.0)
        return normal(courses, i, y, world)


@dataclass(frozen=True)
class Stuck(Kind):
    """A sensor that repeats its last sample, of `Frozen`.

    A healthy sensor also repeats an unknown share of its samples, which is beta distributed and learned in each history. If the
    mode has no repeated samples of healthy sensors, a repetition is as probable as any other value within the resolution.
    """

    mode: controllers.Frozen

    def start(self, sensors: int) -> dict[str, Floats]:
        """See `Kind`."""
        return {name: np.zeros((1, sensors)) for name in ("repeats", "samples")}

    def log_density(self, i: int, y: float, change: float, courses: Courses, world: World) -> Floats:
        """See `Kind`."""
        mode, noise, own, failed = self.mode, float(world.noise[i]), courses.own, courses.failed[:, i]
        stuck = failed & (not np.isnan(change))
        width = max(float(mode.resolution), 1e-9 * noise**0.5)  # type: ignore[arg-type]
        equal = abs(change) <= 0.5 * width
        spread = 2 * mode.dither**2 * noise + width**2 / 6
        near = np.log(1 - mode.repeats) - 0.5 * (change**2 / spread + np.log(spread) + LOG_2_PI)
        repeated = np.log(mode.repeats / width) if equal else near
        expected = float(mode.healthy_repeats)  # type: ignore[arg-type]
        if expected == 0:
            sound = normal(courses, i, y, world, ~stuck)
        else:
            share = (own["repeats"][:, i] + expected * STRENGTH) / (own["samples"][:, i] + STRENGTH)
            own["samples"][:, i] += ~failed
            own["repeats"][:, i] += ~failed & equal
            reads = ~stuck & (not equal)  # a repetition has no information about the state
            sound = np.where(equal, np.log(share / width), np.log(1 - share) + normal(courses, i, y, world, reads))
        log_density: Floats = np.where(stuck, repeated, sound)
        return log_density


@dataclass(frozen=True)
class Silent(Kind):
    """A sensor without samples, of `DroppedOut`."""

    mode: controllers.DroppedOut

    def log_arrives(self, i: int, present: bool, courses: Courses, world: World) -> Floats:
        """See `Kind`."""
        sends = (1 - world.loss) * np.where(courses.failed[:, i], self.mode.arrives, 1.0)
        log_probability: Floats = np.log(sends if present else 1 - sends)
        return log_probability


@dataclass(frozen=True)
class Regressed(Kind):
    """A sensor whose innovations follow a learned regression, of `Unmodelled`; the state is inferred without this sensor.

    Coefficients and precision of the noise have a normal-gamma distribution, whose natural parameters decay towards the prior's.
    So does the beta distribution of the share of exact repetitions, which must not occur in the sequence.
    """

    mode: controllers.Unmodelled

    def start(self, sensors: int) -> dict[str, Floats]:
        """See `Kind`."""
        zeros = {name: np.zeros((1, sensors, *np.shape(value))) for name, value in self._prior().items()}
        return (
            zeros
            | {name: np.zeros((1, sensors)) for name in ("last", "level")}
            | {"predicted": np.full((1, sensors), np.nan)}
        )

    def weigh(self, row: Floats, change: Floats, courses: Courses, world: World) -> None:
        """See `Kind`: first the healthy sensors, then the residuals of the failed ones."""
        present, failed = ~np.isnan(row), courses.failed.copy()
        # The prediction of each sensor from all other healthy sensors.
        weights = np.where(~failed & present, 1 / world.noise, 0.0)
        before = courses.covariance[:, 0, 0] ** -1
        sums = before * courses.mean[:, 0] + weights @ np.where(present, row, 0.0)
        others = (before + weights.sum(axis=1))[:, None] - weights
        predicted = (sums[:, None] - weights * np.where(present, row, 0.0)) / others
        for i, y in enumerate(row):
            courses.log = courses.log + self.log_arrives(i, bool(present[i]), courses, world)
            if present[i]:
                sound = normal(courses, i, float(y), world, ~failed[:, i])
                astray = self._follow(i, float(y), predicted[:, i], float(world.noise[i]) ** 0.5, courses)
                courses.log = courses.log + np.where(failed[:, i], astray, sound)

    def _prior(self) -> dict[str, Any]:
        """Return the natural parameters at the onset."""
        mode = self.mode
        weights, means = np.diag(np.square(mode.deviations) ** -1.0), np.array(mode.means)
        rate = mode.shape * mode.scale**2 + 0.5 * means @ weights @ means
        strength = mode.repeats_strength
        share = {"repeats": mode.repeats * strength, "samples": strength}
        return {"weights": weights, "pulls": weights @ means, "shape": mode.shape, "rate": rate, **share}

    def _follow(self, i: int, y: float, predicted: Floats, deviation: float, courses: Courses) -> Floats:
        """Learn from a sample; return the logarithm of its density, Student's t (Bishop 2006, exercise 3.13)."""
        own, before = courses.own, courses.own["predicted"][:, i]
        moved = np.where(np.isnan(before), 0.0, predicted - before) / deviation
        own["level"][:, i] = self.mode.fading * own["level"][:, i] + moved
        r = (y - predicted) / deviation
        x = np.stack([np.ones_like(r), own["last"][:, i], own["level"][:, i]], axis=1)
        kept = np.where(courses.failed[:, i] & ~courses.fresh[:, i], self.mode.forgetting, 0.0)
        now = {}
        for name, prior in self._prior().items():
            part = kept.reshape(-1, *[1] * np.ndim(prior))
            now[name] = part * own[name][:, i] + (1 - part) * prior
        covariance = np.linalg.inv(now["weights"])
        mean = np.einsum("nab,nb->na", covariance, now["pulls"])
        a, b = now["shape"], now["rate"] - 0.5 * np.einsum("na,na->n", mean, now["pulls"])
        scale = b / a * (1 + np.einsum("na,nab,nb->n", x, covariance, x))
        density: Floats = stats.t.logpdf(r, 2 * a, np.einsum("na,na->n", x, mean), np.sqrt(scale)) - np.log(deviation)
        density += np.log(1 - now["repeats"] / now["samples"])
        learned = {"weights": x[:, :, None] * x[:, None, :], "pulls": x * r[:, None], "shape": 0.5, "rate": 0.5 * r**2}
        learned |= {"repeats": 0.0, "samples": 1.0}
        for name, more in learned.items():
            own[name][:, i] = now[name] + more
        own["last"][:, i], own["predicted"][:, i] = r, predicted
        return density


def on_a_grid(
    world: World, mode: controllers.Noisier, samples: Floats, *, spacing: float = 0.6, nodes: int = 32
) -> Floats:
    """Return the same as `probabilities` for failed sensors whose noise has an unknown precision.

    The precision is gamma distributed and constant during the fault, without forgetting. The state is summed over a grid with
    `spacing` in standard deviations of the process noise, the logarithm of each sensor's precision over a grid with `nodes`.
    These sums of smooth densities are accurate to 1e-5.
    """
    m, deviation = samples.shape[1], world.process_variance**0.5
    reach = 6 * (world.variance + len(samples) * world.process_variance) ** 0.5
    x = world.mean + np.arange(-reach, reach, spacing * deviation)
    logs = np.linspace(-14.0, 4.0, nodes) - np.log(mode.scale**2 * mode.shape)
    # The density of the precision's logarithm; the first place is that of a healthy sensor.
    prior = np.exp(mode.shape * logs - mode.shape * mode.scale**2 * np.exp(logs))
    relative = np.array([1.0, *np.exp(logs)])
    first = np.array([0.0, *prior / prior.sum()])
    passes = np.diag([1 - world.begins, *np.full(nodes, 1 - world.ends)])
    passes[0] += world.begins * first
    passes[1:, 0] = world.ends
    moves = np.exp(-0.5 * ((x[:, None] - world.decay * x[None, :]) / deviation) ** 2)
    belief = np.zeros((len(x), *[1 + nodes] * m))
    belief.reshape(len(x), -1)[:, 0] = np.exp(-0.5 * (x - world.mean) ** 2 / world.variance)
    said = []
    for k, row in enumerate(samples):
        if k > 0:
            belief = np.tensordot(moves, belief, 1)
        for i, y in enumerate(row):
            belief = np.moveaxis(np.moveaxis(belief, 1 + i, -1) @ passes, -1, 1 + i)
            if not np.isnan(y):
                precision = relative / world.noise[i]
                density = np.sqrt(precision) * np.exp(-0.5 * precision * (y - x[:, None]) ** 2)
                belief = belief * density.reshape(len(x), *(1 + nodes if j == i else 1 for j in range(m)))
        belief = belief / belief.sum()
        each = [belief.sum(axis=tuple(j for j in range(1 + m) if j != 1 + i)) for i in range(m)]
        said.append([1 - of[0] for of in each])
    return np.array(said)
