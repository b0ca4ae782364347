"""The contract of a block: ports, state, parameters, and step functions over flat float64 arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesftc.cosim.base.html import settings
from bayesftc.cosim.errors import BayesFTCError, KernelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, listed
from bayesftc.cosim.stepping.records import as_written, with_arrays
from bayesftc.cosim.types import Floats, Kernel

if TYPE_CHECKING:
    from bayesftc.cosim.control.control_system import ControlSystem
    from bayesftc.cosim.run.online import Online


@dataclass(frozen=True)
class Definition:
    """What a block does at a given sample time.

    Attributes
    ----------
    output : function or None
        Step function that writes the outputs at t_k; it runs in the order of direct feedthrough. A sampled block (a
        controller, a sensor) does everything here and may change its state as well.
    update : function or None
        Step function that takes the state from t_k to t_k+1 once all outputs at t_k are known. It sees every input.
    state, parameters : mapping of name to array
        Initial values; their shapes are what the step functions see. Scalars become arrays of one element.
    compiled : bool
        False for a block that calls back into Python; the whole diagram then runs interpreted.
    scratch : mapping of name to array
        Space for what a step function computes on the way, since it allocates nothing. It is no state: what is in it when a
        step function begins means nothing, so that what ``update`` needs of ``output`` is a state.
    records : mapping of name to NamedTuple of str
        Arguments of the step functions that are records of several arrays: a `NamedTuple` class, filled with the *names* of the
        ports and entries that its fields are, as ``{"model": Model(A="A", Q="process_covariance")}``. The step function gets
        the record of the arrays themselves: ``model.Q[i, j]``. A field may be a record again.
    """

    output: Kernel | None = None
    update: Kernel | None = None
    state: Mapping[str, ArrayLike] = field(default_factory=dict)
    parameters: Mapping[str, ArrayLike] = field(default_factory=dict)
    compiled: bool = True
    scratch: Mapping[str, ArrayLike] = field(default_factory=dict)
    records: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("output", "update"):
            kernel = getattr(self, name)
            written = kernel if kernel is None else as_written(kernel)  # which it is not after dataclasses.replace
            object.__setattr__(self, name, with_arrays(written, self.records))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values |= {name: values[name] and as_written(values[name]) for name in ("output", "update")}
        return type(self), tuple(values.values())


class Block:
    """Anything that stands in a diagram.

    To write a block you must:

    1. make it a frozen dataclass of plain settings, checked in ``__post_init__``, so that it can be pickled, compared and
       named in a scenario file;
    2. give its ``inputs`` and ``outputs`` as tuples of `Port` (properties, where they depend on the settings);
    3. return from ``define(step)`` a `Definition`: the initial state, the parameters, and the step functions;
    4. write a step function as a plain Python function whose *argument names* say what it gets: the names of ports, of
       state entries, of parameters and of scratch space, each as a float64 array (a scalar is an array of one element); of
       records of such arrays (`Definition.records`); ``t`` (time in seconds) and ``k`` (the block's own step count); and
       ``inputs`` and ``outputs``: all ports of that side, one after the other, as one flat array, for blocks whose ports are
       not known when the function is written;
    5. in a step function, read inputs, parameters and state, write outputs and state in place, allocate nothing, use scalar
       loops, take all mathematics from `bayesftc.cosim.ops`, and branch on data with ``ops.select`` only;
    6. keep random numbers out of it: declare an input port with ``draw="normal"`` or ``draw="uniform"``;
    7. set ``feedthrough=False`` on every input that ``output`` does not read.

    A block that keeps these rules runs in a debugger as plain Python, one call at a time on hardware (`online`), and in the
    compiled engine, with the same numbers to the last bit.
    """

    #: Whether a NaN or infinity in the outputs stops the run (plants), or means a missing sample (sensors).
    checks_finite: ClassVar[bool] = False

    @property
    def inputs(self) -> tuple[Port, ...]:
        """The block's input ports."""
        return ()

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The block's output ports."""
        return ()

    @property
    def one_unit(self) -> tuple[str, ...]:
        """Names of ports that have one unit, whichever it is, as the input and the output of a delay."""
        return ()

    @property
    def only_recorded(self) -> int:
        """How many of its outputs' last numbers nothing depends on: a run records them, NaN or not, and they are no state."""
        return 0

    def watching(self, names: Iterable[str], *, only_recorded: bool = False) -> Block:
        """Return the same block with further variables of these names among its outputs, as far as it has such; else itself."""
        return self

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """Return the block that stands for this one in a linearization: what it learns is held; itself if it learns nothing.

        Parameters
        ----------
        outputs : mapping of str to ndarray
            What its outputs are where it is linearized.
        """
        return self

    @property
    def default_name(self) -> str:
        """The name under which a diagram adds the block if none is given."""
        return type(self).__name__.lower()

    @property
    def sample_time(self) -> Fraction | None:
        """The only sample time at which the block can run, in seconds; None where any will do."""
        return None

    def define(self, step: Fraction) -> Definition:
        """Return what the block does when it runs every `step` seconds."""
        raise KernelError(f"{type(self).__name__} does not say what it does: give it a method define(step).")

    def port(self, name: str) -> Port:
        """Return the port called `name`."""
        ports = {port.name: port for port in (*self.inputs, *self.outputs)}
        if name not in ports:
            raise UnknownNameError(f"{type(self).__name__} has no port {name!r}; {did_you_mean(name, ports)}")
        return ports[name]

    def _repr_html_(self) -> str:
        """Return the settings and ports as a table, for notebooks."""
        try:
            ports = [("inputs", listed(self.inputs, 30)), ("outputs", listed(self.outputs, 30))]
        except BayesFTCError:  # as of a fault before it is in a diagram
            ports = []
        return settings(self, ports)

    def online(self, dt: float | str | Fraction | None = None, *, compiled: bool = True) -> Online:
        """Return the same block for a user's own loop or for hardware: a callable that makes one step.

        Parameters
        ----------
        dt : float, str or Fraction, optional
            Sample time in seconds; not needed where the block knows it (a controller has its model's).
        compiled : bool
            False to step through the plain Python form in a debugger.
        """
        from bayesftc.cosim.run.online import Online

        return Online(self, dt, compiled=compiled)

    def to_control(
        self,
        dt: float | str | Fraction | None = None,
        *,
        inputs: Sequence[str] | Mapping[str, str] | str | None = None,
        outputs: Sequence[str] | Mapping[str, str] | str | None = None,
        seed: int | None = 0,
        engine: Literal["auto", "compiled", "interpreted"] = "auto",
        name: str | None = None,
    ) -> ControlSystem:
        """Return the block as a discrete-time system of python-control, for ``control.interconnect`` and simulation there.

        Its state is what the block keeps from a step to the next, and its functions are pure, so that ``control.linearize`` and
        ``control.find_operating_point`` work, too. The state of an FMU is known to that alone, but for those of this package:
        it is the number of a saved state, or of the steps made by an FMU that cannot save (which can only be stepped in
        order); both functions refuse it. ``control.linearize`` holds precision learners: see `ControlSystem.linearize`.
        python-control begins at zeros: give ``X0=cosim.initial_state(system)``.

        Parameters
        ----------
        dt : float, str or Fraction, optional
            Sample time in seconds; not needed where the block knows it. A model exchange FMU without one becomes a system in
            continuous time, whose states are its own; no events happen there.
        inputs, outputs : sequence of str or mapping of str to str, optional
            Names of the ports to take, ``y[1]`` for one element of a vector; a mapping gives each a new name. By default all but
            random inputs. A vector becomes ``y[0]``, ``y[1]``, and dots become ``_``.
        seed : int or None
            Of the random inputs that are not among `inputs`: they are drawn for the step that the time is of, as in a
            diagram in which the block has the same name. None for no noise.
        engine : {"auto", "compiled", "interpreted"}
            As in `Diagram.simulate`.
        name : str, optional
            Of the system; by default that under which a diagram adds the block.

        Returns
        -------
        control.NonlinearIOSystem
            With the attribute ``initial_state``, for ``X0``.

        Raises
        ------
        UnknownNameError
            If there is no port of that name.
        ModelError
            If `dt` is needed, or a name is given twice.

        Examples
        --------
        >>> import control, numpy
        >>> from bayesftc import cosim
        >>> delay = cosim.UnitDelay().to_control(dt=0.1, outputs={"y": "late"})
        >>> control.input_output_response(delay, 0.1 * numpy.arange(3), [5.0, 6.0, 7.0]).outputs.tolist()
        [0.0, 5.0, 6.0]
        """
        from bayesftc.cosim.control.control_system import block_to_control

        return block_to_control(self, dt, inputs, outputs, seed, engine, name)


class ExternalBlock(Block):
    """A block whose step functions are functions in C already: an FMU, or a plant in a library of your own.

    To write an external block you must:

    1. keep rules 1, 2 and 6 of `Block`; its ports are what C functions read and write, flat, in the order of the ports. A plant
       sets ``checks_finite``, so that a NaN in its outputs stops the run;
    2. say in `timing` when outputs are computed, and declare inputs on which they do not depend at once ``feedthrough=False``;
    3. return from ``instantiate(step, name)`` an `External`, which holds what runs; each run has instances of its own;
    4. write the step functions in C, with the engine's signature::

           int32_t step(double *state, int64_t *table, const double *inputs, double *outputs, double t, int64_t k)

       ``table`` is a copy of the instance's own (at most 32 words: addresses of what it needs, numbers), ``t`` the time in
       seconds at the beginning of the step, ``k`` the block's own step count; ``state`` is not used. They return 0, or a
       status below a million that stops the run and that `External.explain` puts into words;
    5. give the same two functions in Python, for the interpreted engine and with the same numbers.
    """

    #: ``"plant"``: the output function reads the outputs at t_k, which do not depend on the inputs at t_k; then the update
    #: function makes a step. ``"direct"``: the same, but they do. ``"sampled"``: the output function makes the step with the
    #: inputs at t_k, and its outputs count at t_k, as a controller's do; there is no update.
    timing: Literal["plant", "direct", "sampled"] | None = "plant"

    def instantiate(self, step: Fraction, name: str) -> External:
        """Return a new running instance that makes steps of `step` seconds."""
        raise KernelError(f"{type(self).__name__} cannot be run: give it a method instantiate(step, name).")


class External(Protocol):
    """A running instance of an external block.

    Where a coupling iterates or changes step sizes, compiled code calls ``save``, ``restore`` and ``forget``, at the cost of
    calls of Python; an instance that is saved by C functions with the signatures of FMI 2 can name these instead, by an attribute
    ``state_functions``: its own address, and those of the three.
    """

    table: NDArray[np.int64]

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 where the output function does everything."""

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """Write the outputs; return 0, or a status that stops the run."""

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """Make one step from time `t`; return 0, or a status that stops the run."""

    def explain(self, status: int) -> str:
        """Return what the status means, with the last messages of the instance."""

    @property
    def has_ended(self) -> bool:
        """Whether what `explain` was asked for last is no failure: the instance itself ends the simulation."""

    @property
    def can_save(self) -> bool:
        """Whether `save` and `restore` work."""

    def expect_return(self) -> None:
        """Be ready from now on to go back to states before the present one; nothing need be done where that is always so."""

    def save(self) -> object:
        """Return the present state, to which `restore` goes back; it pickles where the instance can serialise.

        Raises
        ------
        FMUError
            If it cannot be saved.
        """

    def restore(self, saved: object) -> None:
        """Go back to a saved state, as often as one likes.

        Raises
        ------
        FMUError
            If it is no state of this block, or of another run and cannot be serialised.
        """

    def forget(self, saved: object) -> None:
        """Free what a saved state takes; it cannot be restored any more. `close` forgets all of them."""

    def close(self) -> None:
        """Free the instance."""


class VariableStep(External, Protocol):
    """A running instance whose steps may be of any size: what `Coupling.step_error` asks for."""

    step_word: int  #: The word of the table that holds the step size in seconds, as a double.

    @property
    def can_resize(self) -> bool:
        """Whether it really may."""

    def resize(self, h: float) -> None:
        """Make steps of `h` seconds from now on, in interpreted runs; compiled ones change the word of the table."""
