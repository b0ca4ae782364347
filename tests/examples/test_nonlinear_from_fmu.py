"""The example of controllers with the equations of an FMU: better than a linear design where the arm moves far."""

import numpy as np
import pytest

from bayesftc.examples.nonlinear_from_fmu import loops, study


@pytest.mark.slow
def test_the_equations_pay_far_from_the_point_of_linearisation():
    seeds = range(2)
    near, far = (
        {
            way: np.mean([error for error, _ in study.arm_runs(way, size, seeds)])
            for way in (loops.FMU, loops.SAME_GOALS)
        }
        for size in (0.1, 1.5)
    )
    assert near[loops.FMU] == pytest.approx(near[loops.SAME_GOALS], rel=0.05)
    assert far[loops.FMU] < 0.3 * far[loops.SAME_GOALS]


@pytest.mark.slow
def test_the_table_of_the_page(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["study", "2", str(tmp_path / "figure.png")])
    study.main()
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith("| 0")]) == 2 + len(study.ANGLES)
    assert (tmp_path / "figure.png").exists()


@pytest.mark.slow
def test_the_arm_with_a_failing_sensor(capsys):
    loops.main()
    errors = [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()[1:]]
    assert errors[0] < 0.5 * min(errors[1:])
