"""Memory of a long recording, in a process of its own."""

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
    """Measure how much the process grows at its peak, over the size of what it records."""
    steps = 1_000_000 if quick else 10_000_000
    said, reason = repeated(CHILD.format(steps=steps, columns=COLUMNS), 1 if quick else 3)
    growth, samples = [grown / 1e6 for grown, _ in said], [grown / recorded for grown, recorded in said]
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
    """Return the resident memory of this process in bytes; where the system does not tell, its peak so far."""
    return _status("VmRSS") or peak()


def peak() -> int:
    """Return the peak of this process's resident memory in bytes.

    Raises
    ------
    OSError
        If this system does not tell.
    """
    # Not getrusage where there is a choice: on Linux its peak is inherited from the process that started this one.
    known = _status("VmHWM")
    if known:
        return known
    try:
        import resource
    except ImportError:
        raise OSError("This system does not tell the peak of a process's memory.") from None
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _status(name: str) -> int:
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as lines:
            return next((1024 * int(line.split()[1]) for line in lines if line.startswith(name + ":")), 0)
    except OSError:
        return 0
