"""A crossing with a button for pedestrians: a clock, a program of phases, and logic.

``python -m bayesftc.examples.parts.traffic_light`` prints each second of the first minute.
"""

from __future__ import annotations

from bayesftc import cosim

CYCLE = 20
"""Seconds of a cycle."""
RED, YELLOW, GREEN = 0.0, 1.0, 2.0
PROGRAM = cosim.LookupTable([0.0, 9.0, 11.0, 18.0], [GREEN, YELLOW, RED, YELLOW], interpolate=False)
"""What cars see, by the second of the cycle."""


def crossing(presses: tuple[float, ...] = (5.0, 33.0, 52.0)) -> cosim.Diagram:
    """Return the diagram; the button is pressed for a second at each of these times in seconds."""
    diagram = cosim.Diagram(dt=0.5)
    times = sorted({0.0, *presses, *(t + 1.0 for t in presses)})
    button = diagram.add(cosim.Table(times, [float(t in presses) for t in times], interpolate=False), "button")
    clock = diagram.add(cosim.Pulse(1.0, period=1.0, start=1.0), "clock")
    second = diagram.add(cosim.Counter(limit=CYCLE), "second")
    diagram.connect(clock["y"], second["u"])

    cars = diagram.add(PROGRAM, "cars")
    diagram.connect(second["y"], cars["u"])
    is_red = diagram.add(cosim.Compare("=="), "is_red")
    diagram.connect([cars["y"], diagram.add(cosim.Constant(RED), "red")["y"]], is_red["u"])

    # A request lives from the press of the button to the end of the walk.
    request = diagram.add(cosim.Logic("or"), "request")
    walk = diagram.add(cosim.Logic("and"), "walk")
    waiting = diagram.add(cosim.Logic("and"), "waiting")
    before, ended = diagram.add(cosim.UnitDelay(), "before"), diagram.add(cosim.Logic("not"), "ended")
    over = diagram.add(cosim.Compare(">="), "over")
    diagram.connect([second["y"], diagram.add(cosim.Constant(17.0), "last")["y"]], over["u"])
    diagram.connect(over["y"], ended["u"])
    diagram.connect([button["y"], before["y"]], request["u"])
    diagram.connect([request["y"], is_red["y"]], walk["u"])
    diagram.connect([request["y"], ended["y"]], waiting["u"])
    diagram.connect(waiting["y"], before["u"])

    left = diagram.add(cosim.Sum("+-"), "left")
    diagram.connect([diagram.add(cosim.Constant(18.0), "end")["y"], second["y"]], left["u"])
    display = diagram.add(cosim.Switch(), "display")  # seconds that remain for walking
    diagram.connect(walk["y"], display["condition"])
    diagram.connect(left["y"], display["above"])
    diagram.connect(diagram.add(cosim.Constant(0.0), "dark")["y"], display["otherwise"])
    return diagram


def main(duration: float = 60.0) -> cosim.Result:
    """Run the crossing, print what cars and pedestrians see, and return the result."""
    result = crossing().simulate(duration)
    signals = (result.time, *(result[f"{name}.y"] for name in ("second", "cars", "walk", "display")))
    for t, second, cars, walk, display in zip(*(values[::2] for values in signals)):
        sign = f"walk {display:2.0f}" if walk else "wait"
        print(f"{t:3.0f} s  second {second:2.0f} of the cycle  cars {('red', 'yellow', 'green')[int(cars)]:6}  {sign}")
    return result


if __name__ == "__main__":
    main()
