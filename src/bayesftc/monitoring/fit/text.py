"""The text of a model file from a fitted model."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

from bayesftc.cosim.base.recordings.dates import span_text
from bayesftc.monitoring.fit.columns import Place
from bayesftc.monitoring.fit.fit import FittedModel
from bayesftc.monitoring.recording import Recording

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""A key that needs no quotes in TOML."""


def as_model_file(
    fitted: FittedModel, recording: Recording, places: Mapping[str, Place], stretch: slice = slice(None)
) -> str:
    """Return the text of a model file, which `load_monitor` reads.

    Parameters
    ----------
    fitted : FittedModel
        The fitted model.
    recording : Recording
        Its recording.
    places : mapping of str to Place
        File and columns of each sensor.
    stretch : slice
        The steps in which the sensors are healthy, as in `fit_model`.

    Returns
    -------
    str
        The content of a TOML file.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
    >>> level = 20.0 + np.cumsum(0.05 * rng.standard_normal(1000))
    >>> noise = 0.1 * rng.standard_normal((1000, 2))
    >>> recording = monitoring.recorded({name: monitoring.Signal(t, level + noise[:, i]) for i, name in enumerate("ab")})
    >>> places = {name: monitoring.Place("tank.csv", f"T_{name}", "time") for name in "ab"}
    >>> text = monitoring.as_model_file(monitoring.fit_model(recording), recording, places)
    >>> text.splitlines()[2], text.splitlines()[7]
    ('dt = 0.1  # sample time in s', 'kind = "RandomWalk"  # a quantity that changes at random')
    """
    units = dict(zip(recording.sensors, recording.units, strict=True))
    several = len({place.file for place in places.values()}) > 1
    time = next(iter(places.values())).time
    lines = [
        f"# Fitted by bayesftc monitor --fit to {_span(recording, slice(None))}{_healthy(recording, stretch)}.",
        "",
        f"dt = {float(recording.dt):.10g}  # sample time in s",
        f"time = {_text(time)}  # the column of times",
        *([f"joint = true  # sensors are judged together: {_why_joint(fitted)}"] if fitted.joint else []),
        "",
        "[model]",
        *_plant(fitted, recording.units[0] if len(set(recording.units)) == 1 else "", float(recording.dt)),
    ]
    for name, sensor in fitted.sensors.items():
        place = places[name]
        lines += ["", f"[sensors.{_key(name)}]  # {sensor.missing:.1%} of the steps are without a sample"]
        if several and place.file:
            lines.append(f"file = {_text(place.file)}")
        if place.column != name:
            lines.append(f"column = {_text(place.column)}")
        if place.time != time:
            lines.append(f"time = {_text(place.time)}")
        if place.invalid:
            lines.append(f"invalid = [{', '.join(map(_value, place.invalid))}]  # these stand for no sample")
        if place.period:
            lines.append(f"period = {place.period:.10g}  # an angle, which begins anew after a full turn")
        if place.held:
            lines.append("held = true  # a value that repeats the one before is no sample")
        if units[name]:
            lines.append(f"unit = {_text(units[name])}")
        lines += [
            f"std = {_number(sensor.std)}  # of the white noise{' of the divided samples' if sensor.gain != 1.0 else ''}",
            f"bias = {_number(sensor.bias)}  # constant difference from the typical sensor",
            *(
                [f"gain = {_number(sensor.gain)}  # samples, less the bias, are divided by it"]
                if sensor.gain != 1.0
                else []
            ),
            f"resolution = {_number(sensor.resolution)}" + ("" if sensor.resolution else "  # too fine to matter"),
            f"repeats = {sensor.repeats:.3g}  # share of samples that equal the one before",
        ]
    for errors in fitted.errors:
        named = ", ".join(map(_text, errors.sensors or ()))
        lines += [
            "",
            "[[errors]]  # " + ("common to these sensors" if errors.common else "lasting"),
            f"sensors = [{named}]",
            f"std = {_number(errors.std)}",
            f"time_constant = {_number(errors.time_constant)}  # s",
            *(["common = true"] if errors.common else []),
        ]
    return "\n".join(lines) + "\n"


def _why_joint(fitted: FittedModel) -> str:
    if fitted.changes:
        return "one has moved away from the others"
    return "those that agree outvote another one" if len(fitted.sensors) > 2 else "healthy ones are blamed less often"


def _healthy(recording: Recording, stretch: slice) -> str:
    within = recording.time[stretch]
    if len(within) == len(recording.time):
        return ""
    return f", with healthy sensors from {_span(recording, stretch)}"


def _span(recording: Recording, stretch: slice) -> str:
    within = recording.time[stretch]
    return span_text(within[0], within[-1], recording.origin)


def _plant(fitted: FittedModel, unit: str, dt: float) -> list[str]:
    kind, std = type(fitted.plant).__name__, _number(fitted.plant.std)
    if fitted.belief is None:
        of = (f", in {unit}" if unit else "") + f"; in {dt:.10g} s: {fitted.plant.std * dt**0.5:.2g}" * (dt != 1.0)
        return [
            f'kind = "{kind}"  # a quantity that changes at random',
            f"std = {std}  # of its change in one second{of}",
        ]
    (level, _), (spread, rate) = fitted.belief
    of = f", in {unit}/s" if unit else ""
    return [
        f'kind = "{kind}"  # a quantity whose rate changes at random',
        f"std = {std}  # of the rate's change in one second{of}",
        f"initial_mean = [{_number(level)}, 0.0]  # quantity and rate before the first sample",
        f"initial_std = [{_number(spread)}, {_number(rate)}]",
    ]


def _number(value: object) -> str:
    return f"{float(value):.5g}"  # type: ignore[arg-type]


def _value(value: float | str) -> str:
    return _text(value) if isinstance(value, str) else f"{value:.17g}"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _key(name: str) -> str:
    return name if BARE.fullmatch(name) else _text(name)
