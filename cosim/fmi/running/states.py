"""Saved states of FMU instances: places in the FMU's own memory, and bytes where it can make some of them.

A place belongs to the instance that gave it. A saved state that outlives its instance, goes to another one of the same FMU or
is pickled becomes bytes, which only an FMU with ``canSerializeFMUState`` can write and read.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from typing import Any
from weakref import WeakSet

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.library import CallError, Library


class SavedState:
    """The state of an FMU instance at one instant, made by `States.save`; it pickles where the FMU can serialise.

    Attributes
    ----------
    model, token : str
        Name of the model and what proves that a state belongs to a binary.
    beside : tuple
        What whoever runs the instance remembers with it, of numbers and texts.
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
        """Return the state as the FMU serialises it.

        Raises
        ------
        FMUError
            If the FMU cannot, or the instance was closed before.
        """
        if not self._bytes:
            if self._states is None:
                raise FMUError(
                    f"A saved state of the FMU {self.model!r} is gone: it was forgotten, or its run is closed and the FMU cannot "
                    "serialise states (canSerializeFMUState); restore a state before that."
                )
            return self._states.serialise(self._place)
        return self._bytes

    def changed_to(self, content: bytes) -> SavedState:
        """Return a state of the same FMU of which the bytes are these."""
        other = object.__new__(SavedState)
        other.__setstate__(self._with(content))
        return other

    def _with(self, content: bytes) -> dict[str, Any]:
        own = {"model": self.model, "token": self.token, "beside": self.beside}
        return {**own, "_states": None, "_place": 0, "_bytes": content}

    def place_in(self, states: States) -> int:
        """Return where in the memory of the FMU the state lies; 0 if it is none of that instance's."""
        return self._place if self._states is states else 0

    def detach(self, *, keep: bool) -> int:
        """Return the place, which is no longer this object's; with `keep` the bytes stay, where the FMU can make them."""
        if keep and self._states is not None and self._states.can_serialise:
            with suppress(FMUError):  # whoever needs a state that is lost is told that its run is closed
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
        What errors call the instance.
    """

    def __init__(self, library: Library, component: int, name: str):
        self._library, self._component, self._name = library, component, name
        self._alive: WeakSet[SavedState] = WeakSet()
        self._left: list[int] = []
        self.model, self.token = library.description.name, library.description.token

    @property
    def can_save(self) -> bool:
        """Whether the FMU says that it can save and restore its state."""
        return bool(self._library.description.capabilities.get("canGetAndSetFMUstate"))

    @property
    def can_serialise(self) -> bool:
        """Whether the FMU says that it can turn a saved state into bytes and back."""
        return self.can_save and bool(self._library.description.capabilities.get("canSerializeFMUstate"))

    def save(self) -> SavedState:
        """Return the present state.

        Raises
        ------
        FMUError
            If the FMU cannot save its state, or fails to.
        """
        if not self.can_save:
            if self._library.description.fmi_major == 1:
                raise FMUError(
                    f"The FMU {self.model!r} ({self._name!r}) is of FMI 1.0, which has no saved states; export it as FMI 2.0 or "
                    "3.0 with canGetAndSetFMUState."
                )
            raise FMUError(
                f"The FMU {self.model!r} ({self._name!r}) cannot save its state: it does not offer canGetAndSetFMUState; export "
                "it with that capability."
            )
        self._sweep()
        place = ctypes.c_void_p()
        self._call(0, ctypes.byref(place))
        saved = SavedState(self, place.value or 0)
        self._alive.add(saved)
        return saved

    def restore(self, saved: object) -> None:
        """Go back to a saved state, of this instance or, as bytes, of another one of the same FMU.

        Raises
        ------
        FMUError
            If it is no state of this FMU, or the FMU refuses it.
        """
        if not isinstance(saved, SavedState) or saved.token != self.token:
            other = f" but one of {saved.model!r}" if isinstance(saved, SavedState) else ""
            raise FMUError(
                f"What {self._name!r} was to be restored to is no saved state of the FMU {self.model!r}{other}; save it in a run "
                "of the same FMU."
            )
        if not self.can_save:
            self.save()  # says why not
        place = saved.place_in(self)
        if place:
            self._call(1, ctypes.c_void_p(place))
            return
        if not self.can_serialise:
            raise FMUError(
                f"The saved state of the FMU {self.model!r} is of another run, and this FMU cannot serialise its states "
                f"(canSerializeFMUState), so {self._name!r} cannot take it; restore states in the run that saved them."
            )
        own = ctypes.c_void_p()
        content = saved.serialised()
        buffer = (self._library.byte * len(content)).from_buffer_copy(content)
        self._serial(2, buffer, len(content), ctypes.byref(own))
        try:
            self._call(1, own)
        finally:
            self._call(2, ctypes.byref(own))

    def forget(self, saved: object) -> None:
        """Free a saved state."""
        if isinstance(saved, SavedState) and saved.place_in(self):
            self._alive.discard(saved)
            self.leave(saved.detach(keep=False))
            self._sweep()

    def leave(self, place: int) -> None:
        """Note a place that nobody needs any more; it is freed when the FMU is called next.

        Not at once: the garbage collector may come in a thread of its own while the FMU makes a step in another.
        """
        self._left.append(place)

    def serialise(self, place: int) -> bytes:
        """Return a state as bytes.

        Raises
        ------
        FMUError
            If the FMU cannot.
        """
        if not self.can_serialise:
            raise FMUError(
                f"A saved state of the FMU {self.model!r} cannot be pickled: the FMU does not offer canSerializeFMUState; export "
                "it with that capability, or keep the state in this process."
            )
        size = ctypes.c_size_t()
        self._serial(0, ctypes.c_void_p(place), ctypes.byref(size))
        buffer = (self._library.byte * size.value)()
        self._serial(1, ctypes.c_void_p(place), buffer, size)
        return bytes(memoryview(buffer))

    def close(self, *, free: bool) -> None:
        """Give up all places before the instance goes; `free` is False where the FMU may not be called any more."""
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
                f"The FMU {self.model!r} ({self._name!r}) could not do what it says that it can: {error}."
            ) from None
