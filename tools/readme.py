"""The commands and snippets of the README, as a list: tests and ``.ci/run`` take them from here.

``python tools/readme.py run`` prints the command below the marker ``<!-- run command -->``. ``python tools/readme.py walk
FOLDER`` does in FOLDER what a newcomer does: it makes an environment with the first command, and runs all the rest there,
in order.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
TESTS = "test"
"""The marker of the command that runs the tests, of which a walk is one."""


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the word of the marker above it (``<!-- run command -->``), if it has one."""

    language: str
    text: str
    marker: str = ""


def blocks(page: Path = README) -> list[Block]:
    """Return a page's blocks of code, in order."""
    found = re.findall(
        r"^(?:<!-- (\w+) command -->\n)?```(\w+)\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M
    )
    return [Block(language, text, marker) for marker, language, text in found]


def command(marker: str) -> str:
    """Return the one command below a marker."""
    (block,) = (block for block in blocks() if block.marker == marker)
    (line,) = block.text.splitlines()
    return line


def python(page: Path = README) -> str:
    """Return the Python of a page as one program: later snippets may use names of earlier ones."""
    return "\n".join(block.text for block in blocks(page) if block.language == "python")


def walk(folder: Path) -> None:
    """Run every command and snippet in an environment that the first command makes; stop at the first that fails.

    The first command runs in a clone, which is then removed, and everything after it in an empty folder. A snippet is run
    with the earlier ones before it.
    """
    clone, empty, environment = folder / "clone", folder / "empty", folder / "environment"
    empty.mkdir(parents=True)
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    venv.create(environment, with_pip=True)
    scripts = environment / ("Scripts" if os.name == "nt" else "bin")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    variables |= {
        "PATH": f"{scripts}{os.pathsep}{variables['PATH']}",
        "MPLBACKEND": "agg",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
    variables |= {"BAYESFTC_CACHE": str(folder / "cache")}  # nothing compiled before may hide a missing step
    program = ""
    for block in blocks():
        if block.marker == TESTS or block.language not in {"sh", "python"}:
            continue
        program += block.text if block.language == "python" else ""
        shell = block.language == "sh"
        run = ["bash", "-euxc", block.text] if shell else [str(scripts / "python"), "-c", program]
        print(f"```{block.language}\n{block.text}```", flush=True)
        subprocess.run(run, cwd=clone if block.marker else empty, env=variables, check=True)
        if block.marker:
            shutil.rmtree(clone)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="The commands and snippets of the README.")
    parser.add_argument("what", help="a marker, whose command is printed, or: walk")
    parser.add_argument("folder", nargs="?", type=Path, help="where to walk; it must not exist yet")
    options = parser.parse_args()
    if options.what == "walk":
        walk(options.folder.absolute())
    else:
        sys.stdout.write(command(options.what) + "\n")


if __name__ == "__main__":
    main()
