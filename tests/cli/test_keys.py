"""``bayesftc keys`` prints the keys of every section and kind, and the site shows the same."""

import re
from pathlib import Path

import pytest

from bayesftc.cli.commands.loops.keys import FILES, classes
from bayesftc.scenario._keys import described, keys_of, thing

PAGES = Path(__file__).resolve().parents[2] / "docs" / "reference"
DIRECTIVE = re.compile(r"^```\{(?:keys|kinds)\} (\S+)\n(?::without: ([^\n]*)\n)?```", re.MULTILINE)


@pytest.mark.parametrize("file", FILES)
def test_the_site_has_the_same_sections(file):
    page = (PAGES / f"{file}-keys.md").read_text(encoding="utf-8")
    on_page = [(path, without) for path, without in DIRECTIVE.findall(page)]
    of_command = [(part.path, part.without) for parts in FILES[file].values() for part in parts]
    assert sorted(on_page) == sorted(of_command)


@pytest.mark.parametrize("file", FILES)
def test_every_key_has_a_meaning(file):
    for parts in FILES[file].values():
        for part in parts:
            for kind, cls in classes(part):
                assert [key.name for key in keys_of(cls, part.without) if not key.meaning] == [], kind or part.path


def test_a_kind_is_printed_with_units_defaults_and_meanings(bayesftc_):
    shown = " ".join(bayesftc_("keys", "scenario", "Drift").stdout.split())
    assert 'kind = "Drift": ' in shown
    assert "slope a number (unit of the required Growth of the" in shown
    keys = {key.name: key for key in keys_of(thing("bayesftc.cosim.Drift"))}
    assert keys["slope"][1:3] == ("a number (unit of the signal/s)", "required")
    assert keys["duration"][1:3] == ("a number (s)", "inf")


def test_sections_files_and_mistakes(bayesftc_):
    listed = bayesftc_("keys").stdout
    assert "bayesftc keys scenario faults         [[faults]], [[input_faults.NAME]]" in listed
    for section in ("faults", "input_faults"):
        assert "Freeze" in bayesftc_("keys", "scenario", section).stdout
    for section in ("known", "known.plant", "plant"):
        assert "[plant], [known.plant]" in bayesftc_("keys", "scenario", section).stdout
    assert bayesftc_("keys", "scenario", "plant.known").exit_code == 3
    assert "[[samples]]" in bayesftc_("keys", "campaign").stdout
    wrong = bayesftc_("keys", "scenario", "fautls")
    assert wrong.exit_code == 3
    assert "did you mean 'faults'?" in wrong.stderr
    assert "'scenario'" in bayesftc_("keys", "szenario").stderr


def test_a_reference_to_another_docstring_is_followed():
    assert described(thing("bayesftc.controllers.design"))["u_min"].startswith("Limits of the controls")
    assert described(thing("bayesftc.cosim.Freeze"))["stop"].startswith("Seconds: the fault can be present")


def test_a_class_that_is_no_kind_has_its_keys_by_name(bayesftc_):
    shown = bayesftc_("keys", "scenario", "Port").stdout
    assert "name" in shown
    assert "unit" in shown
    assert "feedthrough" not in shown
    assert "arrays" in bayesftc_("keys", "scenario", "FMU").stdout
