"""The commands and snippets of the README, as a list for the tests and ``.ci/run``.

``python tools/readme.py run`` prints the command below the marker ``<!-- run command -->``. ``python tools/readme.py walk
FOLDER`` makes an environment in FOLDER with the first command and runs all others there in order, like a new user.
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
"""The marker of the command that runs the tests, which a walk leaves out, because it is one of them."""


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the word of the marker above it (``<!-- run command -->``), if any."""

    language: str
    text: str
    marker: str = ""


def blocks(page: Path = README) -> list[Block]:
    """Return a page's blocks of code, in order."""
    matches = re.findall(
        r"^(?:<!-- (\w+) command -->\n)?```(\w+)\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M
    )
    return [Block(language, text, marker) for marker, language, text in matches]


def command(marker: str) -> str:
    """Return the command below a marker."""
    (block,) = (block for block in blocks() if block.marker == marker)
    (line,) = block.text.splitlines()
    return line


def python(page: Path = README) -> str:
    """Return the Python code of a page as one program, because snippets use names of earlier ones."""
    return "\n".join(block.text for block in blocks(page) if block.language == "python")


def walk(folder: Path) -> None:
    """Run every command and snippet in an environment that the first command makes; stop at the first error.

    The first command runs in a clone, which is then deleted; all others run in an empty folder. A snippet runs after the earlier
    snippets.
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
    variables |= {"BAYESFTC_CACHE": str(folder / "cache")}  # code that was compiled before must not hide a missing step
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
    parser.add_argument("folder", nargs="?", type=Path, help="folder of the walk, which must not exist yet")
    options = parser.parse_args()
    if options.what == "walk":
        walk(options.folder.absolute())
    else:
        sys.stdout.write(command(options.what) + "\n")


if __name__ == "__main__":
    main()
