"""What the shell completes after Tab."""

import os
import subprocess
import sys

import pytest


def completed(line, folder):
    environment = {**os.environ, "_BAYESFTC_COMPLETE": "complete_bash", "COMP_WORDS": line,
                   "COMP_CWORD": str(len(line.split(" ")) - 1)}  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "bayesftc"], env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    return done.stdout.split()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("bayesftc run cru", ["cruise_control"]),
        ("bayesftc run my", ["my.toml"]),
        ("bayesftc run sub/", ["sub/other.toml"]),
        ("bayesftc inspect Cru", ["CruiseControl"]),
        ("bayesftc inspect pl", ["plant.fmu"]),
        ("bayesftc example pos", ["position_servo"]),
        ("bayesftc keys sc", ["scenario"]),
        ("bayesftc keys scenario fau", ["faults"]),
        ("bayesftc export my.toml --block f", ["filter"]),
        ("bayesftc export nothing.toml --block con", ["controller"]),
    ],
)
def test_names_are_completed(line, names, tmp_path):
    (tmp_path / "my.toml").write_text('[blocks.filter]\nkind = "Gain"\n')
    (tmp_path / "plant.fmu").touch()
    (tmp_path / "notes.txt").touch()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "other.toml").touch()
    assert completed(line, tmp_path) == names
