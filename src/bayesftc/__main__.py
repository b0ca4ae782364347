"""``bayesftc`` and ``python -m bayesftc``: the command line."""

import sys


def main() -> None:
    """Run the command line and end the process with its exit code."""
    try:
        from bayesftc.cli import app

        app(prog_name="bayesftc")
    except KeyboardInterrupt:  # while modules were loading; the commands catch their own
        print("Stopped by Ctrl-C.", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
