"""Which variables of an FMU become ports, and what is said where an output would lag."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from math import prod

from bayesftc.cosim.errors import FMUError, ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.reading.archive import Archive
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable
from bayesftc.cosim.ports import Port

WATCHED = ("local", "calculatedParameter", "parameter")
"""Of which causality variables are outputs if they are asked for."""


def choose(
    archive: Archive,
    variables: Mapping[str, FMUVariable],
    causality: str,
    wanted: Sequence[str | Port] | None,
    ticking: Container[int] = (),
) -> list[FMUVariable]:
    """Return the variables that become ports of one side; of clocked ones, those with a clock among `ticking`.

    Outputs may be local variables and parameters as well, which can be read at any time: those that are wanted by name.
    """
    candidates = {v.name: v for v in variables.values() if v.causality == causality}
    if wanted is None:
        return [v for v in candidates.values() if not _obstacle(v, ticking) and not v.alias]
    if causality == "output":
        candidates |= {v.name: v for v in variables.values() if v.causality in WATCHED}
    if not isinstance(wanted, list | tuple) or not all(isinstance(item, str | Port) for item in wanted):
        example = [wanted] if isinstance(wanted, str) else [*candidates][:1] or ["y"]
        raise ModelError(f"FMU has {causality}s={wanted!r}; give a list of names, as {example}.")
    chosen: list[FMUVariable] = []
    for item in wanted:
        name = item.name if isinstance(item, Port) else item
        if name not in candidates:
            other = variables.get(name)
            hint = f"it is of causality {other.causality}." if other else did_you_mean(name, candidates)
            raise UnknownNameError(f"The FMU {archive.path.name} has no {causality} {name!r}; {hint}")
        variable = candidates[name]
        what = _obstacle(variable, ticking)
        if what:
            raise FMUError(
                f"The {causality} {name!r} of the FMU {archive.path.name} is {what}; only numbers can be ports: leave it out of "
                f"{causality}s, or export it as such."
            )
        if variable in chosen:
            raise ModelError(f"FMU has {name!r} twice among its {causality}s; name it once.")
        chosen.append(variable)
    return chosen


def ticking_clocks(description: FMUDescription, causality: str, *, exchange: bool) -> frozenset[int]:
    """Return the clocks of which clocked inputs or outputs can be ports: in co-simulation those that time ticks, and the FMU."""
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
        return "clocked, by clocks that nothing here ticks"
    if not variable.is_numeric:
        return f"of type {variable.type}"
    if variable.negated and variable.type not in {"Real", "Integer"}:
        return f"the opposite of another variable (negatedAlias) and of type {variable.type}"
    return None if prod(variable.shape) else f"an array of shape {variable.shape}, which is empty"


def choose_tunable(archive: Archive, variables: Mapping[str, FMUVariable], wanted: Sequence[str]) -> list[FMUVariable]:
    """Return the parameters that become inputs."""
    if not isinstance(wanted, list | tuple) or not all(isinstance(item, str) for item in wanted):
        raise ModelError(
            f"FMU has tunable={wanted!r}; give a list of names, as {[wanted] if isinstance(wanted, str) else ['k']}."
        )
    names = [v.name for v in variables.values() if v.causality == "parameter" and v.variability == "tunable"]
    for name in wanted:
        if name not in variables:
            raise UnknownNameError(
                f"The FMU {archive.path.name} has no variable {name!r}; tunable parameters: {', '.join(names) or 'none'}."
            )
        variable = variables[name]
        what = f"a {variable.variability} {variable.causality}" if name not in names else _obstacle(variable)
        if what:
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} is {what}; only tunable parameters that are numbers can be changed "
                f"while it runs ({', '.join(names) or 'it has none'}); set it by parameters= for a whole run."
            )
    if len(set(wanted)) < len(wanted):
        raise ModelError(f"FMU has a name twice in tunable={list(wanted)!r}; name it once.")
    return [variables[name] for name in wanted]


def late_outputs(
    archive: Archive, description: FMUDescription, inputs: Sequence[Port], outputs: Sequence[Port]
) -> str | None:
    """Return the sentence that names the outputs which are declared to depend at once on inputs, or None.

    FMI forbids to set inputs and read outputs without a step in between (FMI 2), so that no order of calls would show them.
    Most plants whose exporter declares nothing have no such outputs; ``bayesftc inspect`` says that they do not say.
    """
    here = [port.name for port in inputs]
    reached = {port.name: description.feedthrough.get(port.name) for port in outputs}
    fed = {name: [u for u in through or () if u in here] for name, through in reached.items()}
    declared = [f"{name} depends on {' and '.join(through)}" for name, through in fed.items() if through]
    if not declared:
        return None
    return (
        f"The FMU {archive.path.name} declares that at the same instant {', '.join(declared)}, but a plant's outputs at t_k are "
        "read before its inputs of t_k are set, so such an output shows the inputs of the step before: give timing='sampled' if "
        "the FMU is a controller or has no memory, or timing='plant' if this is as it should be."
    )
