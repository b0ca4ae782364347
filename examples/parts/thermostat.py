"""A room heated by a relay with hysteresis: a late pipe, a noisy sensor, and an evening that gets colder.

``python -m bayesftc.examples.parts.thermostat`` prints how far the temperature is from the goal and how often the burner starts.
"""

from __future__ import annotations

from bayesftc import cosim

GOAL = 20.0
"""Degrees Celsius."""


def house(width: float) -> cosim.Diagram:
    """Return the room with a thermostat that switches at `width` degrees around the goal.

    The room: dT/dt = 0.01 (heat - (T - T_outside)) in degrees per minute.
    """
    diagram = cosim.Diagram(dt=0.1)  # minutes
    outside = diagram.add(cosim.Ramp(slope=-0.02, offset=5.0, start=60.0), "outside")
    noise = diagram.add(cosim.Gaussian(std=0.2), "noise")
    room = diagram.add(cosim.Integrator(initial=15.0), "room")
    sensor = diagram.add(cosim.Sum("++"), "sensor")
    smooth = diagram.add(cosim.MovingAverage(10), "smooth")
    cold = diagram.add(cosim.Gain(-1.0, offset=GOAL), "cold")
    burner = diagram.add(cosim.Hysteresis(on=width, off=-width, high=30.0), "burner")
    pipe = diagram.add(cosim.VariableDelay(longest=5.0), "pipe")
    late = diagram.add(cosim.Constant(2.0), "late")  # minutes from the burner to the room
    balance = diagram.add(cosim.Sum("+-+"), "balance")
    change = diagram.add(cosim.Gain(0.01), "change")
    starts = diagram.add(cosim.Counter(), "starts")
    error = diagram.add(cosim.Abs(), "error")

    diagram.connect([room["y"], noise["y"]], sensor["u"])
    for one, other in ((sensor, smooth), (smooth, cold), (cold, burner), (burner, pipe), (burner, starts)):
        diagram.connect(one["y"], other["u"])
    diagram.connect(late["y"], pipe["delay"])
    diagram.connect([pipe["y"], room["y"], outside["y"]], balance["u"])
    diagram.connect(balance["y"], change["u"])
    diagram.connect(change["y"], room["u"])
    diagram.connect(cold["y"], error["u"])
    return diagram


def main(hours: float = 8.0) -> dict[float, tuple[float, float]]:
    """Return for each width the largest error after the first two hours, in degrees, and the number of starts."""
    found = {}
    for width in (0.2, 0.5, 1.0):
        result = house(width).simulate(60.0 * hours, seed=1)
        found[width] = float(result["error.y"][1200:].max()), float(result["starts.y"][-1])
        print(f"+-{width:3.1f} degrees: at most {found[width][0]:.2f} degrees off, {found[width][1]:2.0f} starts")
    return found


if __name__ == "__main__":
    main()
