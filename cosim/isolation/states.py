"""Saved states of FMUs in processes of their own."""

from __future__ import annotations

import contextlib
import pickle
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import FMUError

if TYPE_CHECKING:
    from bayesftc.cosim.isolation.instance import Isolated


class IsolatedState:
    """A saved state of an isolated FMU, which stays in the FMU's process.

    Pickled, it becomes a saved state like that of an FMU in process, where the FMU can serialise.

    Attributes
    ----------
    owner : Isolated or None
        The instance that it is of, while that runs.
    token : int
        The owner's number for it.
    """

    def __init__(self, owner: Isolated, token: int):
        self.owner: Isolated | None = owner
        self.token = token
        self._content = b""

    def __reduce__(self) -> tuple[Any, ...]:
        if self.owner is not None:
            return pickle.loads, (self.owner.pickled(self.token),)
        if not self._content:
            raise FMUError(
                "A saved state of an isolated FMU is gone: it was forgotten, or its run is closed and the FMU cannot serialise "
                "states (canSerializeFMUState); restore a state before that."
            )
        return pickle.loads, (self._content,)

    def __del__(self) -> None:
        if self.owner is not None:
            self.owner.leave(self.token)

    def detach(self) -> None:
        """Keep the bytes, where the FMU can make them, for when its process has gone."""
        if self.owner is not None:
            with contextlib.suppress(FMUError):  # whoever needs a state that is lost is told so
                self._content = self.owner.pickled(self.token)
            self.owner = None
