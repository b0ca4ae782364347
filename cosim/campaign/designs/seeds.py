"""Seeds of a campaign: the same noise for all points that are compared, noise of its own where that is asked for."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.random import check_seed

LARGEST = 2**63 - 1
"""Seed that a table of integers of 64 bits holds."""


MOST = 10_000_000
"""Runs of a campaign: of more not even the numbers fit into memory."""


def hashed_seeds(seed: int, purpose: str, count: int) -> list[int]:
    """Return `count` seeds for one purpose.

    They are hashed from the seed and the purpose, so that runs for one purpose (a scenario, finding a setting) never share noise
    with those for another.

    Parameters
    ----------
    seed : int
        Of all.
    purpose : str
        What they are for.
    count : int
        How many.
    """
    return _drawn(np.random.SeedSequence((check_seed(seed), zlib.crc32(purpose.encode()))), count)


def seeds_of_points(
    labels: Sequence[Mapping[str, Any]], seeds: int | Sequence[int], seed: int, independent: Sequence[str]
) -> tuple[tuple[int, ...], ...]:
    """Return the seeds of the runs of each point.

    Parameters
    ----------
    labels : sequence of mapping
        For each point the label of each factor.
    seeds : int or sequence of int
        How many runs each point has, or the seeds of the runs, the same for all points.
    seed : int
        From which they are hashed where only their number is given.
    independent : sequence of str
        Factors of which each value has seeds of its own.

    Raises
    ------
    ModelError
        If the seeds can be none, or are given and `independent` as well.
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
                "seeds lists the seeds, the same for all points; give their number for independent=... to hash them."
            )
        own = tuple(check_seed(s) for s in seeds)
        if own and max(own) > LARGEST:
            raise ModelError(
                f"seeds has {max(own)}; the seeds of a campaign go up to 2**63 - 1, as columns of tables do."
            )
        if not own or len(set(own)) < len(own):
            raise ModelError("seeds has no seed, or one twice; each run of a point needs one of its own.")
        return (own,) * len(labels)
    if seeds < 1:
        raise ModelError(f"seeds is {seeds}; each point needs at least one run.")
    if seeds * len(labels) > MOST:
        raise ModelError(
            f"seeds is {brief(seeds)} and there are {len(labels)} points, but a campaign has at most {MOST:,} runs; make several "
            "campaigns of it, each with its own seed."
        )
    if not independent:
        return (tuple(hashed_seeds(seed, "", seeds)),) * len(labels)
    check_seed(seed)
    known: dict[tuple[str, ...], tuple[int, ...]] = {}
    for point in labels:
        values = tuple(repr(point[name]) for name in independent)
        if values not in known:
            known[values] = tuple(_seeds_of_values(seed, values, seeds))
    return tuple(known[tuple(repr(point[name]) for name in independent)] for point in labels)


def _seeds_of_values(seed: int, values: tuple[str, ...], count: int) -> list[int]:
    """Return seeds for values of factors; of 256 bits of hash, for among thousands of points two of 32 bits may be the same."""
    digest = hashlib.sha256(repr(values).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return _drawn(np.random.SeedSequence((seed, *words)), count)


def _drawn(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Return numbers of 63 bits: what columns of tables hold."""
    return [int(s) for s in sequence.generate_state(count, np.uint64) >> np.uint64(1)]


__all__ = ["hashed_seeds", "seeds_of_points"]
