"""Compute from an FMU's description what can be done with it: the table that ``bayesftc inspect`` prints."""

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
    """A use of an FMU, whether it works (``yes``, ``no`` or ``partly``), and how, or why not."""

    what: str
    works: Literal["yes", "no", "partly"]
    how: str


def verdicts(path: Path, description: FMUDescription, *, validate: bool) -> list[Verdict]:
    """Return what can be done with an FMU. With `validate` its description must follow the rules of FMI."""
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
    """Return the FMU as a block, or why it cannot be one."""
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
        tool = (
            " It needs the tool that made it (needsExecutionTool)." if _flag(description, "needsExecutionTool") else ""
        )
        other = misnamed(description, entry)
        text = f"its binary for {platform} {other}." if other else f"it has a binary for {platform}."
        return Verdict(what, "partly" if tool or other else "yes", text + tool)
    if read_sources(archive, description, exchange="coSimulation" not in description.kinds) is None:
        return Verdict(what, "no", f"it has no binary for {platform} and no sources. Export it for this platform.")
    return Verdict(
        what, "partly", f"it has no binary for {platform}. At the first run a C compiler builds one from its sources."
    )


def _used_as(kind: str, block: FMU | str | None, description: FMUDescription) -> Verdict:
    if block is None:
        return Verdict(kind, "no", "the FMU does not support it.")
    if isinstance(block, str):
        return Verdict(kind, "no", block)
    if kind == "co-simulation":
        step = description.default_experiment.get("stepSize")
        more = f", with its default step of {step:g} s" if step else "; its description has no step size"
        return Verdict(kind, "yes", f"as timing={block.timing!r}{more}.{_late(block, description)}")
    info = description.exchange
    states = info.count if info else 0
    events = f", {info.indicators} event indicators" if info and info.indicators else ""
    default = "" if "coSimulation" not in description.kinds else " Ask for it with kind='model exchange'."
    return Verdict(kind, "yes", f"{_many(states, 'state')}{events}, timing={block.timing!r}.{default}")


def _late(block: FMU, description: FMUDescription) -> str:
    """Return a note on outputs with direct feedthrough, which timing='plant' delays."""
    if block.timing != "plant" or not block.inputs:
        return ""
    direct = [name for name, inputs in description.feedthrough.items() if inputs]
    if direct:
        return f" Direct feedthrough to {_some(direct)}: use timing='sampled' for a controller, or for a block without state."
    unknown = [name for name, inputs in description.feedthrough.items() if inputs is None]
    return " Its description does not state the direct feedthrough." if unknown else ""


def _ports(block: FMU | None, description: FMUDescription) -> list[Verdict]:
    if block is None:
        return []
    results = []
    for side in ("input", "output"):
        have = [v for v in description.variables if v.causality == side and not v.alias]
        ports = {port.name for port in getattr(block, f"{side}s") or ()}
        free = [v for v in have if v.name not in ports]
        never = [v.name for v in free if v.clocked or not v.is_numeric]
        named = [v.name for v in free if v.name not in never]
        arrays = sum(1 for v in have if v.shape and v.name in ports)
        text = _many(len(ports), "port") + (f", {arrays} of them vectors or matrices" if arrays else "")
        text += f"; others can be named in {side}s=[...]: {_some(named)}" if named else ""
        text += f"; cannot be ports: {_some(never)}" if never else ""
        results.append(
            Verdict(f"{side}s", "partly" if never else "yes" if have else "no", (text if have else "it has none") + ".")
        )
    return results


def _instances(description: FMUDescription) -> list[Verdict]:
    info = description.exchange
    once = _flag(description, "canBeInstantiatedOnlyOncePerProcess") or bool(info and info.once)
    several = (
        Verdict("several instances", "partly", "one instance per process; isolate=True gives each a process.")
        if once
        else Verdict("several instances", "yes", "any number in one process.")
    )
    return [
        several,
        Verdict("isolate=True", "yes", "in a separate process, whose crash or endless step does not end yours."),
    ]


def _states(description: FMUDescription) -> list[Verdict]:
    info = description.exchange
    exchange_alone = "coSimulation" not in description.kinds and info is not None
    saves = _flag(description, "canGetAndSetFMUstate")
    smooth = exchange_alone and info is not None and info.smooth and not saves
    bytes_ = _flag(description, "canSerializeFMUstate")
    no = "it cannot save its state"
    if smooth:
        saved = Verdict("save and restore", "yes", "its time, states and inputs are its whole state.")
    elif saves:
        saved = Verdict("save and restore", "yes", "session.save_state(), session.restore(state).")
    else:
        saved = Verdict("save and restore", "no", f"{no}; a run can only restart (session.reset()).")
    held = saves or smooth
    pickled = Verdict(
        "states as bytes",
        "yes" if bytes_ or smooth else "no",
        "a saved state can be pickled, for another process or a later session."
        if bytes_ or smooth
        else "a saved state stays in this process.",
    )
    iterated = Verdict(
        "iterated coupling",
        "yes" if held else "no",
        "steps can be repeated, so tight couplings are iterated."
        if held
        else f"{no}; put a UnitDelay into loops, or couple by Gauss-Seidel or Jacobi.",
    )
    return [saved, pickled, iterated] if held else [saved, iterated]


def _linearised(description: FMUDescription) -> Verdict:
    what, info = "a linear model of it", description.exchange
    if info is not None:
        how = "its directional derivatives" if info.directional else "central differences of its equations"
        return Verdict(what, "yes", f"LinearModel.from_fmu: {how}, at a steady state that it computes.")
    if "coSimulation" in description.kinds:
        from_where = "a saved state" if _flag(description, "canGetAndSetFMUstate") else "a new instance"
        return Verdict(what, "yes", f"LinearModel.from_fmu: its pulse responses at rest, each from {from_where}.")
    return Verdict(what, "no", "it supports neither co-simulation nor model exchange.")


def _steps(description: FMUDescription) -> list[Verdict]:
    if "coSimulation" not in description.kinds:
        return []
    variable = _flag(description, "canHandleVariableCommunicationStepSize")
    results = [
        Verdict(
            "steps that vary",
            "yes" if variable else "no",
            "its step size may vary." if variable else "it needs a constant step size.",
        )
    ]
    if description.fmi_major == 3:
        for flag, what, how in (
            ("hasEventMode", "event mode", "events are handled when the FMU requests it, also within steps."),
            ("mightReturnEarlyFromDoStep", "early return", "a step that returns early is completed."),
        ):
            has = _flag(description, flag)
            results.append(Verdict(what, "yes" if has else "no", how if has else "it has none."))
    return [*results, *_clocks(description)]


def _clocks(description: FMUDescription) -> list[Verdict]:
    clocks = [v for v in description.variables if v.clock and v.causality == "input"]
    timed = [v.name for v in clocks if v.clock and v.clock.is_timed]
    triggered = [v.name for v in clocks if v.name not in timed]
    if not clocks:
        return []
    if not description.uses_event_mode:
        return [Verdict("clocks", "no", "without event mode only the FMU uses them; clocked variables are no ports.")]
    how = [f"time ticks {_some(timed)}, when the FMU requests it"] if timed else []
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
        return Verdict(what, "partly", "only as a plant (timing='plant'): SSP cannot express timing='sampled'.")
    if arrays:
        return Verdict(what, "yes", f"cosim.save_ssp(diagram, path), as SSP 2.0 because of arrays: {_some(arrays)}.")
    return Verdict(what, "yes", "cosim.save_ssp(diagram, path), together with other blocks.")


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
