"""Sentences about a wrong model: what is wrong, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.candidates import AS_STATED, EFFECT
from bayesftc.controllers.diagnosis.words.inputs import of_inputs
from bayesftc.controllers.diagnosis.words.phrases import (
    NO_EFFECT,
    STUCK_AT,
    beyond,
    change,
    gains,
    named,
    rounded,
    seconds,
    since,
    strongly,
)
from bayesftc.controllers.models.disturbances import has_loads, lagged_loads
from bayesftc.cosim.base.numbers import counted, with_and
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.signals import ALARM

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel, SignalNames
    from bayesftc.cosim.types import Floats

ALIKE = "All sensors disagree with the model in the same way"

APART = "By the model, sensors of different quantities disagree"

UNLIKE = "The sensors disagree with the model, each in its own way"

AS_LIKELY, AS_MUCH = "nearly as likely by this run", "which explains nearly as much of this run"
"""What is said of another explanation: by its likelihood, or by what it explains: of noise, which has few parameters, and of an
effect that is other all the time instead of lost."""

_DISTURBANCE = "disturbance in design and in a scenario; LinearModel.with_disturbance"

USUAL_STEP = 0.02
"""Longest sample time in seconds for which the size of ``disturbance=True`` is meant."""

MOST_TIMES = 3
"""Largest number of faults of a sensor of which the sentence has the times."""

AT_TIMES = 0.2
"""Share of the run below which a plant that moves more than its model is said to do so at times."""

PRIOR = 10.0
"""Standard deviation of an offset to be estimated, relative to the one found; with a smaller one the default learner doubts other
sensors until it is estimated."""

UNEQUAL = 3.0
"""Standard deviations of a sensor from which on offsets of one quantity are no common one."""

VISIBLE = 0.1
"""Offset of a sensor of several, in standard deviations of its noise, below which it is none."""

DIFFERENT = (
    "Offsets of one quantity that differ so much are more likely faults of single sensors, or errors of the model that make the "
    "controller follow these: look at both first. If they are offsets, s"
)
"""What to think of such offsets before they are believed."""

SEVERAL = (
    "All sensors of several quantities are rarely wrong together: a load, or a control with another effect than in B, looks "
    "the same. Try disturbance=True in design first. If the error stays, the load acts elsewhere than the control "
    "(docs/how-to/constant-disturbances.md). If they are offsets, s"
)
"""What to try before offsets of several quantities are believed."""

TOGETHER = (
    "All sensors of a quantity are rarely wrong together: a load that acts where no control does, or an error of A between the "
    "quantities, as of a stiffness, looks the same. Look at both first (docs/how-to/constant-disturbances.md). If they are "
    "offsets, s"
)
"""The same for one quantity of several."""
COUPLED = " An error of A between the quantities, as of a stiffness, may look the same."
"""What is said of the offset of the only sensor of one quantity of several."""

ELSEWHERE = (
    "All sensors of several quantities are rarely wrong together: a load that acts elsewhere than the control, or a plant with "
    "other gains, looks the same. Look at both first (docs/how-to/constant-disturbances.md). If they are offsets, s"
)
"""The same, where the controller already estimates a load at the control."""

PLAY = " A dead band, stiction or play of the actuator may look the same: compare the control and the position of the actuator."
"""What may be the cause where the plant follows the control late, slowly or weakly, or a load on it changes all the time."""

LASTS = (
    " A load that lasts, such as a friction that changes its sign with the motion, may look the same: name its input in loads "
    "(of design, or [controller] of a scenario)."
)
"""What may be the cause of other dynamics where the model has no load that lasts."""

STATED = "a larger standard deviation or a shorter time constant in loads"
"""How a load that the model has is stated as larger or faster."""

UNMOVED = (
    "the quantity moves differently from the model, a sensor follows it late, or the recording has long gaps. Fit the model to a "
    "recording that moves as this one does (bayesftc monitor --fit). If it is fitted to this one, it is too simple for it: trust "
    "only clear alarms."
)
"""What is wrong with a model that no control moves, as that of a monitor: nothing can be linearised or weakened."""


def sentence(
    kind: str,
    values: Sequence[float],
    model: LinearModel,
    others: Sequence[tuple[str, Sequence[float]]] = (),
    inferred: Sequence[float] | None = None,
    units: Sequence[str | None] = (),
    control_units: Sequence[str | None] = (),
    recorded: bool = False,
    elsewhere: bool = False,
    state: int | None = None,
    first_sample: datetime | None = None,
    linear: bool = False,
) -> str:
    """Return the sentence for a finding's kind and values (see `ModelFinding`), and for others that fit nearly as well.

    `inferred` has the largest fault probability of each actuator; None if the controller infers none. `units` has the unit of
    each sensor, `control_units` of each control, if known. `recorded`: the controls are the recorded inputs of a monitor, which
    may be measured ones, and `first_sample` is the date of the first sample, if known. `elsewhere`: a load that begins acts where
    no control does, and as this `state` of the model, if it has one for it. `linear`: the plant is known to be linear.
    """
    found, moved = [(kind, values), *others], bool(np.any(model.B))
    words: dict[str, Callable[[Sequence[float], LinearModel], str]] = {
        **_WORDS,
        "load": partial(_load, units=control_units),
        "rate": partial(_rate, units=control_units),
        "deadband": partial(_deadband, units=control_units),
        "loss": partial(_loss, units=control_units, linear=linear),
        "onset": partial(_onset, units=control_units, elsewhere=elsewhere, state=state, linear=linear),
        "noise": partial(_noise, units=control_units),
        **(of_inputs(first_sample) if recorded else {}),
        "offset": partial(_offset, units=units, controlled=moved and not recorded),
    }
    said: dict[str, str] = {}
    for each, its in found:
        said.setdefault(words[each](its, model) if moved or each == "offset" else UNMOVED, each)
    which = APART if kind in {"offset", "late_sensors"} and len(model.alike) > 1 else ALIKE
    if kind == "offset" and _unequal(values, model):
        which = UNLIKE
    actuators = _actuators(found, model, inferred) if moved and not recorded else ""
    first, *more = said
    whole = {"noise", *(EFFECT if kind == "loss" else ())}
    slow = moved and not recorded and any(_looks_like_play(*each, model) for each in found)
    played = PLAY if slow and all(each != "deadband" for each, _ in found) else ""
    either = "".join(f" Or, {AS_MUCH if said[text] in whole else AS_LIKELY}: {text}" for text in more)
    return f"{which}: {first}{either}{played}{actuators}{_alone(model)}"


def _looks_like_play(kind: str, values: Sequence[float], model: LinearModel) -> bool:
    """Return whether play may look like a finding: the control acts late, slowly or weakly, or a load on it changes."""
    weak, on_control = kind in ("dt", "gain", "gains"), model.states - model.disturbances
    factors = values[: model.controls if kind == "gains" else 1]
    return kind == "late" or (weak and max(factors) < 1.0) or (kind == "noise" and values[0] >= on_control)


def _actuators(
    found: Sequence[tuple[str, Sequence[float]]], model: LinearModel, inferred: Sequence[float] | None
) -> str:
    """Return a sentence on the actuator modes for faults of an actuator; else nothing."""
    lost = [values for kind, values in found if kind == "loss"]
    if not lost and not (inferred is not None and any(kind == "onset" for kind, _ in found)):
        return ""
    if inferred is None:
        mode, fault = "LostEffect", "a lost effect of an actuator"
        if lost and len(lost[0]) > STUCK_AT:
            mode, fault = "StuckActuator", "an actuator that is stuck"
        precision = f"controllers.SwitchingPrecision(actuator_modes=[controllers.{mode}()])"
        return f" A controller with precision={precision} can infer {fault}."
    if not inferred:
        return " Record actuator_fault_probability of the controller: its actuator modes may see it."
    j = int(lost[0][3]) if lost else int(np.argmax(inferred))
    return inferred_fault(inferred, model, j) or (
        f" The actuator modes of the controller do not see it: the fault probability of {named(j, model)} is at most "
        f"{inferred[j]:.2g}."
    )


def inferred_fault(inferred: Sequence[float] | None, model: LinearModel, control: int | None = None) -> str:
    """Return a sentence if the controller infers a fault of an actuator, by default of the one that is most likely faulty."""
    if not inferred:
        return ""
    j = int(np.argmax(inferred)) if control is None else control
    if inferred[j] < ALARM:
        return ""
    return (
        f" The controller infers a fault of {named(j, model)}: its fault probability reaches {inferred[j]:.2g}. "
        "result.findings() has its kind and size."
    )


def faulty_sensors(
    blamed: Sequence[int],
    *,
    together: int,
    alone: bool,
    partner: bool = True,
    others: bool = False,
    recorded: SignalNames | None = None,
    times: Sequence[tuple[float, float]] = (),
    names: SignalNames | None = None,
    first_sample: datetime | None = None,
) -> str:
    """Return the sentence about sensors that the controller blames for long, where nothing is found without their samples.

    `together`: so many are usually blamed at once. `alone`: samples for which it blames others, for a short time, stay.
    `partner`: another sensor measures the quantity of a single one. `others`: it blames further sensors for a short time.
    `recorded`: the names in a recording, for a monitor. `times`: from when to when it alone blames the only sensor of a quantity;
    `names` are those of the model, and `first_sample` is the date of the first sample, if known.
    """
    if times:
        name = "" if names is None else f" ({names.sensors[blamed[0]]})"
        who = f"Sensor {blamed[0]}{name}" if recorded is None else f"The sensor {recorded.sensors[blamed[0]]}"
        said = [since(each, first_sample) for each in times]
        *most, last = said if len(said) <= MOST_TIMES else [*said[:MOST_TIMES], "later"]
        when = f"{', '.join(most)} and {last}" if most else last
        return (
            f"{who}, the only one of its quantity, is probably faulty {when}: it alone is blamed, and without these samples of "
            "it nothing certain speaks against the model."
        )
    *most, last = (str(i) if recorded is None else recorded.sensors[i] for i in blamed)
    at_once = "" if together < 2 else " at the same time"
    if 1 < together <= len(most):
        at_once = f", mostly {together} of them{at_once}"
    sensors = ("sensors " if most else "sensor ") if recorded is None else ""
    who = f"{sensors}{', '.join(most)} and {last}{at_once}" if most else f"{sensors}{last}"
    who = f"above all {who}" if others else who
    which = "any sensor" if not alone else "them" if most else "it"
    they = (
        "they are faulty, or the model is wrong and they are"
        if most
        else "it is faulty, or the model is wrong and it is"
    )
    cause = (
        f"Either {they} blamed because of it."
        if most or not partner
        else "One faulty sensor beside others of its quantity would leave these in agreement with a right model: the model is "
        "probably wrong, or others have failed for a time as well."
    )
    return (
        f"The {'controller' if recorded is None else 'monitor'} blames {who}. Without the samples for which it blames {which}, "
        f"nothing certain speaks against the model. {cause} If the {'run' if recorded is None else 'recording'} has faults of "
        "sensors, one without them may name the error."
    )


def moved_at_times(time: Floats, process: Floats | None) -> str:
    """Return a sentence if the controller infers that something moves the plant at times; `process`: the probability of it."""
    moved = np.zeros(0, dtype=bool) if process is None else process >= ALARM
    if not 0.0 < np.mean(np.append(moved, False)) < AT_TIMES:
        return ""
    first = [seconds(float(time[begin])) for begin, _ in periods(moved)]
    first = first if len(first) < 4 else [*first[:2], "later"]
    when = with_and(first)
    return (
        f" Or something that the model does not know moves the plant at times, such as gusts or bumps: the controller infers it "
        f"at {when}. Then state noise where it acts (noise in design and in a scenario), as large as what it does."
    )


def _alone(model: LinearModel) -> str:
    """Return a sentence if a fault of a sensor looks the same, because its quantity has no second one; else nothing."""
    single = [group[0] for group in model.proportional if len(group) == 1]
    if len(single) == len(model.proportional):
        return " No quantity has a second sensor, so a sensor fault may look the same."
    if not single:
        return ""
    if model.names:
        names = [model.names.sensors[i] for i in single]
        only = "a sensor that is the only one of its quantity" if len(names) > 1 else "the only sensor of its quantity"
        return f" A fault of {only} ({', '.join(names)}) may look the same."
    names = [f"sensor {i}" for i in single]
    return f" A fault of {' or '.join(names)} may look the same, because no other sensor measures the same quantity."


def _sign(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"{named(values[1], model)} moves the plant in the opposite direction: its effect is {values[0]:.3g} times the model's. "
        "Check the sign of B."
    )


def _gain(values: Sequence[float], model: LinearModel) -> str:
    if abs(values[0]) < NO_EFFECT:
        return (
            f"{named(values[1], model)} has little or no effect on the plant. Check B, and whether the actuator works: it may be "
            "switched off, stuck, much slower than the control, or not connected."
        )
    return (
        f"{named(values[1], model)} moves the plant {values[0]:.3g} times as strongly as in the model. Check B: the gain of "
        "the actuator, and the mass, inertia or capacity that it acts on."
    )


def _gains(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"{gains(values, model, 'control')}. Check B: the gains of the actuators, and the masses, inertias or capacities that "
        "they act on."
    )


def _dt(values: Sequence[float], model: LinearModel) -> str:
    f, dt = values[0], float(model.step)
    return (
        f"the plant is {f:.3g} times as fast as the model. Check dt: A and B fit a sample time of {dt / f:.3g} s, but dt is "
        f"{dt:.3g} s. If dt is right, a part of the plant is {'faster' if f > 1 else 'slower'} than in the model: check the "
        f"masses, inertias and stiffnesses. Of a plant of first order, {1 / f:.3g} times the model's mass would have the same "
        "effect."
    )


def _late(values: Sequence[float], model: LinearModel) -> str:
    seconds, lag, *which = values
    who = f"{named(which[0], model)} acts" if which else _all_act(model)
    if lag:
        how = f"{who} late: the actuator has a further lag, with a time constant of about {rounded(seconds)} s"
        remedy = (
            "Add a state with this lag between the control and the plant that you design for. Less exactly, give the model a "
            "delay of about that time"
        )
    else:
        how = f"{who} late, by {seconds:.3g} s ({counted(round(seconds / float(model.step)), 'sample')})"
        remedy = "Give the model this delay"
    swing = " A load that swings all the time, as of a rotor, may look like this lag." if lag else ""
    return f"{how}. {remedy} (LinearModel.with_delays), or weaken the control.{swing}"


def _early(values: Sequence[float], model: LinearModel) -> str:
    (seconds, *which), samples = values, counted(round(values[0] / float(model.step)), "sample")
    who, of = (f"{named(which[0], model)} acts", "its delay") if which else (_all_act(model), "the delays")
    remedy = f"Shorten {of} in the model (LinearModel.with_delays)."
    return f"{who} earlier than in the model, by {seconds:.3g} s ({samples}). {remedy}"


def _all_act(model: LinearModel) -> str:
    return "the control acts" if model.controls == 1 else "the controls act"


def _limit(values: Sequence[float], model: LinearModel) -> str:
    return (
        f"the plant does not get {named(values[2], model)} where it is {beyond(values)}. The actuator has a limit that the "
        "controller does not have. Give it as u_min and u_max."
    )


def _rate(values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    j, rate = values[1], rounded(values[0])
    unit = behind(units[int(j)]) if len(units) == model.controls else ""
    return (
        f"the plant gets {named(j, model)} as if it could change by no more than about {rate}{unit} in a second. The "
        "actuator has a limit of its rate that the controller does not have. Give it as u_rate, or weaken the control."
    )


def _exchanged(values: Sequence[float], model: LinearModel) -> str:
    one, other = (named(j, model) for j in values)
    return (
        f"{one} acts as {other} does in the model, and the other way round: the two are exchanged. Check the order of the "
        "controls and their wires, and the columns of B."
    )


def _deadband(values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    width, j, about_last = values
    control, unit = named(j, model), behind(units[int(j)]) if len(units) == model.controls else ""
    if about_last:
        how = (
            f"the actuator seems to have a dead band, stiction or play of about {width:.2g}{unit} in all: when {control} turns "
            "round, the plant follows only after that change"
        )
    else:
        how = (
            f"the actuator seems to have a dead zone about zero: the plant does not get {control} between {-width / 2:.2g} and "
            f"{width / 2:.2g}{unit}, and less of it beyond"
        )
    return (
        f"{how}. Compare {control} and the position of the actuator. No linear model can contain this: mend the actuator, or "
        "weaken the control and simulate with the dead band (docs/how-to/actuator-faults.md)."
    )


def _load(values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    return (
        f"a constant load acts. It has the effect of a change of {change(values, model, units)}. You can "
        f"{_estimate('it', model)}, or add it to the model."
    )


def _estimate(load: str, model: LinearModel) -> str:
    """Return how the controller is to estimate a load, which depends on whether its model already has a disturbance."""
    if has_loads(model):
        return f"make the disturbance of the model larger ({_DISTURBANCE}), so that its estimate follows {load} sooner"
    if known := _known_loads(model):
        return f"give {known} {STATED}; or, if another load acts, estimate it ({_DISTURBANCE})"
    return f"estimate {load} ({_DISTURBANCE})"


def _known_loads(model: LinearModel) -> str:
    """Return the names of the loads that the model has as slow noise, as those of `loads`; nothing if it has none."""
    names = model.state_names
    each = [names[i] for i in lagged_loads(model, measured=True)]
    return f"the load {each[0]}" if len(each) == 1 else f"one of the loads {with_and(each)}" if each else ""


def _faster(model: LinearModel) -> str:
    """Return a sentence on the loads that the model has as slow noise; nothing if it has none."""
    known = _known_loads(model)
    return (
        f" {known[0].upper()}{known[1:]} may be larger, or change faster, than the model says: try {STATED}."
        if known
        else ""
    )


def _offset(values: Sequence[float], model: LinearModel, units: Sequence[str | None], controlled: bool) -> str:
    groups = [group for group in model.alike if any(values[i] for i in group)]
    sensors = sorted(i for group in groups for i in _with_offset(group, values, model))
    stds = {i: float(f"{PRIOR * max(abs(values[j]) for j in group):.1g}") for group in groups for i in group}
    std = f"{stds[sensors[0]]:g}" if len(groups) == 1 else [stds[i] for i in sensors]
    each = " and ".join(_offset_of(group, values, model, units) for group in groups)
    one = len(groups) == 1 < len(model.alike) and controlled
    if _unequal(values, model):
        doubt = DIFFERENT
    elif len(groups) > 1 and controlled:
        doubt = ELSEWHERE if has_loads(model) else SEVERAL
    elif one and len(groups[0]) > 1:
        doubt = TOGETHER
    else:
        doubt = "S"
    coupled = COUPLED if one and doubt == "S" else ""
    return (
        f"{each}. {doubt}ubtract them from the readings, or estimate them: LinearModel.with_sensor_errors(std={std}, "
        f"time_constant=1e5, sensors={sensors}), or [[errors]] in a monitor's model file.{coupled}"
    )


def _late_sensors(values: Sequence[float], model: LinearModel) -> str:
    late = [i for i, value in enumerate(values) if value]
    names = list(dict.fromkeys(model.names.sensors[i] for i in late)) if model.names else []
    who = (
        f"all sensors of {with_and(names)} ({with_and(list(map(str, late)))})"
        if names
        else f"sensors {with_and(list(map(str, late)))}"
    )
    steps = [round(value / float(model.step)) for value in values]
    return (
        f"{who} are late, by {max(values):.3g} s ({counted(max(steps), 'sample')}). Add this to their delays in the model "
        f"(sensor_delays in design; LinearModel.with_delays(sensors={steps}), if it has none yet)."
    )


def _unequal(values: Sequence[float], model: LinearModel) -> bool:
    """Return whether offsets of the sensors of one quantity differ too much to be a common one."""
    std = np.sqrt(np.diag(model.matrix("sensor_covariance")))
    return any(np.ptp([values[i] for i in g]) > UNEQUAL * max(std[i] for i in g) for g in model.alike)


def _with_offset(group: Sequence[int], values: Sequence[float], model: LinearModel) -> list[int]:
    """Return the sensors of one quantity whose offset is visible in their noise; all if none is."""
    std = np.sqrt(np.diag(model.matrix("sensor_covariance")))
    return [i for i in group if abs(values[i]) > VISIBLE * std[i]] or list(group)


def _offset_of(group: Sequence[int], values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    """Return which sensors of one quantity have which offset."""
    whole, group = len(group), _with_offset(group, values, model)
    numbers = " and ".join(map(str, group))
    names = " and ".join(dict.fromkeys(model.names.sensors[i] for i in group)) if model.names else ""
    if len(group) < whole:
        who = f"sensor{'s' * (len(group) > 1)} {numbers}{f' ({names})' * bool(names)}"
    elif whole == 1:
        who = f"the only sensor of {names}" if names else f"sensor {numbers}, the only one of its quantity,"
    else:
        who = f"all sensors of {names} ({numbers})" if names else f"sensors {numbers}, all of one quantity,"
    sizes = list(dict.fromkeys(f"{values[i]:.2g}" for i in group))
    offset = "a constant offset" if len(sizes) == 1 else "constant offsets"
    unit = behind(units[group[0]]) if units else ""
    return f"{who} {'has' if len(group) == 1 else 'have'} {offset} of about {' and '.join(sizes)}{unit}"


def _noise(values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    state, std = values[:2]
    if state == AS_STATED:
        return (
            f"the plant is moved more at random than the model says, about as by noise of {std:.2g} times the stated standard "
            "deviation, if those of the sensors are right. State so much where it acts (noise in design and in a scenario), or "
            f"multiply process_covariance by {std**2:.2g}."
        )
    if (load := int(state) - model.states + model.disturbances) >= 0:
        return _noise_of_load(load, std, model) if has_loads(model) else _wandering(load, values[1:], model, units)
    names = None if model.names is None or state < 0 else model.names.states
    # A number says nothing without the unit of a state that has a name.
    named_state = names[int(state)] if names and not names[0].startswith("x[") else ""
    size = f", about as by a standard deviation of {std:.2g} in each sample of {named_state}" if named_state else ""
    lasts = " For a load that lasts, noise is not enough: name its input in loads (of design, or of a scenario)."
    return (
        f"the plant is moved more at random than process_covariance says{size}. Say where that noise acts (noise in design and "
        f"in a scenario), or make process_covariance larger.{_faster(model) or lasts}"
    )


def _noise_of_load(load: int, std: float, model: LinearModel) -> str:
    """Return the sentence about a load on a control that changes faster than the model says."""
    on = f" on {model.names.controls[load]}" if model.names else f" on control {load}" if model.controls > 1 else ""
    every = np.diag(model.matrix("process_covariance"))[-model.disturbances :][: model.controls]
    known, larger = every[load], every + std**2 * (np.arange(len(every)) == load)
    use = f"disturbance={larger[load]:.2g} instead of {known:.2g}"
    if len(every) > 1:
        listed = ", ".join(f"{each:.2g}" for each in larger)
        use = f"disturbance=[{listed}] ({larger[load]:.2g} instead of {known:.2g})"
    return (
        f"a load{on} changes faster than the model says. Use about {use} in "
        "design and in a scenario (of a LinearModel: with_disturbance), or say where process noise acts (noise)."
    )


def _wandering(load: int, values: Sequence[float], model: LinearModel, units: Sequence[str | None]) -> str:
    """Return the sentence about a load on a control that changes all the time, of which the model has none."""
    unit = behind(units[load]) if len(units) == model.controls else ""
    std, mean, share = values
    seems = (
        f" Beside such a load, the standard deviation of all other process noise seems to be {share**0.5:.2g} times the stated "
        "one. Leave it as stated until the controller estimates the load."
    )
    less = "" if share == 1.0 else seems
    average = f", on average by {mean:.3g}{unit}" if mean else ""
    quick = float(model.step) <= USUAL_STEP
    lasting = ", or disturbance=True: if the load lasts, its estimate follows sooner" if mean and quick else ""
    size = f"{std**2:.2g}"
    if model.controls == 1:
        how = (
            f"(about disturbance={size} in design and in a scenario, the variance of its change in each sample{lasting}; of a "
            f"LinearModel: with_disturbance({size})), or say where process noise acts (noise)."
        )
    else:  # a single number would be that of every control, too large for one with another unit
        how = (
            "with disturbance=True in design and in a scenario, or say where process noise acts (noise). (Its change in each "
            f"sample has a variance of about {size}. Of a LinearModel, give with_disturbance a list with this number, and small "
            "positive ones for the other controls.)"
        )
    estimate = f"{_faster(model).lstrip()} If another load acts, estimate it" if _known_loads(model) else "Estimate it"
    return (
        f"a load acts, and changes all the time. It has the effect of a change of {named(load, model)}{average}. {estimate} "
        f"{how}{less}"
    )


def _onset(
    values: Sequence[float],
    model: LinearModel,
    units: Sequence[str | None],
    elsewhere: bool,
    state: int | None,
    linear: bool,
) -> str:
    each = 2 + model.controls
    loads = [values[k : k + each] for k in range(0, len(values), each)]
    times = ", and another one ".join(map(since, loads))
    if state is not None:
        known = model.names.states[state] if model.names is not None else f"x[{state}]"
        they, act, are, come = ("it", "acts", "is", "comes") if len(loads) == 1 else ("they", "act", "are", "come")
        return (
            f"{'a load acts' if len(loads) == 1 else 'one load acts'} {times}. {they.capitalize()} {act} as the state {known} of "
            f"the model does, but {are} larger, or {come} faster, than the noise of {known} says. Give {known} more noise (in "
            f"design and in a scenario: {STATED}, or a larger noise; of a LinearModel: process_covariance)."
        )
    if elsewhere:
        ends = not linear and any(np.isfinite(load[1]) for load in loads)
        far = "If the plant is far from its operating point meanwhile, its nonlinearity may look the same. " * ends
        acts = f"a load acts {times}, " if len(loads) == 1 else f"one load acts {times}; at least one of the two acts "
        if known := _known_loads(model):
            return (
                f"{acts}where no control does. {far}If it is {known} of the model, give it {STATED}. For another load, give the "
                "plant that you design for an input where the load acts, and name this input in loads, too."
            )
        return (
            f"{acts}where no control does. {far}If such "
            "loads belong to normal operation, measure them, or estimate "
            "them where they act. disturbance=True is for loads where a control acts. For others, the plant that you design for "
            "needs an input where the load acts: name it in loads=, with its standard deviation and time constant. noise= is not "
            "enough for a load that stays. The guide 'How do I get rid of a steady error?' has an example."
        )
    changes = ", and then ".join(f"of a change of {change(load[2:], model, units)}" for load in loads)
    return (
        f"a load, or an offset of the actuator, acts {times}. {'It has' if len(loads) == 1 else 'They have'} about the effect "
        f"{changes}. If such loads belong to normal operation, measure them, or {_estimate('them', model)}."
    )


def _loss(values: Sequence[float], model: LinearModel, units: Sequence[str | None], linear: bool) -> str:
    control = named(values[3], model)
    if len(values) > STUCK_AT:
        unit = behind(units[int(values[3])]) if len(units) == model.controls else ""
        return f"{control} is stuck at about {values[STUCK_AT]:.3g}{unit} {since(values)}. Look for a fault of the actuator."
    far = " If the plant is then at another operating point, its nonlinearity looks the same: design for that point (at=...)."
    how = f"{control} moves the plant {strongly(values[2])} {since(values)}"
    return f"{how}. Look for a fault of the actuator.{'' if linear else far}"


def _nonlinear(values: Sequence[float], model: LinearModel) -> str:
    return (
        "the plant's motion depends on its state: the plant is far from the point of linearisation. Linearise it nearer to its "
        "goals (at= in design), or use a nonlinear model (NonlinearBayesianController)."
    )


def _dynamics(values: Sequence[float], model: LinearModel) -> str:
    return (
        "the plant moves differently from A and B. Check the masses, inertias, stiffnesses and frictions behind them, and dt; or "
        "identify the model from a recording in which the control also moves at random (LinearModel.identify)."
        f"{'' if has_loads(model) else _faster(model) or LASTS}"
    )


def _unknown(values: Sequence[float], model: LinearModel) -> str:
    return (
        "neither A, B and C of the model nor its noise explain the plant's motion, and no simple explanation fits the run: not "
        "the sign, gain, delay or limits of a control, not dt, not one or two loads of constant size, not other linear dynamics. "
        "There may be several causes, such as loads that change, noise that comes in bursts, and sensor faults: diagnose a "
        "shorter run, or the begin of this one (diagnose_recording). If the model is wrong there as well, identify it anew from "
        "a recording in which the controls move the plant (LinearModel.identify). Against loads that change, "
        f"{_estimate('them', model)}."
    )


def _suspect(values: Sequence[float], model: LinearModel) -> str:
    return (
        "the samples differ from the model's predictions. Check the direction of the control, its delay and limits, dt, and the "
        "masses, inertias and frictions."
    )


_WORDS = {
    "sign": _sign,
    "gain": _gain,
    "gains": _gains,
    "dt": _dt,
    "late": _late,
    "early": _early,
    "limit": _limit,
    "exchanged": _exchanged,
    "late_sensors": _late_sensors,
    "nonlinear": _nonlinear,
    "dynamics": _dynamics,
    "unknown": _unknown,
    "suspect": _suspect,
}
