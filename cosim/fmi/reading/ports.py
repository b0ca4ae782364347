"""Which variables of an FMU become ports, and the warning about outputs that lag by a step."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from math import prod

from bayesftc.cosim.errors import FMUError, ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.reading.archive import Archive
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable
from bayesftc.cosim.ports import Port

WATCHED = ("local", "calculatedParameter", "parameter")
"""Causalities of variables that can be outputs on request."""


def choose(
    archive: Archive,
    variables: Mapping[str, FMUVariable],
    causality: str,
    requested: Sequence[str | Port] | None,
    ticking: Container[int] = (),
) -> list[FMUVariable]:
    """Return the variables that become ports of one side; clocked variables need a clock among `ticking`.

    Local variables and parameters can be read at any time, and become outputs if requested by name.
    """
    candidates = {v.name: v for v in variables.values() if v.causality == causality}
    if requested is None:
        return [v for v in candidates.values() if not _obstacle(v, ticking) and not v.alias]
    if causality == "output":
        candidates |= {v.name: v for v in variables.values() if v.causality in WATCHED}
    if not isinstance(requested, list | tuple) or not all(isinstance(item, str | Port) for item in requested):
        example = [requested] if isinstance(requested, str) else [*candidates][:1] or ["y"]
        raise ModelError(f"FMU has {causality}s={requested!r}; give a list of names, as {example}.")
    chosen: list[FMUVariable] = []
    for item in requested:
        name = item.name if isinstance(item, Port) else item
        if name not in candidates:
            other = variables.get(name)
            own = [v.name for v in variables.values() if v.causality == causality]
            hint = f"it is of causality {other.causality}." if other else did_you_mean(name, own, others=candidates)
            raise UnknownNameError(f"The FMU {archive.path.name} has no {causality} {name!r}; {hint}")
        variable = candidates[name]
        what = _obstacle(variable, ticking)
        if what:
            raise FMUError(
                f"The {causality} {name!r} of the FMU {archive.path.name} is {what}; only numbers can be ports. Leave it out of "
                f"{causality}s, or export it as a number."
            )
        if variable in chosen:
            raise ModelError(f"FMU has {name!r} twice in {causality}s; name it once.")
        chosen.append(variable)
    return chosen


def ticking_clocks(description: FMUDescription, causality: str, *, exchange: bool) -> frozenset[int]:
    """Return the clocks whose clocked variables can be ports: in co-simulation time-based ones, and the FMU's output clocks."""
    if exchange or not description.uses_event_mode:
        return frozenset()
    return frozenset(
        v.reference
        for v in description.variables
        if v.clock and (v.clock.is_timed if v.causality == "input" else causality == "output")
    )


def _obstacle(variable: FMUVariable, ticking: Container[int] = ()) -> str | None:
    """Return why a variable cannot be a port, or None."""
    if variable.clocked and not any(clock in ticking for clock in variable.clocks):
        return "clocked, by clocks that do not tick here"
    if not variable.is_numeric:
        return f"of type {variable.type}"
    if variable.negated and variable.type not in {"Real", "Integer"}:
        return f"the opposite of another variable (negatedAlias) and of type {variable.type}"
    return None if prod(variable.shape) else f"an array of shape {variable.shape}, which is empty"


def choose_tunable(
    archive: Archive, variables: Mapping[str, FMUVariable], requested: Sequence[str]
) -> list[FMUVariable]:
    """Return the parameters that become inputs."""
    if not isinstance(requested, list | tuple) or not all(isinstance(item, str) for item in requested):
        raise ModelError(
            f"FMU has tunable={requested!r}; give a list of names, as {[requested] if isinstance(requested, str) else ['k']}."
        )
    names = [v.name for v in variables.values() if v.causality == "parameter" and v.variability == "tunable"]
    for name in requested:
        if name not in variables:
            raise UnknownNameError(
                f"The FMU {archive.path.name} has no variable {name!r}; tunable parameters: {', '.join(names) or 'none'}."
            )
        variable = variables[name]
        what = f"a {variable.variability} {variable.causality}" if name not in names else _obstacle(variable)
        if what:
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} is {what}; only tunable parameters that are numbers can change "
                f"during a run ({', '.join(names) or 'it has none'}). Set it by parameters= for a whole run."
            )
    if len(set(requested)) < len(requested):
        raise ModelError(f"FMU has a name twice in tunable={list(requested)!r}; name it once.")
    return [variables[name] for name in requested]


def late_outputs(
    archive: Archive, description: FMUDescription, inputs: Sequence[Port], outputs: Sequence[Port]
) -> str | None:
    """Return a warning about outputs that are declared to depend on inputs of the same instant, or None.

    FMI 2 forbids to set inputs and read outputs without a step in between, so no order of calls gives such outputs at once. Most
    plants without declared dependencies have no such outputs; ``bayesftc inspect`` reports missing declarations.
    """
    input_names = [port.name for port in inputs]
    dependencies = {port.name: description.feedthrough.get(port.name) for port in outputs}
    relevant = {name: [u for u in through or () if u in input_names] for name, through in dependencies.items()}
    declared = [f"{name} depends on {' and '.join(through)}" for name, through in relevant.items() if through]
    if not declared:
        return None
    return (
        f"The FMU {archive.path.name} declares that at the same instant {', '.join(declared)}, but a plant's outputs at t_k are "
        "read before its inputs at t_k are set. Such an output shows the inputs of the previous step. Give timing='sampled' if "
        "the FMU is a controller or has no memory, or timing='plant' if this delay is intended."
    )
