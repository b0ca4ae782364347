"""What the example's commands share: arguments that are checked, and errors that end in a sentence."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bayesftc.cosim.errors import BayesFTCError


def at_least(least: int) -> Callable[[str], int]:
    """Return what makes an argument a whole number that is not less."""

    def number(text: str) -> int:
        if not text.lstrip("+-").isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} must be a whole number of at least {least}")
        return int(text)

    return number


@contextmanager
def sentences(parser: argparse.ArgumentParser) -> Iterator[None]:
    """End the program with a sentence and its exit code where something is wrong with files or settings."""
    try:
        yield
    except BayesFTCError as error:
        parser.exit(error.exit_code, f"Error: {error}\n")
    except OSError as error:
        parser.exit(12, f"Error: {error.filename} cannot be written ({error.strerror}); choose another place.\n")
