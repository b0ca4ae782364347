"""The fault panels of a closed loop's figure: expected noise, fault probabilities, and present faults."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.figures.panels import LETTER, WIDTH, name_spans, thin, thin_marks
from bayesftc.cosim.judging.figures.plotting import BLACK, LINES, colour_of
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.parts import parts_of_device
from bayesftc.cosim.judging.signals import ALARM, ActuatorSignals, Flags, LoopSignals, SensorSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Marks = dict[int, dict[str, Flags]]
"""By sensor: what its samples are at which times."""

IGNORED = 100.0
"""Factor above the smallest expected standard deviation of a quantity; beyond it, a weight is below 1/10,000 of the largest."""
WORSE = 10.0
"""Factor above a sensor's own smallest one, which it must also exceed: a coarse sensor beside a fine one is not ignored."""
SMALLEST = 0.01
"""Quantile of the expected standard deviations that counts as the smallest, because the minimum may last for one sample only."""
OTHER = 1000.0
"""Ratio of expected standard deviations from which sensors without units have panels of their own, as for metres and pascals."""
LANE, FIRST_LANE = 0.11, 1.10
"""Height of a row of kinds and the middle of the lowest, in units of the probability."""
HATCHED: dict[str, Any] = {"fc": "none", "ec": "0.8", "hatch": "///"}
"""Look of the time of an actuator or process fault."""
GREY_BAR: dict[str, Any] = {"color": "0.6", "lw": 5, "alpha": 0.5, "solid_capstyle": "butt"}
"""Look of a bar of any colour in a legend."""
PLAIN, ROW = 1.8, 0.16
"""Heights in inches of a panel of expected noise or of beta without marks, and of a row of marks above its values."""
BAR = 0.07
"""Height in inches of a bar in such a row."""
ENDS = 3.0
"""Length of a bar that must be seen beside a word on it, in letters: a bar that the word hides looks like another kind."""
CORRECTED: dict[str, Any] = {"facecolor": "white", "hatch": "//////", "lw": 0.8}
"""Look of a bar for corrected samples; bars for ignored ones are filled."""


def deviation_panels(signals: LoopSignals) -> list[tuple[float, Callable[[Axes], None]]]:
    """Return a panel of expected standard deviations for each unit; without units, for each quantity if their sizes differ."""
    units: dict[tuple[str, str | None], list[SensorSignals]] = {}
    shown = [sensor for sensor in signals.sensors if sensor.precision is not None]
    names = {i: quantity.name for quantity in signals.quantities for i in quantity.sensors}
    least: dict[str, float] = {}
    for sensor in shown:
        name = names.get(sensor.index, "")
        if not sensor.unit and np.isfinite(size := _smallest(_expected(sensor))):
            least[name] = min(size, least.get(name, size))
    apart = max(least.values(), default=0.0) > OTHER * min(least.values(), default=np.inf)
    for sensor in shown:
        quantity = names.get(sensor.index, "") if apart and not sensor.unit else ""
        units.setdefault((quantity, sensor.unit), []).append(sensor)
    panels: list[tuple[float, Callable[[Axes], None]]] = []
    for (quantity, unit), group in units.items():
        marks = _unused(signals, group)
        height = PLAIN + ROW * len(marks)
        what = f"deviation of {quantity}" if quantity else with_unit("deviation", unit)
        draw = partial(_draw_deviation, signals=signals, sensors=group, what=what, marks=marks, row=ROW / height)
        panels.append((height, draw))
    return panels


def _unused(signals: LoopSignals, sensors: list[SensorSignals]) -> Marks:
    """Return when the samples of each sensor are ignored, corrected or missing; without sensors of which none ever are."""
    expected = {sensor.index: _expected(sensor) for sensor in sensors}
    marks = {}
    for sensor in sensors:
        beyond = expected[sensor.index] > _most(signals, sensor, expected)
        if sensor.alarm is not None:
            beyond &= sensor.alarm  # a healthy sensor may be much noisier than those beside it
        none = np.zeros(len(signals.time), dtype=bool)
        missing, lost = (none if each is None else each for each in (sensor.missing, sensor.lost))
        little = _held(sensor, (~missing & (sensor.precision == 0)) | beyond)
        corrected = little & sensor.corrected  # its precision does not count the samples minus the offset
        each = {"ignored": little & ~corrected, "corrected": corrected, "missing": lost}
        if found := {what: where for what, where in each.items() if where.any()}:
            marks[sensor.index] = found
    return marks


def _draw_deviation(
    axis: Axes, *, signals: LoopSignals, sensors: list[SensorSignals], what: str, marks: Marks, row: float
) -> None:
    drawn = []
    for sensor in sensors:
        its = marks.get(sensor.index, {})
        unused = np.any([np.zeros(len(signals.time), dtype=bool), *its.values()], axis=0)
        shown = np.where(unused, np.nan, _expected(sensor))
        drawn.append(shown)
        axis.plot(*thin(signals.time, shown), **_line(signals, sensor))
        if its:
            _mark(axis, signals, sensor, its, list(marks).index(sensor.index), row)
    if any("corrected" in its for its in marks.values()):
        axis.fill_between([], [], edgecolor="0.6", label="corrected: the inferred\noffset is subtracted", **CORRECTED)
    axis.set_ylabel(f"expected standard\n{what}")
    _logarithmic(axis, drawn, (len(marks) + 0.5) * row if marks else 0.0)


def _most(signals: LoopSignals, sensor: SensorSignals, expected: Mapping[int, Floats]) -> float:
    """Return the largest expected standard deviation that has a weight beside the best sensor of the same quantity."""
    peers = next((q.sensors for q in signals.quantities if sensor.index in q.sensors), tuple(expected))
    own = expected[sensor.index]  # the least of all: at the start it may be as modelled for a moment only
    usual = WORSE * float(np.nanmin(own)) if np.isfinite(own).any() else 0.0
    return max(IGNORED * _smallest(np.concatenate([expected[i] for i in peers if i in expected])), usual)


def _smallest(expected: Floats) -> float:
    """Return the smallest expected standard deviation, for more than a moment; infinity of none."""
    finite = expected[np.isfinite(expected)]
    return float(np.quantile(finite, SMALLEST)) if len(finite) else np.inf


def _expected(sensor: SensorSignals) -> Floats:
    """Return the standard deviation that the controller expects; NaN without a sample or a precision."""
    assert sensor.precision is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where(sensor.precision > 0, 1.0 / np.sqrt(sensor.precision), np.nan)
    return _given(sensor, expected)


def _mark(
    axis: Axes, signals: LoopSignals, sensor: SensorSignals, marks: Mapping[str, Flags], row: int, share: float
) -> None:
    """Mark times of a sensor in a row at the top of an axis, with words; `share` is the height of a row, of the axis' height."""
    time, across, colour = signals.time, axis.get_xaxis_transform(), colour_of(sensor.index)
    top, bars = 1.0 - share * (row + 0.5), []
    for what, where in marks.items():
        style: dict[str, Any] = {"transform": across, "label": f"{signals.sensor_name(sensor.index)} {what}"}
        spans = [(float(time[a]), float(time[b - 1])) for a, b in periods(where)]
        bars += [(a, b, what) for a, b in spans]
        if what == "corrected":
            height = share * BAR / ROW
            lengths = [(a, b - a) for a, b in spans]
            axis.broken_barh(lengths, (top - 0.5 * height, height), edgecolor=colour, **CORRECTED, **style)
        elif what == "ignored":  # a bar, with a tick for a single sample, which has no length
            bar: dict[str, Any] = {"lw": 72 * BAR, "solid_capstyle": "butt", "marker": "|", "ms": 72 * BAR}
            ends = np.array([(a, b, np.nan) for a, b in spans]).ravel()
            axis.plot(ends, np.where(np.isnan(ends), np.nan, top), color=colour, **bar, **style)
        else:
            size = 2.5 if what == "missing" else 5
            at, values = thin_marks(time[where], np.full(int(where.sum()), top))
            crosses: dict[str, Any] = {"ls": "none", "marker": "x", "ms": size, "color": colour}
            drawn = _apart(at, 1.5 * size / 72 / WIDTH * float(time[-1] - time[0]))
            axis.plot(at, values, markevery=drawn, **crosses, **style)
    _name_bars(axis, time, bars, top, colour, across, once=True)


def _apart(time: Floats, least: float) -> list[int]:
    """Return the numbers of those of ascending times that lie apart, so that crosses at them do not run into one bar."""
    kept: list[int] = []
    for i, t in enumerate(time):
        if not kept or t - time[kept[-1]] >= least:
            kept.append(i)
    return kept


def _name_bars(
    axis: Axes,
    time: Floats,
    bars: list[tuple[float, float, str]],
    y: float,
    colour: str,
    transform: Any,
    *,
    once: bool = False,
) -> None:
    """Write the words of bars in a row: on bars that are long enough, or, where no bar of a word is, beside its longest.

    With `once`, a word stands on its longest bar only. A word without room is left out, and so is that of bars that are hardly
    to be seen beside longer ones.
    """
    first, last = float(time[0]), float(time[-1])
    letter = 0.8 * LETTER * (last - first)
    taken = [(a, b) for a, b, _ in bars]
    visible = min(letter, max((b - a for a, b in taken), default=0.0))
    for word in dict.fromkeys(word for *_, word in bars):
        width = letter * (len(word) + 1)
        longest, *rest = sorted(((a, b) for a, b, of in bars if of == word), key=lambda bar: bar[0] - bar[1])
        fitting = [(a, b) for a, b in [longest, *rest[: 0 if once else None]] if b - a > width + ENDS * letter]
        for a, b in fitting:
            _write(axis, 0.5 * (a + b), y, word, colour, transform)
        if fitting or longest[1] - longest[0] < visible:
            continue
        sides = (longest[1], longest[1] + width), (longest[0] - width, longest[0])
        free = (x for x in sides if x[0] >= first and x[1] <= last and not any(a < x[1] and b > x[0] for a, b in taken))
        if (place := next(free, None)) is not None:
            taken.append(place)
            _write(axis, 0.5 * sum(place), y, word, colour, transform)


def _write(axis: Axes, x: float, y: float, text: str, colour: str, transform: Any) -> None:
    """Write a text on a bar."""
    box = {"fc": "white", "ec": "none", "pad": 0.8}
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7, "zorder": 6}
    axis.text(x, y, text, color=colour, bbox=box, transform=transform, **style)


def _logarithmic(axis: Axes, drawn: list[Floats], margin: float = 0.0) -> None:
    """Make the axis logarithmic, with further ticks if there would be at most one power of ten.

    ``margin`` is the share of its height at the top for marks, which has no ticks: a mark there is no value.
    """
    from matplotlib.ticker import NullFormatter, StrMethodFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    values = np.concatenate(drawn) if drawn else np.array([])
    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return
    low, high = 0.8 * values.min(), 1.3 * values.max()
    axis.set_ylim(low, low * (high / low) ** (1.0 / (1.0 - min(margin, 0.8))))
    subs: tuple[float, ...] = (1.0,)
    if values.max() < 100 * values.min():
        subs = tuple(np.arange(1.0, 10.0)) if values.max() < 5 * values.min() else (1.0, 2.0, 5.0)
    axis.yaxis.set_major_locator(_ticks_below(high, subs))
    axis.yaxis.set_minor_locator(_ticks_below(high, tuple(np.arange(2.0, 10.0))))
    if margin:
        axis.spines["left"].set_bounds(low, high)
        axis.axhline(high, color="0.8", lw=0.6, zorder=1)


def _ticks_below(top: float, subs: tuple[float, ...]) -> Any:
    """Return a locator of ticks on a logarithmic axis, without those above a value."""
    from matplotlib.ticker import LogLocator

    class Below(LogLocator):
        def tick_values(self, vmin: float, vmax: float) -> Any:
            ticks = np.asarray(super().tick_values(vmin, vmax))
            return ticks[ticks <= top]

    return Below(subs=subs)


def detection_panels(signals: LoopSignals) -> list[tuple[float, Callable[[Axes], None]]]:
    """Return the panel of fault probabilities, or of beta; none if the run has neither. Rows of kinds increase its height."""
    rated = _with_probability(signals) or signals.actuators or _with_beta(signals)
    if not rated and all(sensor.alarm is None for sensor in signals.sensors):
        return []
    return [(1.9 + 0.17 * len(_alarmed(signals)), partial(draw_detection, signals=signals))]


def _with_probability(signals: LoopSignals) -> list[SensorSignals]:
    return [s for s in signals.sensors if s.probability is not None and not np.isnan(s.probability).all()]


def _with_beta(signals: LoopSignals) -> list[SensorSignals]:
    return [s for s in signals.sensors if s.beta is not None and not np.isnan(s.beta).all()]


def _alarmed(signals: LoopSignals) -> list[SensorSignals | ActuatorSignals]:
    """Return the sensors and actuators with an alarm and known kinds, and the process if it moves more than its model expects."""
    moved = [] if signals.moved is None else [signals.moved]
    devices: list[SensorSignals | ActuatorSignals] = [*signals.sensors, *signals.actuators, *moved]
    return [
        each
        for each in devices
        if each.kinds and each.kind is not None and each.probability is not None and (each.probability >= ALARM).any()
    ]


def draw_detection(axis: Axes, *, signals: LoopSignals) -> None:
    """Draw the fault probabilities and the kinds of faults; without probabilities, beta and detected faults."""
    with_probability = _with_probability(signals)
    if not with_probability and not signals.actuators:
        _draw_beta(axis, signals)
        return
    for sensor in with_probability:
        assert sensor.probability is not None
        infers_dropout = "DroppedOut" in sensor.kinds  # a missing sample then says something, too
        probability = sensor.probability if infers_dropout else _given(sensor, sensor.probability)
        axis.plot(*thin(signals.time, probability), **_line(signals, sensor))
    for j, actuator in enumerate(signals.actuators):
        # Black, as for inputs, because the colours belong to the sensors.
        style: dict[str, Any] = {"color": BLACK, "ls": LINES[j % len(LINES)], "lw": 1.3, "zorder": 3}
        axis.plot(*thin(signals.time, actuator.probability), label=f"actuator {actuator.name}", **style)
    axis.axhline(ALARM, color="0.4", lw=0.8, zorder=0, label=f"alarm from {ALARM:g}")
    rows = _alarmed(signals)
    for row, each in enumerate(rows):
        _draw_kinds(axis, signals.time, each, FIRST_LANE + LANE * row)
    if rows:
        axis.plot([], [], **GREY_BAR, label="bar: most probable kind\nduring an alarm")
    axis.set_ylim(-0.04, FIRST_LANE + LANE * (len(rows) - 0.4) if rows else 1.04)
    axis.set_yticks(np.linspace(0.0, 1.0, 6))
    axis.set_ylabel("fault probability")


def _draw_kinds(axis: Axes, time: Floats, each: SensorSignals | ActuatorSignals, y: float) -> None:
    """Draw a bar for each part of an alarm with one kind, and write the kind on bars that are long enough."""
    colour = colour_of(each.index) if isinstance(each, SensorSignals) else BLACK
    ends, listed = np.append(time, time[-1]), parts_of_device(each, time)
    bars = [(float(ends[p.begin]), float(ends[p.end]), _words(each.kinds, p.kind)) for p in listed if p.kind > 0]
    axis.broken_barh([(a, b - a) for a, b, _ in bars], (y - 0.04, 0.08), color=colour, alpha=0.5, lw=1, zorder=4)
    if changes := [float(ends[p.begin]) for p in listed if p.begin > p.alarm]:
        axis.vlines(changes, y - 0.04, y + 0.04, color="white", lw=1.5, zorder=5)
    _name_bars(axis, time, bars, y, colour, axis.transData)


def _words(kinds: Sequence[str], number: float) -> str:
    """Return the name of a kind as separate words: ``dropped out`` for `DroppedOut`."""
    name = kinds[int(number) - 1] if number <= len(kinds) else f"kind {number:g}"
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def _draw_beta(axis: Axes, signals: LoopSignals) -> None:
    rated = _with_beta(signals)
    for sensor in rated:
        assert sensor.beta is not None
        axis.plot(*thin(signals.time, _given(sensor, sensor.beta)), **_line(signals, sensor))
    detected = [sensor for sensor in signals.sensors if sensor.alarm is not None and sensor.alarm.any()]
    share = ROW / PLAIN
    for row, sensor in enumerate(detected):
        assert sensor.alarm is not None
        _mark(axis, signals, sensor, {"detected": sensor.alarm}, row, share)
    units = {sensor.unit for sensor in rated}
    unit = units.pop() if len(units) == 1 else None
    axis.set_ylabel(with_unit("beta", f"({unit})²" if unit else None))
    if rated:
        _logarithmic(
            axis, [s.beta for s in rated if s.beta is not None], (len(detected) + 0.5) * share if detected else 0.0
        )
    else:
        axis.set_yticks([])
        axis.set_ylabel("detected faults")


def draw_shades(axis: Axes, signals: LoopSignals, sensors: Sequence[int] | None = None) -> None:
    """Shade the faults of some sensors, by default of all, each in its colour over the whole height; hatch those of inputs."""
    over: dict[str, Any] = {"transform": axis.get_xaxis_transform(), "lw": 0, "zorder": 0, "step": "post"}
    for sensor in signals.sensors:
        shaded = sensors is None or sensor.index in sensors
        if shaded and sensor.faulty is not None and sensor.faulty.any():
            style = {"color": colour_of(sensor.index), "alpha": 0.12, **over}
            axis.fill_between(signals.time, 0, 1, where=sensor.faulty, **style)
    for each in signals.inputs:
        if each.faulty is not None and each.faulty.any():
            axis.fill_between(signals.time, 0, 1, where=each.faulty, **HATCHED, **over)


def name_faults(axis: Axes, signals: LoopSignals) -> None:
    """Write the name of each fault above its period, or one note if there are too many; label what shades and hatching mean."""
    faults = [
        (a, b, f"sensor {i}: {_kind(name, '', f'_{i}')}", colour_of(i))
        for name, (i, active) in signals.faults.items()
        for a, b in periods(active)
    ]
    note = f"shaded: {len(faults)} faults, in the colour of their sensor"
    of_inputs = [
        (a, b, f"{each.name}: {_kind(name, f'{each.name}_', '_0')}", "0.35")
        for each in signals.inputs
        for name, active in each.faults.items()
        if active is not None
        for a, b in periods(active)
    ]
    faults += of_inputs
    named = [(float(signals.time[a]), float(signals.time[b - 1]), text, colour) for a, b, text, colour in faults]
    name_spans(axis, signals.time, named, note + f"; hatched: {len(of_inputs)}" * bool(of_inputs))
    if any(active.any() for _, active in signals.faults.values()):
        axis.fill_between([], [], color="0.88", lw=0, label="shaded: sensor fault")
    faulty = [each for each in signals.inputs if each.faulty is not None and each.faulty.any()]
    which = sorted({"process" if each.control is None else "actuator" for each in faulty})
    if which:
        axis.fill_between([], [], lw=0, label=f"hatched: {' or '.join(which)} fault", **HATCHED)


def _kind(name: str, of: str, number: str) -> str:
    """Return the kind of fault in a default name such as ``freeze_1``, or ``freeze_1_2`` of a second one: ``freeze 2``.

    Any other name is returned unchanged.
    """
    default = re.fullmatch(rf"{re.escape(of)}(.+?){number}(_\d+)?", name)
    return f"{default[1]}{default[2] or ''}".replace("_", " ") if default else name


def _given(sensor: SensorSignals, values: Floats) -> Floats:
    """Return a learner's output with gaps for missing samples, because without samples it only relaxes.

    Between two samples of a slow sensor it is that of the last one.
    """
    return values if sensor.missing is None else _held(sensor, np.where(sensor.missing, np.nan, values))


def _held(sensor: SensorSignals, values: Any) -> Any:
    """Return values over time, with that of the last sample at the pauses of a slow sensor."""
    pauses = sensor.pauses
    if not pauses.any():
        return values
    last = np.maximum.accumulate(np.where(pauses, 0, np.arange(len(values))))
    return values[last]


def _line(signals: LoopSignals, sensor: SensorSignals) -> dict[str, Any]:
    i = sensor.index
    return {"color": colour_of(i), "ls": LINES[i % len(LINES)], "lw": 1.3, "label": signals.sensor_name(i)}


__all__ = ["detection_panels", "deviation_panels", "draw_detection", "draw_shades", "name_faults"]
