"""How a command ends after an error: one sentence on stderr and an exit code, no traceback.

Exit codes: 2 a wrong command line; 3 to 18 and 20 the kinds of `BayesFTCError` (attribute ``exit_code``); 19 an FMU that
differs from its blocks; 70 a bug of bayesftc; 71 not enough memory; 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from bayesftc._interrupt import EXIT_CODE, SENTENCE, Interrupted, asked

BUG, NO_MEMORY, INTERRUPTED, BROKEN_PIPE = 70, 71, EXIT_CODE, 141


@contextmanager
def guarded(debug: bool = False) -> Iterator[None]:
    """Turn an exception into a sentence (with `debug` also a traceback) and a `typer.Exit` with its exit code."""
    from bayesftc.cosim.errors import BayesFTCError

    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warnings_shown_once()  # type: ignore[assignment]
            try:
                yield
            except Exception:
                if asked():
                    raise Interrupted from None
                raise
    except BayesFTCError as error:
        if debug:
            traceback.print_exc()
        _say(f"Error: {error}")
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt as stop:  # inside another program; else `bayesftc._interrupt` makes it `Interrupted`
        _say(str(stop) or SENTENCE)
        raise typer.Exit(INTERRUPTED) from None
    except MemoryError:
        _say(
            "Error: there is not enough memory for this run. Record fewer signals or set a decimation, in [simulation]."
        )
        raise typer.Exit(NO_MEMORY) from None
    except BrokenPipeError:  # the reader of the output, such as `head`, has closed it
        print_nothing_more()
        raise typer.Exit(BROKEN_PIPE) from None
    except Exception as error:
        if isinstance(error, typer.Exit | typer.BadParameter):
            raise
        traceback.print_exc()
        _say("Error: this is a bug in bayesftc. Please report it, with the lines above and the command that you ran.")
        raise typer.Exit(BUG) from None


def print_nothing_more() -> None:
    """Discard what is still printed, because nobody reads it."""
    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), 1)


def _say(sentence: str) -> None:
    typer.echo(sentence, err=True)


def _warnings_shown_once() -> Callable[..., None]:
    """Return a function that prints each warning for users once: several loops of a command may have the same plant."""
    printed: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *_: object) -> None:
        text = f"Warning: {message}\n"
        if issubclass(category, UserWarning) and text not in printed:
            printed.add(text)
            sys.stderr.write(text)

    return show
