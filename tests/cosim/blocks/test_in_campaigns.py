"""The blocks in campaigns: many runs, one after the other in the same memory, are the runs alone."""

from bayesftc import cosim

FED = (
    cosim.Abs(),
    cosim.Sign(),
    cosim.DeadZone(-0.5, 0.3),
    cosim.Quantizer(0.25),
    cosim.Polynomial([1.0, -2.0, 0.5]),
    cosim.LookupTable([-1.0, 0.0, 2.0], [3.0, 1.0, -1.0]),
    cosim.Integrator(1.0, low=-2.0, high=3.0),
    cosim.ExponentialFilter(0.3),
    cosim.MovingAverage(3),
    cosim.RateLimiter(2.0, 1.0),
    cosim.Hysteresis(0.5, -0.5),
    cosim.Counter(limit=3.0),
    cosim.TransferFunction([1.0, 2.0], [1.0, 0.6, 1.0]),
)
PAIRED = (
    cosim.Product("*/"),
    cosim.Minimum(),
    cosim.Maximum(),
    cosim.Compare("<="),
    *(cosim.Logic(name) for name in ("and", "or", "xor")),
)
SOURCES = (
    cosim.Pulse(2.0, period=0.4),
    cosim.PRBS(1.0, interval=0.2, order=5),
    cosim.Chirp(1.0, 0.5, 2.0, 3.0),
    cosim.Table([0.0, 1.0, 2.5], [1.0, -1.0, 4.0]),
)


def test_every_block(campaign_as_alone):
    diagram = cosim.Diagram(dt=0.1)
    one, two = (diagram.add(cosim.Gaussian(1.0), name)["y"] for name in ("one", "two"))
    for i, block in enumerate(SOURCES):
        diagram.add(block, f"source_{i}")
    for i, block in enumerate(FED):
        diagram.connect(one, diagram.add(block, f"fed_{i}")["u"])
    for i, block in enumerate(PAIRED):
        diagram.connect([one, two], diagram.add(block, f"paired_{i}")["u"])
    for name, block, ports in (
        ("switch", cosim.Switch(), ("condition", "above", "otherwise")),
        ("hold", cosim.SampleAndHold(), ("u", "trigger")),
        ("late", cosim.VariableDelay(0.4), ("u", "delay")),
        ("plane", cosim.LookupTable2D([-1.0, 1.0], [0.0, 1.0], [[3.0, 1.0], [-1.0, 0.5]]), ("u", "v")),
        ("sum", cosim.Integrator(reset=True), ("u", "reset")),
    ):
        node = diagram.add(block, name)
        for i, port in enumerate(ports):
            diagram.connect((two, one)[i % 2], node[port])
    points = {"fed_2.high": [0.3, 0.6], "fed_6.initial": [0.0, 1.0]}
    assert (campaign_as_alone(diagram, 4.0, points=points)["status"] == "ok").all()
