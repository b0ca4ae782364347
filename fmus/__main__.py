"""``python -m bayesftc.fmus build [NAME ...] [--out DIR] [--here]`` and ``python -m bayesftc.fmus list``.

Shipped FMUs are built for all platforms with ``ziglang`` (``pip install 'bayesftc[export]'``): the same bytes on every machine.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from bayesftc.fmus._catalogue import check_name, names
from bayesftc.fmus._platforms import PLATFORMS
from bayesftc.fmus.build import FMI_VERSIONS, build_fmu
from bayesftc.fmus.plants import PLANTS


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments without the program's name; those of the process by default.

    Returns
    -------
    int
        Exit status: 0, or 1 after an error message.
    """
    parser = argparse.ArgumentParser(prog="python -m bayesftc.fmus", description="The plants that are shipped as FMUs.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list the plants")
    build = commands.add_parser("build", help="build FMUs for FMI 2.0 and FMI 3.0")
    build.add_argument("names", nargs="*", metavar="NAME", help="plants to build; all by default")
    build.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).resolve().parent,
        metavar="DIR",
        help="folder to write to; by default the package's folder, which replaces the shipped FMUs",
    )
    build.add_argument(
        "--here", action="store_true", help="build only for this machine, with its compiler, to try a new plant"
    )
    options = parser.parse_args(arguments)
    if options.command == "list":
        sys.stdout.write("".join(f"{name}\n" for name in names()))
        return 0
    try:
        for name in options.names:
            check_name(name)
        platforms = None if options.here else PLATFORMS
        for plant in PLANTS:
            if not options.names or plant.name in options.names:
                for fmi in FMI_VERSIONS:
                    sys.stdout.write(f"{build_fmu(plant, options.out, fmi=fmi, platforms=platforms)}\n")
    except (ValueError, RuntimeError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
