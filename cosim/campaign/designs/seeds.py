"""Seeds of a campaign: the same noise for all points that are compared, or independent noise by choice."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.random import check_seed

LARGEST = 2**63 - 1
"""Largest seed in a table column of 64-bit integers."""


MOST = 10_000_000
"""Largest number of runs of a campaign; for more, not even the run numbers fit into memory."""


def hashed_seeds(seed: int, purpose: str, count: int) -> list[int]:
    """Return `count` seeds for one purpose.

    They are computed from a hash of the seed and the purpose, so that runs for one purpose (a scenario, finding a setting)
    never share noise with those for another.

    Parameters
    ----------
    seed : int
        The seed for all purposes.
    purpose : str
        Name of the purpose.
    count : int
        Number of seeds.
    """
    return _drawn(np.random.SeedSequence((check_seed(seed), zlib.crc32(purpose.encode()))), count)


def seeds_of_points(
    labels: Sequence[Mapping[str, Any]], seeds: int | Sequence[int], seed: int, independent: Sequence[str]
) -> tuple[tuple[int, ...], ...]:
    """Return the seeds of the runs of each point.

    Parameters
    ----------
    labels : sequence of mapping
        The label of each factor, for each point.
    seeds : int or sequence of int
        The number of runs of each point, or their seeds, the same for all points.
    seed : int
        The seed from which they are computed if `seeds` is a number.
    independent : sequence of str
        Factors of which each value has different seeds.

    Raises
    ------
    ModelError
        If the seeds are wrong, or listed although `independent` is given.
    UnknownNameError
        If there is no such factor.
    """
    if isinstance(independent, str):
        independent = [independent]
    for name in independent:
        if name not in labels[0]:
            raise UnknownNameError(f"independent names {name!r}, which is no factor; {did_you_mean(name, labels[0])}")
    if isinstance(seeds, np.ndarray | np.integer):
        seeds = seeds.tolist()
    if isinstance(seeds, bool) or not isinstance(seeds, int | Sequence | range) or isinstance(seeds, str):
        raise ModelError(f"seeds is {seeds!r}; it must be the number of runs of each point, or a list of their seeds.")
    if isinstance(seeds, Sequence):
        if independent:
            raise ModelError(
                "seeds is a list, which holds for all points, and independent=... needs different seeds; give their number."
            )
        listed = tuple(check_seed(s) for s in seeds)
        if listed and max(listed) > LARGEST:
            raise ModelError(f"seeds has {max(listed)}; use seeds up to 2**63 - 1, the limit of table columns.")
        if not listed or len(set(listed)) < len(listed):
            raise ModelError("seeds has no seed, or one twice; give each run of a point a different seed.")
        return (listed,) * len(labels)
    if seeds < 1:
        raise ModelError(f"seeds is {seeds}; each point needs at least one run.")
    if seeds * len(labels) > MOST:
        raise ModelError(
            f"seeds is {brief(seeds)} and there are {len(labels)} points, but a campaign has at most {MOST:,} runs; make "
            "several campaigns with different seeds."
        )
    if not independent:
        return (tuple(hashed_seeds(seed, "", seeds)),) * len(labels)
    check_seed(seed)
    by_values: dict[tuple[str, ...], tuple[int, ...]] = {}
    for point in labels:
        values = tuple(repr(point[name]) for name in independent)
        if values not in by_values:
            by_values[values] = tuple(_seeds_of_values(seed, values, seeds))
    return tuple(by_values[tuple(repr(point[name]) for name in independent)] for point in labels)


def _seeds_of_values(seed: int, values: tuple[str, ...], count: int) -> list[int]:
    """Return seeds for values of factors, from a hash of 256 bits: among thousands of points, two of 32 bits may be equal."""
    digest = hashlib.sha256(repr(values).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return _drawn(np.random.SeedSequence((seed, *words)), count)


def _drawn(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Return numbers of 63 bits, which fit into table columns."""
    return [int(s) for s in sequence.generate_state(count, np.uint64) >> np.uint64(1)]


__all__ = ["hashed_seeds", "seeds_of_points"]
