"""The steps that an SSP is to be run at, for which the standard has no word: what tools write into its annotations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from xml.etree.ElementTree import Element

from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import SSPError

_FIXED = (
    ("FixedStepAlgorithm", "baseStepSize"),  # libcosim
    ("FixedStepMaster", "stepSize"),  # OMSimulator
    ("SimulationInformation", "fixedStepSize"),  # its third version
)
_VARIABLE = {"VariableStepMaster", "VariableStepSolver", "SimulationInformation"}


@dataclass(frozen=True)
class Steps:
    """What annotations say of a system's step: the fixed one, and the longest of a solver with variable steps."""

    fixed: Fraction | None = None
    longest: str | None = None


def steps_of(root: Element, where: str) -> Steps:
    """Read the step of the whole system: as this package writes it, the Open Simulation Platform, or OMSimulator.

    Parameters
    ----------
    root : Element
        The SystemStructureDescription.
    where : str
        The name of the .ssd, for messages.

    Raises
    ------
    SSPError
        If a step is no positive number, or two tools' annotations differ in it.
    """
    system = next((e for e in root if _local(e) == "System"), None)
    experiment = (e for e in root if _local(e) == "DefaultExperiment")
    known = [e for owner in (system, *experiment) if owner is not None for e in _annotated(owner)]
    ours = next((text for e in known if _local(e) == "bayesftc" and (text := e.get("step"))), None)
    if ours is not None:
        return Steps(_step(ours, f"{where} says step={ours!r}", exact=True))
    texts = [(tag, name, e.get(name)) for tag, name in _FIXED for e in known if _local(e) == tag]
    found = {
        _step(text, f"{where} says {name}={text!r}"): f"{name}={text} ({tag})"
        for tag, name, text in texts
        if text is not None and text != "None"  # as OMSimulator 3 writes a solver that has none
    }
    if len(found) > 1:
        raise SSPError(f"{where} gives several steps: {', '.join(found.values())}; give dt=... in seconds.")
    longest = next(
        (e.get("maximumStepSize") for e in known if _local(e) in _VARIABLE and e.get("maximumStepSize")), None
    )
    return Steps(next(iter(found), None), longest)


def step_hint(component: Element, what: str) -> Fraction | None:
    """Return the step at which one component is to run, as the Open Simulation Platform writes it (StepSizeHint)."""
    texts = (e.get("value", "") for e in _annotated(component) if _local(e) == "StepSizeHint")
    text = next(texts, None)
    return None if text is None else _step(text, f"{what} has a StepSizeHint of {text!r}")


def every(hint: Fraction | None, base: Fraction) -> int:
    """Return at which multiple of the base step a component runs: the whole steps in its hint, as libcosim counts them."""
    return 1 if hint is None else max(1, hint // base)


def _step(text: str, what: str, *, exact: bool = False) -> Fraction:
    """Return a step; of a decimal number that no other tool can write exactly (a thirtieth) the one that is meant."""
    try:
        return rational_step(text.strip() if exact else float(text))
    except ValueError:  # of which a StepSizeError is one
        raise SSPError(f"{what}, which is no step in seconds; correct it, or remove it and give dt=...") from None


def _annotated(owner: Element) -> Iterator[Element]:
    """Yield what stands in the annotations of an element, but not in those of its parts."""
    for part in (e for e in owner if _local(e) == "Annotations"):
        yield from part.iter()


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


__all__ = ["Steps", "every", "step_hint", "steps_of"]
