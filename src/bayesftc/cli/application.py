"""The commands of ``bayesftc``; each loads what it needs when it is called, so that ``--help`` is instant."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bayesftc.cli.guard import guarded

app = typer.Typer(
    name="bayesftc",
    help="Fault-tolerant control by Bayesian inference: run closed loops with faulty sensors, look into FMUs.",
    epilog="Try: bayesftc run cruise_control",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Timing(StrEnum):
    """When the outputs of an FMU hold."""

    plant = "plant"
    sampled = "sampled"


class Form(StrEnum):
    """What is exported."""

    fmu = "fmu"
    c = "c"


class Engine(StrEnum):
    """What a run is computed with."""

    auto = "auto"
    compiled = "compiled"
    interpreted = "interpreted"


class Executor(StrEnum):
    """What makes the runs of a campaign."""

    threads = "threads"
    processes = "processes"
    dask = "dask"


EXPERIMENTS = """Run the paper's experiments, with our numbers beside its own, and ours beyond it.

\b
arm            A robot arm with a frozen encoder (the paper's table 1).
tracking       A car whose speed sensor fails: tracking errors (table 2).
detection      Sensors that fail at random: which residual tells (table 3).
bound          Beyond the paper: how good could a detector be at best?
models         Beyond the paper: learners where the model is wrong.
beliefs        Beyond the paper: fault modes whose settings are wrong.
probabilities  Beyond the paper: are fault probabilities true?
family         Beyond the paper: every learner in faults that none expects.
"""
"""Help of ``bayesftc reproduce``; lines after a backspace are not joined."""

Json = Annotated[bool, typer.Option("--json", help="Print plain JSON instead of tables.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def _version(wanted: bool) -> None:
    if wanted:
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


@app.command()
def run(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file (TOML), or the name of a shipped one: cruise_control.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write result.npz, figure.png and figures.json there.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all noise, instead of the scenario's.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds, instead of the scenario's.")] = None,
    engine: Annotated[Engine | None, typer.Option(help="Engine, instead of the scenario's.")] = None,
    pace: Annotated[
        float | None,
        typer.Option(metavar="FACTOR", help="Simulated seconds for each second of the clock; 1 for real time."),
    ] = None,
    check_kalman: Annotated[
        bool, typer.Option("--check-kalman", help="Compare the belief with filterpy's Kalman filter.")
    ] = False,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Run a scenario and print the figures of the run."""
    with guarded(debug):
        from bayesftc.cli.run import run_scenario

        options = {"seed": seed, "duration": duration, "engine": engine.value if engine else None, "pace": pace}
        run_scenario(scenario, out, options, check_kalman=check_kalman, json=json, quiet=quiet)


@app.command()
def inspect(
    fmu: Annotated[str, typer.Argument(help="An FMU or SSP file, or the name of a shipped FMU, as CruiseControl.")],
    validate: Annotated[bool, typer.Option(help="Whether its description must keep the rules of FMI.")] = True,
    everything: Annotated[bool, typer.Option("--all", help="Show local variables as well.")] = False,
    json: Json = False,
    debug: Debug = False,
) -> None:
    """Show what an FMU says of itself (variables, units, kinds, platforms, capabilities), and what works with it."""
    with guarded(debug):
        from bayesftc.cli.inspection.inspect import inspect_fmu

        inspect_fmu(fmu, validate=validate, json=json, everything=everything)


@app.command()
def export(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")],
    block: Annotated[
        list[str],
        typer.Option(
            "--block", "-b", help="A block of its loop, as controller; several become one.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="The FMU; of C the folder. By default named after the block."),
    ] = None,
    form: Annotated[Form, typer.Option("--format", help="An FMU, or C without FMI for firmware.")] = Form.fmu,
    fmi: Annotated[
        str | None, typer.Option(help="Version of FMI: 2.0 (the default) or 3.0.", show_default=False)
    ] = None,
    platform: Annotated[
        list[str] | None,
        typer.Option(help="With a binary for this one, as windows-x86_64; several, or all. By default this machine's."),
    ] = None,
    timing: Annotated[
        Timing | None, typer.Option(help="When the outputs hold; by default what fits the block.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Write blocks of a scenario as an FMU that needs no Python, or as C."""
    with guarded(debug):
        from bayesftc.cli.export import export_scenario

        when = timing.value if timing else None
        export_scenario(
            scenario, block, out, form=form.value, fmi=fmi, platforms=platform or (), timing=when, quiet=quiet
        )


@app.command()
def verify(
    fmu: Annotated[Path, typer.Argument(help="An FMU, of bayesftc export or of any tool with the same names.")],
    against: Annotated[
        str, typer.Option(metavar="SCENARIO", help="The scenario whose blocks it is to do the work of.")
    ],
    block: Annotated[
        list[str] | None,
        typer.Option(
            "--block", "-b", help="The block that it stands for; by default the one that it was exported from."
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds, instead of the scenario's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all noise, instead of the scenario's.")] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            help="Largest difference, by the largest value of a signal. 0: the same numbers; 1e-9 is usual where exp, log or "
            "sin come from another C library."
        ),
    ] = 0.0,
    timing: Annotated[Timing | None, typer.Option(help="When its outputs hold; by default what it says.")] = None,
    isolate: Annotated[bool, typer.Option("--isolate", help="Run the FMU in a process of its own.")] = False,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Run an FMU beside the blocks that it was exported from, with noise and faults, and print the differences."""
    with guarded(debug):
        from bayesftc.cli.verify import verify_scenario

        verify_scenario(
            fmu,
            against,
            block or (),
            duration=duration,
            seed=seed,
            tolerance=tolerance,
            timing=timing.value if timing else None,
            isolate=isolate,
            json=json,
            quiet=quiet,
        )


@app.command()
def example(
    name: Annotated[str | None, typer.Argument(help="A shipped scenario; without a name they are listed.")] = None,
    debug: Debug = False,
) -> None:
    """Print a shipped scenario, to be changed: bayesftc example cruise_control > car.toml."""
    with guarded(debug):
        from bayesftc.cli.example import print_example

        print_example(name)


@app.command()
def calibrate(
    scenario: Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")],
    time_to_fault: Annotated[float, typer.Option(help="Mean time to a fault in seconds.")] = 2.8,
    time_to_recovery: Annotated[float, typer.Option(help="Mean time to recovery in seconds.")] = 0.4,
    injection: Annotated[float | None, typer.Option(help="Offset of an injection; by default 3 sensor sd.")] = None,
    drift: Annotated[float | None, typer.Option(help="Drift per second; by default 5 sensor sd.")] = None,
    steps: Annotated[int, typer.Option(help="Length of the simulated run.")] = 80_000,
    seed: Annotated[int, typer.Option(help="Seed of its noise and faults.")] = 0,
    json: Json = False,
    debug: Debug = False,
) -> None:
    """Fit the map from beta to a fault probability on simulated faults, and print it for the scenario file."""
    with guarded(debug):
        from bayesftc.cli.calibrate import calibrate_scenario
        from bayesftc.controllers import Hazards

        sizes = {"injection": injection, "drift": drift}
        magnitudes = {name: size for name, size in sizes.items() if size is not None}
        calibrate_scenario(
            scenario, Hazards(time_to_fault, time_to_recovery), magnitudes, steps=steps, seed=seed, json=json
        )


@app.command()
def monitor(
    recording: Annotated[list[Path], typer.Argument(help="CSV files with recorded samples, or a folder of them.")],
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="TOML",
            help="Which column is what, and what is known of the sensors; with --fit it is written, by default model.toml.",
        ),
    ] = None,
    fit: Annotated[
        bool,
        typer.Option(
            "--fit", help="Find the model in the recording first, of which all columns are sensors of one quantity."
        ),
    ] = False,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="Fit from this time on.")] = None,
    stop: Annotated[float | None, typer.Option("--to", metavar="S", help="Fit up to this time.")] = None,
    sensors: Annotated[
        list[str] | None, typer.Option("--sensor", help="Fit this column only; give it again for each further one.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write probabilities.csv, faults.json and figure.png there."),
    ] = None,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Look for faults in recorded samples of redundant sensors: which sensor, what kind, since when, how large."""
    if model is None and not fit:
        raise typer.BadParameter("name the model file by --model, or take --fit to find the model in the recording.")
    if not fit and (sensors or start is not None or stop is not None):
        raise typer.BadParameter("--from, --to and --sensor say what to fit: they need --fit.")
    with guarded(debug):
        from bayesftc.cli.monitor import monitor_files

        told = (start, stop, tuple(sensors or ())) if fit else None
        monitor_files(recording, model, out, told, json=json, quiet=quiet)


@app.command(help=EXPERIMENTS)
def reproduce(
    experiment: Annotated[str, typer.Argument(help="One of those above, or all.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write a JSON file and figures for each experiment there."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all noise and faults.")] = 0,
    jobs: Annotated[int | None, typer.Option(help="Number of threads; by default one for each core.")] = None,
    runs: Annotated[int | None, typer.Option(help="Runs of each case, fewer than by default for a quick look.")] = None,
    cases: Annotated[
        list[str] | None, typer.Option("--case", metavar="PATTERN", help="Of family: a case, as 'freeze*'; repeatable.")
    ] = None,
    learners: Annotated[
        list[str] | None,
        typer.Option("--learner", metavar="PATTERN", help="Of family: a learner, as '*Precision'; repeatable."),
    ] = None,
    unseen: Annotated[
        int | None,
        typer.Option(metavar="N", help="Of family: N cases that are drawn at random, on which nothing was tuned."),
    ] = None,
    paper_only: Annotated[
        bool,
        typer.Option(
            "--paper-only",
            help="Leave out what is not in the paper: further techniques, other faults; of all also bound and what follows it.",
        ),
    ] = False,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Run experiments; the help is `EXPERIMENTS`."""
    with guarded(debug):
        from bayesftc.cli.reproduce import reproduce_experiments

        options = {"seed": seed, "jobs": jobs, "runs": runs, "beyond": not paper_only}
        filters = {"cases": cases, "learners": learners, "unseen": unseen}
        reproduce_experiments(experiment, out, options, filters, json=json, quiet=quiet)


@app.command()
def campaign(
    file: Annotated[Path, typer.Argument(help="A campaign file (TOML): a scenario, what is varied, how many runs.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="STORE",
            help="Folder of the results; by default named after the file. What it has stays.",
        ),
    ] = None,
    executor: Annotated[
        Executor | None, typer.Option(help="What makes the runs; by default threads where they use all cores.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Number of workers; by default one for each core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, as tcp://10.0.0.1:8786.")
    ] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Make runs that have failed again.")] = False,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Run a campaign: a scenario at many settings with many seeds. One that was stopped goes on."""
    with guarded(debug):
        from bayesftc.cli.campaign import run_campaign

        run_campaign(
            file,
            out,
            executor=executor.value if executor else None,
            jobs=jobs,
            scheduler=scheduler,
            retry_failed=retry_failed,
            json=json,
            quiet=quiet,
        )


@app.command()
def report(
    store: Annotated[Path, typer.Argument(help="The folder of a campaign's results.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="The page; by default report.html in the folder.")
    ] = None,
    metric: Annotated[str | None, typer.Option(help="The metric that counts; by default the first.")] = None,
    compare: Annotated[
        str | None,
        typer.Option(metavar="FACTOR", help="The factor whose levels are compared, as controller.precision."),
    ] = None,
    title: Annotated[str | None, typer.Option(help="The question; by default the folder's name.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Write a campaign's report: one page with its tables and figures, for any browser and for print."""
    with guarded(debug):
        from bayesftc.cli.report import write_report

        write_report(store, out, metric=metric, compare=compare, title=title, quiet=quiet)


@app.command()
def replay(
    store: Annotated[Path, typer.Argument(help="The folder of a campaign's results.")],
    run: Annotated[int, typer.Argument(help="Number of the run, as the table has it.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write result.npz, figure.png and figures.json there.")
    ] = None,
    json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")] = False,
    debug: Debug = False,
) -> None:
    """Make one run of a campaign again, with everything recorded. It unpickles: only for stores that you trust."""
    with guarded(debug):
        from bayesftc.cli.replay import replay_run

        replay_run(store, run, out, json=json, quiet=quiet)


@app.command()
def bench(
    section: Annotated[
        list[str] | None, typer.Argument(help="What to measure, as campaign or export; by default everything.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short repetitions: shows that all works, not how fast.")
    ] = False,
    json: Json = False,
    debug: Debug = False,
) -> None:
    """Measure speed, start-up, memory and compilation on this machine."""
    with guarded(debug):
        from bayesftc import bench as benchmarks

        benchmarks.main(json=json, quick=quick, sections=section or benchmarks.SECTIONS)
