"""Run Python code in a separate process and measure its time from outside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


class ChildError(Exception):
    """The process failed."""


@dataclass(frozen=True)
class Finished:
    """A process that has ended: its time in seconds, and the value of its last line if that is JSON."""

    seconds: float
    value: Any


def run_code(code: str, environment: Mapping[str, str] | None = None) -> Finished:
    """Run Python code; its last printed line, as JSON, is the returned value."""
    return run_python(["-c", code], environment)


def run_python(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Finished:
    """Run this Python with the given arguments.

    Raises
    ------
    ChildError
        If its exit status is not 0.
    """
    # -P: modules in the current folder must not replace installed ones.
    command = [sys.executable, "-P", *arguments]
    started = time.perf_counter()
    done = subprocess.run(
        command, env={**os.environ, **(environment or {})}, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - started
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or [""]
        kind = last[0].partition(":")[0].rpartition(".")[2]
        # Only the class of the error: its text may contain paths of this machine, and reports are passed on.
        why = f" with {kind}" if kind.isidentifier() else ""
        raise ChildError(f"A process of the measurement failed{why} (exit status {done.returncode}).")
    try:
        value = json.loads(done.stdout.strip().rpartition("\n")[2])
    except ValueError:
        value = None
    return Finished(seconds, value)


def repeated(code: str, times: int = 1) -> tuple[list[Any], str | None]:
    """Run code a number of times, until one run fails; return the values of the runs, and the reason of a failure or None."""
    values: list[Any] = []
    try:
        for _ in range(times):
            values.append(run_code(code).value)
    except ChildError as error:
        return values, str(error)
    return values, None
