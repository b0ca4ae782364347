"""Common parts of the example's commands: checked arguments, and errors as sentences."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bayesftc.cosim.errors import BayesFTCError


def at_least(least: int) -> Callable[[str], int]:
    """Return a function that converts an argument to a whole number and checks its least value."""

    def number(text: str) -> int:
        if not text.lstrip("+-").isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} must be a whole number of at least {least}")
        return int(text)

    return number


@contextmanager
def sentences(parser: argparse.ArgumentParser) -> Iterator[None]:
    """End the program with a sentence and an exit code if there is an error in files or settings."""
    try:
        yield
    except BayesFTCError as error:
        parser.exit(error.exit_code, f"Error: {error}\n")
    except OSError as error:
        parser.exit(12, f"Error: {error.filename} cannot be written ({error.strerror}). Choose another place.\n")
