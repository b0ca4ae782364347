"""The fault panels of a closed loop's figure: expected noise, fault probabilities, and present faults."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.panels import LETTER, name_spans, thin
from bayesftc.cosim.judging.plotting import BLACK, LINES, colour_of
from bayesftc.cosim.judging.signals import ALARM, ActuatorSignals, Flags, LoopSignals, SensorSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

IGNORED = 100.0
"""Factor above the smallest expected standard deviation of a quantity; beyond it, a weight is below 1/10,000 of the largest."""
SMALLEST = 0.01
"""Quantile of the expected standard deviations that counts as the smallest, because the minimum may last for one sample only."""
LANE, FIRST_LANE = 0.11, 1.10
"""Height of a row of kinds and the middle of the lowest, in units of the probability."""
HATCHED: dict[str, Any] = {"fc": "none", "ec": "0.8", "hatch": "///"}
"""Look of the time of an actuator or process fault."""
GREY_BAR: dict[str, Any] = {"color": "0.6", "lw": 5, "alpha": 0.5, "solid_capstyle": "butt"}
"""Look of a bar of any colour in a legend."""
ROW = 0.09
"""Height of a row of marks, as a share of the panel's."""


def deviation_panels(signals: LoopSignals) -> list[tuple[float, Callable[[Axes], None]]]:
    """Return a panel of expected standard deviations for each unit of sensors."""
    units: dict[str | None, list[SensorSignals]] = {}
    for sensor in signals.sensors:
        if sensor.precision is not None:
            units.setdefault(sensor.unit, []).append(sensor)
    return [(1.8, partial(_draw_deviation, signals=signals, sensors=group, unit=unit)) for unit, group in units.items()]


def _draw_deviation(axis: Axes, *, signals: LoopSignals, sensors: list[SensorSignals], unit: str | None) -> None:
    expected = {sensor.index: _expected(sensor) for sensor in sensors}
    drawn, row = [], 0
    for sensor in sensors:
        values = expected[sensor.index]
        beyond = values > _most(signals, sensor, expected)
        if sensor.alarm is not None:
            beyond &= sensor.alarm  # a healthy sensor may be much noisier than those beside it
        shown = np.where(beyond, np.nan, values)
        drawn.append(shown)
        axis.plot(*thin(signals.time, shown), **_line(signals, sensor))
        missing = np.zeros(len(signals.time), dtype=bool) if sensor.missing is None else sensor.missing
        little = (~missing & (sensor.precision == 0)) | beyond
        corrected = little & sensor.corrected  # its precision does not count the samples minus the offset
        ignored = little & ~corrected
        row += _mark(axis, signals, sensor, "ignored", row, ignored)
        row += _mark(axis, signals, sensor, "corrected", row, corrected)
        row += _mark(axis, signals, sensor, "missing", row, missing)
    if any(text.endswith(" corrected") for text in axis.get_legend_handles_labels()[1]):
        axis.plot([], [], **GREY_BAR, label="corrected: the inferred\noffset is subtracted")
    axis.set_ylabel("expected standard\n" + with_unit("deviation", unit))
    _logarithmic(axis, drawn, (row + 0.5) * ROW if row else 0.0)


def _most(signals: LoopSignals, sensor: SensorSignals, expected: Mapping[int, Floats]) -> float:
    """Return the largest expected standard deviation that has a weight beside the best sensor of the same quantity."""
    peers = next((q.sensors for q in signals.quantities if sensor.index in q.sensors), tuple(expected))
    values = np.concatenate([expected[i] for i in peers if i in expected])
    finite = values[np.isfinite(values)]
    return IGNORED * float(np.quantile(finite, SMALLEST)) if len(finite) else np.inf


def _expected(sensor: SensorSignals) -> Floats:
    """Return the standard deviation that the controller expects; NaN without a sample or a precision."""
    assert sensor.precision is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where(sensor.precision > 0, 1.0 / np.sqrt(sensor.precision), np.nan)
    return _given(sensor, expected)


def _mark(axis: Axes, signals: LoopSignals, sensor: SensorSignals, what: str, row: int, where: Flags) -> int:
    """Mark times of a sensor in a row at the top of an axis, with a text; return the number of rows used."""
    if not where.any():
        return 0
    time, height = signals.time, axis.get_xaxis_transform()
    top, label = 0.97 - ROW * row, f"{signals.sensor_name(sensor.index)} {what}"
    style: dict[str, Any] = {"color": colour_of(sensor.index), "transform": height, "label": label}
    if what in ("ignored", "corrected"):  # a bar, with a tick for a single sample, which has no length
        bar: dict[str, Any] = {"lw": 5, "solid_capstyle": "butt", "marker": "|", "ms": 5}
        ends = np.array([(time[a], time[b - 1], np.nan) for a, b in periods(where)]).ravel()
        axis.plot(ends, np.where(np.isnan(ends), np.nan, top), **bar, **style)
    else:
        crosses: dict[str, Any] = {"ls": "none", "marker": "x", "ms": 2.5 if what == "missing" else 5}
        axis.plot(*thin(time[where], np.full(int(where.sum()), top)), **crosses, **style)
    begin, end = max(periods(where), key=lambda period: period[1] - period[0])
    width = LETTER * (len(what) + 1) * float(time[-1] - time[0])
    if time[end - 1] - time[begin] > width:
        _write(axis, 0.5 * float(time[begin] + time[end - 1]), top, what, colour_of(sensor.index), height)
    return 1


def _write(axis: Axes, x: float, y: float, text: str, colour: str, transform: Any) -> None:
    """Write a text on a bar."""
    box = {"fc": "white", "ec": "none", "pad": 0.8}
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7, "zorder": 6}
    axis.text(x, y, text, color=colour, bbox=box, transform=transform, **style)


def _logarithmic(axis: Axes, drawn: list[Floats], margin: float = 0.0) -> None:
    """Make the axis logarithmic, with further ticks if there would be at most one power of ten.

    ``margin`` is the free share of its height at the top.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_yscale("log")
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    values = np.concatenate(drawn) if drawn else np.array([])
    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return
    low, high = 0.8 * values.min(), 1.3 * values.max()
    axis.set_ylim(low, low * (high / low) ** (1.0 / (1.0 - min(margin, 0.8))))
    if values.max() < 100 * values.min():
        few = values.max() < 5 * values.min()
        axis.yaxis.set_major_locator(LogLocator(subs=tuple(np.arange(1.0, 10.0)) if few else (1.0, 2.0, 5.0)))


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
    """Return the sensors and actuators with an alarm and known kinds."""
    devices: list[SensorSignals | ActuatorSignals] = [*signals.sensors, *signals.actuators]
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
    """Draw a bar for each section of an alarm with one kind, and write the kind on bars that are long enough."""
    assert each.kind is not None
    assert each.probability is not None
    colour = colour_of(each.index) if isinstance(each, SensorSignals) else BLACK
    kind = np.where(each.probability >= ALARM, np.nan_to_num(each.kind), 0.0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1, [len(kind)]])
    ends = np.append(time, time[-1])
    sections = [
        (float(ends[a]), float(ends[b]), _words(each.kinds, kind[a])) for a, b in pairwise(edges) if kind[a] > 0
    ]
    axis.broken_barh([(a, b - a) for a, b, _ in sections], (y - 0.04, 0.08), color=colour, alpha=0.5, lw=0, zorder=4)
    letter = 0.8 * LETTER * float(time[-1] - time[0])
    for a, b, word in sections:
        if b - a > letter * (len(word) + 1):
            _write(axis, 0.5 * (a + b), y, word, colour, axis.transData)
    if sections and all(b - a <= letter * (len(word) + 1) for a, b, word in sections):
        a, b, word = max(sections, key=lambda section: section[1] - section[0])
        right = b + letter * (len(word) + 1) < time[-1]
        side = {"ha": "left" if right else "right", "va": "center", "fontsize": 7, "zorder": 6}
        axis.text(b + 0.5 * letter if right else a - 0.5 * letter, y, word, color=colour, **side)  # type: ignore[arg-type]


def _words(kinds: Sequence[str], number: float) -> str:
    """Return the name of a kind as separate words: ``dropped out`` for `DroppedOut`."""
    name = kinds[int(number) - 1] if number <= len(kinds) else f"kind {number:g}"
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def _draw_beta(axis: Axes, signals: LoopSignals) -> None:
    rated = _with_beta(signals)
    for sensor in rated:
        assert sensor.beta is not None
        axis.plot(*thin(signals.time, _given(sensor, sensor.beta)), **_line(signals, sensor))
    row = 0
    for sensor in signals.sensors:
        if sensor.alarm is not None:
            row += _mark(axis, signals, sensor, "detected", row, sensor.alarm)
    units = {sensor.unit for sensor in rated}
    unit = units.pop() if len(units) == 1 else None
    axis.set_ylabel(with_unit("beta", f"({unit})²" if unit else None))
    if rated:
        _logarithmic(axis, [s.beta for s in rated if s.beta is not None], (row + 0.5) * ROW if row else 0.0)
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
    """Return the kind of fault in a default name such as ``freeze_1``; any other name is returned unchanged."""
    kind = name.removeprefix(of).removesuffix(number)
    return name if kind == name else kind.replace("_", " ")


def _given(sensor: SensorSignals, values: Floats) -> Floats:
    """Return a learner's output with gaps for missing samples, because without samples it only relaxes."""
    return values if sensor.missing is None else np.where(sensor.missing, np.nan, values)


def _line(signals: LoopSignals, sensor: SensorSignals) -> dict[str, Any]:
    i = sensor.index
    return {"color": colour_of(i), "ls": LINES[i % len(LINES)], "lw": 1.3, "label": signals.sensor_name(i)}


__all__ = ["detection_panels", "deviation_panels", "draw_detection", "draw_shades", "name_faults"]
