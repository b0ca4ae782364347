"""Saved states of FMU instances: addresses in the FMU's memory, or bytes if the FMU can serialise them.

An address is valid only for its instance. A saved state becomes bytes if it outlives its instance, is restored in another
instance of the same FMU, or is pickled. Only an FMU with ``canSerializeFMUState`` can write and read such bytes.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from typing import Any
from weakref import WeakSet

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.library import CallError, Library


class SavedState:
    """The state of an FMU instance at one instant, made by `States.save`; it can be pickled if the FMU can serialise it.

    Attributes
    ----------
    model, token : str
        Name of the model, and the token that proves that a state belongs to a binary.
    beside : tuple
        Numbers and texts that this package saves with the FMU's own state.
    """

    def __init__(self, states: States, place: int):
        self.model, self.token = states.model, states.token
        self.beside: tuple[Any, ...] = ()
        self._states: States | None = states
        self._place, self._bytes = place, b""

    def __getstate__(self) -> dict[str, Any]:
        return self._with(self.serialised())

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    def __del__(self) -> None:
        if self._place and self._states is not None:
            self._states.leave(self._place)

    def serialised(self) -> bytes:
        """Return the state as bytes from the FMU.

        Raises
        ------
        FMUError
            If the FMU cannot serialise it, or the instance was closed before.
        """
        if not self._bytes:
            if self._states is None:
                raise FMUError(
                    f"A saved state of the FMU {self.model!r} no longer exists: it was deleted, or its run is closed and the FMU "
                    "cannot serialise states (canSerializeFMUState). Restore states before the run is closed."
                )
            return self._states.serialise(self._place)
        return self._bytes

    def changed_to(self, content: bytes) -> SavedState:
        """Return a state of the same FMU with these bytes."""
        other = object.__new__(SavedState)
        other.__setstate__(self._with(content))
        return other

    def _with(self, content: bytes) -> dict[str, Any]:
        identity = {"model": self.model, "token": self.token, "beside": self.beside}
        return {**identity, "_states": None, "_place": 0, "_bytes": content}

    def place_in(self, states: States) -> int:
        """Return the state's address in the memory of an instance; 0 if it belongs to another one."""
        return self._place if self._states is states else 0

    def detach(self, *, keep: bool) -> int:
        """Give up the address and return it; with `keep`, keep the state as bytes if the FMU can serialise it."""
        if keep and self._states is not None and self._states.can_serialise:
            with suppress(FMUError):  # restoring a lost state raises an error that names the reason
                self._bytes = self._states.serialise(self._place)
        place, self._states, self._place = self._place, None, 0
        return place


class States:
    """The saved states of one instance.

    Parameters
    ----------
    library : Library
        The FMU's binary.
    component : int
        The instance's address.
    name : str
        Name of the instance, for error messages.
    """

    def __init__(self, library: Library, component: int, name: str):
        self._library, self._component, self._name = library, component, name
        self._alive: WeakSet[SavedState] = WeakSet()
        self._left: list[int] = []
        self.model, self.token = library.description.name, library.description.token

    @property
    def can_save(self) -> bool:
        """Whether the FMU declares that it can save and restore its state."""
        return bool(self._library.description.capabilities.get("canGetAndSetFMUstate"))

    @property
    def can_serialise(self) -> bool:
        """Whether the FMU declares that it can turn a saved state into bytes and back."""
        return self.can_save and bool(self._library.description.capabilities.get("canSerializeFMUstate"))

    def save(self) -> SavedState:
        """Return the present state.

        Raises
        ------
        FMUError
            If the FMU cannot save its state, or saving fails.
        """
        if not self.can_save:
            if self._library.description.fmi_major == 1:
                raise FMUError(
                    f"The FMU {self.model!r} ({self._name!r}) is of FMI 1.0, which has no saved states. Export it as FMI 2.0 or "
                    "3.0 with canGetAndSetFMUState."
                )
            raise FMUError(
                f"The FMU {self.model!r} ({self._name!r}) cannot save its state, as it does not declare canGetAndSetFMUState. "
                "Export it with that capability."
            )
        self._sweep()
        place = ctypes.c_void_p()
        self._call(0, ctypes.byref(place))
        saved = SavedState(self, place.value or 0)
        self._alive.add(saved)
        return saved

    def restore(self, saved: object) -> None:
        """Restore a saved state of this instance or, as bytes, of another instance of the same FMU.

        Raises
        ------
        FMUError
            If it is no state of this FMU, or restoring fails.
        """
        if not isinstance(saved, SavedState) or saved.token != self.token:
            other = f" but one of {saved.model!r}" if isinstance(saved, SavedState) else ""
            raise FMUError(
                f"{self._name!r} cannot be restored: this is no saved state of the FMU {self.model!r}{other}. Give a state from "
                "a run of the same FMU."
            )
        if not self.can_save:
            self.save()  # says why not
        place = saved.place_in(self)
        if place:
            self._call(1, ctypes.c_void_p(place))
            return
        if not self.can_serialise:
            raise FMUError(
                f"{self._name!r} cannot be restored: the saved state is from another run, and the FMU {self.model!r} cannot "
                "serialise its states (canSerializeFMUState). Restore states in the run that saved them."
            )
        place_here = ctypes.c_void_p()
        content = saved.serialised()
        buffer = (self._library.byte * len(content)).from_buffer_copy(content)
        self._serial(2, buffer, len(content), ctypes.byref(place_here))
        try:
            self._call(1, place_here)
        finally:
            self._call(2, ctypes.byref(place_here))

    def forget(self, saved: object) -> None:
        """Free a saved state."""
        if isinstance(saved, SavedState) and saved.place_in(self):
            self._alive.discard(saved)
            self.leave(saved.detach(keep=False))
            self._sweep()

    def leave(self, place: int) -> None:
        """Mark an address as unused; it is freed with the next call of the FMU.

        It is not freed at once: the garbage collector may run in one thread while the FMU makes a step in another.
        """
        self._left.append(place)

    def serialise(self, place: int) -> bytes:
        """Return a state as bytes.

        Raises
        ------
        FMUError
            If the FMU cannot serialise it.
        """
        if not self.can_serialise:
            raise FMUError(
                f"A saved state of the FMU {self.model!r} cannot be pickled, as the FMU does not declare canSerializeFMUState. "
                "Export it with that capability, or keep the state in this process."
            )
        size = ctypes.c_size_t()
        self._serial(0, ctypes.c_void_p(place), ctypes.byref(size))
        buffer = (self._library.byte * size.value)()
        self._serial(1, ctypes.c_void_p(place), buffer, size)
        return bytes(memoryview(buffer))

    def close(self, *, free: bool) -> None:
        """Give up all addresses before the instance is freed; `free` is False if the FMU may no longer be called."""
        for saved in tuple(self._alive):
            self._left.append(saved.detach(keep=free))
        if free:
            self._sweep()

    def _sweep(self) -> None:
        while self._left:
            self._call(2, ctypes.byref(ctypes.c_void_p(self._left.pop())))

    def _call(self, function: int, argument: Any) -> None:
        self._checked(self._library.state_functions[function], argument)

    def _serial(self, function: int, *arguments: Any) -> None:
        self._checked(self._library.serial_functions[function], *arguments)

    def _checked(self, function: str, *arguments: Any) -> None:
        try:
            self._library.call(function, self._component, *arguments)
        except CallError as error:
            raise FMUError(
                f"The FMU {self.model!r} ({self._name!r}) failed at a capability that it declares: {error}."
            ) from None
