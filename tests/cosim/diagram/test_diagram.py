"""Adding, connecting, building: what is refused, and with which words."""

import copy
import math
import pickle

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.errors import did_you_mean


def nothing():
    """Do nothing."""


@pytest.fixture
def parts(make_block):
    diagram = cosim.Diagram(0.1)
    ports = [Port("speed", unit="m/s"), Port("xy", (2,)), Port("P", (2, 2))]
    ins = [Port("force", unit="N"), Port("uv", (2,)), Port("opt", default=3.0), Port("way", unit="m")]

    def write(speed, xy, P):
        speed[0] = 1.0
        for i in range(2):
            xy[i] = 10.0 + i
            for j in range(2):
                P[i, j] = 2.0 * i + j

    plant = diagram.add(make_block(outputs=ports, output=write), "plant")
    brain = diagram.add(make_block(inputs=ins), "brain")
    return diagram, plant, brain


@pytest.mark.parametrize(
    ("connect", "sentence"),
    [
        (
            lambda p, b: (p["speed"], b["uv"]),
            "plant.speed (size 1) cannot be connected to brain.uv (size 2): the sizes differ",
        ),
        (lambda p, b: (p["xy"], b["opt"]), "plant.xy (size 2) cannot be connected to brain.opt (size 1)"),
        (lambda p, b: ([p["speed"], p["xy"]], b["uv"]), "plant.speed (size 1) + plant.xy (size 2) cannot be connected"),
        (lambda p, b: ([], b["uv"]), "cannot be connected to brain.uv (size 2)"),
        (
            lambda p, b: (p["speed"], b["way"]),
            "plant.speed is in m/s, but brain.way is in m: their dimensions differ; put a block",
        ),
        (lambda p, b: (b["opt"], b["force"]), "brain.opt is an input, but the source must be an output"),
        (lambda p, b: (p["speed"], p["speed"]), "plant.speed is an output, but the target must be an input"),
        (
            lambda p, b: (p, b["opt"]),
            "The source of a connection must be a port, such as node['y'], not <plant: Custom>",
        ),
        (lambda p, b: (p["speed"], b), "The target of a connection must be a port"),
        (
            lambda p, b: ("plant.speed", b["opt"]),
            "The source of a connection must be a port, such as node['y'], not 'plant.speed'",
        ),
        (lambda p, b: (3, b["opt"]), "The source of a connection must be a port, such as node['y'], not 3"),
        (
            lambda p, b: ([p["xy"][0], 3.0], b["uv"]),
            "The source of a connection must be a port, such as node['y'], not 3.0",
        ),
    ],
)
def test_connections_that_cannot_be(parts, connect, sentence):
    diagram, plant, brain = parts
    with pytest.raises(cosim.ConnectionError) as caught:
        diagram.connect(*connect(plant, brain))
    assert sentence in str(caught.value)
    assert not any(diagram.source_of(brain, port, e) for port in brain.block.inputs for e in range(port.size))


@pytest.mark.parametrize(
    ("source", "target", "sentence"),
    [
        ("km/h", "m/s", "; put Gain(0.277777777778) between them."),
        ("m/s", "km/h", "; put Gain(3.6) between them."),
        ("degC", "K", "; put Gain(1, offset=273.15) between them."),
        ("Hz", "rad/s", ": 1 Hz is 2 pi rad/s; put a block"),
        ("W", "N", ": their dimensions differ; put a block"),
        ("p.u.", "V", "; put a Gain between them that converts."),  # who knows
        ("N.m", "kg.m2/s2", None),
        ("rad/s", "1/s", None),
        ("p.u.", "p*u*", None),
    ],
)
def test_units_of_a_connection_are_compared_by_meaning(make_block, source, target, sentence):
    diagram = cosim.Diagram(0.1)
    a = diagram.add(make_block(outputs=[Port("y", unit=source)]), "a")
    b = diagram.add(make_block(inputs=[Port("u", unit=target)]), "b")
    if sentence is None:
        diagram.connect(a["y"], b["u"])
        return
    with pytest.raises(cosim.ConnectionError) as caught:
        diagram.connect(a["y"], b["u"])
    assert f"a.y is in {source}, but b.u is in {target}{sentence}" in str(caught.value)


def test_a_second_source_is_refused_and_changes_nothing(parts):
    diagram, plant, brain = parts
    diagram.connect(plant["P"][3], brain["uv"][1])
    with pytest.raises(
        cosim.ConnectionError,
        match=r"brain.uv\[1\] already has a source \(plant.P\[3\]\); it cannot also take plant.xy",
    ):
        diagram.connect(plant["xy"], brain["uv"])
    assert diagram.source_of(brain, brain.block.port("uv"), 0) is None
    diagram.connect(plant["xy"][0], brain["uv"][0])
    diagram.connect(plant["speed"], brain["opt"])
    with pytest.raises(cosim.ConnectionError, match=r"brain.opt already has a source \(plant.speed\)"):
        diagram.connect(plant["xy"][1], brain["opt"])


def test_blocks_of_another_diagram(parts, make_block):
    diagram, plant, _ = parts
    other = cosim.Diagram(0.1).add(make_block(inputs=[Port("u")]), "plant")
    with pytest.raises(cosim.ConnectionError, match=r"plant\.u belongs to a block of another diagram"):
        diagram.connect(plant["speed"], other["u"])


def test_missing_sources(parts):
    diagram, plant, brain = parts
    diagram.connect(plant["xy"][1], brain["uv"][0])
    with pytest.raises(
        cosim.ConnectionError, match=r"^The input brain\.force has no source and no start value; connect"
    ):
        diagram.build()
    diagram.connect(plant["xy"][1], brain["force"])
    with pytest.raises(cosim.ConnectionError, match=r"^The input brain\.uv\[1\] has no source"):
        diagram.build()


def test_elements_lists_and_iteration(parts, run_both):
    diagram, plant, brain = parts
    diagram.connect(reversed_(plant["xy"]), brain["uv"])
    diagram.connect(plant["P"][-1:], brain["force"])
    diagram.connect(plant["P"][2], brain["way"])
    assert plant["P"][1:3].name == "plant.P[1, 2]"
    assert [r.name for r in plant["xy"]] == ["plant.xy[0]", "plant.xy[1]"]
    assert len(plant["P"]) == 4
    result = run_both(diagram, 0, record=["brain.uv", "brain.force", "brain.way", "brain.opt", "plant.*"])
    assert result["brain.uv"].tolist() == [[11.0, 10.0]]
    assert result["brain.force"].tolist() == [3.0]
    assert result["brain.way"].tolist() == [2.0]
    assert result["brain.opt"].tolist() == [3.0]
    assert result["plant.P"].tolist() == [[[0.0, 1.0], [2.0, 3.0]]]


def reversed_(reference):
    return tuple(reference)[::-1]


@pytest.mark.parametrize("index", [2, -3, slice(2, 9), "x", 1.5, (0, 1), None])
def test_elements_that_are_not_there(parts, index):
    with pytest.raises(cosim.ConnectionError, match=r"plant\.xy has 2 elements, numbered from 0"):
        parts[1]["xy"][index]


def test_units_in_another_spelling_are_the_same(make_block):
    for a, b in [("N.m", "N*m"), ("N·m", "N m".replace(" ", "*")), ("m/s", " m / s "), (None, "m"), ("m", None)]:
        diagram = cosim.Diagram(1)
        source = diagram.add(cosim.Constant(1.0, unit=a))
        diagram.connect(source["y"], diagram.add(make_block(inputs=[Port("u", unit=b)]))["u"])


def test_of_many_names_the_first_are_listed():
    assert (
        did_you_mean("pump.toml", ["car.toml", "s.toml"]) == "known names: car.toml, s.toml."
    )  # only the ending is shared
    assert did_you_mean("car.speed", ["plant.speed", "plant.u"]) == "did you mean 'plant.speed'?"
    signals = ["controller.y", "plant.gust", "plant.position", "plant.torque"]  # all begin alike
    assert did_you_mean("plant.positon", signals) == "did you mean 'plant.position'?"
    assert did_you_mean("zzz", ["g", "body.m"]) == "known names: body.m, g."
    assert did_you_mean("plant.speed", signals) == "known names: plant.gust, plant.position, plant.torque."
    assert did_you_mean("pmp.toml", ["car.toml", "pump.toml"]) == "did you mean 'pump.toml'?"
    assert did_you_mean("zzz", map(str, range(100, 115))).endswith("110, 111, and 3 more.")


def test_unknown_names_list_the_near_ones(parts):
    diagram, plant, _ = parts
    with pytest.raises(cosim.UnknownNameError) as caught:
        plant["sped"]
    assert str(caught.value) == "Block 'plant' has no port 'sped'; did you mean 'speed'?"
    with pytest.raises(cosim.UnknownNameError, match=r"known names: P, force|known names: P, speed, xy"):
        plant["zzz"]
    with pytest.raises(cosim.UnknownNameError, match="no port 'p'; did you mean 'P'"):
        plant["p"]
    with pytest.raises(cosim.UnknownNameError, match="no port 0"):
        plant[0]
    with pytest.raises(cosim.UnknownNameError, match="no block 'plan'; did you mean 'plant'"):
        diagram["plan"]
    with pytest.raises(KeyError):
        diagram["plan"]
    with pytest.raises(cosim.UnknownNameError, match="there are none"):
        diagram.add(cosim.Block(), "bare")["u"]
    assert diagram["plant"] is plant
    with pytest.raises(cosim.UnknownNameError, match="Sine has no port 'x'"):
        cosim.Sine(1.0, 2.0).port("x")


def test_names():
    diagram = cosim.Diagram(1)
    assert diagram.add(cosim.Constant(1.0)).name == "constant"
    with pytest.raises(cosim.ModelError, match="already has a block 'constant'; give this Constant another name="):
        diagram.add(cosim.Constant(2.0))
    for wrong in ("", "a b", "a\tb", 3, None if False else 1.5):
        with pytest.raises(cosim.ModelError, match="cannot be a block's name"):
            diagram.add(cosim.Constant(2.0), wrong)
    for name in ("größe", "速度", "x" * 300, "a.b", "a[0]", "*"):
        diagram.add(cosim.Constant(2.0), name)
    result = diagram.simulate(1)
    assert result["größe.y"].tolist() == result["速度.y"].tolist() == result["x" * 300 + ".y"].tolist() == [2.0, 2.0]
    assert list(diagram.simulate(1, record=["*.y"])) == ["*.y"]  # a name goes before a pattern
    assert list(diagram.simulate(1, record=["a[0].y"])) == ["a[0].y"]


def test_signals_of_the_same_name_are_refused(make_block):
    def write(q):
        q[0] = 1.0

    diagram = cosim.Diagram(1)
    diagram.add(make_block(outputs=[Port("q")], output=write), "a.b")
    other = make_block(outputs=[Port("b.q")], output=lambda outputs: None)
    diagram.add(other, "a")
    with pytest.raises(
        cosim.ModelError, match=r"'a\.b' and 'a' both have a signal 'a\.b\.q'; give one of them another name"
    ):
        diagram.build()


def test_what_is_no_block():
    for wrong in (3, cosim.Gain, None, "gain"):
        with pytest.raises(cosim.ModelError, match="Only blocks can be added to a diagram"):
            cosim.Diagram(1).add(wrong)


@pytest.mark.parametrize("wrong", [0, -1, 1.5, "2", math.nan, math.inf, None, 2**70])
def test_every(wrong):
    with pytest.raises(
        cosim.ModelError, match=r"Block 'gain' has every=.*; it must be a whole number of steps, at least 1"
    ):
        cosim.Diagram(1).add(cosim.Gain(1.0), every=wrong)


def test_frozen_after_building(parts):
    diagram = cosim.Diagram(1)
    node = diagram.add(cosim.Constant(1.0))
    gain = diagram.add(cosim.Gain(1.0))
    diagram.connect(node["y"], gain["u"])
    assert diagram.build() is diagram
    for change in (lambda d: d.add(cosim.Constant(2.0), "two"), lambda d: d.connect(node["y"], gain["u"])):
        with pytest.raises(cosim.ModelError, match="is built and frozen"):
            change(diagram)
        with pytest.raises(cosim.ModelError, match="is built and frozen"):
            change(pickle.loads(pickle.dumps(diagram)))
    assert "2 blocks at 1 s: constant, gain" in repr(diagram)


def test_coupling_is_chosen_once_and_kept():
    with pytest.raises(
        cosim.ModelError, match="coupling is 'jakobi'; it must be 'gauss-seidel', 'jacobi' or 'iterated'"
    ):
        cosim.Diagram(1).build("jakobi")
    diagram = cosim.Diagram(1).build("jacobi")
    assert diagram.build().schedule.coupling.method == "jacobi"
    with pytest.raises(cosim.ModelError, match="is already built with jacobi coupling"):
        diagram.build("gauss-seidel")
    assert pickle.loads(pickle.dumps(diagram)).schedule.coupling.method == "jacobi"
    assert cosim.Diagram(1).build().schedule.coupling.method == "gauss-seidel"


def test_copies_are_independent_and_run_alike(same_bits):
    diagram = cosim.Diagram("1/30")
    noise, total = diagram.add(cosim.Gaussian(1.0)), diagram.add(cosim.UnitDelay(), "total")
    diagram.connect(noise["y"], total["u"])
    for make in (copy.copy, copy.deepcopy, lambda d: pickle.loads(pickle.dumps(d))):
        twin = make(diagram)
        assert twin.step == diagram.step
        twin.add(cosim.Constant(1.0), "more")
        assert [n.name for n in diagram.nodes] == ["gaussian", "total"]
        same_bits(
            twin.simulate(1, seed=3)["total.y"],
            diagram.__class__.simulate(copy.deepcopy(diagram), 1, seed=3)["total.y"],
        )


def test_a_block_can_stand_in_a_diagram_twice(run_both):
    block, diagram = cosim.UnitDelay(initial=5.0), cosim.Diagram(1)
    a, b = diagram.add(block, "a"), diagram.add(block, "b")
    diagram.connect(diagram.add(cosim.Ramp(1.0))["y"], a["u"])
    diagram.connect(a["y"], b["u"])
    result = run_both(diagram, 3)
    assert result["a.y"].tolist() == [5, 0, 1, 2]
    assert result["b.y"].tolist() == [5, 5, 0, 1]


def test_empty_diagram(run_both):
    result = run_both(cosim.Diagram("1/30"), 1)
    assert len(result) == 0
    assert len(result.time) == 31
    assert result.to_pandas().shape == (31, 0)
    assert list(result.to_xarray().coords) == ["time"]


def test_blocks_without_outputs_and_outputs_that_nobody_reads(make_block, run_both):
    def swallow(u, kept):
        kept[0] = kept[0] + u[0]

    diagram = cosim.Diagram(1)
    source = diagram.add(cosim.Constant(1.0), "unread")
    for name, parts in {"early": {"output": swallow}, "late": {"update": swallow}, "never": {}}.items():
        sink = make_block(inputs=[Port("u", feedthrough=name != "late")], state={"kept": 0.0}, **parts)
        diagram.connect(source["y"], diagram.add(sink, name)["u"])
    result = run_both(diagram, 3, record=["unread.y", "early.u", "late.u", "never.u"])
    for name in ("early", "late", "never"):
        assert result[f"{name}.u"].tolist() == [1.0] * 4


def test_sizes_one_and_scalar_fit(run_both):
    diagram = cosim.Diagram(1)
    one = diagram.add(cosim.Gaussian([1.0]), "one")
    gain = diagram.add(cosim.Gain(2.0))
    diagram.connect(one["y"], gain["u"])
    result = run_both(diagram, 2)
    assert result["one.y"].shape == (3, 1)
    assert result["gain.y"].shape == (3,)
    np.testing.assert_array_equal(result["one.y"][:, 0] * 2, result["gain.y"])


@pytest.mark.parametrize(
    "make",
    [lambda: Port("a", (0,)), lambda: Port("a", (2, -1)), lambda: Port("a", 3), lambda: Port("a", [3]), lambda: Port("a", (1.5,)),
     lambda: Port("a", draw="gauss")],
)  # fmt: skip
def test_ports_that_cannot_be(make):
    with pytest.raises(cosim.ModelError, match=r"^Port 'a' has "):
        make()


@pytest.mark.slow
def test_large_diagrams_are_built_in_reasonable_time(python):
    seconds = python(
        "import time; from bayesftc import cosim\n"
        "d = cosim.Diagram(1); last = d.add(cosim.Constant(1.0))\n"
        "for i in range(2000):\n"
        "    node = d.add(cosim.Gain(1.0), f'g{i}'); d.connect(last['y'], node['u']); last = node\n"
        "t = time.process_time(); d.build(); print(time.process_time() - t)"
    )
    assert seconds < 5.0  # it takes 0.1 s; a cubic search for the order takes minutes
