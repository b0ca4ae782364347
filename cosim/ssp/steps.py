"""The step sizes of an SSP: the standard does not define them, but tools write them into annotations."""

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
    ("SimulationInformation", "fixedStepSize"),  # OMSimulator 3
)
_VARIABLE = {"VariableStepMaster", "VariableStepSolver", "SimulationInformation"}


@dataclass(frozen=True)
class Steps:
    """A system's step sizes from annotations: the fixed one, and the longest of a solver with variable steps."""

    fixed: Fraction | None = None
    longest: str | None = None


def steps_of(root: Element, where: str) -> Steps:
    """Read the step size of the whole system, as written by this package, the Open Simulation Platform or OMSimulator.

    Parameters
    ----------
    root : Element
        The SystemStructureDescription.
    where : str
        The name of the .ssd, for messages.

    Raises
    ------
    SSPError
        If a step size is no positive number, or annotations give different ones.
    """
    system = next((e for e in root if _local(e) == "System"), None)
    experiment = (e for e in root if _local(e) == "DefaultExperiment")
    annotations = [e for owner in (system, *experiment) if owner is not None for e in _annotated(owner)]
    exact_step = next((text for e in annotations if _local(e) == "bayesftc" and (text := e.get("step"))), None)
    if exact_step is not None:
        return Steps(_step(exact_step, f"{where} has step={exact_step!r}", exact=True))
    texts = [(tag, name, e.get(name)) for tag, name in _FIXED for e in annotations if _local(e) == tag]
    labels = {
        _step(text, f"{where} has {name}={text!r}"): f"{name}={text} ({tag})"
        for tag, name, text in texts
        if text is not None and text != "None"  # OMSimulator 3 writes "None" for a solver without steps
    }
    if len(labels) > 1:
        raise SSPError(f"{where} gives several steps: {', '.join(labels.values())}; give dt=... in seconds.")
    longest = next(
        (e.get("maximumStepSize") for e in annotations if _local(e) in _VARIABLE and e.get("maximumStepSize")), None
    )
    return Steps(next(iter(labels), None), longest)


def step_hint(component: Element, what: str) -> Fraction | None:
    """Return the step size of one component, as written by the Open Simulation Platform (StepSizeHint)."""
    texts = (e.get("value", "") for e in _annotated(component) if _local(e) == "StepSizeHint")
    text = next(texts, None)
    return None if text is None else _step(text, f"{what} has a StepSizeHint of {text!r}")


def every(hint: Fraction | None, base: Fraction) -> int:
    """Return the multiple of the base step at which a component runs: its hint, rounded down as in libcosim."""
    return 1 if hint is None else max(1, hint // base)


def _step(text: str, what: str, *, exact: bool = False) -> Fraction:
    """Return a step size. Decimals of other tools are approximate (a thirtieth): they become the nearby simple fraction."""
    try:
        return rational_step(text.strip() if exact else float(text))
    except ValueError:  # a StepSizeError is a ValueError, too
        raise SSPError(f"{what}, which is no step size in seconds. Correct it, or remove it and give dt=...") from None


def _annotated(owner: Element) -> Iterator[Element]:
    """Yield the elements in the annotations of an element, but not in those of its parts."""
    for part in (e for e in owner if _local(e) == "Annotations"):
        yield from part.iter()


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


__all__ = ["Steps", "every", "step_hint", "steps_of"]
