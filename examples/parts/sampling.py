"""A slow converter behind a vibrating sensor: without a filter before the sampling, the vibration becomes a slow wave.

``python -m bayesftc.examples.parts.sampling`` prints the error of the samples with and without the anti-alias filter.
"""

from __future__ import annotations

import numpy as np

from bayesftc import cosim

RATE = 10.0
"""Samples a second of the converter."""


def converter() -> cosim.Diagram:
    """Return a slow signal with a vibration of 9.8 Hz, which is sampled at 10 Hz with and without a filter."""
    diagram = cosim.Diagram(dt="1/1000")
    signal = diagram.add(cosim.Sine(1.0, period=20.0), "signal")
    vibration = diagram.add(cosim.Sine(0.5, period=1.0 / 9.8), "vibration")
    sensor = diagram.add(cosim.Sum("++"), "sensor")
    first, second = (diagram.add(cosim.ExponentialFilter(0.1), name) for name in ("first", "second"))
    clock = diagram.add(cosim.Pulse(1.0, period=1.0 / RATE, width=1e-3 * RATE), "clock")
    both = diagram.add(cosim.SampleAndHold(size=2), "both")
    digital = diagram.add(cosim.Quantizer(2.0**-8, size=2), "digital")
    diagram.connect([signal["y"], vibration["y"]], sensor["u"])
    diagram.connect(sensor["y"], first["u"])
    diagram.connect(first["y"], second["u"])
    diagram.connect([sensor["y"], second["y"]], both["u"])
    diagram.connect(clock["y"], both["trigger"])
    diagram.connect(both["y"], digital["u"])
    return diagram


def main() -> dict[str, float]:
    """Return the root-mean-square error of the samples, the delay of the filter (0.2 s) taken out."""
    result = converter().simulate(40.0)
    late = 200
    found = {}
    for name, element, shift in (("without a filter", 0, 0), ("with two filters", 1, late)):
        samples, truth = result["digital.y"][20_000:, element], result["signal.y"][20_000 - shift : 40_001 - shift]
        found[name] = float(np.sqrt(np.mean((samples[::100] - truth[::100]) ** 2)))
        print(f"{name}: samples differ by {found[name]:.3f}")
    return found


if __name__ == "__main__":
    main()
