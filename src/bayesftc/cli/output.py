"""The output of the commands: tables on the terminal, and files that get their names only when they are complete."""

from __future__ import annotations

import io
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cli.guard import print_nothing_more
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.errors import ResultFileError
from bayesftc.cosim.judging.metrics import without_nan
from bayesftc.cosim.run.summary import DASH as DASH, tables_of

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from bayesftc.cosim.judging.signals import LoopSignals
    from bayesftc.cosim.run.result import Result

RESULT, FIGURE, NUMBERS = "result.npz", "figure.png", "figures.json"
DOTS_PER_INCH = 150
GUTTER = 3
"""Characters between two columns of a table."""
PERIOD = 10.0
"""Seconds between two progress lines, which replace the bar where there is no terminal."""


def check_folder(folder: Path, names: Collection[str] = (RESULT, FIGURE, NUMBERS), *, silent: bool = False) -> None:
    """Check before a run that files (by default those of a run) can be written to a folder.

    Files that exist already are noted, unless `silent`; they will be replaced.
    The folder need not exist. The check creates nothing, so no empty folder stays behind if the run fails.

    Raises
    ------
    ResultFileError
        If the files cannot be written.
    """
    try:
        existing = next(p for p in (folder, *folder.absolute().parents) if os.path.lexists(p))
        if not existing.is_dir():
            raise ResultFileError(
                f"Nothing can be written into {folder}: {existing} is a file, not a folder. Choose another name."
            )
        with tempfile.TemporaryFile(dir=existing):
            pass
        folder.exists()  # raises an OSError if the name is not valid
        taken = [name for name in names if (folder / name).is_dir()]
    except OSError as error:
        raise _unwritable(folder, error) from None
    if taken:
        raise ResultFileError(f"{folder / taken[0]} cannot be written: it is a folder. Choose another name.")
    if not silent:
        note_replaced(folder / name for name in names)


def note_replaced(files: Iterable[Path]) -> None:
    """Note files that exist already."""
    there = [str(file) for file in files if file.exists()]
    if there:
        say_notes([f"{', '.join(there)} exist{'s' * (len(there) == 1)} already, and will be replaced."])


def write_files(folder: Path, result: Result, numbers: Mapping[str, Any], signals: LoopSignals) -> Exception | None:
    """Write ``result.npz``, ``figures.json`` and ``figure.png``, or, if one fails, none of them and no folder.

    A figure that cannot be drawn does not take the signals with it: the other files are written without it, and its error is
    returned, to be raised once the run is shown.

    Raises
    ------
    ResultFileError
        If one of them cannot be written.
    """
    from bayesftc.cosim.judging.figures.loop_figure import plot_run

    text = as_json(numbers) + "\n"
    title = ", ".join([Path(numbers["scenario"]).stem, f"seed {numbers['seed']}", *result.notes])
    picture, failed = io.BytesIO(), None
    try:
        with reported("Drawing the figure, for some seconds."):
            plot_run(signals, title).savefig(picture, dpi=DOTS_PER_INCH, format="png")
    except Exception as error:  # noqa: BLE001 - whatever it is, it must not take the run with it
        failed = error
        say_notes(
            [f"{FIGURE} could not be drawn ({type(error).__name__}: {error}); {RESULT} and {NUMBERS} are written."]
        )
    with staged(folder) as stage:
        result.save(stage / RESULT)
        (stage / NUMBERS).write_text(text, encoding="utf-8")
        if failed is None:
            (stage / FIGURE).write_bytes(picture.getbuffer())
    return failed


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Give an empty folder inside `folder`. At the end its files move into `folder`; after a failure nothing remains."""
    from bayesftc.cosim.base.temporary import BESIDE, temporary_folder

    made = [p for p in (folder, *folder.parents) if not p.exists()]
    stage: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with temporary_folder(BESIDE, folder) as stage:
            yield stage
            for file in sorted(stage.iterdir()):
                file.replace(folder / file.name)
    except BaseException as error:
        for path in made:
            with suppress(OSError):  # the folder was not made yet, or it contains other files by now
                path.rmdir()
        if isinstance(error, OSError):
            raise _unwritable(folder, error) from None
        if isinstance(error, ResultFileError) and stage is not None:
            raise ResultFileError(str(error).replace(str(stage), str(folder))) from None
        raise


def _unwritable(folder: Path, error: OSError) -> ResultFileError:
    return ResultFileError(
        f"Nothing can be written to the folder {folder} ({error.strerror or error}). Choose another folder."
    )


@contextmanager
def progress_bar(
    name: str, *columns: str, shown: bool, breath: float = 0.0, **fields: Any
) -> Iterator[Callable[..., None] | None]:
    """Show a progress bar on stderr and give the function that moves it, or None if no bar is shown.

    The function is called as ``move(done, of, **fields)``.

    Parameters
    ----------
    name : str
        Text before the bar, until a ``description`` is given.
    *columns : str
        Columns after the bar: ``count``, ``elapsed``, ``remaining``, or a text of rich.
    shown : bool
        Whether to show the bar.
    breath : float
        Least seconds between two moves.
    **fields
        Fields of the texts, with their first values.
    """
    if not shown:
        yield None
        return
    from rich import progress
    from rich.console import Console

    kinds: dict[str, type[progress.ProgressColumn]] = {
        "count": progress.MofNCompleteColumn,
        "elapsed": progress.TimeElapsedColumn,
        "remaining": progress.TimeRemainingColumn,
    }
    made = [kinds[column]() if column in kinds else progress.TextColumn(column) for column in columns]
    first = progress.TextColumn("{task.description}"), progress.BarColumn()
    with progress.Progress(*first, *made, console=Console(stderr=True), transient=True) as bar:
        task, last = bar.add_task(name, total=None, **fields), 0.0

        def move(done: int, of: int, **now: Any) -> None:
            nonlocal last
            if time.monotonic() - last > breath or done >= of:
                last = time.monotonic()
                bar.update(task, completed=done, total=of, **now)

        yield move


@contextmanager
def progress_lines(name: str, first: str = "", *, period: float = PERIOD) -> Iterator[Callable[..., None]]:
    """Print the progress on stderr every few seconds, and give the function that updates it.

    The function is called as ``move(done, of, **fields)``. The lines replace the bar where stderr is no terminal, as in the log
    of a cluster. A `first` line, if given, is printed at once.
    """
    if first:
        sys.stderr.write(f"{name}: {first}\n")
        sys.stderr.flush()
    state: dict[str, Any] = {}
    ended = threading.Event()
    begun = time.monotonic()

    def move(done: int, of: int, **now: Any) -> None:
        state.update(done=done, of=of, now=now)

    def print_lines() -> None:
        while not ended.wait(period):
            texts = [str(state["now"][key]) for key in sorted(state["now"]) if state["now"][key]] if state else []
            progress = ", ".join([f"{state['done']} of {state['of']}", *texts]) if state else "preparing"
            sys.stderr.write(f"{name}: {progress}, after {time.monotonic() - begun:.0f} s\n")
            sys.stderr.flush()

    thread = threading.Thread(target=print_lines, daemon=True)
    thread.start()
    try:
        yield move
    finally:
        ended.set()
        thread.join()


@contextmanager
def runs_progress(name: str, *, shown: bool) -> Iterator[Callable[[int, int, int], None]]:
    """Give a function of (done, of, failed) that shows the progress of many runs: a bar, or lines where there is no terminal.

    If it is not to be shown, the function does nothing. The runs then say nothing of their own, as without a function.
    """
    if not shown:
        yield lambda done, of, failed: None
        return
    as_bar = sys.stderr.isatty()
    with progress_bar(name, "count", "remaining", shown=True) if as_bar else progress_lines(name) as move:
        assert move is not None
        yield lambda done, of, failed: move(done, of)


def say_notes(notes: Iterable[str]) -> None:
    """Print notes on stderr: facts that are no errors, but may be mistakes."""
    import typer

    for note in notes:
        typer.echo(f"Note: {note}", err=True)


def as_json(numbers: Mapping[str, Any]) -> str:
    """Return the text of a JSON file. Numbers that are not finite become null: JSON has neither NaN nor infinity."""
    return json.dumps(without_nan(numbers), indent=2, allow_nan=False, ensure_ascii=False)


def print_report(numbers: Mapping[str, Any]) -> None:
    """Print the figures of a run as tables."""
    from rich.text import Text

    console = terminal()
    title = f"{numbers['scenario']}: {numbers['duration']:g} s, {numbers['steps']} steps, seed {numbers['seed']}"
    console.print(Text(title), soft_wrap=True)
    for figures in (figures for figures in tables_of(numbers) if not figures.empty):
        turned = figures.key not in ("errors", "findings")  # their columns are sensors, inputs or actuators
        _print_table(console, figures.heading, figures.columns, figures.texts(), figures.remark, turned=turned)
    if check := numbers.get("kalman"):
        kinds = {"relative": "difference", "absolute": "absolute"}
        values = {what: [check[f"{what}_{kind}"] for kind in kinds.values()] for what in ("mean", "covariance")}
        rows = ((what, *(DASH if v is None else f"{v:.2e}" for v in of)) for what, of in values.items())
        heading = f"Largest differences from filterpy's Kalman filter over {check['steps']} samples"
        _print_table(console, heading, tuple(kinds), rows, check["verdict"])
    if said := _of_model(numbers):
        console.print()
        console.print(Text("The model", style="bold"))
        console.print(Text(said))
    for note in numbers["notes"]:
        console.print()
        console.print(Text(note))


def _of_model(numbers: Mapping[str, Any]) -> str:
    """Return what a run shows of an error of the controller's model; nothing if it was not compared with the samples."""
    if numbers.get("model"):
        return str(numbers["model"]["sentence"])
    if not (count := numbers.get("model_without_error")):
        return ""
    which = f"{'first ' if count <= numbers['steps'] else ''}{count} samples"
    return f"The {which} have not enough evidence against the controller's model to name an error."


def say_written(folder: Path, undrawn: Exception | None = None) -> None:
    """Print the files of a run, whose figure may be `undrawn`."""
    _, say = sayer()
    say(f"\nWritten to {folder}: {', '.join([RESULT, *([] if undrawn else [FIGURE]), NUMBERS])}")


def _print_table(
    console: Console,
    heading: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    remark: str,
    *,
    turned: bool = False,
) -> None:
    from rich.text import Text

    console.print()
    console.print(Text(heading, style="bold"))
    for table in _fitting(console, columns, list(rows), turned):
        console.print(table)
    if remark:
        console.print(Text(remark))


def _fitting(console: Console, columns: Sequence[str], rows: Sequence[Sequence[str]], turned: bool) -> Iterator[Table]:
    """Give a table, in parts with some of its columns each if it does not fit the terminal without breaking a word.

    If `turned`, a table that does not fit gets a row for each of its columns first.
    """
    if turned and not _fits(console, _filled(columns, rows, whole=True)):
        columns, rows = [row[0] for row in rows], list(zip(columns, *(row[1:] for row in rows), strict=True))
    begin, whole = 0, turned
    while begin < len(columns):
        end = begin + 1
        made = _part(columns, rows, begin, end, whole)
        while end < len(columns) and _fits(console, more := _part(columns, rows, begin, end + 1, whole)):
            end, made = end + 1, more
        if made.__rich_measure__(console, console.options.update(max_width=10_000)).maximum > console.width:
            _narrow(console, made)
        yield made
        begin = end


def _part(columns: Sequence[str], rows: Sequence[Sequence[str]], begin: int, end: int, whole: bool) -> Table:
    """Return the table of the columns from `begin` to before `end`."""
    return _filled(columns[begin:end], [(row[0], *row[1 + begin : 1 + end]) for row in rows], whole=whole)


def _filled(columns: Sequence[str], rows: Sequence[Sequence[str]], *, whole: bool) -> Table:
    """Return a table whose columns are at least as wide as their longest word, and as their numbers."""
    table = empty_table(*columns)
    labels, *numbers = zip(*rows, strict=True) if rows else [(), *((),) * len(columns)]
    words = [word for label in labels for word in ([label] if whole else label.split())]
    texts = [words, *([*title.split(), *cells] for title, cells in zip(columns, numbers, strict=True))]
    for column, each in zip(table.columns, texts, strict=True):
        column.min_width = max(map(len, each), default=0)
    for row in rows:
        table.add_row(*row)
    return table


def _narrow(console: Console, table: Table) -> None:
    """Give each column its least width, and the labels the rest of the terminal."""
    for column in table.columns:
        column.width = column.min_width
    left = console.width - sum((column.min_width or 0) + GUTTER for column in table.columns)
    labels = max((len(str(label)) for label in table.columns[0].cells), default=0)
    table.columns[0].width = min(labels, (table.columns[0].min_width or 0) + max(left, 0))


def _fits(console: Console, table: Table) -> bool:
    """Return whether a table fits the terminal without breaking a word."""
    return sum((column.min_width or 0) + GUTTER for column in table.columns) <= console.width


def empty_table(*columns: str) -> Table:
    """Return a table in the common style: a first column for the row labels, then these columns."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for column in columns:
        table.add_column(Text(column), justify="right", overflow="fold")
    return table


def plain_table(*columns: str, right: Collection[str] = (), whole: Collection[str] = ()) -> Table:
    """Return a table in the common style with these columns: in `right` aligned to the right, in `whole` not broken."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        justify = "right" if column in right else "left"
        table.add_column(column, overflow="fold", justify=justify, no_wrap=column in whole)  # type: ignore[arg-type]
    return table


def terminal(width: int | None = None) -> Console:
    """Return the terminal, which prints names as they are: rich would take ``[degC]`` for a style, and ``:car:`` too."""
    from rich.console import Console

    class Terminal(Console):
        def on_broken_pipe(self) -> None:
            """Go on in silence: rich would exit, and no file be written, because `head` has read enough."""
            self.quiet = True
            print_nothing_more()

    return Terminal(highlight=False, markup=False, emoji=False, width=width)


def sayer() -> tuple[Console, Callable[..., None]]:
    """Return the terminal, and a function that prints a sentence there in a style of rich."""
    from rich.text import Text

    console = terminal()
    return console, lambda sentence, style="": console.print(Text(sentence, style=style), soft_wrap=True)
