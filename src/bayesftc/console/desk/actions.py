"""What an operator does by hand, as entries of the scenario: a served run is a function of its scenario."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.diagram.closed_loop import fault_blocks
from bayesftc.cosim.diagram.wiring import samples_ahead
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.scenario import Scenario
from bayesftc.scenario._place import Place
from bayesftc.scenario._sections import fault_list

SENSORS = "sensors"
"""The target of a sensor fault; that of an actuator fault is the name of a control."""

GOAL = "by_hand"
"""Beginning of the names of the blocks that change a reference."""


@dataclass(frozen=True)
class Action:
    """One action, in effect from step `k` on.

    Attributes
    ----------
    k : int
        The first step that it changes.
    what : str
        ``"fault"``: a new fault of `target` with `settings`. ``"repair"``: the fault with the name `target` ends. ``"goal"``:
        element `target` of the reference becomes `value`. ``"input"``: the free input, or the tunable parameter, `target` of
        the plant becomes `value`.
    target : str
        See above.
    settings : mapping
        The table of a fault in a scenario file.
    value : float
        The new number.
    """

    k: int
    what: Literal["fault", "repair", "goal", "input"]
    target: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    value: float = 0.0


def words_of(action: Action) -> str:
    """Return an action in words."""
    if action.what == "fault":
        numbers = [
            f"{n} {v:g}" for n, v in action.settings.items() if isinstance(v, float | int) and n not in ("sensor",)
        ]
        where = (
            f"sensor {action.settings.get('sensor', 0)}" if action.target == SENSORS else f"actuator {action.target}"
        )
        return f"{action.settings.get('kind')} of {where}" + (f" ({', '.join(numbers)})" if numbers else "")
    if action.what == "repair":
        return f"end of {action.target}"
    name = f"reference {action.target}" if action.what == "goal" else action.target
    return f"{name} set to {action.value:g}"


def time_of(k: int, step: Fraction) -> float:
    """Return the time of a step: the double nearest to it, with which a run compares times."""
    return k * step.numerator / step.denominator


def with_actions(
    content: Mapping[str, Any], actions: Sequence[Action], step: Fraction, scenario: Scenario
) -> dict[str, Any]:
    """Return the content of a scenario file with the entries of actions, in their order.

    Parameters
    ----------
    content : mapping
        The content of the file.
    actions : sequence of Action
        With rising steps.
    step : Fraction
        The base step in seconds.
    scenario : Scenario
        The scenario of the content, without the actions.

    Raises
    ------
    BayesFTCError
        If an action does not fit to the scenario.
    """
    edited = deepcopy(dict(content))
    for action in actions:
        t = time_of(action.k, step)
        if action.what == "fault":
            _add_fault(edited, action, t)
        elif action.what == "repair":
            _end_fault(edited, action.target, t)
    _set_goals(edited, [a for a in actions if a.what == "goal"], step, scenario)
    _set_inputs(edited, [a for a in actions if a.what == "input"], step, scenario)
    return edited


def faults_of(content: Mapping[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    """Return the target, the name of the block and the table of each fault of a scenario."""
    found = []
    for target, tables in _chains(content).items():
        faults = fault_list(tables, Place("scenario", target))
        names = fault_blocks(faults, "" if target == SENSORS else target)
        found += [(target, name, table) for name, table in zip(names, tables, strict=True)]
    return found


def _chains(content: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    return {SENSORS: content.get("faults", []), **content.get("input_faults", {})}


def _add_fault(content: dict[str, Any], action: Action, t: float) -> None:
    table = {name: value for name, value in action.settings.items() if name != "name"}
    start = table.get("start")
    if start is None:
        table["start"] = t
    elif isinstance(start, str):
        condition = When.read(start)
        if condition is None or not condition.signal:
            raise ModelError(
                f"The start of the fault is {brief(start)}; give seconds, or a condition such as 'plant.v > 22'."
            )
        table["start"] = {**_plain(condition), "after": t}
    elif isinstance(start, int | float) and start < t:
        raise ModelError(
            f"The fault starts at {start:g} s, but the run is already at {t:g} s; give a later time, or go back."
        )
    if action.target == SENSORS:
        chain = content.setdefault("faults", [])
    else:
        chain = content.setdefault("input_faults", {}).setdefault(action.target, [])
    fault = fault_list([table], Place("The fault"))[0]
    chain.append({**table, "name": _new_name(content, fault, action.target)})


def _plain(condition: When) -> dict[str, Any]:
    # The signal of the step before is compared, because most signals of a loop depend on its faults.
    delayed = not condition.signal.startswith(("plant.", "reference"))
    return {
        "signal": condition.signal,
        "relation": condition.relation,
        "value": condition.value,
        **({"delayed": True} if delayed else {}),
    }


def _new_name(content: Mapping[str, Any], fault: Fault, target: str) -> str:
    """Return the name that the fault would have without one, with a number if it is in use."""
    taken = {name for _, name, _ in faults_of(content)}
    first = name = fault_blocks([fault], "" if target == SENSORS else target)[0]
    number = 1
    while name in taken:
        number += 1
        name = f"{first}_{number}"
    return name


def _end_fault(content: dict[str, Any], name: str, t: float) -> None:
    """Let a fault end; remove one that has not begun."""
    known = faults_of(content)
    found = next((each for each in known if each[1] == name), None)
    if found is None:
        raise UnknownNameError(f"There is no fault {name!r}; {did_you_mean(name, [block for _, block, _ in known])}")
    target, _, table = found
    start, stop = table.get("start", 0.0), table.get("stop")
    earliest = start.get("after", 0.0) if isinstance(start, dict) else start if isinstance(start, int | float) else 0.0
    if earliest < t:
        table["stop"] = t if not isinstance(stop, int | float) else min(stop, t)
        return
    for of, block, each in known:  # the names of the other faults, and so their random numbers, must not change
        if of == target and each is not table:
            each["name"] = block
    chain = _chains(content)[target]
    chain[:] = [each for each in chain if each is not table]
    if not chain:
        if target == SENSORS:
            del content["faults"]
        else:
            del content["input_faults"][target]


def _table(changes: Sequence[Action], step: Fraction, first: Sequence[tuple[float, float]] = ()) -> dict[str, Any]:
    """Return the source of values that change at steps; of several changes at one step the last one counts."""
    values = {**dict(first), **{time_of(a.k, step): float(a.value) for a in changes}}
    times = sorted(values)
    return {"kind": "Table", "times": times, "values": [values[t] for t in times], "interpolate": False}


def _set_goals(content: dict[str, Any], actions: Sequence[Action], step: Fraction, scenario: Scenario) -> None:
    """Put a switch from the reference to a table of values between a reference and the controller."""
    if not actions:
        return
    count = goals_of(scenario)
    for goal in {a.target for a in actions}:
        if not (goal.isdecimal() and int(goal) < count):
            raise UnknownNameError(f"There is no reference {goal!r}; the references have the numbers 0 to {count - 1}.")
    blocks = content.setdefault("blocks", {})
    others, sources = _sources_of_goals(content.get("connections", []), count, scenario)
    connections = content["connections"] = others
    for i in range(count):
        changes = [a for a in actions if int(a.target) == i]
        if changes:
            name = f"{GOAL}_{i}"
            blocks[f"{name}_value"] = _table(changes, step)
            blocks[f"{name}_on"] = {"kind": "Step", "time": time_of(changes[0].k, step), "after": 1.0}
            blocks[name] = {"kind": "Switch"}
            connections += [
                {"from": f"{name}_on.y", "to": f"{name}.condition"},
                {"from": f"{name}_value.y", "to": f"{name}.above"},
                {"from": sources[i], "to": f"{name}.otherwise"},
            ]
            sources[i] = f"{name}.y"
    connections.append({"from": sources, "to": "controller.goal"})


def goals_of(scenario: Scenario) -> int:
    """Return the number of elements of the controller's goal."""
    return next(port.size for port in scenario.controller.inputs if port.name == "goal")


def _sources_of_goals(
    connections: Sequence[Mapping[str, Any]], count: int, scenario: Scenario
) -> tuple[list[Any], list[str]]:
    """Return the connections that are not to the goal, and the source of each element of the goal.

    Raises
    ------
    ModelError
        If the number of the sources is not that of the elements.
    """
    output = "ahead" if samples_ahead(scenario.controller) else "y"
    names = [f"reference_{i}" for i in range(count)] if len(scenario.reference) > 1 else ["reference"]
    sources, others = [f"{name}.{output}" for name in names], []
    for each in connections:
        given = [each["from"]] if isinstance(each["from"], str) else list(each["from"])
        if each["to"] == "controller.goal":
            sources = given
        elif each["to"].startswith("controller.goal[") and len(given) == 1 and len(sources) == count:
            sources[int(each["to"].removeprefix("controller.goal[").rstrip("]"))] = given[0]
        else:
            others.append(each)
    if len(sources) != count:
        raise ModelError(
            f"The {count} elements of the goal come from {len(sources)} signals, so they cannot be changed by hand. Connect one "
            "signal to each element."
        )
    return others, sources


def _set_inputs(content: dict[str, Any], actions: Sequence[Action], step: Fraction, scenario: Scenario) -> None:
    """Feed a free input, or a tunable parameter, of the plant with a table of values."""
    known = free_inputs(scenario)
    for name in dict.fromkeys(a.target for a in actions):
        if name not in known:
            raise UnknownNameError(
                f"There is no free input or tunable parameter {name!r} of the plant; {did_you_mean(name, known)}"
            )
        value, is_parameter = known[name]
        changes = [a for a in actions if a.target == name]
        content.setdefault("noise", {})[name] = _table(changes, step, [(0.0, value)])
        if is_parameter:
            tunable = content["plant"].get("tunable", [])
            content["plant"]["tunable"] = [*([tunable] if isinstance(tunable, str) else tunable), name]


def free_inputs(scenario: Scenario) -> dict[str, tuple[float, bool]]:
    """Return the present value of each number that an operator can set in the plant, and whether it is a parameter."""
    control = scenario.wiring.control
    fed = {*([control] if isinstance(control, str) else control), *scenario.noise, *scenario.input_faults}
    fed |= {target.removeprefix("plant.") for _, target in scenario.connections}
    fed = {re.sub(r"\[.*", "", name) for name in fed}
    free: dict[str, tuple[float, bool]] = {
        port.name: (float(port.default), False)  # type: ignore[arg-type]
        for port in scenario.plant.inputs
        if port.name not in fed and port.size == 1 and port.default is not None and port.draw is None
    }
    parameters: Mapping[str, Any] = getattr(scenario.plant, "parameters", None) or {}
    description = getattr(scenario.plant, "description", None)
    for variable in getattr(description, "variables", ()):
        if variable.causality == "parameter" and variable.variability == "tunable" and variable.name not in free:
            start = parameters.get(variable.name, variable.start)
            if isinstance(start, int | float) and not isinstance(start, bool):
                free[variable.name] = float(start), True
    return free


def with_absolute_paths(content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the content with absolute paths of FMUs, so that the file can lie in any folder."""

    def absolute(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                name: str((folder / each).resolve())
                if name == "fmu" and isinstance(each, str) and (folder / each).is_file()
                else absolute(each)
                for name, each in value.items()
            }
        return [absolute(each) for each in value] if isinstance(value, list) else value

    plain: dict[str, Any] = absolute(dict(content))
    return plain


__all__ = [
    "SENSORS",
    "Action",
    "faults_of",
    "free_inputs",
    "goals_of",
    "time_of",
    "with_absolute_paths",
    "with_actions",
    "words_of",
]
