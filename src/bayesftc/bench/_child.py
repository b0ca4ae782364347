"""Runs a piece of Python in a process of its own, and times it from outside."""

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
    """The process failed; the message is a sentence that says so."""


@dataclass(frozen=True)
class Finished:
    """A process that came to its end: how long it took in seconds, and what its last line said if that was JSON."""

    seconds: float
    said: Any


def run_code(code: str, environment: Mapping[str, str] | None = None) -> Finished:
    """Run Python code; what it prints last, as JSON, comes back."""
    return run_python(["-c", code], environment)


def run_python(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> Finished:
    """Run this Python with the given arguments.

    Raises
    ------
    ChildError
        If it ends with another status than 0.
    """
    # -P: what lies in the current folder must not stand in for what is installed.
    command = [sys.executable, "-P", *arguments]
    started = time.perf_counter()
    done = subprocess.run(
        command, env={**os.environ, **(environment or {})}, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - started
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or [""]
        kind = last[0].partition(":")[0].rpartition(".")[2]
        # Only the kind of the error: its text may hold paths, which have no place in a report that is handed on.
        why = f" with {kind}" if kind.isidentifier() else ""
        raise ChildError(f"A process of the measurement failed{why} (exit status {done.returncode}).")
    try:
        said = json.loads(done.stdout.strip().rpartition("\n")[2])
    except ValueError:
        said = None
    return Finished(seconds, said)


def repeated(code: str, times: int = 1) -> tuple[list[Any], str | None]:
    """Run code some times; return what each run said last, and a sentence if one failed, after which there are no more."""
    said: list[Any] = []
    try:
        for _ in range(times):
            said.append(run_code(code).said)
    except ChildError as error:
        return said, str(error)
    return said, None
