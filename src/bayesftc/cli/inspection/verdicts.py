"""What can be done with an FMU, computed from its description: the table that ``bayesftc inspect`` prints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bayesftc.cosim.errors import BayesFTCError
from bayesftc.cosim.fmi.binaries.loading import binary_entry, misnamed
from bayesftc.cosim.fmi.fmu import FMU, FMUDescription
from bayesftc.cosim.fmi.reading.archive import Archive, open_archive
from bayesftc.cosim.fmi.reading.sources import read_sources
from bayesftc.cosim.ports import Port

_KINDS: dict[str, Literal["co-simulation", "model exchange"]] = {
    "coSimulation": "co-simulation",
    "modelExchange": "model exchange",
}


@dataclass(frozen=True)
class Verdict:
    """What can be done, whether it works (``yes``, ``no`` or ``partly``), and how, or why not."""

    what: str
    works: Literal["yes", "no", "partly"]
    how: str


def verdicts(path: Path, description: FMUDescription, *, validate: bool) -> list[Verdict]:
    """Return what can be done with an FMU; with `validate` its description must keep the rules of FMI."""
    archive = open_archive(path.absolute())
    blocks = {kind: _block(path, kind, validate) for name, kind in _KINDS.items() if name in description.kinds}
    return [
        _runs_here(archive, description),
        *(_used_as(kind, blocks.get(kind), description) for kind in _KINDS.values()),
        *_ports(next((b for b in blocks.values() if isinstance(b, FMU)), None), description),
        *_instances(description),
        *_states(description),
        _linearised(description),
        *_steps(description),
        _ssp(next((b for b in blocks.values() if isinstance(b, FMU)), None)),
    ]


def _block(path: Path, kind: Literal["co-simulation", "model exchange"], validate: bool) -> FMU | str:
    """Return the block that one would get, or why there is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return FMU(path, kind=kind, validate=validate)
        except BayesFTCError as error:
            return str(error)


def _flag(description: FMUDescription, name: str) -> bool:
    return bool(description.capabilities.get(name))


def _runs_here(archive: Archive, description: FMUDescription) -> Verdict:
    platform, entry = binary_entry(archive, description)
    what = "run on this machine"
    if entry in archive.names:
        tool = " It says that it needs the tool that made it." if _flag(description, "needsExecutionTool") else ""
        other = misnamed(description, entry)
        text = f"its binary for {platform} {other}." if other else f"it has a binary for {platform}."
        return Verdict(what, "partly" if tool or other else "yes", text + tool)
    if read_sources(archive, description, exchange="coSimulation" not in description.kinds) is None:
        return Verdict(what, "no", f"it has no binary for {platform}, nor sources; export it for this platform.")
    return Verdict(
        what, "partly", f"it has no binary for {platform}; at the first run a C compiler makes one of its sources."
    )


def _used_as(kind: str, block: FMU | str | None, description: FMUDescription) -> Verdict:
    if block is None:
        return Verdict(kind, "no", "it is not made for that.")
    if isinstance(block, str):
        return Verdict(kind, "no", block)
    if kind == "co-simulation":
        step = description.default_experiment.get("stepSize")
        more = f", at steps of {step:g} s by its own account" if step else "; it does not say at which step"
        return Verdict(kind, "yes", f"as timing={block.timing!r}{more}.{_late(block, description)}")
    info = description.exchange
    states = info.count if info else 0
    events = f", {info.indicators} event indicators" if info and info.indicators else ""
    default = "" if "coSimulation" not in description.kinds else " Ask for it with kind='model exchange'."
    return Verdict(kind, "yes", f"{_many(states, 'state')}{events}, timing={block.timing!r}.{default}")


def _late(block: FMU, description: FMUDescription) -> str:
    """Return what a plant's user should know of outputs that depend at once on inputs."""
    if block.timing != "plant" or not block.inputs:
        return ""
    told = [name for name, inputs in description.feedthrough.items() if inputs]
    if told:
        return f" But {_some(told)} depends at once on inputs: timing='sampled' for a controller or what has no memory."
    silent = [name for name, inputs in description.feedthrough.items() if inputs is None]
    return " It does not say whether outputs depend at once on inputs." if silent else ""


def _ports(block: FMU | None, description: FMUDescription) -> list[Verdict]:
    if block is None:
        return []
    found = []
    for side in ("input", "output"):
        have = [v for v in description.variables if v.causality == side and not v.alias]
        ports = {port.name for port in getattr(block, f"{side}s") or ()}
        free = [v for v in have if v.name not in ports]
        never = [v.name for v in free if v.clocked or not v.is_numeric]
        named = [v.name for v in free if v.name not in never]
        arrays = sum(1 for v in have if v.shape and v.name in ports)
        text = _many(len(ports), "port") + (f", {arrays} of them vectors or matrices" if arrays else "")
        text += f"; others by name, {side}s=[...]: {_some(named)}" if named else ""
        text += f"; never: {_some(never)}" if never else ""
        found.append(
            Verdict(f"{side}s", "partly" if never else "yes" if have else "no", (text if have else "it has none") + ".")
        )
    return found


def _instances(description: FMUDescription) -> list[Verdict]:
    info = description.exchange
    once = _flag(description, "canBeInstantiatedOnlyOncePerProcess") or bool(info and info.once)
    several = (
        Verdict("several instances", "partly", "one in a process, by its own account; more with isolate=True.")
        if once
        else Verdict("several instances", "yes", "as many as you like in one process.")
    )
    return [
        several,
        Verdict("isolate=True", "yes", "in a process of its own: a crash or an endless step leaves yours alive."),
    ]


def _states(description: FMUDescription) -> list[Verdict]:
    info = description.exchange
    exchange_alone = "coSimulation" not in description.kinds and info is not None
    saves = _flag(description, "canGetAndSetFMUstate")
    smooth = exchange_alone and info is not None and info.smooth and not saves
    bytes_ = _flag(description, "canSerializeFMUstate")
    no = "it cannot save its state"
    if smooth:
        saved = Verdict("save and restore", "yes", "its time, states and inputs are all that it remembers.")
    elif saves:
        saved = Verdict("save and restore", "yes", "session.save_state(), session.restore(state).")
    else:
        saved = Verdict("save and restore", "no", f"{no}; a run can only start anew (session.reset()).")
    held = saves or smooth
    pickled = Verdict(
        "states as bytes",
        "yes" if bytes_ or smooth else "no",
        "a saved state pickles, for another process or day."
        if bytes_ or smooth
        else "a saved state stays in this process.",
    )
    iterated = Verdict(
        "iterated coupling",
        "yes" if held else "no",
        "steps can be taken back, so tight couplings are iterated."
        if held
        else f"{no}; put a UnitDelay into loops, or couple by Gauss-Seidel or Jacobi.",
    )
    return [saved, pickled, iterated] if held else [saved, iterated]


def _linearised(description: FMUDescription) -> Verdict:
    what, info = "a linear model of it", description.exchange
    if info is not None:
        how = "its directional derivatives" if info.directional else "central differences of its equations"
        return Verdict(what, "yes", f"LinearModel.from_fmu: {how}, at a steady state that is found.")
    if "coSimulation" in description.kinds:
        from_where = "a saved state" if _flag(description, "canGetAndSetFMUstate") else "a new instance"
        return Verdict(
            what, "yes", f"LinearModel.from_fmu: its answers to pulses, each from {from_where}, where it comes to rest."
        )
    return Verdict(what, "no", "it is made neither for co-simulation nor for model exchange.")


def _steps(description: FMUDescription) -> list[Verdict]:
    if "coSimulation" not in description.kinds:
        return []
    variable = _flag(description, "canHandleVariableCommunicationStepSize")
    found = [
        Verdict(
            "steps that vary",
            "yes" if variable else "no",
            "it says that it can handle them." if variable else "it wants to be run at one step size.",
        )
    ]
    if description.fmi_major == 3:
        for flag, what, how in (
            ("hasEventMode", "event mode", "events are handled when it asks for it, within steps too."),
            ("mightReturnEarlyFromDoStep", "early return", "a step that it ends early is carried to its end."),
        ):
            has = _flag(description, flag)
            found.append(Verdict(what, "yes" if has else "no", how if has else "it has none."))
    return [*found, *_clocks(description)]


def _clocks(description: FMUDescription) -> list[Verdict]:
    clocks = [v for v in description.variables if v.clock and v.causality == "input"]
    timed = [v.name for v in clocks if v.clock and v.clock.is_timed]
    triggered = [v.name for v in clocks if v.name not in timed]
    if not clocks:
        return []
    if not description.uses_event_mode:
        return [Verdict("clocks", "no", "without event mode they are its own affair; what is clocked is no port.")]
    how = [f"time ticks {_some(timed)}, when it asks for that"] if timed else []
    how += [f"nothing triggers {_some(triggered)}"] if triggered else []
    works: Literal["yes", "no", "partly"] = "no" if not timed else "partly" if triggered else "yes"
    return [Verdict("clocks", works, f"{'; '.join(how)}.")]


def _ssp(block: FMU | None) -> Verdict:
    what = "save in an SSP"
    if block is None:
        return Verdict(what, "no", "it cannot be a block.")
    ports = [p for side in (block.inputs, block.outputs) for p in side or () if isinstance(p, Port)]
    arrays = [p.name for p in ports if p.shape]
    if block.timing == "sampled":
        return Verdict(what, "partly", "as a plant (timing='plant'): SSP cannot ask a tool for timing='sampled'.")
    if arrays:
        return Verdict(what, "yes", f"cosim.save_ssp(diagram, path), as SSP 2.0, for its arrays: {_some(arrays)}.")
    return Verdict(what, "yes", "cosim.save_ssp(diagram, path), with others.")


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
