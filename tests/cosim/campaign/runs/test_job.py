"""The runs of a piece: the signals of each point are those of the first."""

import pytest

from bayesftc import cosim


def loop(fault):
    """Return a sine with a fault, whose block is called after the fault unless that has a name."""
    diagram = cosim.Diagram(dt=0.1)
    sine = diagram.add(cosim.Sine(1.0, 1.0), "sine")
    node = diagram.add(fault, fault.name or type(fault).__name__.lower())
    diagram.connect(sine["y"], node["u"])
    return diagram


def campaign(record, **options):
    faults = {kind.__name__: kind(start=0.5, channels=1, **options) for kind in (cosim.Freeze, cosim.Dropout)}
    return cosim.Campaign(loop, duration=1.0, grid={"fault": faults}, record=[record])


@pytest.mark.parametrize(
    ("record", "said"),
    [
        ("freeze.active", "There is no signal 'freeze.active' to record"),
        ("*.active", "This point has no signal 'freeze.active', but the first point has it."),
    ],
)
def test_a_name_that_does_not_exist_at_every_point_fails_with_the_remedy(record, said):
    table = campaign(record).run().table
    assert table["status"].tolist() == ["ok", "failed"]
    assert said in table["reason"][1]
    assert "give their blocks the same name everywhere (name=...)" in table["reason"][1]


def test_the_remedy_helps():
    result = campaign("f.active", name="f").run()
    assert result.table["status"].tolist() == ["ok", "ok"]
    assert result.dataset["f.active"].to_numpy().any(axis=1).tolist() == [True, True]


@pytest.mark.parametrize(
    ("width", "said"),
    [
        (2, "The signal 'a.y' has the shape (2,), but (1,) at the first point."),
        (0, "This point has the signal 'b.y', which the first point does not have."),
    ],
)
def test_signals_of_another_shape_and_further_ones_are_named(width, said):
    def sources(width):
        diagram, count = cosim.Diagram(dt=0.1), max(width, 1)
        one, held = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Freeze(channels=count), "a")
        for i in range(count):
            diagram.connect(one["y"], held["u"][i])
        if not width:
            diagram.add(cosim.Constant(1.0), "b")
        return diagram

    table = cosim.Campaign(sources, duration=1.0, grid={"width": [1, width]}, record=["*"]).run().table
    assert said in table["reason"][1]
