"""Two coupled FMUs in the compiled engine: a car that follows another or is towed by it, and a live run step by step."""

from __future__ import annotations

import time

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns
from bayesftc.bench._slave import CAR
from bayesftc.cosim.diagram.diagram import Diagram

STEP = 0.02
EVERY = 100


def platoon() -> Diagram:
    """Return two cars: the first follows a sine with a limited force, the second follows the first."""
    from bayesftc import cosim, fmus

    diagram = cosim.Diagram(STEP)
    first, second = (diagram.add(cosim.FMU(fmus.path(CAR), inputs=["force"]), name) for name in ("first", "second"))
    speed = diagram.add(cosim.Sine(amplitude=5.0, period=8.0, offset=20.0), "speed")
    behind, apart = (diagram.add(cosim.Sum("+-"), name) for name in ("behind", "apart"))
    engine, pursuit = (diagram.add(cosim.Gain(800.0), name) for name in ("engine", "pursuit"))
    limit = diagram.add(cosim.Saturation(-5_000.0, 5_000.0), "limit")
    for source, target in (
        ([speed["y"], first["v"]], behind["u"]),
        (behind["y"], engine["u"]),
        (engine["y"], limit["u"]),
        (limit["y"], first["force"]),
        ([first["v"], second["v"]], apart["u"]),
        (apart["y"], pursuit["u"]),
        (pursuit["y"], second["force"]),
    ):
        diagram.connect(source, target)
    return diagram


def towed() -> Diagram:
    """Return two cars on a rope that is so stiff that only iterated steps are stable."""
    from bayesftc import cosim, fmus

    diagram = cosim.Diagram(STEP)
    engine = diagram.add(cosim.Constant(500.0), "engine")
    car, trailer = (diagram.add(cosim.FMU(fmus.path(CAR), inputs=["force"]), name) for name in ("car", "trailer"))
    slip, rest = (diagram.add(cosim.Sum("+-"), name) for name in ("slip", "rest"))
    rope = diagram.add(cosim.Gain(50_000.0), "rope")
    for source, target in (
        ([car["v"], trailer["v"]], slip["u"]),
        (slip["y"], rope["u"]),
        ([engine["y"], rope["y"]], rest["u"]),
        (rest["y"], car["force"]),
        (rope["y"], trailer["force"]),
    ):
        diagram.connect(source, target)
    return diagram.build("iterated")


def measure(quick: bool = False) -> Section:
    """Measure the steps per second, and the difference of the speeds of both engines."""
    steps, rounds = (20_000, 2) if quick else (3_000_000, 7)
    diagram = platoon()
    both = [diagram.simulate(20.0, engine=engine)["second.v"] for engine in ("compiled", "interpreted")]

    apart = [float(np.abs(both[0] - both[1]).max())]

    def rate() -> float:
        started = time.perf_counter()
        diagram.simulate(steps * diagram.step, record=["second.v"], decimation=EVERY)
        return steps / (time.perf_counter() - started)

    rope = towed()
    rope.simulate(1.0)  # compiles

    def iterated() -> float:
        started = time.perf_counter()
        rope.simulate(steps // 10 * rope.step, record=["car.v"], decimation=EVERY)
        return steps // 10 / (time.perf_counter() - started)

    def pieces() -> float:
        count, size = steps // 100, float(diagram.step)
        with diagram.start() as session:
            started = time.perf_counter()
            for _ in range(count):
                session.advance(size)
            return count / (time.perf_counter() - started)

    rates = in_turns({"engine": rate, "iterated": iterated, "pieces": pieces}, rounds)
    return Section(
        "coupled",
        "Two coupled FMUs with six blocks",
        (
            Figure("engine", "compiled engine, one core", "steps/s", rates["engine"], 3e6),
            Figure("iterated", "two on a stiff rope, iterated", "steps/s", rates["iterated"]),
            Figure("pieces", "the first as a live run, a step at a time", "steps/s", rates["pieces"]),
            Figure(
                "difference", "largest difference of the speeds, compiled and interpreted", "m/s", apart, at_most=0.0
            ),
        ),
    )
