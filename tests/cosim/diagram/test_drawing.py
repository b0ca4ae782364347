"""Drawings of diagrams: each block and connection once, from left to right, well-formed and escaped."""

import re
from xml.etree import ElementTree

import pytest

from bayesftc import cosim
from bayesftc.cosim.diagram.drawing import MOST_BLOCKS
from bayesftc.scenario import load_scenario

SVG = "{http://www.w3.org/2000/svg}"


def drawn(diagram):
    """Places of the blocks' frames by name, and the connections by their hints."""
    tree = ElementTree.fromstring(f"<body>{diagram._repr_html_()}</body>")
    boxes = {}
    for group in tree.iter(f"{SVG}g"):
        frame = group.find(f"{SVG}rect")
        boxes[group.find(f"{SVG}text").text] = tuple(float(frame.get(n)) for n in ("x", "y", "width", "height"))
    wires = {path.find(f"{SVG}title").text: path.get("d") for path in tree.iter(f"{SVG}path") if len(path)}
    return boxes, wires


def test_a_closed_loop_is_drawn_from_left_to_right():
    loop = load_scenario("cruise_control").loop()
    boxes, wires = drawn(loop)
    assert set(boxes) == {node.name for node in loop.nodes}
    assert set(wires) == {
        "reference.y to controller.goal", "freeze_0.y to controller.y", "controller.u to plant.force",
        "disturbance_noise.y to plant.disturbance", "plant.v to sensors.u", "sensors.y to freeze_0.u",
    }  # fmt: skip
    order = ["reference", "controller", "plant", "sensors", "freeze_0"]
    places = [boxes[name][0] for name in order]
    assert places == sorted(places)
    assert boxes["disturbance_noise"][0] == boxes["controller"][0]  # right before what it feeds
    back = re.findall(r"V([\d.]+)", wires["freeze_0.y to controller.y"])[0]
    assert float(back) >= max(y + height for _, y, _, height in boxes.values())  # below all blocks
    frames = list(boxes.values())
    for i, (x, y, width, height) in enumerate(frames):
        for a, b, c, d in frames[:i]:
            assert x + width <= a or a + c <= x or y + height <= b or b + d <= y


def test_a_line_that_passes_a_column_goes_above_it():
    diagram = cosim.Diagram(0.1)
    one, gain = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Gain(2.0), "twice")
    total = diagram.add(cosim.Sum("++"), "sum")
    diagram.connect(one["y"], gain["u"])
    diagram.connect([gain["y"], one["y"]], total["u"])
    boxes, wires = drawn(diagram)
    around = float(re.findall(r"V([\d.]+)", wires["one.y to sum.u"])[0])
    assert around <= min(y for _, y, _, _ in boxes.values())


def test_names_are_escaped():
    diagram = cosim.Diagram(0.1)
    diagram.add(cosim.Constant(1.0), "<b>&")
    assert "<b>&<" not in diagram._repr_html_()
    assert list(drawn(diagram)[0]) == ["<b>&"]


@pytest.mark.parametrize("count", [0, 1, MOST_BLOCKS + 1])
def test_from_no_block_to_very_many(count):
    diagram = cosim.Diagram(0.1)
    for i in range(count):
        diagram.add(cosim.Constant(1.0), f"c{i}")
    html = diagram._repr_html_()
    assert ("<svg" in html) == (0 < count <= MOST_BLOCKS)
    assert html.count(f"c{count - 1}") >= min(count, 1)
