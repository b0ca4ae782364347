"""The README: every command and snippet works after its first command, in an environment that this command alone has made."""

import re
import shlex
from pathlib import Path

import pytest
import readme

from bayesftc.cli.application import COMMANDS, load

ROOT = Path(__file__).resolve().parents[1]
SHELL = [block for block in readme.blocks() if block.language == "sh"]


def calls(text):
    """Return the words of each call of ``bayesftc``, without comments and redirections."""
    for line in text.splitlines():
        for call in line.split("&&"):
            words = shlex.split(call.partition(" >")[0], comments=True)
            if words[:1] == ["bayesftc"]:
                yield words[1:]


def test_each_marker_stands_above_one_command():
    assert [block.marker for block in readme.blocks() if block.marker] == ["run", "test"]
    assert readme.command("run").startswith("python -m pip install . && bayesftc ")
    assert readme.command("test").endswith("python -m pytest -n auto")
    checks = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "tools/readme.py walk" in checks
    assert "tools/readme.py test" in checks


@pytest.mark.parametrize("words", [words for block in SHELL for words in calls(block.text)], ids=" ".join)
def test_every_command_line_has_a_known_command_and_known_options(words):
    assert words[0] in COMMANDS
    known = {option for parameter in load(words[0]).params for option in parameter.opts}
    assert {word for word in words if word.startswith("-")} <= known


def test_packages_that_the_first_command_does_not_install_are_named_beside_what_needs_them():
    """An extra, above the first command that needs it and in the same block."""
    needs = {"campaign": r"bayesftc (campaign|report|replay)\b", "export": r"bayesftc (export|verify)\b"}
    for extra, command in needs.items():
        for block in SHELL:
            if re.search(command, block.text):
                assert f'pip install "bayesftc[{extra}]"' in block.text.splitlines()[0]


def test_it_is_read_in_a_minute():
    assert len(readme.README.read_text(encoding="utf-8").splitlines()) <= 125


@pytest.mark.slow
def test_everything_works_after_the_first_command(tmp_path):
    """It needs an index of packages."""
    readme.walk(tmp_path / "newcomer")
    made = {path.name for path in (tmp_path / "newcomer" / "empty").iterdir()}
    assert {"servo.png", "results", "tracking", "report.html", "run17", "controller.fmu", "firmware"} <= made
