"""Cruise control of a car with gears: the gain follows a table of speed and gear, so that every gear answers alike.

``python -m bayesftc.examples.parts.gain_scheduling`` prints how long a step of the goal takes with a fixed and a scheduled gain.
"""

from __future__ import annotations

import numpy as np

from bayesftc import cosim

MASS = 1000.0
"""Kilograms."""
SPEEDS, GEARS = (5.0, 15.0, 25.0), (2.0, 3.0, 4.0)
FORCE = ((9000.0, 6000.0, 3500.0), (7000.0, 5000.0, 3200.0), (4500.0, 3800.0, 2800.0))
"""Newton at full throttle, by speed in m/s and gear."""
DRAG = (0.6, 0.0, 0.0)
"""Coefficients of the air drag, which is 0.6 v^2."""


def loop(gear: float, scheduled: bool) -> cosim.Diagram:
    """Return the loop: an error in speed becomes a force, and the force becomes a throttle by the table or by its middle."""
    diagram = cosim.Diagram(dt=0.02)
    goal = diagram.add(cosim.Step(time=2.0, before=10.0, after=12.0), "goal")
    shift = diagram.add(cosim.Constant(gear), "gear")
    car = diagram.add(cosim.Integrator(initial=10.0, low=0.0), "car")
    error = diagram.add(cosim.Sum("+-"), "error")
    play = diagram.add(cosim.DeadZone(-0.01, 0.01), "play")
    law = diagram.add(cosim.Gain(2000.0, offset=160.0), "law")  # N/(m/s); at 10 m/s there are 160 N
    table = diagram.add(cosim.LookupTable2D(SPEEDS, GEARS, FORCE), "table")
    middle = diagram.add(cosim.Constant(float(np.mean(FORCE))), "middle")
    throttle = diagram.add(cosim.Product("*/"), "throttle")
    open_, closed = diagram.add(cosim.Minimum(), "open"), diagram.add(cosim.Maximum(), "closed")
    pedal = diagram.add(cosim.RateLimiter(rising=1.0, falling=4.0), "pedal")
    limit = diagram.add(cosim.Saturation(0.0, 1.0), "limit")
    engine = diagram.add(cosim.Product("**"), "engine")
    air, rolling = diagram.add(cosim.Polynomial(DRAG), "air"), diagram.add(cosim.Sign(), "rolling")
    friction = diagram.add(cosim.Gain(100.0), "friction")  # of the wheels, in N
    force = diagram.add(cosim.Sum("+--"), "force")
    speed_up = diagram.add(cosim.Gain(1.0 / MASS), "speed_up")

    diagram.connect([goal["y"], car["y"]], error["u"])
    diagram.connect(car["y"], table["u"])
    diagram.connect(shift["y"], table["v"])
    diagram.connect([law["y"], (table if scheduled else middle)["y"]], throttle["u"])
    diagram.connect([throttle["y"], diagram.add(cosim.Constant(1.0), "full")["y"]], open_["u"])
    diagram.connect([open_["y"], diagram.add(cosim.Constant(0.0), "none")["y"]], closed["u"])
    for one, other in ((error, play), (play, law), (closed, pedal), (pedal, limit), (rolling, friction)):
        diagram.connect(one["y"], other["u"])
    diagram.connect([limit["y"], table["y"]], engine["u"])
    for block in (air, rolling):
        diagram.connect(car["y"], block["u"])
    diagram.connect([engine["y"], air["y"], friction["y"]], force["u"])
    diagram.connect(force["y"], speed_up["u"])
    diagram.connect(speed_up["y"], car["u"])
    return diagram


def main() -> dict[tuple[str, float], float]:
    """Return the seconds to 90 % of the step, by way and gear."""
    found = {}
    for way in ("fixed", "scheduled"):
        for gear in GEARS:
            result = loop(gear, way == "scheduled").simulate(10.0)
            found[way, gear] = float(result.time[np.argmax(result["car.y"] >= 11.8)] - 2.0)
        print(f"{way:9} gain: " + ", ".join(f"{found[way, gear]:.2f} s in gear {gear:.0f}" for gear in GEARS))
    return found


if __name__ == "__main__":
    main()
