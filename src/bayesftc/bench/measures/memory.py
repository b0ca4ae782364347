"""Memory of a long recording, measured in a separate process."""

from __future__ import annotations

from bayesftc.bench._child import repeated
from bayesftc.bench._figures import Figure, Section
from bayesftc.bench._user_loop import COLUMNS

CHILD = """
import json, sys
from bayesftc.bench.measures.full_loop import RECORD, full_diagram
from bayesftc.bench.measures.memory import peak, resident

diagram = full_diagram()
diagram.simulate(20.0, record=RECORD)  # loads the compiled code
before = resident()
result = diagram.simulate({steps} * diagram.step, record=RECORD)
recorded = len(result["plant.v"]) * {columns} * 8
del result
print(json.dumps([peak() - before, recorded]))
"""


def measure(quick: bool = False) -> Section:
    """Measure the peak growth of the process, and its ratio to the size of the recording."""
    steps = 1_000_000 if quick else 10_000_000
    results, reason = repeated(CHILD.format(steps=steps, columns=COLUMNS), 1 if quick else 3)
    growth, samples = [grown / 1e6 for grown, _ in results], [grown / recorded for grown, recorded in results]
    label = f"peak growth / recorded arrays, {COLUMNS} signals, {steps / 1e6:g} million steps"
    return Section(
        "memory",
        "Memory",
        (
            Figure("peak_growth", "peak growth of resident memory", "MB", growth, reason=reason),
            Figure("growth_over_recording", label, "", samples, at_most=1.2, reason=reason),
        ),
    )


def resident() -> int:
    """Return the resident memory of this process in bytes, or its peak if the system does not report it."""
    return _status("VmRSS") or peak()


def peak() -> int:
    """Return the peak of this process's resident memory in bytes.

    Raises
    ------
    OSError
        If this system does not report it.
    """
    # This is better than getrusage, whose peak a process on Linux inherits from its parent.
    bytes_ = _status("VmHWM")
    if bytes_:
        return bytes_
    try:
        import resource
    except ImportError:
        raise OSError("This system does not report the peak of a process's memory.") from None
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _status(name: str) -> int:
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as lines:
            return next((1024 * int(line.split()[1]) for line in lines if line.startswith(name + ":")), 0)
    except OSError:
        return 0
