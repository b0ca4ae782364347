"""The commands of ``bayesftc``. Each has a module, which is loaded only when it is called, so that ``--help`` is instant.

To add a command, write a function and a module of its name, with options like those of the others, and add it to `COMMANDS`
with its help, and to the table of ``docs/reference/command-line.md``.
Every command also gets ``--debug``, and ends as `guard` describes.
"""

from __future__ import annotations

import logging
from functools import wraps
from importlib import import_module
from inspect import Parameter, signature
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from bayesftc.cli.guard import guarded
from bayesftc.cli.options import Debug

PANELS = {
    "loops": "Closed loops",
    "recordings": "Recorded samples",
    "fmus": "FMUs",
    "campaigns": "Campaigns",
    "studies": "The paper, and speed",
}
"""The folder of each panel of the help, and its heading."""

COMMANDS = {
    "run": ("loops", "Run a scenario and print the figures of the run."),
    "serve": (
        "loops",
        "Run a scenario now, with a page to watch it, to inject faults into sensors and actuators, and to go back in time.",
    ),
    "live": (
        "loops",
        "Run a scenario's controller against a real plant: samples and controls by MQTT, OPC UA, UDP, serial lines or files.",
    ),
    "example": (
        "loops",
        "Print a shipped file (scenario, campaign, monitor) to start from: bayesftc example cruise_control > car.toml.",
    ),
    "keys": ("loops", "Print the keys of scenario, campaign and monitor files: bayesftc keys scenario faults."),
    "calibrate": (
        "loops",
        "Measure the accuracy of the fault probability on simulated faults. The default learner gives a probability itself, and "
        "nothing is fitted. For a learner that gives only beta, fit the map from beta to a probability.",
    ),
    "monitor": (
        "recordings",
        "Find faults in recorded samples of redundant sensors: which sensor, what kind, since when, how large.",
    ),
    "fit": (
        "recordings",
        "Fit parameters of an FMU to a recording with gaps and faults: values, standard errors, what it cannot determine.",
    ),
    "inspect": (
        "fmus",
        "Show an FMU's description (variables, units, kinds, platforms, capabilities), and what works with it.",
    ),
    "export": ("fmus", "Write blocks of a scenario as an FMU that needs no Python, or as C."),
    "verify": (
        "fmus",
        "Run an FMU beside the blocks that it was exported from, with noise and faults, and print the differences.",
    ),
    "campaign": (
        "campaigns",
        "Run a campaign: a scenario at many settings with many seeds. A stopped campaign continues.",
    ),
    "report": (
        "campaigns",
        "Write a campaign's report: one page with its tables and figures, for any browser and for print.",
    ),
    "replay": (
        "campaigns",
        "Repeat one run of a campaign, with everything recorded. It loads pickles: use it only for stores that you trust.",
    ),
    "reproduce": (
        "studies",
        """Run the paper's experiments and print our numbers beside the paper's. Further experiments go beyond the paper.

\b
arm            A robot arm with a frozen encoder (the paper's table 1).
tracking       A car whose speed sensor fails: tracking errors (table 2).
detection      Sensors that fail at random: which residual detects it (table 3).
bound          Beyond the paper: how good can a detector be at best?
models         Beyond the paper: learners with a wrong model.
beliefs        Beyond the paper: fault modes with wrong settings.
probabilities  Beyond the paper: are fault probabilities correct?
family         Beyond the paper: every learner with faults that none models.
""",
    ),
    "bench": ("studies", "Measure speed, start-up, memory and compilation on this machine."),
}
"""The folder and the help text of each command, in the order of the help. Lines after a backspace are not joined."""


class WithoutTypesOfFlags:
    """Show flags without a type: newer versions of typer write ``--quiet <bool>``, as if it had a value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, with that of ``--help``."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for each in parameters:
            if getattr(each, "is_flag", False):
                each.display_type_rich = lambda ctx: None
        return parameters


class Command(WithoutTypesOfFlags, TyperCommand):
    """A command."""


def load(name: str) -> Any:
    """Return a command: the function of its name, with ``--debug`` added."""
    folder, text = COMMANDS[name]
    function = getattr(import_module(f"bayesftc.cli.commands.{folder}.{name}"), name)
    shown = signature(function, eval_str=True)
    debug = Parameter("debug", Parameter.KEYWORD_ONLY, default=False, annotation=Debug)

    @wraps(function)
    def run(*, debug: bool, **options: Any) -> None:
        logger = logging.getLogger("bayesftc")
        level = logger.level
        if options.get("quiet"):
            logger.setLevel(logging.WARNING)
        try:
            with guarded(debug):
                function(**options)
        finally:
            logger.setLevel(level)

    run.__signature__ = shown.replace(parameters=[*shown.parameters.values(), debug])  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in (*shown.parameters.values(), debug)}
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command(name, cls=Command, help=text)(run)
    return typer.main.get_command(single)


class Commands(WithoutTypesOfFlags, TyperGroup):
    """The commands. Only the command that is called is loaded."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command and its arguments."""
        name, _, rest = super().resolve_command(ctx, args)
        return name, load(str(name)), rest


app = typer.Typer(
    cls=Commands,
    name="bayesftc",
    help="Fault-tolerant control by Bayesian inference: run closed loops with faulty sensors, and inspect FMUs.",
    epilog="Try: bayesftc run cruise_control",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command, (panel, text) in COMMANDS.items():
    app.command(command, help=text, rich_help_panel=PANELS[panel])(lambda: None)


def _version(requested: bool) -> None:
    if requested:
        from bayesftc import __version__

        typer.echo(f"bayesftc {__version__}")
        raise typer.Exit


@app.callback()
def _bayesftc(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass
