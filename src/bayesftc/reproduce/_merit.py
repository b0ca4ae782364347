"""The paper's merit: in how many scenarios one technique tracks better than another, by Welch's t-tests (table 2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

from bayesftc.cosim.block import Floats
from bayesftc.reproduce._statistics import outcomes

Table = dict[str, dict[str, int]]
"""Row -> column -> tests that the column won against the row, minus those that it lost."""


def merit(errors: Sequence[Mapping[str, Floats]], techniques: Sequence[str], significance: float) -> Table:
    """Count the outcomes over scenarios.

    Parameters
    ----------
    errors : sequence of mapping
        For each scenario the errors of each technique, one for each run.
    techniques : sequence of str
        Which techniques are compared.
    significance : float
        Level of the two-sided tests.
    """
    pairs = [(row, column) for row, column in product(techniques, techniques) if row != column]
    ours, theirs = ([[e[pair[i]] for e in errors] for pair in pairs] for i in (1, 0))
    counts = dict(zip(pairs, outcomes(ours, theirs, significance).sum(axis=-1).tolist(), strict=True))
    return {row: {column: counts.get((row, column), 0) for column in techniques} for row in techniques}


def total(table: Table) -> dict[str, int]:
    """Return the sums of a table's columns."""
    return {column: sum(table[row][column] for row in table) for column in table}
