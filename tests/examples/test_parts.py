"""The examples of the smaller blocks: each runs and shows what it says, and each block is used by an example."""

import re
from pathlib import Path

import numpy as np

import bayesftc.examples
from bayesftc import cosim
from bayesftc.examples.parts import gain_scheduling, identify, sampling, thermostat, traffic_light

FOLDER = Path(bayesftc.examples.__path__[0])


def test_every_block_is_used_by_an_example():
    scripts = "\n".join(file.read_text(encoding="utf-8") for file in FOLDER.rglob("*.py"))
    scenarios = "\n".join(file.read_text(encoding="utf-8") for file in FOLDER.rglob("*.toml"))
    for block in (*cosim.BLOCKS, cosim.StateSpace, cosim.Sensors):
        used = re.search(rf"cosim\.{block.__name__}\(", scripts) or f'kind = "{block.__name__}"' in scenarios
        assert used, f"no example uses {block.__name__}"
    used_here = {file.stem for file in (FOLDER / "parts").glob("*.py")} - {"__init__"}
    assert used_here == {"gain_scheduling", "identify", "sampling", "thermostat", "traffic_light"}


def test_cars_and_pedestrians_never_go_together(capsys):
    result = traffic_light.main(80.0)
    walk, second = result["walk.y"] > 0.5, result["second.y"]
    assert (result["cars.y"][walk] == traffic_light.RED).all()
    np.testing.assert_array_equal(second, np.floor(result.time) % traffic_light.CYCLE)
    starts = result.time[1:][np.diff(walk.astype(int)) == 1]
    np.testing.assert_array_equal(starts, [11.0, 33.0, 52.0])  # none in the fourth cycle, in which nobody presses
    np.testing.assert_array_equal(result["display.y"][walk], 18.0 - second[walk])
    assert len(capsys.readouterr().out.splitlines()) == 81


def test_a_narrow_hysteresis_holds_the_temperature_better_and_switches_more(capsys):
    errors, starts = zip(*thermostat.main().values())
    assert errors[0] < errors[1] < errors[2] < 2.0
    assert starts[0] > starts[1] > starts[2] > 5
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_a_scheduled_gain_makes_gears_alike(capsys):
    seconds = gain_scheduling.main()
    spread = {way: np.ptp([seconds[way, gear] for gear in gain_scheduling.GEARS]) for way in ("fixed", "scheduled")}
    assert spread["scheduled"] < 0.3 * spread["fixed"]
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_a_motor_is_identified_from_a_pseudo_random_signal(capsys):
    model, explained = identify.main()
    true = np.exp(np.roots([1.0, 2.4, 4.0]) * identify.DT)
    poles = np.linalg.eigvals(model.matrix("A"))
    assert max(np.abs(poles - pole).min() for pole in true) < 1e-3
    assert explained > 0.999
    assert "true" in capsys.readouterr().out


def test_a_filter_before_the_sampling_keeps_the_vibration_out(capsys):
    errors = sampling.main()
    assert errors["with two filters"] < 0.05 * errors["without a filter"]
    assert abs(errors["without a filter"] - 0.5 / np.sqrt(2.0)) < 0.02  # all of the vibration
    assert len(capsys.readouterr().out.splitlines()) == 2
