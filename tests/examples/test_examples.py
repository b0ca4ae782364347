"""Every example runs, and shows what it says it shows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesftc.examples
from bayesftc import fmus
from bayesftc.examples.actuator_limits import study as actuator_limits
from bayesftc.examples.cruise_control import (
    actuator_faults,
    block_diagram,
    couple_external_fmu,
    cruise_control,
    kalman_validation,
    where_it_helps,
)
from bayesftc.examples.design_from_fmu import four_plants
from bayesftc.examples.goals_ahead import study as goals_ahead
from bayesftc.examples.python_control_style import cruise_control as in_python_control
from bayesftc.examples.wrong_motor import drive as wrong_drive, study as wrong_motor
from bayesftc.scenario import load_scenario, shipped_scenarios

FOLDER = Path(bayesftc.examples.__path__[0]) / "cruise_control"
MODULES = {
    "cruise_control",
    "actuator_faults",
    "couple_external_fmu",
    "block_diagram",
    "kalman_validation",
    "where_it_helps",
}


def test_no_example_is_forgotten():
    assert {p.stem for p in FOLDER.glob("*.py")} - {"__init__"} == MODULES
    assert set(shipped_scenarios()) == {"cruise_control", "live_car", "position_servo", "smooth_car"}


def test_learned_precision_keeps_the_car_on_the_road(capsys):
    errors = cruise_control.main()
    assert errors["GammaPrecision"] < errors["SERFDI"] < errors["FixedPrecision"]
    assert errors["FixedPrecision"] > 10 * errors["GammaPrecision"] > 11 * errors["SwitchingPrecision"]
    assert len(capsys.readouterr().out.splitlines()) == 6


@pytest.mark.slow
def test_learned_precision_helps_on_a_sine_and_hurts_on_a_constant(capsys):
    """The README says both."""
    table = where_it_helps.main(runs=8)
    assert table["freeze", "sine"]["GammaPrecision"] < 0.2 * table["freeze", "sine"]["FixedPrecision"]
    assert table["freeze", "constant"]["GammaPrecision"] > 1.3 * table["freeze", "constant"]["FixedPrecision"]
    for row in table.values():
        assert row["SwitchingPrecision"] < 1.02 * min(row.values())
    assert len(capsys.readouterr().out.splitlines()) == 7


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_scenario_runs(name):
    scenario = load_scenario(name)
    result = scenario.simulate(duration=0.5, engine="interpreted")
    assert np.isfinite(result[f"plant.{scenario.wiring.measured}"]).all()


def test_the_three_ways_of_making_a_diagram_agree(capsys):
    differences = block_diagram.main(8.0)
    assert differences["FMU, block by block"] == 0.0
    assert max(differences.values()) < 1e-11
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_the_belief_is_a_kalman_filters(capsys):
    for check in kalman_validation.main(8.0).values():
        assert check.steps == 401
        assert check.mean_difference < 1e-12
        assert check.covariance_difference < 1e-12


@pytest.mark.parametrize("arguments", [[], [str(fmus.path("CruiseControl", fmi="3.0")), "--around", "10"]])
def test_an_fmu_without_a_model(arguments, capsys):
    result = couple_external_fmu.main([*arguments, "--duration", "8"])
    wanted = 10.0 if arguments else 20.0
    assert result["plant.v"][-100:].mean() == pytest.approx(wanted, abs=0.5)
    assert "0.999000" in capsys.readouterr().out


@pytest.mark.slow
def test_a_failed_engine_is_told_from_failed_sensors(capsys):
    table = actuator_faults.main(runs=4)
    for case in (("1500 N more", None), ("0.4 of the force", None)):
        row = table[case]
        assert row["with actuator modes"] < 0.25 * row["FixedPrecision"] < row["SwitchingPrecision"]
    healthy = table[None, None]
    assert healthy["with actuator modes"] < 1.03 * healthy["FixedPrecision"]
    assert len(capsys.readouterr().out.splitlines()) == 2 + len(table)
    price = actuator_faults.insurance(runs=20)
    assert price["with actuator modes"] < 1.02
    assert price["with frequent actuator faults"] > price["with actuator modes"]
    ((_, errors),) = actuator_faults.slow_engine(runs=2, lags=(0.5,), steps=2000).items()
    assert errors["with actuator modes"] > 3 * errors["FixedPrecision"]  # a reason why they are no default


def test_in_python_controls_style_only_the_line_of_the_plant_changes(capsys):
    runs = in_python_control.main(10.0)
    assert len(capsys.readouterr().out.splitlines()) == 5
    for law in ("PI", "Bayesian"):
        np.testing.assert_allclose(runs[law, "FMU"].outputs, runs[law, "nlsys"].outputs, rtol=1e-12, atol=1e-12)
    goal = runs["PI", "FMU"].inputs[0]
    blind, alert = (np.abs(runs[law, "FMU"].outputs[0] - goal)[350:].max() for law in ("PI", "Bayesian"))
    assert blind > 20.0
    assert alert < 2.0


@pytest.mark.sampled(1)
@pytest.mark.parametrize("index", [0, 3])
def test_a_controller_in_one_call_bears_a_failing_sensor(index, capsys):
    """The beginning of each run."""
    case = replace(four_plants.CASES[index], duration=(4.5, 0, 0, 13.0)[index])
    errors = four_plants.main(runs=1, cases=(case,))
    tolerant, without, oracle = (errors[case.name, way] for way in four_plants.WAYS)
    assert tolerant < 0.8 * without
    assert tolerant < 1.2 * oracle
    assert case.name in capsys.readouterr().out


@pytest.mark.slow
def test_controllers_in_one_call_are_as_good_as_the_oracle(tmp_path):
    errors = four_plants.main(10, tmp_path / "four.png")
    for case in four_plants.CASES:
        tolerant, without, oracle = (errors[case.name, way] for way in four_plants.WAYS)
        assert tolerant < 0.6 * without
        assert tolerant < 1.1 * oracle
    assert (tmp_path / "four.png").stat().st_size > 10_000


def test_a_servo_that_knows_its_goals_does_not_lag(capsys):
    errors = goals_ahead.main(runs=1, previews=(0, 20), cases=goals_ahead.CASES[1:2])
    assert errors["sine", 20] < 0.15 * errors["sine", 0]
    assert "sine" in capsys.readouterr().out


def test_a_load_takes_up_what_the_model_of_a_motor_lacks(capsys):
    """Healthy sensors are not blamed for a weaker motor, and the belief is as good as with the right model."""
    reached = wrong_motor.main(2, ["3"], ["as modelled", "20 % weaker"], ["healthy", "drift"])
    for fault in ("healthy", "drift"):
        wrong, load = (reached["3", "20 % weaker", fault, load] for load in wrong_motor.LOADS)
        assert load.belief < 0.5 < wrong.belief
        assert load.blamed < 0.5 * wrong.blamed
    assert reached["3", "as modelled", "drift", True].belief < 0.5
    assert "20 % weaker    drift" in capsys.readouterr().out


@pytest.mark.slow
def test_what_acts_elsewhere_needs_noise_there(capsys):
    table = wrong_drive.main(1, faults=["healthy"])
    blamed = {design: share for (design, _), (_, share) in table.items()}
    assert blamed["disturbance=True"] > 0.3
    assert blamed["and noise at_load"] < 0.05
    assert "healthy" in capsys.readouterr().out


@pytest.mark.slow
def test_each_known_sample_makes_the_servo_lag_less(tmp_path):
    errors = goals_ahead.main(3, tmp_path / "ahead.png")
    for case in goals_ahead.CASES[:2]:
        assert (np.diff([errors[case.name, n] for n in goals_ahead.PREVIEWS]) < 1e-4).all()
    assert (tmp_path / "ahead.png").stat().st_size > 10_000


def test_only_controllers_that_know_the_limits_do_not_wind_up(tmp_path):
    table = actuator_limits.main(tmp_path / "limits.png")
    for kind in ("PI", "LQG"):
        winding, limited = (figures for name, figures in table.items() if name.startswith(kind))
        assert winding["overshoot"] > 5.0
        assert limited["overshoot"] < 0.6
        assert limited["settled"] < 0.5 * winding["settled"]
    assert table["LQG with u_min, u_max"]["undershoot"] < 0.1
    assert (tmp_path / "limits.png").stat().st_size > 10_000
