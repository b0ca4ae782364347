"""``bayesftc`` and ``python -m bayesftc``: the command line."""

import sys

from bayesftc._interrupt import EXIT_CODE, SENTENCE, Interrupted, heard


def main() -> None:
    """Run the command line and end the process with its exit code."""
    try:
        with heard():
            from bayesftc.cli import app

            app(prog_name="bayesftc")
    except (Interrupted, KeyboardInterrupt):
        print(SENTENCE, file=sys.stderr)  # noqa: T201
        sys.exit(EXIT_CODE)


if __name__ == "__main__":
    main()
