"""Saved states of isolated FMUs."""

from __future__ import annotations

import contextlib
import pickle
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import FMUError

if TYPE_CHECKING:
    from bayesftc.cosim.isolation.instance import Isolated


class IsolatedState:
    """A saved state of an isolated FMU, which stays in the FMU's process.

    Pickled, it becomes a saved state like that of an FMU in process, if the FMU can serialise states.

    Attributes
    ----------
    owner : Isolated or None
        Its instance, while that runs.
    token : int
        The number of the state in the owner.
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
                "A saved state of an isolated FMU no longer exists: it was deleted, or its run is closed and the FMU cannot "
                "serialise states (canSerializeFMUState). Restore states before the run is closed."
            )
        return pickle.loads, (self._content,)

    def __del__(self) -> None:
        if self.owner is not None:
            self.owner.leave(self.token)

    def detach(self) -> None:
        """Keep the state as bytes, if the FMU can serialise it, before its process ends."""
        if self.owner is not None:
            with contextlib.suppress(FMUError):  # restoring a lost state raises an error
                self._content = self.owner.pickled(self.token)
            self.owner = None
