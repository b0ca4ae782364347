"""Run the measurements and print them as tables or as JSON."""

from __future__ import annotations

import json as encoder
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from bayesftc.bench._child import ChildError
from bayesftc.bench._figures import Figure, Section
from bayesftc.bench._machine import describe_machine

if TYPE_CHECKING:
    from rich.table import Table

SECTIONS = (
    "plain_loop",
    "coupled",
    "model_exchange",
    "python_control",
    "full_loop",
    "limit",
    "fit",
    "campaign",
    "executors",
    "report",
    "isolation",
    "export",
    "learners",
    "large_diagrams",
    "console",
    "live",
    "startup",
    "memory",
)
"""The measurements, each a module of this package."""


def measure(sections: Iterable[str] = SECTIONS, *, quick: bool = False) -> Iterator[Section]:
    """Check the names and return an iterator that makes the measurements one by one.

    Parameters
    ----------
    sections : iterable of str
        Names from `SECTIONS`.
    quick : bool
        Few and short repetitions: a check that everything works, not a measurement.

    Returns
    -------
    iterator of Section
        A section that cannot be measured here has no figures and a `reason`.

    Raises
    ------
    UnknownNameError
        If there is no such measurement.
    """
    from bayesftc.cosim.errors import UnknownNameError, did_you_mean

    sections = list(sections)
    for name in sections:
        if name not in SECTIONS:
            raise UnknownNameError(f"There is no measurement {name!r}; {did_you_mean(name, SECTIONS)}")
    return (_measured(name, quick) for name in sections)


def _measured(name: str, quick: bool) -> Section:
    from rich.console import Console

    from bayesftc.cosim.errors import BayesFTCError
    from bayesftc.fmus._compiler import CompilerError

    # Lines instead of a spinner, whose thread would disturb the measurement.
    Console(stderr=True).print(f"measuring: {name.replace('_', ' ')}")
    try:
        section: Section = import_module(f"bayesftc.bench.measures.{name}").measure(quick)
    except (BayesFTCError, CompilerError, ChildError, OSError) as error:
        return Section(name, name.replace("_", " ").capitalize(), (), reason=str(error))
    return section


def main(json: bool = False, *, quick: bool = False, sections: Iterable[str] = SECTIONS) -> None:
    """Measure `sections` (see `measure`) and print each table at once, or one JSON object at the end.

    A target that is not reached is no error. After Ctrl-C or an error, the object has the measurements until then.
    """
    measured = measure(sections, quick=quick)
    if json:
        done: list[Section] = []
        try:
            for section in measured:
                done.append(section)
        finally:
            if done:
                sys.stdout.write(encoder.dumps(as_json(done, quick), indent=2) + "\n")
        return
    from rich.console import Console

    console = Console() if sys.stdout.isatty() else Console(width=110)  # rich's default is 80 columns
    machine = describe_machine()
    console.print(", ".join(f"{name} {value}" for name, value in machine.items()), highlight=False)
    console.print("The targets are the project's own, for a machine without other load.")
    for section in measured:
        if section.reason:
            console.print(f"{section.title}: {section.reason}", highlight=False, markup=False)
        else:
            console.print(as_table(section))
    if quick:
        console.print("These are quick figures with too few steps to judge speed.")


def as_json(sections: Iterable[Section], quick: bool) -> dict[str, Any]:
    """Return the measurements as plain data."""
    sections = list(sections)
    return {
        "machine": describe_machine(),
        "quick": quick,
        **{s.key: s.as_json() for s in sections},
        "bars": {name: bar for s in sections for name, bar in s.bars().items()},
    }


def as_table(section: Section) -> Table:
    """Return the measurements of a section as a table."""
    from rich.table import Table

    table = Table(title=section.title, title_justify="left")
    table.add_column("", overflow="fold")
    for heading in ("median", "min", "max", "target"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for figure in section.figures:
        shown = [_shown(figure, value) for value in (figure.value, *_extremes(figure))]
        table.add_row(figure.label, *shown, _bar(figure), _verdict(section, figure))
    return table


def _extremes(figure: Figure) -> tuple[float | None, float | None]:
    return (min(figure.samples), max(figure.samples)) if len(figure.samples) > 1 else (None, None)


def _shown(figure: Figure, value: float | None) -> str:
    if value is None:
        return ""
    if figure.unit == "steps/s":
        return f"{value / 1e6:.3g} M/s"
    return f"{value:.3g} {figure.unit}".rstrip()


def _bar(figure: Figure) -> str:
    limits = (("≥", figure.at_least), ("≤", figure.at_most))
    return ", ".join(f"{sign} {_shown(figure, limit)}" for sign, limit in limits if limit is not None)


def _verdict(section: Section, figure: Figure) -> str:
    from rich.markup import escape  # texts such as [campaign] are no markup

    met = section.met(figure) if figure.has_bar else None
    words = {True: "[green]reached[/]", False: "[yellow]not reached here[/]", None: ""}[met]
    if met and not figure.clears:
        words = "by the alternative"
    remarks = figure.reason or "", f"({figure.note})" if figure.note else ""
    return " ".join(text for text in (words, *map(escape, remarks)) if text)
