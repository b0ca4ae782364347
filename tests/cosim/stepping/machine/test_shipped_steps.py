"""Long step functions of shipped scenarios, which stand in the package in LLVM's text format."""

import platform
import runpy
from pathlib import Path

import numpy as np
import pytest

from bayesftc.cosim.stepping.machine import shipped, steps
from bayesftc.cosim.stepping.machine.code import load
from bayesftc.cosim.types import ENTRY

TOOL = runpy.run_path(str(Path(__file__).parents[4] / "tools" / "engine_text.py"))

RUN = """
import hashlib, json
from bayesftc.cosim.stepping.machine import steps
from bayesftc.scenario import load_scenario
usual = steps.shipped_step
steps.shipped_step = lambda *given: SHIPPED and usual(*given)
ready, made = [], steps.ready_code
steps.ready_code = lambda text: ready.append(len(text)) or made(text)
result = load_scenario("cruise_control").loop().simulate(20.0, seed=3)
print(json.dumps([len(ready), hashlib.sha256(result.table.tobytes()).hexdigest()]))
"""

pytestmark = pytest.mark.skipif(platform.machine() not in shipped.MACHINES, reason="the text is for 64-bit x86")


@pytest.mark.slow
def test_a_shipped_step_has_the_bits_of_plain_python(python, tmp_path):
    run = RUN.replace("SHIPPED", "True").replace("20.0, seed=3", "0.4, seed=3, engine=ENGINE")
    used, bits = python(run.replace("ENGINE", "'compiled'"), cache=tmp_path)
    assert used == 1
    assert python(run.replace("ENGINE", "'interpreted'")) == [0, bits]


@pytest.fixture(scope="module")
def bits(python, tmp_path_factory):
    """The bits of a run with the shipped step."""
    used, found = python(RUN.replace("SHIPPED", "True"), cache=tmp_path_factory.mktemp("shipped"))
    assert used == 1
    return found


@pytest.mark.slow
def test_a_shipped_step_has_the_bits_of_a_compiled_one(python, tmp_path, bits):
    assert python(RUN.replace("SHIPPED", "None"), cache=tmp_path) == [0, bits]


@pytest.mark.slow
def test_instead_of_text_that_llvm_does_not_know_it_is_compiled(python, tmp_path, bits):
    """As with an LLVM that is older than that of the text."""
    strange = RUN.replace("SHIPPED", "'define strange' if given[0].__name__ == 'bayesian_controller' else None")
    assert python(strange.replace(" and usual(*given)", ""), cache=tmp_path) == [1, bits]


@pytest.mark.parametrize(
    "scenario",
    [pytest.param(name, marks=[pytest.mark.slow] * (name != "cruise_control")) for name in TOOL["SCENARIOS"]],
)
def test_the_shipped_steps_are_those_of_the_present_sources(scenario):
    """A run of the tool is due otherwise: python tools/engine_text.py."""
    assert any(shipped.shipped_step(*each, "step") for each in TOOL["kernels"](scenario)), "python tools/engine_text.py"


def test_they_are_not_used_after_an_edit_of_their_sources(monkeypatch):
    monkeypatch.setattr(shipped, "digest_of", lambda files: "of edited sources")
    assert not any(shipped.shipped_step(*each, "step") for each in TOOL["kernels"]("cruise_control"))


def gain(u, y):
    y[0] = 2.0 * u[0]


def test_text_that_llvm_does_not_know_is_made_anew(monkeypatch):
    """As with an LLVM that is older than that of the text."""
    monkeypatch.setattr(steps, "shipped_step", lambda *given: "define strange")
    sections = {"u": ("inputs", 0, (1,)), "y": ("outputs", 0, (1,))}
    name = steps.name_of(gain, sections)
    made = load(steps._compiled(gain, sections, name), name)
    u, y = np.array([3.0]), np.zeros(1)
    assert ENTRY(made)(0, 0, u.ctypes.data, y.ctypes.data, 0.0, 0) == 0
    assert y[0] == 6.0


def test_another_function_is_not_among_them():
    sections = {"u": ("inputs", 0, (1,)), "y": ("outputs", 0, (1,))}
    assert shipped.shipped_step(gain, sections, "step") is None
