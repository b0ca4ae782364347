"""The C without FMI as firmware uses it: no warnings, C and C++, nothing but mathematics, and the example."""

import re
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.program import program_of
from bayesftc.examples.cruise_control.cruise_control import cruise_control

WARNINGS = [
    f"-W{kind}" for kind in ("all", "extra", "pedantic", "error", "conversion", "double-promotion", "shadow", "vla")
]


def run(*command, folder):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the C of the cruise controller, of one with the paper's learner, and the example's."""
    folder = tmp_path_factory.mktemp("firmware")
    for name, learner in (("controller", controllers.SwitchingPrecision()), ("paper", controllers.GammaPrecision())):
        file = write_c(program_of(cruise_control(learner), blocks=["controller"], name=name))
        (folder / f"{name}.h").write_text(file.header)
        (folder / f"{name}.c").write_text(file.source)
    shutil.copy(str(files("bayesftc.examples") / "firmware" / "main.c"), folder)
    return folder


@pytest.mark.slow  # test_the_example_rides_out_its_faults compiles the larger one without a warning
@pytest.mark.parametrize("name", ["controller", "paper"])
@pytest.mark.parametrize("dialect", ["c99", "c11", "c++11"])
def test_no_warning_in_any_dialect(folder, c_compiler, name, dialect):
    language = ["-x", "c++"] if "+" in dialect else []
    run(c_compiler, *language, f"-std={dialect}", "-O2", *WARNINGS, "-c", f"{name}.c", "-o", "any.o", folder=folder)


def test_it_needs_nothing_but_mathematics(folder):
    source = (folder / "controller.c").read_text()
    assert set(re.findall(r"#include <(.*)>", source)) == {"math.h", "stddef.h", "stdint.h"}
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|printf|memset|memcpy|goto)\b", source)


@pytest.mark.slow
def test_the_example_rides_out_its_faults(folder, c_compiler):
    run(c_compiler, "-std=c99", "-O2", *WARNINGS, "main.c", "controller.c", "-o", "main", "-lm", folder=folder)
    said = run(str(folder / "main"), folder=folder)
    speed, stuck, healthy, memory = map(float, re.findall(r"[0-9.]+(?:e[+-]?[0-9]+)?", said))
    assert speed == pytest.approx(25.0, abs=0.3)
    assert stuck < healthy / 10
    constant = int(re.search(r"CONTROLLER_MEMORY = (\d+)", (folder / "controller.h").read_text())[1])
    assert memory >= 8 * constant


@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_fast_mathematics_is_refused(folder, c_compiler, option):
    """All of it and its parts: with numbers that are thought to be finite, a missing sample is not noticed."""
    done = subprocess.run([c_compiler, option, "-c", "controller.c"], cwd=folder, capture_output=True, text=True)
    assert done.returncode != 0
    assert "a NaN is a missing sample" in done.stderr


@pytest.mark.slow
def test_digits_do_not_hang_on_flags(folder, c_compiler):
    """Neither fused products nor gcc's 0.0 - n for -n change them: without any flag the example says the same."""
    said = set()
    for flags in (["-O0"], ["-O3", "-std=gnu11", "-march=native", "-ffp-contract=fast"], ["-Os"]):
        run(c_compiler, *flags, "main.c", "controller.c", "-o", "main", "-lm", folder=folder)
        said.add(run(str(folder / "main"), folder=folder))
    assert len(said) == 1
    assert np.isfinite(float(said.pop().split()[0]))


def test_y_and_Y_are_two(make_block, tmp_path, c_compiler):
    block = make_block(inputs=[cosim.Port("u"), cosim.Port("U")], outputs=[cosim.Port("y")], output=add)
    file = write_c(program_of(block, dt=0.1, name="two"))
    (tmp_path / "two.h").write_text(file.header)
    (tmp_path / "two.c").write_text(file.source)
    run(c_compiler, "-std=c99", *WARNINGS, "-c", "two.c", folder=tmp_path)


def add(u, U, y):
    y[0] = u[0] + U[0]
