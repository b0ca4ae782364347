"""The environment on which a campaign's numbers depend: versions, the C library, features of the processor."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PACKAGES = ("bayesftc", "numpy", "numba", "fmpy")


def environment() -> dict[str, Any]:
    """Return the versions, the C library, and the processor's kind and features, but no name of the machine."""
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
    """Return the differences of two environments that may change the last digit of a number, as texts.

    The name of the processor is left out, because compiled code depends only on its features.
    """
    texts = [
        f"{name} {before['versions'].get(name)} before, {number} now"
        for name, number in now["versions"].items()
        if before["versions"].get(name) != number
    ]
    for key, words in (("system", "system"), ("machine", "machine"), ("libc", "C library")):
        if before.get(key) != now[key]:
            texts.append(f"{words} {before.get(key) or 'unknown'} before, {now[key] or 'unknown'} now")
    lost, gained = (set(a) - set(b) for a, b in _both_ways(before.get("features", ()), now["features"]))
    if lost or gained:
        parts = [f"{word} {_some(names)}" for word, names in (("without", lost), ("with", gained)) if names]
        texts.append(f"processor ({now['processor']}) {', '.join(parts)}")
    return texts


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
