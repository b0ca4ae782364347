"""The blocks in campaigns: many runs, one after the other in the same memory, are the runs alone."""

from block_kinds import BLOCKS, DT

from bayesftc import cosim


def test_every_block(campaign_as_alone):
    diagram = cosim.Diagram(DT)
    noises = [diagram.add(cosim.Gaussian(1.0), name)["y"] for name in ("one", "two")]
    names = {kind: kind.replace(" ", "_") for kind in BLOCKS}
    for kind, block in BLOCKS.items():
        node = diagram.add(block, names[kind])
        elements = [node[port.name][e] for port in node.inputs if port.draw is None for e in range(port.size)]
        for i, element in enumerate(elements):
            if element.port.name != "inside":
                diagram.connect(noises[i % 2], element)
    points = {"dead_zone.high": [0.3, 0.6], "integrator.initial": [0.0, 1.0]}
    assert (campaign_as_alone(diagram, 4.0, points=points)["status"] == "ok").all()
