"""What a user of python-control is told once: that a system begins elsewhere than at zeros, and that params do not reach it."""

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
        Of its states.
    initial : ndarray
        Where it begins.
    blocks : iterable of Block
        What it is made of.

    Attributes
    ----------
    told : bool
        Whether no more need be said of a beginning at zeros.
    """

    def __init__(self, names: Sequence[str], initial: Floats, blocks: Iterable[Block]):
        self._names, self._initial = names, initial
        self._own = _parameters(blocks)
        self.told = not initial.any()

    def beginning(self, x: Floats) -> None:
        """Warn of a beginning at zeros that is not the system's own."""
        if not self.told and not x.any():
            self.told = True
            name = self._names[int(np.argmax(self._initial != 0.0))]
            warnings.warn(
                f"A system of python-control begins at zeros, with {name} = 0 and so on, which is "
                "not where its blocks begin; for that, give X0=cosim.initial_state(system).",
                stacklevel=3,
            )

    def params(self, given: object) -> None:
        """Warn of params that a user may believe to reach the system's blocks."""
        if not self._own or not isinstance(given, Mapping):
            return
        for name in given:
            if name in self._own:
                where, self._own = self._own[name], {}
                warnings.warn(
                    f"params={{{name!r}: ...}} of python-control does not reach {where}={{{name!r}: ...}}).",
                    stacklevel=3,
                )
                return


def _parameters(blocks: Iterable[Block]) -> dict[str, str]:
    """Return, for each parameter that a block has, the end of a sentence that says where to give it."""
    found: dict[str, str] = {}
    for block in blocks:
        if isinstance(block, FMU):
            names = [v.name for v in block.description.variables if "parameter" in v.causality.lower() and v.settable]
            found |= dict.fromkeys(
                names, f"the FMU {block.name!r}; give it when the block is made: cosim.FMU(..., parameters"
            )
        elif isinstance(block, StateSpace):
            names = list(getattr(block.system, "params", None) or {})
            found |= dict.fromkeys(
                names, "the system within the block; give it when the block is made: cosim.StateSpace(..., params"
            )
    return found
