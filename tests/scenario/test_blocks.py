"""Further blocks in scenario files: kinds, connections, subsystems, campaigns, and what is said of wrong ones."""

import re
from dataclasses import fields

import block_kinds
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import LAWS
from bayesftc.cosim.errors import (
    AlgebraicLoopError,
    ConnectionError,
    ModelError,
    ScenarioError,
    UnconnectedInputError,
    UnknownNameError,
)
from bayesftc.scenario import load_scenario, shipped_scenarios
from bayesftc.scenario._blocks import KINDS
from bayesftc.scenario.campaigns import load_campaign

CAR = shipped_scenarios()["cruise_control"].read_text()
SMOOTH = shipped_scenarios()["smooth_car"].read_text()
LIMITER = """
[blocks.limiter]
kind = "RateLimiter"
rising = 500.0
falling = 400.0
[[connections]]
from = "controller.u"
to = "limiter.u"
[[connections]]
from = "limiter.y"
to = "plant.force"
"""


@pytest.fixture
def write(tmp_path):
    """Write a scenario with some text replaced; return the file."""

    def write(text, *changes, name="car.toml"):
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        file = tmp_path / name
        file.write_text(text)
        return file

    return write


def short(scenario, duration=0.4):
    return scenario.simulate(duration=duration, engine="interpreted")


def test_a_block_between_controller_and_plant(write, same_bits):
    scenario = load_scenario(write(CAR + LIMITER))
    assert scenario.blocks == {"limiter": (cosim.RateLimiter(500.0, 400.0), 1)}
    result = short(scenario)
    assert np.abs(np.diff(result["limiter.y"])).max() <= 10.0 + 1e-9
    plain = short(load_scenario("cruise_control"))
    assert np.abs(np.diff(plain["controller.u"][:, 0])).max() > 10.0
    loop = cosim.closed_loop(
        scenario.plant,
        scenario.controller,
        control="force",
        measured="v",
        reference=scenario.reference,
        sensors=scenario.sensors,
        faults=scenario.faults,
        noise=scenario.noise,
        blocks={"limiter": cosim.RateLimiter(500.0, 400.0)},
        connections=[("controller.u", "limiter.u"), ("limiter.y", "plant.force")],
    )
    other = loop.simulate(0.4, seed=1, engine="interpreted")
    for name in result:
        same_bits(result[name], other[name], name)


def test_an_input_stands_for_what_the_loop_feeds_it(write):
    filters = """
[blocks.smooth]
kind = "ExponentialFilter"
time_constant = 0.1
size = 2
[[connections]]
from = "controller.y"
to = "smooth.u"
[[connections]]
from = ["smooth.y[0]", "smooth.y[1]"]
to = "controller.y"
"""
    loop = load_scenario(write(CAR + filters)).loop()
    assert loop.source_of(loop["smooth"], loop["smooth"].port("u"), 1)[0].node.name == "freeze_0"
    assert loop.source_of(loop["controller"], loop["controller"].port("y"), 1)[0].node.name == "smooth"


def test_the_shipped_scenario_has_a_subsystem_at_its_own_rate():
    scenario = load_scenario("smooth_car")
    result = scenario.simulate(duration=8.0)
    assert scenario.loop()["warning.lamp"].every == 5
    assert np.diff(result["shaper.y"]).max() <= 0.02 + 1e-9
    assert result["warning.times"][-1] == 1.0
    np.testing.assert_array_equal(result["warning.lamp"], result["warning.lamp.y"])


def toml(value):
    """Return a value in the notation of TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, cosim.When):
        entries = (f"{f.name} = {toml(getattr(value, f.name))}" for f in fields(value))
        return "{ " + ", ".join(entries) + " }"
    if isinstance(value, cosim.Fault):
        return "{ " + ", ".join(settings(value)) + " }"
    if isinstance(value, tuple | list | np.ndarray):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value)


def settings(block):
    """Return the lines of a block's table."""
    values = {f.name: getattr(block, f.name) for f in fields(block) if f.init and getattr(block, f.name) is not None}
    return [f'kind = "{type(block).__name__}"', *(f"{name} = {toml(value)}" for name, value in values.items())]


WRITTEN = {
    name: block for name, block in block_kinds.BLOCKS.items() if isinstance(block, (*cosim.BLOCKS, *cosim.FAULTS))
}


def test_every_kind_can_be_written(write):
    text = "".join("\n".join([f"[blocks.b{i}]", *settings(block), ""]) for i, block in enumerate(WRITTEN.values()))
    scenario = load_scenario(write(f"{CAR}\n{text}"))
    for i, (name, block) in enumerate(WRITTEN.items()):
        assert scenario.blocks[f"b{i}"][0] == block, name
    other = {cosim.StateSpace, cosim.FMU, cosim.Subsystem}
    lacking = set(KINDS) - other - set(LAWS) - {type(block) for block in WRITTEN.values()}
    assert not lacking, f"add {', '.join(cls.__name__ for cls in lacking)} to BLOCKS of tests/cosim/block_kinds.py"
    public = {getattr(cosim, name) for name in cosim.__all__}
    kinds = {k for k in public if isinstance(k, type) and issubclass(k, cosim.Block)}
    base = {cosim.Block, cosim.ExternalBlock, cosim.Fault, cosim.Source}
    assert kinds - set(KINDS) - base == {cosim.Sensors, cosim.Preview}  # a loop has them by itself


def test_laws_linear_systems_and_fmus(write):
    text = """
[blocks.law]
kind = "PID"
gain = 2.0
integral_gain = 0.5
[blocks.lag]
kind = "StateSpace"
A = [[-1.0]]
B = [[1.0]]
C = [[1.0]]
dt = 0
[blocks.other]
kind = "FMU"
fmu = "CruiseControl"
parameters = { m = 200.0 }
[[connections]]
from = ["controller.x_hat"]
to = "law.x_hat"
[[connections]]
from = "controller.goal"
to = "law.goal"
[[connections]]
from = "law.u"
to = "lag.u"
[[connections]]
from = "lag.y"
to = "other.force"
"""
    result = short(load_scenario(write(CAR + text)))
    assert np.ptp(result["other.v"]) > 0.0


PI = """
[simulation]
duration = 5
dt = 0.02
[plant]
kind = "Subsystem"
control = "u"
measured = "y"
inputs = { u = "lag.u" }
outputs = { y = "lag.y" }
[plant.blocks.lag]
kind = "TransferFunction"
numerator = [1.0]
denominator = [1.0, 0.5]
[reference]
kind = "Constant"
value = 1.0
[controller]
kind = "Subsystem"
inputs = { goal = "error.u[0]", y = "error.u[1]" }
outputs = { u = "total.y" }
[controller.blocks]
error = { kind = "Sum", signs = "+-" }
gain = { kind = "Gain", gain = 2.0 }
integral = { kind = "Integrator", low = -5.0, high = 5.0 }
total = { kind = "Sum", signs = "++" }
[[controller.connections]]
from = "error.y"
to = "gain.u"
[[controller.connections]]
from = "error.y"
to = "integral.u"
[[controller.connections]]
from = ["gain.y", "integral.y"]
to = "total.u"
"""


def test_plant_and_controller_may_be_subsystems(write, bayesftc_):
    file = write(PI)
    result = short(load_scenario(file), 20.0)
    assert abs(result["plant.y"][-1] - 1.0) < 0.01
    done = bayesftc_("run", file, "--engine", "interpreted")
    assert done.exit_code == 0, done.output
    assert "tracking of y" in done.output
    with pytest.raises(ScenarioError, match=r"'plant' is a subsystem, whose step is not known\. Add dt"):
        load_scenario(write(PI, ("dt = 0.02\n", "")))
    with pytest.raises(ScenarioError, match=r"'model' cannot be used with kind = 'Subsystem'"):
        load_scenario(write(PI + "[model]\nA = [[1.0]]\n"))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("line", ["warning.lamp.on", "blocks.warning.blocks.lamp.on"])
def test_settings_inside_are_factors_of_campaigns(write, line):
    write(SMOOTH)
    factors = f'"{line}" = [0.8, 0.95]\n"engine.denominator" = [[0.1, 1.0], [0.2, 1.0]]\n'
    text = f'scenario = "car.toml"\nduration = 0.2\n[factors]\n{factors}'
    campaign = load_campaign(write(text, name="campaign.toml"))
    loops = [campaign.job.loop(**point) for point in campaign.job.plan.points]
    assert [loop["warning.lamp"].block.on for loop in loops] == [0.8, 0.8, 0.95, 0.95]
    assert [loop["engine"].block.denominator[0] for loop in loops] == [0.1, 0.2, 0.1, 0.2]


def test_parameters_of_fmus_and_plants_of_blocks_are_factors(write):
    text = CAR + '\n[blocks.other]\nkind = "FMU"\nfmu = "CruiseControl"\n'
    write(text)
    campaign = load_campaign(write('scenario = "car.toml"\n[factors]\n"other.m" = [90.0]\n', name="campaign.toml"))
    assert campaign.job.loop(**campaign.job.plan.points[0])["other"].block.parameters == {"m": 90.0}
    write(PI)
    file = write('scenario = "car.toml"\n[factors]\n"controller.gain.gain" = [3.0]\n', name="campaign.toml")
    campaign = load_campaign(file)
    assert campaign.job.loop(**campaign.job.plan.points[0])["controller.gain"].block.gain == 3.0


def test_a_condition_as_text_has_the_entries_of_its_table(write):
    write(CAR, ("start = 6.0", 'start = "plant.v > 22"'))
    file = write('scenario = "car.toml"\n[factors]\n"freeze_0.start.value" = [23.0]\n', name="campaign.toml")
    campaign = load_campaign(file)
    (point,) = campaign.job.plan.points
    assert campaign.job.loop(**point)["freeze_0"].block.start == cosim.when("plant.v", ">", 23.0)


WRONG = {
    "kind": (('"RateLimiter"', '"RateLimter"'), ScenarioError, ["blocks.limiter.kind", "did you mean 'RateLimiter'"]),
    "no kind": (('kind = "RateLimiter"\n', ""), ScenarioError, ["'blocks.limiter'", "lacks 'kind'"]),
    "key": (("falling = 4", "faling = 4"), ScenarioError, ["'blocks.limiter'", "'faling'", "did you mean 'falling'"]),
    "value": (("falling = 400.0", "falling = -4.0"), ModelError, ["'blocks.limiter'", "falling=-4.0"]),
    "every": (("falling = 400.0", "every = 0"), ScenarioError, ["'blocks.limiter.every'", "at least 1"]),
    "every as text": (("falling = 400.0", "every = 'x'"), ScenarioError, ["'blocks.limiter.every'", "a whole number"]),
    "name": (("[blocks.limiter]", '[blocks."a.b"]'), ScenarioError, ["'blocks.a.b'", "other characters"]),
    "section": (("[blocks.limiter]", "[blocks.noise]"), ScenarioError, ["'blocks.noise'", "is a section"]),
    "name of a block": (("[blocks.limiter]", "[blocks.freeze_0]"), ModelError, ["already has a block 'freeze_0'"]),
    "no table": (("[blocks.limiter]", "[blocks]"), ScenarioError, ["'blocks.kind'", "must be a table"]),
    "connection": (("[[connections]]", "[connections]"), ScenarioError, ["two brackets"]),
    "key of a connection": (('from = "limiter.y"', 'form = "limiter.y"'), ScenarioError, ["connections[1]", "mean 'from'"]),
    "no source": (('from = "limiter.y"\n', ""), ScenarioError, ["'connections[1]' lacks 'from'"]),
    "empty source": (('from = "limiter.y"', "from = []"), ScenarioError, ["'connections[1].from' names no output"]),
    "source of a wrong type": (('from = "limiter.y"', "from = 3"), ScenarioError, ["connections[1].from", "text in quotes"]),
    "block of a port": (('"limiter.y"', '"limter.y"'), UnknownNameError, ["The loop has no block for 'limter.y'", "'limiter'"]),
    "port": (('"limiter.y"', '"limiter.v"'), UnknownNameError, ["Block 'limiter' has no port 'v'"]),
    "element": (('"controller.u"', '"controller.u[1]"'), UnknownNameError, ["no port 'u[1]'"]),
    "output as target": (('to = "plant.force"', 'to = "plant.v"'), ConnectionError, ["plant.v is an output"]),
    "input as source": (('from = "controller.u"', 'from = "limiter.u"'), ConnectionError, ["limiter.u is an input that"]),
    "twice": (('to = "plant.force"', 'to = "limiter.u"'), ConnectionError, ["limiter.u already has a source"]),
    "size": (('"controller.u"', '"sensors.y"'), ConnectionError, ["sensors.y (size 2)", "the sizes differ"]),
    "unconnected": (('to = "limiter.u"', 'to = "controller.goal"'), UnconnectedInputError, ["limiter.u"]),
    "fault without effect": (
        ('from = "limiter.y"\nto = "plant.force"', 'from = "sensors.y"\nto = "controller.y"'),
        ConnectionError, ["leave out the fault 'freeze_0'", "'freeze_0.y'"],
    ),
    "loop": (('from = "controller.u"', 'from = "limiter.y"'), AlgebraicLoopError, ["limiter"]),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_with_its_place(write, case):
    change, error, words = WRONG[case]
    text = LIMITER
    assert change[0] in text
    file = write(
        CAR + text.replace(*change, 1)
        if case != "connection"
        else CAR + text.replace("[[connections]]", "[connections]", 1).split("[[")[0]
    )
    with pytest.raises(error) as caught:
        load_scenario(file).loop()
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.startswith(str(file))
    assert message.endswith((".", "?"))
    for word in words:
        assert word in message, message


def test_the_remedy_of_a_loop_through_a_condition_is_one_of_files(write):
    old = 'start = "plant.v > 24"\nduration = 5.0'
    with pytest.raises(AlgebraicLoopError) as caught:
        load_scenario(write(SMOOTH, (old, 'start = "controller.u > 500"'))).loop()
    sentence = next(line for line in str(caught.value).splitlines() if "A condition of 'freeze_0'" in line)
    assert "when(" not in sentence
    table = re.search(r"give it as a table, (\{.*delayed = true \})\.", sentence)[1]
    assert load_scenario(write(SMOOTH, (old, f"start = {table}"))).loop()["freeze_0"].block.start.delayed


def test_a_fault_that_never_occurred_is_noted(write, bayesftc_):
    file = write(SMOOTH, ("plant.v > 24", "plant.v > 240"))
    done = bayesftc_("run", file, "--duration", "0.4", "--engine", "interpreted", "--json")
    assert "The fault 'freeze_0' did not occur: it begins on the condition plant.v > 240." in done.output


def test_a_fault_whose_state_alone_is_used_has_no_effect(write):
    between = LIMITER.replace('"limiter.y"', '"sensors.y"').replace('"plant.force"', '"controller.y"')
    text = CAR + between.replace('from = "controller.u"', 'from = "freeze_0.active"')
    with pytest.raises(ConnectionError, match="leave out the fault 'freeze_0'"):
        load_scenario(write(text)).loop()


WRONG_INSIDE = {
    "kind": (('"Hysteresis"', '"Histeresis"'), ScenarioError, ["blocks.warning.blocks.lamp.kind", "'Hysteresis'"]),
    "port": (('"lamp.u"', '"lamp.x"'), UnknownNameError, ["'blocks.warning'", "no port 'x'"]),
    "block": (('"times.u"', '"tims.u"'), UnknownNameError, ["'blocks.warning.connections[0]'", "'times'"]),
    "key": (("every = 5", "evry = 5"), ScenarioError, ["'blocks.warning'", "'evry'"]),
    "ports": (('{ probability = "lamp.u" }', "3"), ScenarioError, ["'blocks.warning.inputs'", "a table"]),
    "no blocks": (("[blocks.warning.blocks.lamp]", "[blocks.warning.more]"), ScenarioError, ["'more'"]),
    "input outside": (("warning.probability", "warning.p"), UnknownNameError, ["'warning'", "'p'"]),
}


@pytest.mark.parametrize("case", WRONG_INSIDE)
def test_what_is_wrong_inside_is_said_with_its_place(write, case):
    change, error, words = WRONG_INSIDE[case]
    file = write(SMOOTH, change)
    with pytest.raises(error) as caught:
        load_scenario(file).loop()
    message = str(caught.value)
    assert message.startswith(str(file))
    for word in words:
        assert word in message, message


def test_a_subsystem_needs_blocks_and_a_fault_no_name(write):
    with pytest.raises(
        ScenarioError, match=r"'blocks\.a' is a subsystem without blocks\. Add \[blocks\.a\.blocks\.<name>\]"
    ):
        load_scenario(write(CAR + '\n[blocks.a]\nkind = "Subsystem"\n'))
    with pytest.raises(ScenarioError, match=r"'blocks\.a\.name' has no effect"):
        load_scenario(write(CAR + '\n[blocks.a]\nkind = "Freeze"\nname = "b"\n'))


def test_commands_bear_blocks(write, bayesftc_, tmp_path):
    file = write(SMOOTH)
    done = bayesftc_("export", file, "--block", "warning", "--block", "shaper", "--format", "c", "-o", tmp_path / "c")
    assert done.exit_code == 0, done.output
    assert "warning" in (tmp_path / "c").glob("*.h").__next__().read_text()
    done = bayesftc_("run", file, "--duration", "0.4", "--engine", "interpreted", "--json")
    assert done.exit_code == 0, done.output
    assert bayesftc_("example", "smooth_car").output == SMOOTH
