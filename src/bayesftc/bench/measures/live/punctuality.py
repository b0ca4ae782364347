"""Live runs: how punctual a controller at 1 kHz is, beside a loop that only sleeps.

Both loops run in turns, for a second each, in the same process and on the same core, while another process sends the samples
of two sensors by UDP. In turns, and not at once on two cores: beside the controller, the sleeping loop would miss deadlines
because of it, and the ratio would flatter the controller. A shared machine stops both loops now and then, for a hundred periods
or more; in short turns, both meet the same machine. On a busy one, the ratio says little all the same.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from bayesftc.bench._figures import Figure, Section

PERIOD = 0.001
LIMIT = 0.0005
"""Seconds by which a period may begin late."""

LEAST, MOST = 0.999, 1.2
"""Share of the periods within the limit; or the most misses, as a multiple of those of the sleeping loop."""

SENDER = """
import socket, struct, sys, time
ports = [int(port) for port in sys.argv[1:3]]
sender, k, began = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0, time.perf_counter()
while True:
    k += 1
    time.sleep(max(began + 0.001 * k - time.perf_counter(), 0.0))
    for i, port in enumerate(ports):
        sender.sendto(struct.pack("<2d", 0.001 * k, 20.0 + ((7 * k + 3 * i) % 11 - 5) / 5), ("127.0.0.1", port))
"""
"""Two sensors in a process of their own."""


def measure(quick: bool = False) -> Section:
    """Let both loops run in turns, a minute each, and count the periods that begin too late."""
    turns, seconds = (2, 0.5) if quick else (60, 1.0)
    ports = _free_ports()
    online = _controller()
    online(y=[20.0, 20.0], goal=[20.0])  # compiles
    online.reset()
    sleeping, live = [], []
    with _one_core() as other, _sensors(ports, other):
        for _ in range(turns):
            sleeping.append(_sleep(seconds))
            live.append(_live(online, ports, seconds))
    misses = {name: sum(map(_misses, each)) for name, each in (("live", live), ("sleeping", sleeping))}
    steps = sum(each["steps"] for each in live)
    late = {name: [1e3 * each["delay_0.999"] for each in of] for name, of in (("live", live), ("sleeping", sleeping))}
    note = f"{misses['live']} of {steps} misses, {misses['sleeping']} of the sleeping loop"
    return Section(
        "live",
        f"Live: a controller with two sensors by UDP at 1 kHz, {turns * seconds:g} s",
        (
            Figure(
                "within",
                "share of periods that begin within 0.5 ms",
                "",
                [1.0 - misses["live"] / steps],
                at_least=LEAST,
                either="punctual",
                note=note,
            ),
            Figure(
                "misses_over_sleeping",
                "misses / those of a loop that only sleeps, in turns",
                "",
                [misses["live"] / max(misses["sleeping"], 1)],
                at_most=MOST,
                either="punctual",
            ),
            Figure("late", "delay that 99.9 % of the periods do not exceed", "ms", late["live"]),
            Figure("late_sleeping", "the same of the sleeping loop", "ms", late["sleeping"]),
            Figure("missing", "share of periods without a sample", "", [each["missing"] for each in live]),
        ),
    )


def _controller() -> Any:
    from bayesftc import controllers

    model = controllers.LinearModel([[0.99995]], [[1e-5]], [[1.0], [1.0]], 1e-4, 0.4, dt=PERIOD)
    return controllers.BayesianController(model, initial_mean=20.0).online()


def _sleep(seconds: float) -> Mapping[str, Any]:
    """Return the deadlines of a loop that sleeps until each period begins."""
    from bayesftc.cosim.live.deadlines import Deadlines

    deadlines, began = Deadlines(PERIOD), time.perf_counter()
    for k in range(round(seconds / PERIOD)):
        due = began + k * PERIOD
        if (rest := due - time.perf_counter()) > 0:
            time.sleep(rest)
        late = time.perf_counter() - due
        deadlines.add(late, late)
    return deadlines.report()


def _live(online: Any, ports: tuple[int, int, int], seconds: float) -> Mapping[str, Any]:
    """Return the deadlines of the controller, and its share of missing samples."""
    from bayesftc.cosim import live

    wires = {
        f"sensor {i}": live.Wire(live.UDP(ports[i], format="stamped doubles"), to=f"y[{i}]", stale_after=0.005)
        for i in range(2)
    }
    wires["goal"] = live.Wire(live.UDP(0), to="goal", start=20.0)
    wires["force"] = live.Wire(live.UDP(ports[2]), source="u", safe=0.0)
    summary = live.run_live(online, wires, live.LiveSettings(duration=seconds))
    missing = sum(summary.wires_in[f"sensor {i}"]["missing_share"] for i in range(2)) / 2
    return {**summary.deadlines, "missing": missing}


def _misses(deadlines: Mapping[str, Any]) -> int:
    """Return the number of periods that began later than the limit, by the edges of the histogram."""
    return sum(count for _, high, count in deadlines["histogram"] if high is None or high > LIMIT)


def _free_ports() -> tuple[int, int, int]:
    """Return three ports at which nobody listens."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    a, b, c = (int(each.getsockname()[1]) for each in sockets)
    for each in sockets:
        each.close()
    return a, b, c


@contextmanager
def _one_core() -> Iterator[set[int]]:
    """Keep this process on one core where the system can, and give the others."""
    if not hasattr(os, "sched_setaffinity"):
        yield set()
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield before - {max(before)} or before
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _sensors(ports: tuple[int, int, int], cores: set[int]) -> Iterator[None]:
    """Send samples from another process, on other cores where there are any."""
    process = subprocess.Popen([sys.executable, "-c", SENDER, *map(str, ports[:2])])
    try:
        if cores:
            os.sched_setaffinity(process.pid, cores)
        yield
    finally:
        process.kill()
        process.wait()
