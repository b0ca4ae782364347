"""Results with another C library, which is loaded before the system's: the same bits."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import bayesftc
from bayesftc.fmus._compiler import compiler_command, why_no_compiler

ROOT = Path(__file__).resolve().parents[2]
EXACT = {
    "ceil", "comb", "copysign", "fabs", "floor", "frexp", "gcd", "inf", "isclose", "isfinite", "isinf", "isnan", "lcm", "ldexp",
    "nan", "nextafter", "pi", "prod", "sqrt", "tau", "ulp",
}  # fmt: skip
"""Names in Python's ``math`` whose values are exact, or rounded as IEEE 754 demands."""


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Return a function that runs Python with another C library, or with the system's, and returns what it prints."""
    if sys.platform != "linux" or why_no_compiler():
        pytest.skip("needs Linux and a C compiler")
    library = tmp_path_factory.mktemp("other") / "other.so"
    source = str(Path(__file__).with_name("other_library.c"))
    options = ["-O1", "-fno-builtin", "-fPIC", "-shared", source, "-o", str(library), "-ldl", "-lm"]
    subprocess.run([*compiler_command(None), *options], check=True, capture_output=True)

    def run(*arguments, other):
        environment = {**os.environ, "PYTHONPATH": str(Path(bayesftc.__file__).parents[1])}
        environment |= {"LD_PRELOAD": str(library)} if other else {}
        command = [sys.executable, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout

    return run


@pytest.mark.parametrize("folder", ["cosim", "controllers", "fmus", "src/bayesftc/monitoring"])
def test_no_module_takes_rounded_functions_from_math(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    taken = set()
    for path in files:
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "math" in text else ():
            if isinstance(node, ast.ImportFrom) and node.module == "math":
                taken |= {(path.name, name.name) for name in node.names}
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "math":
                taken.add((path.name, node.attr))
    assert taken or folder.endswith("monitoring")
    used = {(file, name) for file, name in taken if name not in EXACT}
    assert not used, f"use bayesftc.cosim.ops instead of math: {sorted(used)}"


def test_the_other_library_has_other_digits(python):
    """Of Python's functions, and so in the environment that a store of a campaign records."""
    code = (
        "import math; from bayesftc.cosim.campaign.store.environment import environment; "
        "print(math.exp(1.5).hex(), *environment()['digits'].values())"
    )
    here, there = (python("-c", code, other=other).split() for other in (False, True))
    assert [a == b for a, b in zip(here, there, strict=True)] == [False, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("part", ["learner", "fault", "plant", "export", "campaign threads", "linearised"])
def test_results_do_not_depend_on_the_c_library(python, part, tmp_path):
    hashes = []
    for other in (False, True):
        file = tmp_path / f"{other}.json"
        python(str(ROOT / "tools" / "same_bits.py"), "write", str(file), "--only", part, other=other)
        hashes.append(json.loads(file.read_text()))
    assert hashes[0] == hashes[1]
    assert not any(value.startswith("refused") for value in hashes[0].values())
