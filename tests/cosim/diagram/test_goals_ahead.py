"""The goal of a controller with a preview lies ahead, whatever stands between the reference and the controller."""

from fractions import Fraction

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import FixedPrecision, LinearModel, LQGController
from bayesftc.cosim.diagram.wiring import samples_ahead
from bayesftc.cosim.errors import ConnectionError, ModelError
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.scenario import load_scenario, shipped_scenarios

A, B = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.005], [0.1]])
SINE = cosim.Sine(1.0, 10.0)


def loop_of(connections=(), preview=10, reference=SINE, **blocks):
    model = LinearModel(A, B, [[1, 0], [1, 0]], 1e-2 * B @ B.T, 4e-4, dt=0.1)
    controller = LQGController(model, FixedPrecision(), goal_covariance=1e-4, preview=preview)
    return cosim.closed_loop(
        cosim.StateSpace(control.ss(A, B, [[1, 0]], 0, 0.1)),
        controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=0.02),
        reference=reference,
        blocks=blocks,
        connections=connections,
    )


def through(source, block=None):
    return {"connections": [(source, "s.u"), ("s.y", "controller.goal")], "s": block or cosim.Gain(1.0)}


def lag(loop):
    result = loop.simulate(20.0, seed=1, engine="interpreted")
    return np.sqrt(np.mean((result["plant.y"] - result["reference.y"])[50:] ** 2))


def part(block):
    inside = cosim.Diagram(0.1)
    inside.add(block, "block")
    return cosim.Subsystem(inside)


@pytest.mark.parametrize(
    "settings",
    [
        {"connections": [("reference.y", "controller.goal")]},
        through("reference.y"),
        through("reference.y", part(cosim.Gain(1.0))),
        {
            "connections": [(["reference.y", "reference.ahead"], "s.u"), ("s.y", "controller.goal")],
            "s": cosim.Sum("++"),
        },
    ],
    ids=["direct", "block", "subsystem", "both"],
)
def test_a_present_goal_is_refused_with_the_one_that_lies_ahead(settings):
    message = (
        r"controller.goal must lie 10 samples ahead .* reference.y, which is the present .* 'reference.ahead' in its"
    )
    with pytest.raises(ConnectionError, match=message):
        loop_of(**settings)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("source", ["reference.ahead", "controller.goal"])
@pytest.mark.parametrize("block", [cosim.Gain(1.0), part(cosim.Gain(1.0))], ids=["block", "subsystem"])
def test_the_remedy_gives_the_control_with_preview(source, block):
    plain = lag(loop_of())
    assert plain < 0.05 < lag(loop_of(preview=0))
    assert lag(loop_of(**through(source, block))) == plain
    assert lag(loop_of(connections=[("reference.ahead", "controller.goal")])) == plain


@pytest.mark.parametrize(
    ("source", "blocks"),
    [("path.y", {"path": SINE}), ("plant.y", {}), ("controller.u", {}), ("noise.y", {"noise": cosim.Gaussian(1.0)})],
)
def test_a_goal_without_a_known_future_is_refused(source, blocks):
    with pytest.raises(ConnectionError, match=r"whose future the loop does not have. Make that block the reference"):
        loop_of([(source, "controller.goal")], **blocks)


def test_a_constant_and_a_preview_of_ones_own_are_goals():
    loop_of([("c.y", "controller.goal")], c=cosim.Constant(1.0))
    loop_of([("p.ahead", "controller.goal")], p=cosim.Preview(SINE, 1.0))
    with pytest.raises(
        ConnectionError, match=r"p.ahead lies 0.5 s ahead, but the controller's preview is 1 s. Give Preview"
    ):
        loop_of([("p.ahead", "controller.goal")], p=cosim.Preview(SINE, 0.5))
    loop_of(
        [("p.ahead", "g.u"), ("g.y", "controller.goal")], p=cosim.Preview(SINE, 1.5), g=cosim.Gain(1.0)
    )  # may be a delay
    loop_of(through("reference.ahead")["connections"], s=cosim.RateLimiter(rising=1.0))


def test_without_preview_any_block_gives_the_goal():
    loop = loop_of(preview=0, **through("reference.y", cosim.Gain(2.0)))
    assert loop.simulate(0.1, engine="interpreted").roles.quantities[0].reference == ("s.y", 0)


def test_a_later_goal_is_no_reference():
    places = {
        "block": through("reference.ahead"),
        "direct": {"connections": [("reference.ahead", "controller.goal")]},
        "constant": {"connections": [("s.y", "controller.goal")], "s": cosim.Constant(1.0)},
    }
    results = {name: loop_of(**given).simulate(1.0, engine="interpreted") for name, given in places.items()}
    references = {name: result.roles.quantities[0].reference for name, result in results.items()}
    assert references == {"block": None, "direct": ("reference.y", 0), "constant": ("s.y", 0)}
    loops = {name: figures(loop_signals(loop_of(**places[name]), results[name])) for name in ("block", "direct")}
    assert np.isnan(loops["block"].tracking["y"].overall)
    assert np.isfinite(loops["direct"].tracking["y"].overall)


@pytest.mark.parametrize("every", [1, 2])
def test_a_subsystem_has_the_preview_of_the_controller_inside(every):
    """The controller inside followed its goal late, without a word: a tracking error of .8 in place of .07."""
    plain = loop_of()
    inside = cosim.Diagram(dt=0.1 / every)
    inside.add(plain["controller"].block, "own", every=every)
    whole = cosim.Subsystem(inside, {"y": "own.y", "goal": "own.goal"}, {"u": "own.u"}, goals=["y"])
    assert samples_ahead(whole) == 10 * every
    loop = cosim.closed_loop(
        plain["plant"].block, whole, control="u", measured="y", sensors=cosim.Sensors(count=2, std=0.02), reference=SINE,
    )  # fmt: skip
    assert lag(loop) == pytest.approx(lag(plain), abs=0.02)
    inside.add(loop_of(preview=3)["controller"].block, "other", every=every)
    both = cosim.Subsystem(inside, {"y": ["own.y", "other.y"], "goal": ["own.goal", "other.goal"]}, {"u": "own.u"})
    with pytest.raises(ModelError, match="controllers inside with different previews"):
        samples_ahead(both)


def test_a_factor_changes_the_preview_behind_a_block():
    for preview in (0, 4):
        changed = cosim.varied(loop_of(**through("controller.goal")), {"controller.preview": preview})
        again = loop_of(preview=preview) if preview else loop_of(preview=0)
        assert lag(changed) == lag(again)


def test_a_factor_is_refused_where_the_goal_is_present():
    with pytest.raises(ModelError, match=r"goal comes from reference.y, whose future .* a preview of at least 1"):
        cosim.varied(loop_of(preview=0, **through("controller.goal")), {"controller.preview": 5})


CAR = shipped_scenarios()["smooth_car"].read_text()
LQG = CAR.replace('kind = "BayesianController"', 'kind = "LQGController"\ngoal_covariance = 0.1\npreview = 20')


def test_a_scenario_names_the_output_that_lies_ahead(tmp_path, bayesftc_):
    file = tmp_path / "car.toml"
    file.write_text(LQG)
    with pytest.raises(ConnectionError, match=r"car.toml: .*depends on reference.y, .* Connect 'reference.ahead'"):
        load_scenario(file).loop()
    file.write_text(LQG.replace('from = "reference.y"', 'from = "reference.ahead"'))
    assert load_scenario(file).loop()["reference"].block.time == Fraction(2, 5)
    done = bayesftc_("run", file, "--duration", "1")
    assert done.exit_code == 0, done.output
    shown = " ".join(done.output.split())
    assert "v has no tracking error: its goal comes through a block after 'ahead'" in shown
    assert "not recorded" not in shown
