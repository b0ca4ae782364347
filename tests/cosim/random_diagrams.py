"""Random diagrams: blocks at random rates, randomly connected, outside or in a subsystem or in a subsystem of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from hypothesis import strategies as st

from bayesftc import cosim
from bayesftc.cosim.ports import labels

PATHS = ("", "part.", "part.deep.")
"""Where a block stands: outside, in a subsystem, in a subsystem of it."""

Element = tuple[int, str, int]
"""Number of a block, name of a port, element."""


class Plan(NamedTuple):
    """A diagram: its step, its blocks with what is known of them and their rates, the source of each element of an input.

    Blocks are added in an order of their own, each at one of the `PATHS`.
    """

    step: str
    blocks: list[tuple[Any, cosim.Block, int]]
    wires: dict[Element, Element]
    order: list[int]
    levels: list[int]

    @property
    def names(self):
        """The name of each block in the diagram."""
        return [f"{PATHS[level]}b{i}" for i, level in enumerate(self.levels)]


def inputs_of(block):
    """Return the elements of the inputs that are not random, each as a port and a number."""
    return [(port, e) for port in block.inputs if port.draw is None for e in range(port.size)]


def elements_of(i, block):
    """Return the elements of the outputs."""
    return [(i, port.name, e) for port in block.outputs for e in range(port.size)]


@st.composite
def plans(draw, drawn, step, most=9):
    """A plan of blocks that `drawn` returns, each with what the test knows of it; the first makes noise.

    Without an algebraic loop: an input that feeds through gets an output of an earlier block, any other of any block.
    """
    first = ("noise", 0.0), cosim.Gaussian((2.0, 0.5))
    chosen = [first, *draw(st.lists(drawn, min_size=2, max_size=most))]
    rates = [1 if block.sample_time else draw(st.sampled_from([1, 1, 2, 3, 5])) for _, block in chosen]
    levels = [draw(st.sampled_from([0, 0, 1, 2])) for _ in chosen]
    outputs = [elements_of(i, block) for i, (_, block) in enumerate(chosen)]
    wires = {}
    for i, (_, block) in enumerate(chosen):
        for port, e in inputs_of(block):
            sources = outputs[:i] if port.feedthrough else outputs
            wires[i, port.name, e] = draw(st.sampled_from([source for each in sources for source in each]))
    blocks = [(known, block, every) for (known, block), every in zip(chosen, rates, strict=True)]
    return Plan(step, blocks, wires, draw(st.permutations(range(len(blocks)))), levels)


def _watching(plan, i, block):
    """Return a block whose conditions, if it has any, are on the signals that feed it in the plan, by their names."""
    conditions = {}
    for name in block.named_sources:
        j, port, e = plan.wires[i, name, 0]
        source = next(each for each in plan.blocks[j][1].outputs if each.name == port)
        path = "" if plan.levels[i] == plan.levels[j] else PATHS[plan.levels[j]]
        signal = labels(f"{path}b{j}.{port}", source.shape)[e]
        side = name.removesuffix("_signal")
        conditions[side] = replace(getattr(block, side), signal=signal)
    return replace(block, **conditions) if conditions else block


def build(plan, level=0):
    """Return the diagram of a level, the outputs of its blocks and of those inside, and the inputs that are fed from outside."""
    diagram, outputs, inputs = cosim.Diagram(plan.step), {}, {}
    for i in [i for i in plan.order if plan.levels[i] == level]:
        _, block, every = plan.blocks[i]
        node = diagram.add(_watching(plan, i, block), f"b{i}", every=every)
        outputs |= {(i, port.name): node[port.name] for port in node.outputs}
        inputs |= {
            (i, port.name, e): node[port.name][e]
            for port, e in inputs_of(block)
            if port.name not in block.named_sources
        }
    if any(each > level for each in plan.levels):
        inside, inner_outputs, inner_inputs = build(plan, level + 1)
        ports = {"u{}_{}_{}".format(*place): port for place, port in inner_inputs.items()}
        shown = {"y{}_{}".format(*place): port for place, port in inner_outputs.items()}
        node = diagram.add(cosim.Subsystem(inside, inputs=ports, outputs=shown), PATHS[level + 1].split(".")[level])
        outputs |= {place: node["y{}_{}".format(*place)] for place in inner_outputs}
        inputs |= {place: node["u{}_{}_{}".format(*place)] for place in inner_inputs}
    outside = {}
    for place, port in inputs.items():
        i, name, e = plan.wires[place]
        if (i, name) in outputs:
            diagram.connect(outputs[i, name][e], port)
        else:
            outside[place] = port
    return diagram, outputs, outside
