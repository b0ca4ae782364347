"""The environment on which a campaign's numbers depend: versions, the platform, and digits that libraries compute.

Step functions, random numbers and the shipped FMUs have the same bits on every machine. FMUs of other tools and functions of
the user call the C library, and settings that are computed beforehand (such as the gains of `design`) come from NumPy and LAPACK.
Whether these have the same last digits is seen by computing some.
"""

from __future__ import annotations

import hashlib
import math
import platform
import random
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from typing import Any

import numpy as np

PACKAGES = ("bayesftc", "numpy", "scipy", "numba", "fmpy")
FUNCTIONS = ("exp", "expm1", "log", "log1p", "log2", "log10", "sin", "cos", "tan", "atan", "sinh", "cosh", "tanh")
SAMPLES = 5000
"""Numbers for each function. Of two good libraries, one in a thousand results differs."""


def environment() -> dict[str, Any]:
    """Return the versions, the platform, and digits of libraries, but no name of the machine."""
    import llvmlite.binding as llvm

    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "system": platform.system(),
        "machine": platform.machine(),
        "libc": " ".join(part for part in platform.libc_ver() if part),
        "processor": llvm.get_host_cpu_name(),
        "digits": {"functions": _digits_of_functions(), "linear algebra": _digits_of_linear_algebra()},
    }


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the differences of two environments that may change the last digit of a number, as texts.

    The C library and the processor count only if what they compute has other digits; in a store that records no digits, if they
    have other names.
    """
    versions = before["versions"]
    texts = [
        f"{name} {versions[name]} before, {number} now"
        for name, number in now["versions"].items()
        if versions.get(name, number) != number
    ]
    texts += [_change(key, before, now) for key in ("system", "machine") if before.get(key) != now[key]]
    digits = before.get("digits", {})
    for what, key in (("functions", "libc"), ("linear algebra", "processor")):
        if digits[what] != now["digits"][what] if digits else before.get(key) != now[key]:
            texts.append(f"other last digits of {what} ({_change(key, before, now)})")
    return texts


def _change(key: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    return f"{_WORDS.get(key, key)} {before.get(key) or 'unknown'} before, {now[key] or 'unknown'} now"


_WORDS = {"libc": "C library"}


@cache
def _digits_of_functions() -> str:
    """Return a hash of functions of many numbers, by the C library and by NumPy."""
    draw = random.Random(1)
    numbers = [draw.uniform(0.01, 20.0) for _ in range(SAMPLES)]
    parts = [np.array([function(x) for x in numbers]) for function in (getattr(math, name) for name in FUNCTIONS)]
    parts.append(np.array([x**y for x, y in pairwise(numbers)]))
    array = np.array(numbers)
    parts += [np.exp(array), np.log(array), np.sin(array), array**1.7]
    return _hash(*parts)


@cache
def _digits_of_linear_algebra() -> str:
    """Return a hash of products, solutions and decompositions of some matrices."""
    draw, parts = random.Random(2), []
    for n in (2, 3, 5, 8, 16, 40):
        a = np.array([[draw.uniform(-1.0, 1.0) for _ in range(n)] for _ in range(n)])
        product = a @ a.T + np.eye(n)
        parts += [product, np.linalg.solve(a, product), np.linalg.cholesky(product), np.linalg.eigvals(a)]
        parts += [np.linalg.svd(a)[1], np.linalg.eigvalsh(product)]
    return _hash(*parts)


def _hash(*arrays: Any) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:  # run from its sources
        return None


__all__ = ["changes", "environment"]
