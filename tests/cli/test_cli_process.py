"""The command line as a process of its own: exit codes, streams, interruption, start-up, and the installed entry point."""

import subprocess
import sys

import pytest

from bayesftc.cosim.base.announcing import SENTENCE
from bayesftc.scenario import shipped_scenarios

CAR = shipped_scenarios()["cruise_control"].read_text()
COMMAND = [sys.executable, "-m", "bayesftc"]


def run(*arguments, folder, **options):
    options = {"cwd": folder, "capture_output": True, "text": True, "timeout": 120, **options}
    done = subprocess.run([*COMMAND, *arguments], **options)
    done.stderr = done.stderr.replace(f"{SENTENCE}\n", "")  # the first run on a machine compiles, and says so
    return done


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("code", "old", "new", "words"),
    [
        (3, "std = 1.0", "sdt = 1.0", "car.toml: 'sensors' has the unknown key 'sdt'; did you mean 'std'?"),
        (4, '"CruiseControl"', '"gone.fmu"', "gone.fmu cannot be read"),
        (5, '"force"', '"forces"', "did you mean 'force'?"),
        (8, "duration = 20.0", "duration = 20.01", "no whole number of steps"),
        (9, '"SwitchingPrecision"', '"SwitchingPrecision"\nnoise_factor = 0.5', "'controller.precision'"),
        (11, "v0 = 20.0", "m = 1e-320, v0 = 20.0", "plant.v came out infinite"),
    ],
)
def test_an_error_is_one_sentence_on_stderr(tmp_path, code, old, new, words):
    (tmp_path / "car.toml").write_text(CAR.replace(old, new, 1))
    done = run("run", "car.toml", "--engine", "interpreted", folder=tmp_path)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr.startswith("Error: ")
    assert done.stderr.count("\n") == 1
    assert words in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["car.toml"]


@pytest.mark.slow
def test_from_any_folder_twice_in_a_row(tmp_path):
    outputs = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        done = run("run", "cruise_control", "--duration", "7", folder=folder)
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""  # no progress bar in a pipe
        assert "\x1b" not in done.stdout
        assert max(map(len, done.stdout.splitlines())) <= 80
        assert not list(folder.iterdir())
        outputs.append(done.stdout)
    assert outputs[0] == outputs[1]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_leaves_nothing_half_written(stopped_by_ctrl_c, tmp_path):
    code, errors = stopped_by_ctrl_c(
        "run", "cruise_control", "--duration", "40000", "--engine", "interpreted", "--out", "out"
    )
    assert code == 130
    assert errors.splitlines()[-1].startswith("Stopped by Ctrl-C")
    assert "Traceback" not in errors
    assert not list(tmp_path.iterdir())


def test_a_reader_that_has_enough(tmp_path):
    text = f"{' '.join(COMMAND)} inspect CruiseControl | head -n 1"
    done = subprocess.run(["sh", "-c", text], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("model")
    assert "Traceback" not in done.stderr


def test_files_are_written_also_if_the_reader_has_enough(tmp_path):
    """As after ``| head``: the figures are printed first, because the figure takes seconds."""
    text = f"{' '.join(COMMAND)} run cruise_control --duration 1 --out out | true"
    done = subprocess.run(["sh", "-c", text], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert "Traceback" not in done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"figure.png", "figures.json", "result.npz"}


def test_help_loads_nothing_heavy(tmp_path):
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom bayesftc.cli import app\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print([m for m in ('numpy', 'numba', 'pydantic', 'control', 'sklearn', 'filterpy', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


LIMITED = """
try:
    import resource
except ImportError:  # Windows
    pass
else:
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
"""
"""Limits the seconds of computing: those of the clock depend on what else the machine does. With the oldest numba and an empty
cache folder, five seconds of computing took from 12 to 29 seconds beside other jobs."""


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["cruise_control", "position_servo"])  # the second one's model is made of its FMU
def test_a_run_without_files_loads_no_more_than_it_needs(tmp_path, scenario):
    code = (
        LIMITED + "import sys\nfrom typer.testing import CliRunner\nfrom bayesftc.cli import app\n"
        f"done = CliRunner().invoke(app, ['run', '{scenario}', '--engine', 'interpreted', '--duration', '0.1'])\n"
        "assert done.exit_code == 0, done.output\n"
        "print([m for m in ('control', 'sklearn', 'filterpy', 'matplotlib', 'pandas', 'xarray') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.stdout.strip() == "[]", done.stderr
