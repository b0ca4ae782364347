"""The animation of a run: a picture of the plant with scales of its quantities, above the signals up to the shown instant.

What is true, what the controller believes and what each sensor reads are drawn together. A reading with an alarm is pale; one
beyond its scale is an arrow at the end, with its value.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.figures.fault_panels import draw_detection, draw_shades, name_faults
from bayesftc.cosim.judging.figures.limits import limits_with_samples, mark_cut
from bayesftc.cosim.judging.figures.loop_figure import draw_quantity
from bayesftc.cosim.judging.figures.panels import finish, legend, player_figure, thin_marks
from bayesftc.cosim.judging.figures.pictures import PICTURES, Picture
from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, MARKERS, colour_of
from bayesftc.cosim.judging.roles import signals_of
from bayesftc.cosim.judging.signals import ALARM, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bayesftc.cosim.judging.figures.notebook import NotebookAnimation
    from bayesftc.cosim.run.result import Result

MOST_SCALES = 4
"""Largest number of quantities with a scale beside the picture."""
DOTS_PER_INCH = 80
"""Resolution of the pictures; a web page contains each of them."""
HIDDEN = 0.88
"""How much of the signals after the shown instant is hidden."""


def animate_run(result: Result, frames: int, speed: float) -> NotebookAnimation:
    """Return the animation of `Result.animate`."""
    from bayesftc.cosim.judging.figures.notebook import NotebookAnimation

    if isinstance(frames, bool) or not isinstance(frames, int) or frames < 2:
        raise ModelError(f"animate has frames={frames!r}; give a whole number of at least 2.")
    if not (isinstance(speed, int | float) and 0 < speed < np.inf):
        raise ModelError(f"animate has speed={speed!r}; give a positive number, as 1.0 for real time.")
    if len(result.time) < 2:
        raise ModelError(f"The result has {len(result.time)} rows, but an animation needs 2. Simulate for longer.")
    plant, model, lengths = _plant(result)
    signals, variables = _signals(result, plant)
    if not signals.quantities:
        raise ModelError("The result has no scalar signal to animate. Record one: simulate(..., record=['*']).")
    rows = np.unique(np.linspace(0, len(result.time) - 1, frames).round().astype(int))
    figure = player_figure()
    figure.set_size_inches(8.0, 6.8)
    figure.set_dpi(DOTS_PER_INCH)
    figure.set_layout_engine("constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(3.6, 1.6, 1.5), width_ratios=(1.25, 1.0))
    picture = PICTURES.get(model or "")
    parts: list[Any] = []
    if picture and all(f"{plant}.{name}" in result for name in picture.variables):
        parts.append(_Scene(figure.add_subplot(grid[0, 0]), result, plant, picture, lengths, signals, variables, rows))
        parts.append(_Scales(figure.add_subplot(grid[0, 1]), signals))
    else:
        parts.append(_Scales(figure.add_subplot(grid[0, :]), signals))
    shown = signals.quantities[_most_faulty(signals)]
    lower = [figure.add_subplot(grid[1, :] if signals.sensors else grid[1:, :])]
    _draw_signals(lower[0], signals, shown)
    if signals.sensors:
        lower.append(figure.add_subplot(grid[2, :], sharex=lower[0]))
        draw_detection(lower[1], signals=signals)
        lower[0].tick_params(labelbottom=False)
    name_faults(lower[0], signals)
    for axis in lower:
        draw_shades(axis, signals)
        axis.grid(True, color="0.9", lw=0.6)
        legend(axis)
    finish(lower, signals.time)
    parts.append(_Time(lower, signals.time))
    for part in parts:
        part.show(0)
    figure.draw_without_rendering()  # the layout; the canvas of a figure without pyplot draws nothing
    figure.set_layout_engine("none")  # nothing moves but the parts
    seconds = float(result.time[-1] - result.time[0]) / speed

    def show(k: int) -> list[Any]:
        for part in parts:
            part.show(int(rows[k]))
        return []

    moving = [artist for part in parts for artist in part.moving]
    return NotebookAnimation(
        figure, show, moving, frames=len(rows), interval=1000.0 * seconds / len(rows), repeat=False
    )


def _plant(result: Result) -> tuple[str, str | None, dict[str, float]]:
    """Return the block of the plant, its model and its parameters: of a model with a picture if there is one."""
    plants = result.metadata.get("plants", {})
    for block, plant in sorted(plants.items(), key=lambda item: item[1]["model"] not in PICTURES):
        return block, plant["model"], plant["parameters"]
    return "", None, {}


def _signals(result: Result, plant: str) -> tuple[LoopSignals, list[str | None]]:
    """Return the signals by their role, and for each quantity the plant's variable that it is, if it is one.

    Without a closed loop the quantities are the outputs of the plant, or else all scalars.
    """
    roles = result.roles
    if roles is not None and roles.quantities:
        signals = signals_of(roles, result)
        variables = [
            role.truth[0][1][0].removeprefix(f"{plant}.")
            if role.truth and len(role.truth) == 1 and role.truth[0][1][0].startswith(f"{plant}.")
            else None
            for role in roles.quantities
        ]
        return signals, variables
    scalars = [name for name in result if result[name].ndim == 1 and np.isfinite(result[name]).any()]
    names = [name for name in scalars if plant and name.startswith(f"{plant}.")] or scalars
    quantities = tuple(
        QuantitySignals(name, result.units.get(name), (), result[name], None, None, False, False) for name in names
    )
    return LoopSignals(result.time, quantities, (), {}), [name.rpartition(".")[2] for name in names]


def _most_faulty(signals: LoopSignals) -> int:
    """Return the number of the quantity with the longest fault of a sensor, else of the first."""
    durations = [
        max([int(s.faulty.sum()) for i in quantity.sensors if (s := signals.sensors[i]).faulty is not None], default=0)
        for quantity in signals.quantities
    ]
    return int(np.argmax(durations))


def _alarmed(sensor: SensorSignals, row: int) -> bool:
    if sensor.probability is not None and np.isfinite(sensor.probability[row]):
        return bool(sensor.probability[row] >= ALARM)
    return sensor.alarm is not None and bool(sensor.alarm[row])


def _limits(signals: LoopSignals, quantity: QuantitySignals) -> tuple[float, float]:
    """Return the ends of a quantity's scale, which has its true value, its belief, its reference, and its samples."""
    lines = [v for v in (quantity.truth, quantity.belief, quantity.reference) if v is not None]
    return limits_with_samples(lines, _samples(signals, quantity))


def _samples(signals: LoopSignals, quantity: QuantitySignals) -> list[Floats]:
    return [v for i in quantity.sensors if (v := signals.sensors[i].samples) is not None]


def _draw_signals(axis: Axes, signals: LoopSignals, quantity: QuantitySignals) -> None:
    draw_quantity(axis, time=signals.time, quantity=replace(quantity, spread=None))
    style: dict[str, Any] = {"ls": "none", "ms": 1.8, "mew": 0, "alpha": 0.5, "zorder": 1}
    for sensor in (signals.sensors[i] for i in quantity.sensors):
        if sensor.samples is not None:
            label = f"sensor {sensor.index}"
            mark = MARKERS[sensor.index % len(MARKERS)]
            axis.plot(
                *thin_marks(signals.time, sensor.samples), mark, color=colour_of(sensor.index), label=label, **style
            )
    limits = _limits(signals, quantity)
    axis.set_ylim(*limits)
    if samples := _samples(signals, quantity):
        mark_cut(axis, signals.time, samples, limits)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


class _Scene:
    """The plant: its true state in black, the state of the belief dashed, and the reading of each sensor in its colour.

    A sensor's picture is that of the belief with the sensor's quantity replaced by its reading.
    """

    def __init__(
        self,
        axis: Axes,
        result: Result,
        plant: str,
        picture: Picture,
        lengths: dict[str, float],
        signals: LoopSignals,
        variables: list[str | None],
        rows: Any,
    ):
        self.axis, self.picture, self.signals = axis, picture, signals
        truth = {name: result[f"{plant}.{name}"] for name in picture.variables}
        size = max([float(np.nanmax(np.abs(truth[name]))) for name in picture.sized], default=0.0) or 0.1
        self.constants = {**picture.lengths, **{k: v for k, v in lengths.items() if k in picture.lengths}, "size": size}
        if picture.turning:
            turned = np.concatenate([[0.0], np.cumsum(truth[picture.turning][:-1])])
            truth["turned"] = turned / (float(np.abs(np.diff(turned[rows])).max()) or 1.0)
        belief = dict(truth)
        self.layers: list[tuple[dict[str, Floats], SensorSignals | None, list[Any]]] = []
        if picture.compared:
            known = {
                name: q for name, q in zip(variables, signals.quantities, strict=True) if name in picture.variables
            }
            belief |= {name: q.belief for name, q in known.items() if name and q.belief is not None}
            for name, quantity in known.items():
                for sensor in (signals.sensors[i] for i in quantity.sensors):
                    if name and sensor.samples is not None:
                        look = {"color": colour_of(sensor.index), "lw": 1.5, "zorder": 3}
                        self.layers.append(({**belief, name: sensor.samples}, sensor, self._lines(look)))
        self.layers.append((truth, None, self._lines({"color": BLACK, "lw": 2.2, "zorder": 4})))
        if any(q.belief is not None for q in signals.quantities) and picture.compared:
            self.layers.append((belief, None, self._lines({"color": BLUE, "lw": 1.4, "ls": (0, (4, 2)), "zorder": 5})))
        for x, y in picture.fixed(self.constants):
            axis.plot(x, y, color="0.6", lw=1.5, zorder=1, solid_capstyle="round")
        left, right, bottom, top = picture.window(self.constants) if picture.window else self._around(truth, rows)
        axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axis.axis("off")
        self.moving = [*sorted((x for *_, each in self.layers for x in each), key=lambda x: x.zorder), axis.title]

    def _around(self, truth: dict[str, Floats], rows: Any) -> tuple[float, float, float, float]:
        """Return the limits of axes that show all true states, and what does not move, with a margin."""
        states = ({name: float(values[row]) for name, values in truth.items()} for row in rows)
        lines = [line for state in states for line in self.picture.moving({**state, **self.constants})]
        x, y = (np.concatenate(each) for each in zip(*lines, *self.picture.fixed(self.constants), strict=True))
        margin = 0.1 * float(max(np.ptp(x), np.ptp(y)))
        return float(x.min()) - margin, float(x.max()) + margin, float(y.min()) - margin, float(y.max()) + margin

    def _lines(self, look: dict[str, Any]) -> list[Any]:
        state = {**dict.fromkeys((*self.picture.variables, "turned"), 0.0), **self.constants}
        return [self.axis.plot([], [], solid_capstyle="round", **look)[0] for _ in self.picture.moving(state)]

    def show(self, row: int) -> None:
        for values, sensor, lines in self.layers:
            state = {name: float(value[row]) for name, value in values.items()}
            for line, (x, y) in zip(lines, self.picture.moving({**state, **self.constants}), strict=True):
                line.set_data(x, y)
                if sensor is not None:
                    line.set_alpha(0.3 if _alarmed(sensor, row) else 0.8)
        self.axis.set_title(f"t = {self.signals.time[row]:.2f} s", fontsize=10)


class _Mark(NamedTuple):
    """A mark on a scale: the number of its quantity, its name, its sensor if it is one, its values, and how it is drawn."""

    number: int
    label: str
    sensor: SensorSignals | None
    values: Floats
    line: Any
    marker: str


class _Scales:
    """A horizontal scale for each quantity with its true value, its reference, the belief, and the readings of its sensors."""

    def __init__(self, axis: Axes, signals: LoopSignals):
        self.axis, self.signals = axis, signals
        self.quantities = signals.quantities[:MOST_SCALES]
        self.limits = [_limits(signals, quantity) for quantity in self.quantities]
        self.marks: list[_Mark] = []
        self.beyond: list[tuple[Any, Any]] = []
        used: set[int] = set()
        axis.set(xlim=(-0.04, 1.04), ylim=(-0.75, len(self.quantities) - 0.25))
        axis.axis("off")
        for n, quantity in enumerate(self.quantities):
            y, (low, high) = len(self.quantities) - 1 - n, self.limits[n]
            axis.plot([0, 1], [y, y], color="0.6", lw=1.0, zorder=1)
            for share in (0.0, 0.5, 1.0):
                axis.plot([share, share], [y - 0.03, y + 0.03], color="0.6", lw=1.0, zorder=1)
                value = round(low + share * (high - low), 2 - int(np.floor(np.log10(high - low))))
                axis.text(share, y - 0.2, f"{value:g}", fontsize=7, ha="center", va="top")
            axis.text(0.0, y + 0.3, with_unit(quantity.name, quantity.unit), fontsize=9)
            small: dict[str, Any] = {"fontsize": 7, "va": "bottom"}
            ends = axis.text(0.0, y + 0.1, "", ha="left", **small), axis.text(1.0, y + 0.1, "", ha="right", **small)
            self.beyond.append(ends)
            big = {"ms": 15.0, "mew": 2.2}
            self._mark(
                n, "reference", None, quantity.reference, y, {"marker": "|", "color": "0.75", "ms": 18.0, "mew": 5.0}
            )
            self._mark(n, "true value", None, quantity.truth, y, {"marker": "|", "color": BLACK, **big})
            look = {"marker": "o", "mec": BLUE, "mfc": "none", "ms": 8.0, "mew": 1.6}
            self._mark(n, "belief", None, quantity.belief, y, look)
            for sensor in (signals.sensors[i] for i in quantity.sensors):
                used.add(sensor.index)
                mark = {"marker": MARKERS[sensor.index % len(MARKERS)], "color": colour_of(sensor.index), "ms": 5.0}
                self._mark(n, f"sensor {sensor.index}", sensor, sensor.samples, y, mark)
        handles = {each.label: each.line for each in sorted(self.marks, key=lambda each: each.sensor is not None)}
        self.axis.legend(
            list(handles.values()),
            list(handles),
            loc="upper center",
            bbox_to_anchor=(0.5, 0.02),
            ncols=3,
            frameon=False,
            fontsize=8,
            markerscale=0.7,
        )
        self.note = axis.text(1.0, len(self.quantities) - 0.7, "", fontsize=8, ha="right", va="bottom")
        self.moving = [*(each.line for each in self.marks), *(text for pair in self.beyond for text in pair), self.note]

    def _mark(
        self,
        number: int,
        label: str,
        sensor: SensorSignals | None,
        values: Floats | None,
        y: float,
        look: dict[str, Any],
    ) -> None:
        if values is not None:
            line = self.axis.plot([0.5], [y], ls="none", label=label, zorder=3, **look)[0]
            self.marks.append(_Mark(number, label, sensor, values, line, look["marker"]))

    def show(self, row: int) -> None:
        ignored = []
        beyond: list[tuple[list[str], list[str]]] = [([], []) for _ in self.quantities]
        for mark in self.marks:
            low, high = self.limits[mark.number]
            value = float(mark.values[row])
            share = (value - low) / (high - low)
            mark.line.set_xdata([min(max(share, 0.0), 1.0)])
            mark.line.set_marker("<" if share < 0.0 else ">" if share > 1.0 else mark.marker)
            if share < 0.0 or share > 1.0:
                beyond[mark.number][int(share > 1.0)].append(f"{mark.label}: {value:.3g}")
            if mark.sensor is not None:
                alarm = _alarmed(mark.sensor, row)
                mark.line.set_alpha(0.35 if alarm else 1.0)
                ignored += [mark.label] * alarm
        for texts, named in zip(self.beyond, beyond, strict=True):
            for text, names in zip(texts, named, strict=True):
                text.set_text(", ".join(names))
        self.note.set_text(f"alarm: {', '.join(ignored)}" if ignored else "")


class _Time:
    """The shown instant in the panels of signals; what comes after it is nearly hidden."""

    def __init__(self, axes: list[Axes], time: Floats):
        self.time = time
        self.covers = [axis.axvspan(time[0], time[-1], color="white", alpha=HIDDEN, lw=0, zorder=8) for axis in axes]
        self.lines = [axis.axvline(time[0], color="0.3", lw=1.0, zorder=9) for axis in axes]
        self.moving = [*self.covers, *self.lines]

    def show(self, row: int) -> None:
        now = float(self.time[row])
        for cover, line in zip(self.covers, self.lines, strict=True):
            cover.set_x(now)
            cover.set_width(float(self.time[-1]) - now)
            line.set_xdata([now, now])


__all__ = ["animate_run"]
