"""Sentences about the recorded inputs of a monitor, which may be measured, where others speak of controls and actuators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING

from bayesftc.controllers.diagnosis.words.phrases import (
    NO_EFFECT,
    STUCK_AT,
    beyond,
    gains,
    rounded,
    since,
    strongly,
)
from bayesftc.cosim.base.numbers import counted, with_and

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

AS_STRONG = 0.05
"""Relative difference of an effect from the model's up to which its size is right."""

_REMEDY = "If its cause is recorded, make it an input of the model; else give the model more process noise."


def _input(j: float, model: LinearModel) -> str:
    return f"input {j:.0f}" if model.names is None else model.names.controls[int(j)]


def _inputs(model: LinearModel, which: Sequence[float] = ()) -> str:
    return _input(which[0] if which else 0, model) if which or model.controls == 1 else "the inputs"


def _sign(values: Sequence[float], model: LinearModel) -> str:
    opposite = f"{_input(values[1], model)} moves the plant in the opposite direction,"
    if abs(abs(values[0]) - 1.0) < AS_STRONG:
        return f"{opposite} about as strongly as in the model. Check its sign."
    return f"{opposite} {abs(values[0]):.3g} times as strongly as in the model. Check its sign, unit and scale."


def _gain(values: Sequence[float], model: LinearModel) -> str:
    noise = " If it is measured, much noise in it has this effect, too." if values[0] < 1.0 else ""
    if abs(values[0]) < NO_EFFECT:
        return f"{_input(values[1], model)} has little or no effect on the plant. Check what it drives, and its column.{noise}"
    return (
        f"{_input(values[1], model)} moves the plant {values[0]:.3g} times as strongly as in the model. Check its unit and "
        f"scale.{noise}"
    )


def _gains(values: Sequence[float], model: LinearModel) -> str:
    noise = (
        " If they are measured, much noise in them has this effect, too." if max(values[: model.controls]) < 1.0 else ""
    )
    return f"{gains(values, model, 'input')}. Check their units and scales.{noise}"


def _late(values: Sequence[float], model: LinearModel) -> str:
    seconds, lag, *which = values
    late = f"as behind a lag of about {rounded(seconds)} s" if lag else f"by {seconds:.3g} s"
    return (
        f"the plant follows {_inputs(model, which)} late, {late}. The time stamps of the sensors may be late (their delay in "
        "the model file), the plant may have a lag that the model lacks, or a measured input has much noise."
    )


def _early(values: Sequence[float], model: LinearModel) -> str:
    samples = counted(round(values[0] / float(model.step)), "sample")
    return (
        f"the plant follows {_inputs(model, values[1:])} earlier than in the model, by {values[0]:.3g} s ({samples}). Check the "
        "delays in the model file, and the time stamps."
    )


def _limit(values: Sequence[float], model: LinearModel) -> str:
    return f"the plant does not follow {_input(values[2], model)} where it is {beyond(values)}: something behind it has a limit."


def _rate(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"the plant follows {_input(values[1], model)} as if it could change by no more than about {rounded(values[0])} in a "
        "second: something behind it has a limit of its rate."
    )


def _exchanged(values: Sequence[float], model: LinearModel) -> str:
    one, other = (_input(j, model) for j in values)
    return f"{one} acts as {other} does in the model, and the other way round. Check the order of their columns."


def _deadband(values: Sequence[float], model: LinearModel) -> str:
    name, (width, _, about_last) = _input(values[1], model), values
    if about_last:
        return (
            f"when {name} turns round, the plant follows only after a change of about {width:.2g}: something behind it seems to "
            "have a dead band, stiction or play."
        )
    return (
        f"the plant does not follow {name} between {-width / 2:.2g} and {width / 2:.2g}: something behind it seems to have a "
        "dead zone."
    )


def _loss(values: Sequence[float], model: LinearModel, first: datetime | None) -> str:
    name, when = _input(values[3], model), since(values, first)
    if len(values) > STUCK_AT:
        return (
            f"the plant moves {when} as if {name} were stuck at about {values[STUCK_AT]:.3g}. Look for a fault of "
            f"{name}, or of what it drives."
        )
    return f"{name} moves the plant {strongly(values[2])} {when}. Look for a fault of {name}, or of what it drives."


def _late_sensors(values: Sequence[float], model: LinearModel) -> str:
    late = [model.names.sensors[i] if model.names else f"sensor {i}" for i, value in enumerate(values) if value]
    return (
        f"{with_and(list(dict.fromkeys(late)))} {'are' if len(late) > 1 else 'is'} late, by {max(values):.3g} s. Check the time "
        "stamps, and the delays in the model file."
    )


def _load(values: Sequence[float], model: LinearModel) -> str:
    sizes = " and of ".join(f"{_input(j, model)} by {value:.3g}" for j, value in enumerate(values))
    return (
        f"something beside {_inputs(model)} moves the plant all the time. It has the effect of a change of {sizes}. A measured "
        f"input may have an offset. {_REMEDY}"
    )


def _onset(values: Sequence[float], model: LinearModel, first: datetime | None) -> str:
    each = 2 + model.controls
    times = ", and again ".join(since(values[k : k + each], first) for k in range(0, len(values), each))
    return f"something beside {_inputs(model)} moves the plant {times}, or a measured input is wrong then. {_REMEDY}"


def _noise(values: Sequence[float], model: LinearModel) -> str:
    return f"the plant is moved more at random than the model says. {_REMEDY}"


def _nonlinear(values: Sequence[float], model: LinearModel) -> str:
    return "the plant's motion depends on its state. Use a model for the range in which it is, and trust only clear alarms."


def _otherwise(values: Sequence[float], model: LinearModel) -> str:
    return (
        "the plant moves differently from the model. Check what its numbers were derived from, and dt; or fit it to a recording "
        "in which the inputs move the plant (LinearModel.identify)."
    )


def of_inputs(first: datetime | None) -> dict[str, Callable[[Sequence[float], LinearModel], str]]:
    """Return the sentences by kind of the finding; `first` is the date of the first sample, if it has one."""
    return {
        "sign": _sign,
        "gain": _gain,
        "gains": _gains,
        "late": _late,
        "early": _early,
        "limit": _limit,
        "rate": _rate,
        "exchanged": _exchanged,
        "late_sensors": _late_sensors,
        "deadband": _deadband,
        "load": _load,
        "onset": partial(_onset, first=first),
        "loss": partial(_loss, first=first),
        "noise": _noise,
        "nonlinear": _nonlinear,
        "dynamics": _otherwise,
        "unknown": _otherwise,
        "suspect": _otherwise,
    }


__all__ = ["of_inputs"]
