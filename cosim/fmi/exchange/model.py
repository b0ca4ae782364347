"""One instance of a model exchange FMU: modes, values and events, for the integrators."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.guards import Guarded
from bayesftc.cosim.fmi.binaries.library import Beginning, CallError
from bayesftc.cosim.fmi.binaries.model_library import ModelLibrary
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.words import ITERATIONS
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.reading.messages import ENDS, Messages
from bayesftc.cosim.fmi.running.own_inputs import own_inputs
from bayesftc.cosim.fmi.running.port_values import EndError, PortValues, StopError
from bayesftc.cosim.fmi.running.states import SavedState, States
from bayesftc.cosim.fmi.running.written import UNWRITTEN, check_written
from bayesftc.cosim.types import Floats

_DISCARD, _FATAL = 2, 4


@dataclass(frozen=True)
class SavedModel:
    """The state of a model exchange FMU: time, inputs and states, with the FMU's own saved state if they are not enough."""

    state: SavedState | None
    token: str
    names: tuple[str, ...]
    time: float
    next_event: float
    inputs: Floats
    x: Floats


class ExchangeModel:
    """A model exchange FMU that is initialized and in continuous-time mode.

    Parameters
    ----------
    library : ModelLibrary2 or ModelLibrary3
        The binary; its description has an ``exchange``.
    name : str
        Name of the instance.
    beginning : Beginning
        Start values, inputs, and the integrator's relative tolerance, which the FMU uses for equations that it solves itself.
    outputs : sequence of FMUVariable
        The outputs to read.

    Attributes
    ----------
    table : ndarray of int64
        The table for compiled functions: see `bayesftc.cosim.fmi.exchange.words`.
    component : int
        The instance's address.
    nx, nz : int
        Numbers of continuous states and event indicators.
    x : ndarray, (nx,)
        The states that `read_states` reads and `write_states` writes.
    inputs : ndarray
        The inputs that were set last.
    jumps : bool
        Whether some inputs may only be set in event mode, because they are discrete or tunable parameters.

    Raises
    ------
    FMUError
        If the FMU's instantiation or initialization fails, or it ends the simulation at once.
    """

    def __init__(
        self,
        library: ModelLibrary,
        name: str,
        beginning: Beginning,
        outputs: Sequence[FMUVariable],
    ):
        exchange = library.description.exchange
        assert exchange is not None
        self.library, self.info, self.name = library, exchange, name
        self.messages = Messages(name)
        self.component, self.healthy, self.fatal = 0, True, False
        self.table = np.zeros(words.WORDS, dtype=np.int64)
        self.reals = self.table.view(np.float64)
        self.time, self.next_event = 0.0, math.inf
        self._event_info = library.event_info()
        self._beginning, inputs = beginning, beginning.inputs
        self.ports = PortValues(library, list(inputs), outputs)
        self.jumps = not all(v.variability == "continuous" and v.is_float for v in inputs)
        try:
            self._start()
            self.own_inputs = own_inputs(library, self.component, inputs)
            values = [self.own_inputs[v.name] if value is None else value for v, value in inputs.items()]
            self.inputs = np.concatenate([np.zeros(0), *(np.ravel(np.asarray(v, dtype=np.float64)) for v in values)])
            self._fill_table()
            more = (
                ("the continuous states", self.nx, partial(self.read, "get_states")),
                ("the derivatives of the states", self.nx, partial(self.read, "get_derivatives")),
                ("the event indicators", self.nz, partial(self.read, "get_indicators")),
            )
            check_written(library.description.name, name, self.component, self.ports, self.read_outputs, more)
        except BaseException:
            self.healthy = False
            self.close()
            raise

    def _start(self) -> None:
        library, model = self.library, self.library.description.name
        self.component, self._callbacks = library.begin(self.name, self.messages)
        self.states = States(library, self.component, self.name)
        self._bound = library.bound
        try:
            library.initialize(self.component, self._beginning)
            self.nx = library.size(self.component, "states", self._declared)
            if self.nx != self._declared and not any(v.dimensions for v in self.info.states):
                raise StopError(
                    f"Its binary has {self.nx} continuous states, but its model description has {self._declared}"
                )
            self.nz = library.size(self.component, "indicators", self.info.indicators)
            self.places = Guarded(
                max(self.nx, 1), np.dtype(np.float64)
            ).values  # an FMU without states is integrated with one constant state
            self.x = self.places[: self.nx]
            self.x.view(np.int64)[:] = UNWRITTEN
            self._iterate()
        except (CallError, StopError) as error:
            self.fatal = isinstance(error, CallError) and error.status == _FATAL
            raise FMUError(
                f"The FMU {model!r} could not be initialized as {self.name!r}: {error}. Check its parameters and "
                f"start values. {self.messages.quoted()}"
            ) from None

    def _fill_table(self) -> None:
        table, library = self.table, self.library
        for i, role in enumerate(words.NAMES):
            table[i] = library.address(role)
        table[words.MAJOR], table[words.COMPONENT] = library.description.fmi_major, self.component
        table[words.STATES], table[words.INDICATORS], table[words.X] = self.nx, self.nz, self.places.ctypes.data
        table[words.WANTS_STEPS] = self.info.needs_completed_step
        table[words.NO_RETURN] = 1
        input_rows, output_rows = self.ports.rows
        table[words.IN_GROUPS], table[words.IN_GROUP_COUNT] = input_rows.ctypes.data, len(input_rows)
        table[words.OUT_GROUPS], table[words.OUT_GROUP_COUNT] = output_rows.ctypes.data, len(output_rows)
        table[words.IN_SIZE], table[words.INPUTS] = len(self.inputs), self.inputs.ctypes.data

    @property
    def time(self) -> float:
        """The FMU's time in seconds."""
        return float(self.reals[words.TIME])

    @time.setter
    def time(self, t: float) -> None:
        self.reals[words.TIME] = t

    @property
    def next_event(self) -> float:
        """The time of the next time event in seconds; infinity if there is none."""
        return float(self.reals[words.NEXT_EVENT])

    @next_event.setter
    def next_event(self, t: float) -> None:
        self.reals[words.NEXT_EVENT] = t

    @property
    def state_names(self) -> list[str]:
        """Names of the continuous states, element by element."""
        return self.library.state_names(self.component, self.nx)

    @property
    def _declared(self) -> int:
        return self.info.count

    # --- calls -----------------------------------------------------------------------------------------------------

    def call(self, role: str, *arguments: Any) -> None:
        """Call one of the functions in `Bound.names`.

        Raises
        ------
        CallError
            If it returns neither OK nor Warning.
        """
        self.check(role, self._bound[role](self.component, *arguments))

    def check(self, role: str, status: int) -> None:
        """Raise CallError if the function of a role has returned neither OK nor Warning."""
        if status > 1 or status < 0:
            self.note(status)
            raise CallError(self.library.names[role], status)

    def note(self, status: int) -> None:
        """Store, after a status other than OK and Warning, which calls FMI still allows."""
        self.healthy = self.healthy and status == _DISCARD  # after an error FMI forbids to terminate it
        self.fatal = self.fatal or status == _FATAL

    def set_time(self, t: float) -> None:
        """Set the FMU's time."""
        self.call("set_time", t)
        self.time = t

    def write_states(self) -> None:
        """Set the continuous states to `x`."""
        if self.nx:
            self.call("set_states", self.x.ctypes.data, self.nx)

    def read_states(self) -> None:
        """Read the continuous states into `x`."""
        if self.nx:
            self.call("get_states", self.x.ctypes.data, self.nx)

    def read(self, role: str, array: Floats) -> None:
        """Read ``get_derivatives``, ``get_indicators`` or ``get_nominals``."""
        if len(array):
            self.call(role, array.ctypes.data, len(array))

    def nominals(self) -> Floats:
        """Return the nominal values of the states, all positive: 1 if the FMU's value is not valid."""
        values = np.ones(self.nx)
        self.read("get_nominals", values)
        return np.where(np.isfinite(values) & (values != 0.0), np.abs(values), 1.0)

    def write_inputs(self, values: Floats) -> None:
        """Set the inputs, in the present mode."""
        self.inputs[:] = values
        self._noting(self.ports.write, self.inputs)

    def read_outputs(self, values: Floats) -> None:
        """Read the outputs."""
        self._noting(self.ports.read, values)

    def _noting(self, action: Callable[[int, Floats], None], values: Floats) -> None:
        try:
            action(self.component, values)
        except CallError as error:
            self.note(error.status)
            raise

    # --- events ----------------------------------------------------------------------------------------------------

    def event(self, inputs: Floats | None = None) -> bool:
        """Handle an event in event mode, where inputs may jump and discrete states change; `x` receives the new states.

        Returns
        -------
        bool
            Whether the nominal values of the states have changed.

        Raises
        ------
        StopError
            If the iteration does not end.
        EndError
            If the FMU ends the simulation.
        CallError
            If a call fails.
        """
        self.call("enter_event_mode")
        if inputs is not None:
            self.write_inputs(inputs)
        return self._iterate()

    def _iterate(self) -> bool:
        info, update = self._event_info, self.library.update_discrete
        nominals = False
        for _ in range(ITERATIONS):
            ctypes.memset(ctypes.addressof(info), 0, ctypes.sizeof(info))
            self.check("update_discrete", update(self.component, info))
            nominals = nominals or bool(info.nominals)
            if info.terminate:
                raise EndError(f"{ENDS} (terminateSimulation)")
            if not info.needed:
                break
        else:
            raise StopError(
                f"Its event iteration does not end: after {ITERATIONS} passes at t = {self.time:g} s it still requests another "
                f"{self.library.names['update_discrete']}"
            )
        self.next_event = float(info.time) if info.defined else math.inf
        if math.isnan(self.next_event):
            raise StopError("The FMU gives t = NaN as the time of its next event")
        self.call("enter_continuous_mode")
        self.read_states()
        unwritten = self.x.view(np.int64) == UNWRITTEN
        if not (np.isfinite(self.x) | unwritten).all():
            raise StopError(self.nan_state())
        return nominals

    def nan_state(self) -> str:
        """Return which state is NaN or infinite, and when."""
        bad = int(np.argmin(np.isfinite(self.x)))
        return f"The state {self.state_names[bad]!r} came out NaN or infinite at t = {self.time:g} s"

    # --- states and end --------------------------------------------------------------------------------------------

    @property
    def can_save(self) -> bool:
        """See `bayesftc.cosim.block.External.can_save`; an FMU with continuous states only needs no saved states."""
        return self.states.can_save or self._is_smooth

    @property
    def _is_smooth(self) -> bool:
        return self.info.smooth and self.next_event == math.inf

    def expect_return(self) -> None:
        """See `bayesftc.cosim.block.External.expect_return`."""
        self.table[words.NO_RETURN] = 0

    def save(self) -> SavedModel:
        """Return the state; see `bayesftc.cosim.block.External.save`."""
        self.expect_return()
        fmu_state = None if self._is_smooth and not self.states.can_save else self.states.save()
        values = self.inputs.copy(), self.x.copy()
        return SavedModel(fmu_state, self.states.token, self.ports.names[0], self.time, self.next_event, *values)

    def restore(self, saved: object) -> None:
        """Restore a state; see `bayesftc.cosim.block.External.restore`."""
        if not isinstance(saved, SavedModel) or saved.token != self.states.token:
            raise FMUError(
                f"{self.name!r} cannot be restored: this is no saved state of the FMU {self.library.description.name!r} in model "
                "exchange. Give a state from a run of the same FMU."
            )
        if saved.names != self.ports.names[0] or saved.x.shape != self.x.shape:
            raise FMUError(
                f"{self.name!r} cannot be restored: the state is from a block of the FMU {self.library.description.name!r} with "
                f"other inputs or sizes ({', '.join(saved.names) or 'no inputs'}). Give a state from a run of the same block."
            )
        self.expect_return()
        try:
            if saved.state is not None:
                self.states.restore(saved.state)
                self.time, self.inputs[:], self.x[:] = saved.time, saved.inputs, saved.x
            else:
                self._go_back(saved)
        except (CallError, StopError) as error:
            what = str(error)
            raise FMUError(f"{self.name!r} could not be restored: {what}. {self.messages.quoted()}") from None
        self.next_event = saved.next_event
        self.healthy = not self.fatal

    def _go_back(self, saved: SavedModel) -> None:
        """Set an FMU without further memory to a time, inputs and states."""
        try:
            self.set_time(saved.time)
            if self.jumps:
                self.event(saved.inputs)
            else:
                self.write_inputs(saved.inputs)
        except CallError:
            if self.fatal:
                raise
            # FMI does not allow to set a time before the last event: reset the FMU if it insists on that.
            self.library.call(f"fmi{self.library.description.fmi_major}Reset", self.component)
            self.library.initialize(self.component, self._beginning, saved.time)
            self.time = saved.time
            self._iterate()
            self.event(saved.inputs)
        self.x[:] = saved.x
        self.write_states()

    def forget(self, saved: object) -> None:
        """Free a saved state; see `bayesftc.cosim.block.External.forget`."""
        if isinstance(saved, SavedModel) and saved.state is not None:
            self.states.forget(saved.state)

    def close(self) -> None:
        """Free the instance; the binary stays loaded."""
        component, self.component = self.component, 0
        if component:
            self.library.release(
                component,
                lambda: self.states.close(free=not self.fatal),
                healthy=self.healthy,
                fatal=self.fatal,
            )
        self.messages.close()
