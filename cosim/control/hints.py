"""Warnings for users of python-control, each given once: on the initial state, and on params without effect."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats


class Hints:
    """Warnings of one system, each given once.

    Parameters
    ----------
    names : sequence of str
        Names of its states.
    initial : ndarray
        Its initial state.
    blocks : iterable of Block
        Its blocks.

    Attributes
    ----------
    has_warned : bool
        Whether the warning about a start at zeros was given, or is not necessary.
    """

    def __init__(self, names: Sequence[str], initial: Floats, blocks: Iterable[Block]):
        self._names, self._initial = names, initial
        self._remedies = _parameters(blocks)
        self.has_warned = not initial.any()

    def beginning(self, x: Floats) -> None:
        """Warn of a start at zeros if the initial state of the system is another."""
        if not self.has_warned and not x.any():
            self.has_warned = True
            name = self._names[int(np.argmax(self._initial != 0.0))]
            warnings.warn(
                f"python-control starts a system at zeros, here with {name} = 0, which is not the initial state of its blocks; "
                "give X0=cosim.initial_state(system).",
                stacklevel=3,
            )

    def params(self, given: object) -> None:
        """Warn of params that are also parameters of a block, on which they have no effect."""
        if not self._remedies or not isinstance(given, Mapping):
            return
        for name in given:
            if name in self._remedies:
                where, self._remedies = self._remedies[name], {}
                warnings.warn(
                    f"params={{{name!r}: ...}} of python-control does not reach {where}={{{name!r}: ...}}).",
                    stacklevel=3,
                )
                return


def _parameters(blocks: Iterable[Block]) -> dict[str, str]:
    """Return the end of the warning for each parameter of a block: where to give it."""
    remedies: dict[str, str] = {}
    for block in blocks:
        if isinstance(block, FMU):
            names = [v.name for v in block.description.variables if "parameter" in v.causality.lower() and v.settable]
            remedies |= dict.fromkeys(
                names, f"the FMU {block.name!r}; give it when the block is made: cosim.FMU(..., parameters"
            )
        elif isinstance(block, StateSpace):
            names = list(getattr(block.system, "params", None) or {})
            remedies |= dict.fromkeys(
                names, "the system within the block; give it when the block is made: cosim.StateSpace(..., params"
            )
    return remedies
