"""What a campaign's numbers depend on besides its own settings: versions, the C library, what the processor can do."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PACKAGES = ("bayesftc", "numpy", "numba", "fmpy")


def environment() -> dict[str, Any]:
    """Return the versions, the C library, and the processor's kind and features; nothing that names the machine itself."""
    import llvmlite.binding as llvm

    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "system": platform.system(),
        "machine": platform.machine(),
        "libc": " ".join(part for part in platform.libc_ver() if part),
        "processor": llvm.get_host_cpu_name(),
        "features": sorted(name for name, present in llvm.get_host_cpu_features().items() if present),
    }


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return in words what differs between two environments, of all that may change the last place of a number.

    The name of the processor alone does not: compiled code depends on its features.
    """
    found = [
        f"{name} {before['versions'].get(name)} before, {number} now"
        for name, number in now["versions"].items()
        if before["versions"].get(name) != number
    ]
    for key, words in (("system", "system"), ("machine", "machine"), ("libc", "C library")):
        if before.get(key) != now[key]:
            found.append(f"{words} {before.get(key) or 'unknown'} before, {now[key] or 'unknown'} now")
    lost, gained = (set(a) - set(b) for a, b in _both_ways(before.get("features", ()), now["features"]))
    if lost or gained:
        parts = [f"{word} {_some(names)}" for word, names in (("without", lost), ("with", gained)) if names]
        found.append(f"processor ({now['processor']}) {', '.join(parts)}")
    return found


def _both_ways(a: Any, b: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    return (a, b), (b, a)


def _some(names: set[str]) -> str:
    shown = sorted(names)
    return ", ".join(shown[:4]) + (f" and {len(shown) - 4} more" if len(shown) > 4 else "")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:  # run from its sources
        return None


__all__ = ["changes", "environment"]
