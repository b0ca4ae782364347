"""Whether the model is wrong, and not the sensors that a monitor blames: sensors that agree rarely fail at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.diagnosis.scatter import SCATTER, excess, scatter
from bayesftc.controllers.estimation.innovation import steady_covariance
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.switching.fault_modes import DroppedOut, Frozen, Noisier
from bayesftc.cosim.base.numbers import MAD, short
from bayesftc.cosim.base.recordings.dates import span_text
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.blame import AGREE
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import Disagreement, FaultEvent
from bayesftc.monitoring.models import Matrices

if TYPE_CHECKING:
    from bayesftc.cosim.judging.signals import Flags
    from bayesftc.monitoring.monitor import Monitor
    from bayesftc.monitoring.recording import Recording
    from bayesftc.monitoring.run import Monitored

LEAST_SAMPLES = 20
"""Least number of pairs of samples of two sensors that are blamed at the same time."""

LEAST_SHARE = 0.02
"""Least share of a recording in which sensors that agree are blamed at the same time."""

APART = 100
"""Least number of steps between two times: within fewer, an alarm comes again for the same reason."""

LEAST_TIMES = 2
"""Least number of times that sensors that agree, also with every sensor that is not blamed, are blamed together for a moment."""

LEAST_COMMON = 3
"""Least number of steps of a moment at which two sensors both have a sample: with fewer there is no evidence that they agree."""

MOST_TIME = 0.5
"""Share of a recording, or of an alarm, above which a sensor is blamed most of the time; then most of the sensors must be."""

REMAINING = 0.1
"""Share of the blame that may remain with another setting: some of the faults may be real."""

FACTORS = (1.5, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Factors of a setting that are tried."""

MOST_STEPS = 20_000
"""Largest number of steps over which they are tried."""

SHARED = "A fault that all of them have in common, such as that of a supply, would look the same."
"""The other reading, if no sensor of the quantity is left to contradict those that are blamed."""

NO_MOTION = (
    "No larger motion ends this: another kind of [model] may fit, or [[errors]] that these sensors have in common."
)
"""The advice where sensors agree and more motion does not help."""

LOUDER = (
    "they have more noise than in the model. If it depends on the quantity, as that of a flow from a differential pressure, "
    "give them the std that they have there."
)
"""What is said of sensors that agree, and of which the noise has grown."""

ELSEWHERE = (Frozen.__name__, DroppedOut.__name__)
"""Kinds of faults that no model of the motion explains."""


@dataclass(frozen=True)
class ModelSuspicion:
    """A reason to suspect the model of a monitor, and not the sensors that it blames; see `suspect_model`.

    Attributes
    ----------
    sensors : tuple of str
        The sensors that are blamed together.
    share : float
        Share of the recording in which they are blamed.
    ratio : float
        Root mean square of their innovations in this time, relative to the standard deviation that the model predicts.
    setting : str
        ``"motion"`` or ``"noise"``, if with a larger value of this setting the sensors are no longer, or hardly, blamed; else
        empty.
    factor : float
        How much larger it must be; else 1.
    sentence : str
        All this, and what to do.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 1.0 * np.arange(600)
    >>> noise = 0.1 * rng.standard_normal((600, 2))
    >>> recording = monitoring.align({name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("ab")}, {}, dt=1)
    >>> sensors = {name: monitoring.Sensor(std=0.02) for name in "ab"}  # they have more noise than the model knows
    >>> monitor = monitoring.Monitor(1, monitoring.RandomWalk(std=0.01), sensors)
    >>> suspicion = monitoring.suspect_model(monitor, monitor.run(recording))
    >>> suspicion.setting, round(suspicion.factor)
    ('noise', 5)
    """

    sensors: tuple[str, ...]
    share: float
    ratio: float
    setting: str
    factor: float
    sentence: str

    def __repr__(self) -> str:
        return short(self)


def suspect_model(monitor: Monitor, monitored: Monitored) -> ModelSuspicion | None:
    """Say whether the model is suspect, because it makes a monitor blame sensors that agree with each other.

    It is, if redundant sensors agree within the noise of the model, but are blamed at the same time: for a fiftieth of the
    recording, or twice for a shorter time if more motion ends it. The monitor runs again with more motion, up to the least factor
    with which this ends. It is as well, if all sensors of a quantity agree and are blamed at once, even briefly: then the
    sentence also names the other reading, a fault that they have in common. Where sensors differed before, in an alarm that lasts
    until they are blamed together, one of them has failed, and this time does not count. The model may be wrong, if most sensors
    are blamed for most of the time: then their noise, or biases, are compared with the model's. Frozen sensors and dropouts do
    not count.

    Parameters
    ----------
    monitor : Monitor
        The monitor.
    monitored : Monitored
        What its `run` returned.

    Returns
    -------
    ModelSuspicion or None
        None without such a reason.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 1.0 * np.arange(600)
    >>> noise, y = 0.1 * rng.standard_normal((600, 3)), 20.0 + 3.0 * np.sin(t / 50)
    >>> recording = monitoring.align({name: monitoring.Signal(t, y + noise[:, i]) for i, name in enumerate("abc")}, {}, dt=1)
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "abc"}
    >>> monitor = monitoring.Monitor(1, monitoring.RandomWalk(std=0.001), sensors)  # it changes by more in a second
    >>> suspicion = monitoring.suspect_model(monitor, monitor.run(recording))
    >>> suspicion.setting, suspicion.factor
    ('motion', 300.0)
    """
    blame = _Blame(monitor, monitored)
    if not blame.sensors:
        return None
    remedy = _remedy(monitor, monitored, blame)
    if blame.times and not remedy.setting and not blame.whole:
        return None  # a few moments of some of the sensors are not enough to blame another part of the model
    ratio = max(excess(errors, expected)[0] for errors, expected in blame.innovations())
    return ModelSuspicion(
        tuple(monitored.recording.sensors[i] for i in blame.sensors),
        blame.share,
        ratio,
        remedy.setting,
        remedy.factor,
        _sentence(monitor, monitored, blame, remedy),
    )


def doubtful_alarms(monitor: Monitor, monitored: Monitored) -> tuple[FaultEvent, ...]:
    """Return the alarms that are due to the model rather than to their sensors, if the model is wrong.

    Whether it is wrong is not checked here: see `suspect_model` and `Monitor.compare`.

    These are alarms during which the sensor agrees with another one that is blamed for at least half of the time. If no
    sensors agree, they are those of the sensors of `suspect_model`.

    Parameters
    ----------
    monitor : Monitor
        The monitor.
    monitored : Monitored
        What its `run` returned.

    Returns
    -------
    tuple of FaultEvent
        Some of its events.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 1.0 * np.arange(600)
    >>> noise = 0.1 * rng.standard_normal((600, 2))
    >>> recording = monitoring.align({name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("ab")}, {}, dt=1)
    >>> sensors = {name: monitoring.Sensor(std=0.02) for name in "ab"}  # they have more noise than the model knows
    >>> monitor = monitoring.Monitor(1, monitoring.RandomWalk(std=0.01), sensors)
    >>> monitored = monitor.run(recording)
    >>> monitoring.doubtful_alarms(monitor, monitored) == monitored.events
    True
    """
    blame, order = _Blame(monitor, monitored), monitored.recording.sensors

    def together(event: FaultEvent) -> bool:
        i = order.index(event.sensor)
        part = _steps(monitored, event.start, event.end)
        if not blame.agreeing:
            return i in blame.sensors and bool(blame.when[part].mean() >= MOST_TIME)
        pairs = [pair for pair in blame.apart if i in pair]
        often = [pair for pair in pairs if blame.together[pair][part].mean() >= MOST_TIME]
        return any(blame.agree(pair, part) for pair in often)

    return tuple(event for event in monitored.events if event.kind not in ELSEWHERE and together(event))


def failed_before(monitor: Monitor, monitored: Monitored) -> Iterator[str]:
    """Give a sentence for two sensors that are blamed together and agree, after one of them had failed."""
    blame, time, origin = _Blame(monitor, monitored), monitored.time, monitored.recording.origin
    for pair, (first, begin) in blame.faults.items():
        one, other = (monitored.recording.sensors[i] for i in pair)
        if {*pair} in map(set, blame.model.alike):
            yield (
                f"Before {one} and {other} are blamed at the same time, they differ: from about "
                f"{span_text(float(time[first]), float(time[begin]), origin)}. One of them has failed in this time, and the "
                "belief has followed it. Two sensors do not show which one: a third sensor would tell."
            )


def both_blamed(monitor: Monitor, monitored: Monitored) -> tuple[Disagreement, ...]:
    """Return the disagreements in which it is not open which sensor is faulty: both probably are, by the model, but they agree.

    If only one of two is faulty, at most one of their probabilities is above a half.
    """
    if not monitored.disagreements:
        return ()
    found, blame = [], _Blame(monitor, monitored)
    for each in monitored.disagreements:
        i, j = (monitored.recording.sensors.index(name) for name in each.sensors)
        part = _steps(monitored, each.start, each.end)
        groups = [group for group in blame.model.alike if {i, j} <= set(group)]
        agreed = {pair: blame.agree(pair, part) for group in groups for pair in combinations(group, 2)}
        both = float(np.median(monitored.fault_probability[part][:, [i, j]].min(axis=1))) > 0.5
        if both and agreed.get((i, j)) and False not in agreed.values():
            found.append(each)
    return tuple(found)


def moved(monitor: Monitor, monitored: Monitored, both: Sequence[Disagreement]) -> Iterator[str]:
    """Give a sentence for each two sensors of `both_blamed`, with what ends it."""
    times: dict[tuple[str, str], list[Disagreement]] = {}
    for each in both:
        times.setdefault(each.sensors, []).append(each)
    factor, model = _more_motion(monitor, monitored, both[0].start) if both else None, monitored.model
    for sensors, (first, *more) in times.items():
        span = span_text(first.start, first.end, monitored.recording.origin)
        alone = {*map(monitored.recording.sensors.index, sensors)} in map(set, model.alike)
        motion = (
            f"the quantity has moved more than the model expects.{f' {SHARED}' if alone else ''} "
            f"{_motion_advice(monitor, factor) if factor else NO_MOTION}"
        )
        yield (
            f"From {span}{f' and {len(more)} more times' if more else ''} {' and '.join(sensors)} agree, but by the model both "
            f"are probably faulty: {LOUDER if _louder(monitored, sensors, first) else motion}"
        )


def _louder(monitored: Monitored, sensors: Sequence[str], when: Disagreement) -> bool:
    """Return whether each of the sensors has alarms in this time, and all of them are of more noise."""
    events = [each for each in monitored.events if each.start <= when.end and when.start <= each.end]
    kinds = [{each.kind for each in events if each.sensor == sensor} for sensor in sensors]
    return all(each == {Noisier.__name__} for each in kinds)


def _more_motion(monitor: Monitor, monitored: Monitored, start: float) -> float | None:
    """Return the least factor of the motion with which no sensors that agree are blamed, of a while from a time on first."""
    part = _first_part(monitor, monitored.recording, int(np.searchsorted(monitored.time, start)))

    def blames(other: Monitor, recording: Recording) -> bool:
        run = other.run(recording)
        return bool(both_blamed(other, run) or _Blame(other, run).sensors)

    for factor in FACTORS:
        other = _with(monitor, "motion", factor)
        with suppress(ModelError):  # of a number whose square is too large
            if other and not any(blames(other, recording) for recording in (part, monitored.recording)):
                return factor
    return None


def _first_part(monitor: Monitor, recording: Recording, step: int) -> Recording:
    """Return as much of a long recording as is tried first, from shortly before a step if the start may be anywhere."""
    begin = max(step - LEAST_SAMPLES, 0) if monitor.initial_std is None and len(recording.y) > MOST_STEPS else 0
    part = slice(begin, begin + MOST_STEPS)
    return replace(recording, start=float(recording.time[begin]), y=recording.y[part], u=recording.u[part])


def _steps(monitored: Monitored, start: float, end: float) -> slice:
    return slice(*np.searchsorted(monitored.time, [start, end + float(monitored.recording.dt) / 2]))


class _Moment(NamedTuple):
    """A moment at which sensors that agree are blamed together: first step, step after the last, the pairs of these sensors."""

    begin: int
    end: int
    pairs: list[tuple[int, int]]
    whole: bool
    """Whether all sensors of the quantity are blamed at once."""


class _Blame:
    """Which sensors are blamed together, when, and whether they agree."""

    def __init__(self, monitor: Monitor, monitored: Monitored):
        self.model, self.y = monitored.model, monitored.recording.y
        self.innovation = monitored.innovation
        blamed: Flags = _blamed(monitored, monitor.alarm.threshold)
        self.apart = _differences(monitor, monitored.recording, self.model)
        self.alarms = _alarms(monitored)
        self.together = {pair: blamed[:, pair[0]] & blamed[:, pair[1]] for pair in self.apart}
        self.faults = self._leave_out_faults()
        self.agreeing, self.times = self._agreeing(blamed), 0
        self.sensors = sorted({i for pair in self.agreeing for i in pair})
        self.when: Flags = np.zeros(len(blamed), dtype=bool)
        for pair in self.agreeing:
            self.when |= self.together[pair]
        often = [int(i) for i in np.flatnonzero(blamed.mean(axis=0) > MOST_TIME)]
        failed = any(pair in self.faults for pair in combinations(often, 2))
        if not self.sensors and len(often) > 1 and 2 * len(often) > len(blamed.T) and not failed:
            self.sensors, self.when = often, blamed[:, often].sum(axis=1) > 1
        self.moments = self._moments(blamed)
        if not self.sensors and self.telling:
            self.agreeing = sorted({pair for moment in self.moments for pair in moment.pairs})
            self.sensors, self.when = sorted({i for pair in self.agreeing for i in pair}), self.momentary
            self.times = self.occasions
        self.share = float(self.when.mean())
        groups = [set(group) for group in self.model.alike if len(group) > 1]
        self.whole = bool(self.agreeing) and any(
            group <= set(self.sensors) and bool(blamed[:, sorted(group)].all(axis=1).any()) for group in groups
        )

    def _leave_out_faults(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Leave out when two sensors are blamed together after they have differed: one of them has failed before.

        A sensor that drifts and recovers leaves a wrong belief behind. Both sensors then differ from it, and agree. For pairs
        that are mostly blamed in this way, return from which step on they differed, and from which on both are blamed.
        """
        faults = {}
        for pair, together in self.together.items():
            left, steps = [], together.sum()
            for begin, end in periods(together):
                first = self._differed(pair, begin)
                if first is not None:
                    together[begin:end] = False
                    left += [(first, begin, end)] if self.agree(pair, slice(begin, end)) else []
            if 2 * sum(end - begin for _, begin, end in left) > steps:
                faults[pair] = left[0][:2]
        return faults

    def _differed(self, pair: tuple[int, int], begin: int) -> int | None:
        """Return from which step on two sensors differed before a step: just before it, or in an alarm that lasts until then."""
        spans, first = {(max(begin - LEAST_SAMPLES, 0), begin)}, begin
        while True:
            alarms = {(a, min(b, begin)) for i, a, b in self.alarms if i in pair and a < begin and b + APART >= first}
            if alarms <= spans:
                break
            spans |= alarms
            first = min(a for a, _ in spans)
        for a, b in sorted(spans):
            difference = self.y[a:b, pair[0]] - self.y[a:b, pair[1]]
            enough = 2 * np.isfinite(difference).sum() >= LEAST_SAMPLES
            if enough and excess(difference, self.apart[pair])[0] > AGREE:
                return a
        return None

    def _agreeing(self, blamed: Flags) -> list[tuple[int, int]]:
        """Return the pairs of sensors that agree with each other while both are blamed, and with those that are not.

        Two sensors that have failed from the same cause do not agree with a healthy one.
        """
        pairs = []
        for (i, j), expected in self.apart.items():
            together = self.together[i, j]
            difference = (self.y[:, i] - self.y[:, j])[together]
            difference = difference[np.isfinite(difference)]
            enough = len(difference) >= LEAST_SAMPLES and together.mean() >= LEAST_SHARE
            if enough and excess(difference, expected)[0] <= AGREE and not self._contradicted(i, j, blamed):
                pairs.append((i, j))
        return pairs

    def _contradicted(self, i: int, j: int, blamed: Flags) -> bool:
        """Return whether a healthy sensor differs from one of two while both are blamed, for most of this time."""
        together = self.together[i, j]
        for (one, other), expected in self.apart.items():
            if len({one, other} & {i, j}) != 1:
                continue
            third = other if one in (i, j) else one
            difference = (self.y[:, one] - self.y[:, other])[together & ~blamed[:, third]]
            difference = difference[np.isfinite(difference)]
            if 2 * len(difference) > together.sum() and excess(difference, expected)[0] > AGREE:
                return True
        return False

    def _moments(self, blamed: Flags) -> list[_Moment]:
        """Return when blamed sensors agree with all sensors of their quantity.

        Two sensors that have failed from the same cause agree with each other, too, but not with a healthy one. So a sensor
        that is not blamed must have samples at the same steps as those that are.
        """
        moments = []
        for group in self.model.alike:
            members = list(group)
            if len(members) < 2:
                continue
            for begin, end in periods(blamed[:, members].sum(axis=1) > 1):
                part = slice(begin, end)
                agreed = {pair: self.agree(pair, part) for pair in combinations(members, 2)}
                together = [p for p in agreed if agreed[p] and self.together[p][part].any()]
                healthy = {i for i in members if not blamed[part, i].any()}
                named = {i for pair in together for i in pair}
                compared = [agreed[pair] for pair in agreed if healthy & set(pair) and named & set(pair)]
                if together and False not in agreed.values() and all(compared):
                    whole = named == set(members) and bool(blamed[part, members].all(axis=1).any())
                    moments.append(_Moment(begin, end, together, whole))
        return sorted(moments)

    def agree(self, pair: tuple[int, int], part: slice) -> bool | None:
        """Return whether two sensors agree; None if they have too few samples at the same steps to tell."""
        difference = self.y[part, pair[0]] - self.y[part, pair[1]]
        difference = difference[np.isfinite(difference)]
        if len(difference) and excess(difference, self.apart[pair])[0] > AGREE:
            return False
        return True if len(difference) >= LEAST_COMMON else None

    @property
    def occasions(self) -> int:
        """Number of times that sensors that agree are blamed together, at least `APART` steps from each other."""
        steps = np.flatnonzero(self.momentary)
        return int(len(steps) > 0) + int((np.diff(steps) > APART).sum())

    @property
    def momentary(self) -> Flags:
        """Steps at which sensors that agree are blamed together for a moment."""
        when: Flags = np.zeros(len(self.y), dtype=bool)
        for moment in self.moments:
            when[moment.begin : moment.end] = True
        return when

    @property
    def telling(self) -> bool:
        """Whether the moments are evidence against the model: there are several, or one in which no sensor is left to differ."""
        return self.occasions >= LEAST_TIMES or any(moment.whole for moment in self.moments)

    def ends(self, other: _Blame, most: float) -> bool:
        """Return whether another monitor of the same recording blames sensors in this way at no more steps than these."""
        remaining = other.momentary if self.times else other.when
        return bool(remaining.sum() <= most) and (not self.agreeing or not other.telling)

    def difference(self, i: int, j: int) -> Floats:
        """Return the differences of two sensors, where both have a sample."""
        difference = self.y[:, i] - self.y[:, j]
        return difference[np.isfinite(difference)]

    @property
    def spread(self) -> float:
        """How far a typical pair of sensors scatters about its median difference, relative to the model."""
        pairs = [(self.difference(*pair), expected) for pair, expected in self.apart.items()]
        ratios = [MAD * float(np.median(np.abs(d - np.median(d)))) / expected for d, expected in pairs if len(d)]
        return float(np.median(ratios)) if ratios else 0.0

    def innovations(self) -> Iterator[tuple[Floats, float]]:
        """Give for each of the sensors its innovations while it is blamed, and their standard deviation by the model."""
        C, R = self.model.matrix("C"), self.model.matrix("sensor_covariance")
        try:
            variances = np.diag(C @ steady_covariance(self.model) @ C.T + R)
        except ModelError:
            variances = np.diag(R)
        for i in self.sensors:
            yield self.innovation[self.when, i], float(np.sqrt(variances[i]))


def _blamed(monitored: Monitored, threshold: float) -> Flags:
    """Return the steps at which each sensor is blamed for a fault that a wrong model can look like."""
    blamed = np.nan_to_num(monitored.fault_probability) >= threshold
    blamed &= ~monitored.rest[:, None]
    if monitored.kinds:
        kind = np.nan_to_num(monitored.mode_probability).argmax(axis=2)
        blamed &= ~np.isin(kind, [monitored.kinds.index(name) for name in ELSEWHERE if name in monitored.kinds])
    return np.asarray(blamed)


def _alarms(monitored: Monitored) -> list[tuple[int, int, int]]:
    """Return sensor, first step and step after the last of each alarm, from the onset of its fault on."""
    order, step, time = monitored.recording.sensors, float(monitored.recording.dt), monitored.time
    found = []
    for event in monitored.events:
        begin = event.start if event.onset is None else min(event.onset, event.start)
        first, last = np.searchsorted(time, [begin - step / 2, event.end + step / 2])
        found.append((order.index(event.sensor), int(first), int(last)))
    return found


def _differences(monitor: Monitor, recording: Recording, model: LinearModel) -> dict[tuple[int, int], float]:
    """Return for each pair of sensors of one quantity the standard deviation of their difference by the model."""
    C, R = model.matrix("C"), model.matrix("sensor_covariance")
    plant = model.states - model.disturbances
    errors = monitor.start(recording, model)[1][plant:, plant:]
    expected = {}
    for group in model.alike:
        for i, j in combinations(group, 2):
            row = C[i, plant:] - C[j, plant:]
            expected[i, j] = float(np.sqrt(row @ errors @ row + R[i, i] + R[j, j] - 2 * R[i, j]))
    return expected


class _Remedy(NamedTuple):
    """A setting whose larger value ends the blame, and the least factor."""

    setting: str = ""
    factor: float = 1.0
    nearly: bool = False
    """Whether some of the blame remains, for which the model would still be suspect."""


def _remedy(monitor: Monitor, monitored: Monitored, blame: _Blame) -> _Remedy:
    """Return what ends the blame, or nearly ends it. Factors are tried on a part of a long recording first."""
    recording = _first_part(monitor, monitored.recording, int(np.flatnonzero(blame.when)[0]))
    most = REMAINING * float(blame.when[_steps(monitored, *recording.time[[0, -1]])].sum())
    tried = [("motion", factor) for factor in FACTORS]
    if not blame.agreeing:  # then no motion, which they have in common, is the reason
        tried = [("noise", float(f"{blame.spread:.2g}"))] if blame.spread > SCATTER else []
    nearly = _Remedy()
    for setting, factor in tried:
        other = _with(monitor, setting, factor)
        with suppress(ModelError):  # of a number whose square is too large
            if other is None or not blame.ends(_Blame(other, other.run(recording)), most):
                continue
            whole = _Blame(other, other.run(monitored.recording))
            if blame.ends(whole, REMAINING * float(blame.when.sum())):
                if not whole.sensors:
                    return _Remedy(setting, factor)
                nearly = nearly if nearly.setting else _Remedy(setting, factor, True)
    return nearly


def _with(monitor: Monitor, setting: str, factor: float) -> Monitor | None:
    """Return the monitor with more motion or noise; None if its model has no number for it."""
    if setting == "noise":
        return replace(monitor, sensors={n: replace(s, std=factor * s.std) for n, s in monitor.sensors.items()})
    plant: Any = monitor.plant
    if isinstance(plant, Matrices):
        covariance = (factor * factor * np.asarray(plant.process_covariance, dtype=np.float64)).tolist()
        return replace(monitor, plant=replace(plant, process_covariance=covariance))
    return replace(monitor, plant=replace(plant, std=factor * plant.std)) if hasattr(plant, "std") else None


def _sentence(monitor: Monitor, monitored: Monitored, blame: _Blame, remedy: _Remedy) -> str:
    names, units = monitored.recording.sensors, monitored.recording.units
    listed = [names[i] for i in blame.sensors]
    who = f"{', '.join(listed[:-1])} and {listed[-1]}"
    share = f"{blame.times} times" if blame.times else f"for {blame.share:.0%} of the recording"
    if blame.times == 1:
        first, last = (float(time) for time in monitored.time[blame.when][[0, -1]])
        share = f"from {span_text(first, last, monitored.recording.origin)}"
    if blame.agreeing:
        said = [
            f"Suspect the model, not the sensors: {who} agree with each other, but are blamed at the same time, {share}."
        ]
        if blame.whole:
            said.append(SHARED)
    else:
        said = [f"The model may be wrong instead of the sensors: {who} are blamed at the same time, {share}."]
    (i, (errors, expected)), *_ = zip(blame.sensors, blame.innovations(), strict=True)
    if remedy.setting == "noise":
        own = {
            pair: expected for pair, expected in blame.apart.items() if set(pair) <= set(blame.sensors)
        } or blame.apart
        (i, j), expected = next(iter(own.items()))
        errors, subject = (
            blame.difference(i, j),
            f"Apart from their mean, {names[i]} and {names[j]} differ from each other",
        )
        said.append(scatter(errors - np.median(errors), expected, units[i], subject, "from the std of both"))
    else:
        subject, source = f"{names[i]} then differs from its prediction", "from the motion and the noise of all sensors"
        said.append(scatter(errors, expected, units[i], subject, source))
    return " ".join(filter(None, [*said, _advice(monitor, monitored, blame, remedy)]))


def _advice(monitor: Monitor, monitored: Monitored, blame: _Blame, remedy: _Remedy) -> str:
    ends = "This nearly ends" if remedy.nearly else "This ends"
    if remedy.setting == "motion":
        return _motion_advice(monitor, remedy.factor, ends)
    if remedy.setting == "noise":
        return f"{ends} if the std of every sensor is {remedy.factor:g} times as large."
    if blame.agreeing:
        return NO_MOTION
    names, units = monitored.recording.sensors, monitored.recording.units
    apart = {pair: float(np.median(blame.difference(*pair))) for pair in blame.apart if len(blame.difference(*pair))}
    if not apart:
        return ""
    i, j = max(apart, key=lambda pair: abs(apart[pair]) / blame.apart[pair])
    unit = behind(units[i])
    return (
        f"{names[i]} and {names[j]} differ by {abs(apart[i, j]):.3g}{unit} in the median: if that is no fault, give the bias of "
        "each sensor, or [[errors]] that last."
    )


def _motion_advice(monitor: Monitor, factor: float, ends: str = "This ends") -> str:
    plant: Any = monitor.plant
    if isinstance(plant, Matrices):
        return f"{ends} if the process_covariance in [model] is {factor**2:.3g} times as large."
    return (
        f"{ends} with std = {factor * plant.std:.3g} in [model] instead of {plant.std:.3g}, {factor:g} times as large."
    )


__all__ = ["ModelSuspicion", "both_blamed", "doubtful_alarms", "failed_before", "moved", "suspect_model"]
