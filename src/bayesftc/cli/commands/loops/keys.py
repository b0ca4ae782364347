"""``bayesftc keys``: print the keys of scenario, campaign and monitor files."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from bayesftc.cli import completion
from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.scenario._keys import Part, keys_of, summary, thing

SECTIONS = "bayesftc.scenario._sections"

FILES: dict[str, dict[str, list[Part]]] = {
    "scenario": {
        "[simulation]": [Part(f"{SECTIONS}.Simulation")],
        "[plant], [known.plant]": [
            Part(f"{SECTIONS}.Wiring"),
            Part("bayesftc.scenario._fmu_files.Shipped", "An FMU"),
            Part("bayesftc.cosim.FMU", "An FMU", "path"),
            Part(
                "bayesftc.cosim.Port", "inputs, outputs of an FMU", "shape feedthrough default draw description units"
            ),
            Part("bayesftc.scenario._linear_plant.Matrices", "A linear system"),
            Part("bayesftc.cosim.StateSpace", "A linear system", "system feedthrough params method rtol atol"),
            Part("bayesftc.scenario._blocks.Ports", 'kind = "Subsystem", with blocks and connections'),
        ],
        "[sensors], [known.sensors]": [Part("bayesftc.cosim.Sensors", without="function")],
        "[reference], [noise.NAME]": [Part(f"{SECTIONS}.SOURCES")],
        "[[faults]], [[input_faults.NAME]]": [Part("bayesftc.cosim.FAULTS")],
        "[model]": [
            Part("bayesftc.controllers.LinearModel", without="names disturbances constant"),
            Part(f"{SECTIONS}.Extension"),
            Part("bayesftc.controllers.NonlinearModel.from_fmu", 'kind = "from_fmu"', "fmu measured actuated sensors"),
        ],
        "[controller]": [
            Part("bayesftc.controllers.design", 'kind = "design"', "plant measured actuated sensors"),
            Part("bayesftc.controllers.CONTROLLERS", without="model modalities"),
            Part("bayesftc.scenario._fmu_files.Shipped", "An exported controller; other keys as those of [plant]"),
        ],
        "precision = { kind = ... }": [
            Part("bayesftc.controllers.LEARNERS"),
            Part("bayesftc.controllers.FAULT_MODES", "modes of SwitchingPrecision"),
            Part("bayesftc.controllers.switching.actuator_modes.ACTUATOR_MODES", "actuator_modes"),
        ],
        "law = { kind = ... }": [Part("bayesftc.controllers.LAWS")],
        "[blocks.NAME]": [Part("bayesftc.cosim.BLOCKS")],
    },
    "campaign": {
        "above all sections": [Part("bayesftc.scenario.campaigns.Runs")],
        "[[samples]]": [Part("bayesftc.scenario.campaigns.SAMPLES")],
        "[[metrics]]": [Part("bayesftc.cosim.campaign.runs.metrics.METRICS")],
    },
    "monitor": {
        "above all sections": [Part("bayesftc.monitoring.model_file.Head")],
        "[model]": [Part("bayesftc.monitoring.PLANT_MODELS"), Part("bayesftc.monitoring.model_file.Start")],
        "[sensors.NAME]": [Part("bayesftc.monitoring.Sensor")],
        "[inputs.NAME]": [Part("bayesftc.monitoring.Input")],
        "[[errors]]": [Part("bayesftc.monitoring.SensorErrors")],
        "[alarm]": [Part("bayesftc.monitoring.alarms.Alarm")],
    },
}
"""The sections of each file, and what their keys are read from."""


def keys(
    file: Annotated[
        str | None,
        typer.Argument(
            help=f"{', '.join(FILES)}; without it all sections are listed.", autocompletion=completion.kinds_of_files
        ),
    ] = None,
    section: Annotated[
        str | None,
        typer.Argument(
            help="A section such as faults, or a kind such as Freeze; all if left out.",
            autocompletion=completion.sections,
        ),
    ] = None,
) -> None:
    """Print the keys of a file: values with their units, default, and meaning."""
    if file is None:
        for name, titles in FILES.items():
            for title in titles:
                typer.echo(f"{f'bayesftc keys {name} {section_words(title)[0]}':36}  {title}")
        return
    if file not in FILES:
        raise ScenarioError(f"There is no kind of file {file!r}; {did_you_mean(file, FILES)}")
    parts = [(f"{title}  {p.title}".rstrip(), p) for title, ps in FILES[file].items() for p in ps]
    tables = [(title, kind, cls, part.without) for title, part in parts for kind, cls in classes(part)]
    chosen = [
        t for t in tables if section is None or section in section_words(t[0]) or section in (t[1], t[2].__name__)
    ]
    if not chosen:
        names = {
            name for title, kind, cls, _ in tables for name in (*section_words(title)[:1], kind or cls.__name__) if name
        }
        raise ScenarioError(f"A {file} file has no section or kind {section!r}; {did_you_mean(section, names)}")

    from bayesftc.cli.output import plain_table, terminal

    console, before = terminal(), ""
    for title, kind, cls, without in chosen:
        if title != before:
            console.print(f"\n{title}", style="bold")
        before = title
        if kind:
            console.print(f'\nkind = "{kind}": {summary(cls).replace("`", "")}', soft_wrap=True)
        table = plain_table("key", "value", "default", "meaning")
        for name, *cells, meaning in keys_of(cls, without):
            table.add_row(name, *cells, _first_sentence(meaning))
        console.print(table if table.rows else "No further keys.")


def classes(part: Part) -> list[tuple[str, type]]:
    """Return the classes of a part, each with the name of its kind if there are several."""
    found = thing(part.path)
    return [(cls.__name__, cls) for cls in found] if isinstance(found, tuple | list) else [("", found)]


def section_words(title: str) -> list[str]:
    """Return the names by which a section is chosen: those of its title in lower case."""
    return [*re.findall(r"[a-z_]+", title), *re.findall(r"[a-z_]+\.[a-z_]+", title)]


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=\.)\s+(?=[A-Z`])", text)[0].replace("`", "")
