"""A car that runs by itself: an FMU in real time, with two speed sensors, of which one freezes.

    python -m bayesftc.examples.live_car.car --duration 60 --freeze 10

It sends its speeds by UDP and gets the force of its engine, as a real car with a network would. Its controller is another
process: ``bayesftc live live_car --bridge car_by_udp``.
"""

from __future__ import annotations

import argparse
from math import sqrt

from bayesftc import cosim, fmus
from bayesftc.cosim import live

KMH = 3.6
"""km/h in a m/s."""

HOLDS = 100.0
"""Force in N that holds the car's first speed, before there is a controller."""


def car(freeze: float) -> cosim.Diagram:
    """Return the car, whose first sensor is frozen for eight seconds from `freeze` (seconds) on."""
    diagram = cosim.Diagram(dt=0.02)
    plant = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), "car")
    bumps = diagram.add(cosim.Gaussian(std=sqrt(0.001)), "bumps")
    sensors = diagram.add(cosim.Sensors(count=2, std=1.0), "sensors")
    fault = diagram.add(cosim.Freeze(sensor=0, start=freeze, stop=freeze + 8.0, channels=2), "fault")
    diagram.connect(bumps["y"], plant["disturbance"])
    diagram.connect(plant["v"], sensors["u"])
    diagram.connect(sensors["y"], fault["u"])
    return diagram


def wires(port: int) -> dict[str, live.Wire]:
    """Return the wires: speeds in km/h to `port` and the next one, the force in N from the third one."""
    return {
        "speed0": live.Wire(live.UDP(port, format="stamped doubles"), source="fault.y[0]", scale=KMH),
        "speed1": live.Wire(live.UDP(port + 1, format="stamped doubles"), source="fault.y[1]", scale=KMH),
        "force": live.Wire(live.UDP(port + 2), to="car.force", start=HOLDS, stale_after=1.0),
    }


def main() -> None:
    """Run the car."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--duration", type=float, default=60.0, help="seconds")
    options.add_argument("--freeze", type=float, default=10.0, help="seconds until the first sensor freezes")
    options.add_argument("--port", type=int, default=47000)
    given = options.parse_args()
    with car(given.freeze).start(seed=1) as session:
        print("The car drives.", flush=True)
        summary = live.run_live(session, wires(given.port), live.LiveSettings(duration=given.duration))
    print(summary.stopped)
    print(f"The engine got {summary.wires_in['force']['received']} forces in {summary.steps} steps.")


if __name__ == "__main__":
    main()
