"""The contract of a block: ports, state, parameters, and step functions over flat float64 arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesftc.cosim.base.arguments import NamedArguments
from bayesftc.cosim.base.html import Printed, settings
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import BayesFTCError, KernelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, listed
from bayesftc.cosim.stepping.records import as_written, with_arrays
from bayesftc.cosim.types import Floats, Kernel

if TYPE_CHECKING:
    from bayesftc.cosim.control.control_system import ControlSystem
    from bayesftc.cosim.run.online import Online


@dataclass(frozen=True)
class Definition:
    """The step functions, state and parameters of a block at a given sample time.

    Attributes
    ----------
    output : function or None
        Step function that writes the outputs at t_k. It runs in the order of direct feedthrough. A sampled block (a
        controller, a sensor) has only this function, which may also change the state.
    update : function or None
        Step function that advances the state from t_k to t_k+1. It runs when all outputs at t_k are known, and reads all inputs.
    state, parameters : mapping of name to array
        Initial values. The step functions get arrays of the same shapes. Scalars become arrays of one element.
    compiled : bool
        False for a block that calls back into Python; the loop then runs in Python, and calls compiled step functions of other
        blocks only in long runs.
    scratch : mapping of name to array
        Work arrays for intermediate values, such as ``{"k1": np.zeros(4)}``, since a step function allocates nothing. Their
        content at the beginning of a step function has no meaning. Values that ``update`` needs from ``output`` therefore belong
        to the state.
    records : mapping of name to NamedTuple of str
        Arguments of the step functions that are records of several arrays. Each is an instance of a `NamedTuple` class whose
        fields hold the *names* of ports and entries, such as ``{"model": Model(A="A", Q="process_covariance")}``. The step
        function gets the record of the arrays themselves: ``model.Q[i, j]``. A field may itself be a record.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> def output(total, y):
    ...     y[0] = total[0]
    >>> def update(u, total):
    ...     total[0] += u[0]
    >>> counting = cosim.Definition(output, update, state={"total": 5.0})
    >>> total, y = np.array([counting.state["total"]]), np.zeros(1)
    >>> for u in (1.0, 2.0):
    ...     counting.update(np.array([u]), total)
    >>> counting.output(total, y)
    >>> y.tolist()
    [8.0]
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
            written = kernel if kernel is None else as_written(kernel)  # dataclasses.replace passes a converted one
            object.__setattr__(self, name, with_arrays(written, self.records))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values |= {name: values[name] and as_written(values[name]) for name in ("output", "update")}
        return type(self), tuple(values.values())


class Block(Printed, NamedArguments):
    """Base of everything that a diagram consists of.

    To write a block you must:

    1. make it a frozen dataclass of plain settings, checked in ``__post_init__``, so that it can be pickled, compared and
       named in a scenario file;
    2. give its ``inputs`` and ``outputs`` as tuples of `Port` (properties, where they depend on the settings);
    3. return from ``define(step)`` a `Definition`: the initial state, the parameters, and the step functions;
    4. write each step function as a plain Python function whose *argument names* state what it gets:

       - names of ports, state entries, parameters and scratch arrays, each as a float64 array (a scalar is an array of one
         element), or of records of such arrays (`Definition.records`);
       - ``t`` (time in seconds) and ``k`` (the step count of the block);
       - ``inputs`` and ``outputs``: all ports of that side, one after the other, as one flat array, for blocks whose ports are
         not known when the function is written;

    5. in a step function, read inputs, parameters and state, write outputs and state in place, allocate nothing, use scalar
       loops, take all mathematics from `bayesftc.cosim.ops`, and branch on data with ``ops.select`` only;
    6. draw no random numbers: declare an input port with ``draw="normal"`` or ``draw="uniform"``;
    7. set ``feedthrough=False`` on every input that ``output`` does not read.

    A block that keeps these rules runs as plain Python in a debugger, one call at a time on hardware (`online`), and in the
    compiled engine. The numbers are the same to the last bit.
    """

    #: True: a NaN or infinity in the outputs stops the run (plants). False: a NaN is a missing sample (sensors).
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
        """Names of ports that share one unit, whichever it is, such as the input and the output of a delay."""
        return ()

    @property
    def named_sources(self) -> Mapping[str, str]:
        """Names of signals (``plant.v``) for scalar inputs: a diagram feeds the inputs from these, if nothing is connected."""
        return {}

    @property
    def only_recorded(self) -> int:
        """How many numbers at the end of the outputs are only recorded: nothing depends on them, and they may be NaN."""
        return 0

    def watching(self, names: Iterable[str], *, only_recorded: bool = False) -> Block:
        """Return the block with its further variables of these names as outputs; the block itself if there are none of them."""
        return self

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """Return the block that replaces this one in a linearization, with learning stopped; itself if it learns nothing.

        Parameters
        ----------
        outputs : mapping of str to ndarray
            Values of the outputs at the operating point.
        """
        return self

    @property
    def default_name(self) -> str:
        """The name under which a diagram adds the block if none is given."""
        return type(self).__name__.lower()

    @property
    def sample_time(self) -> float | str | Fraction | None:
        """The only sample time at which the block can run, in seconds (0.02, "1/30"); None if there is no such limit."""
        return None

    def define(self, step: Fraction) -> Definition:
        """Return the definition of the block for a sample time of `step` seconds."""
        raise KernelError(f"{type(self).__name__} has no step functions; give it a method define(step).")

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
        except BayesFTCError:  # a fault outside a diagram may lack the length of its signal
            ports = []
        return settings(self, ports)

    def online(self, dt: float | str | Fraction | None = None, *, compiled: bool = True) -> Online:
        """Return the block as a callable that makes one step, for your own loop or for hardware.

        NaN or None is a missing sample. A controller's default learner takes many missing samples in a row for a fault. For a
        sensor that is slower than the controller, give the learner the share of steps without a sample:
        ``SwitchingPrecision(loss=(0.01, 0.9))`` for a second sensor that sends at every tenth step.

        Parameters
        ----------
        dt : float, str or Fraction, optional
            Sample time in seconds; not needed if the block has one (a controller has that of its model).
        compiled : bool
            False for the plain Python form, which you can step through in a debugger.
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

        The state of the system is the state of the block. Its functions are pure, so that ``control.linearize`` and
        ``control.find_operating_point`` work, too. ``control.linearize`` stops precision learners: see
        `ControlSystem.linearize`. python-control starts at zeros: give ``X0=cosim.initial_state(system)``.

        The state of an FMU is not accessible, except for FMUs of this package. The state of the system then has
        the number of a saved state in its place. For an FMU that cannot save its state, it has the number of steps made; such an
        FMU can only be stepped in order. ``control.linearize`` and ``control.find_operating_point`` refuse states of both kinds.

        Parameters
        ----------
        dt : float, str or Fraction, optional
            Sample time in seconds; not needed if the block has one. A model exchange FMU without one becomes a system in
            continuous time with the states of the FMU, without events.
        inputs, outputs : sequence of str or mapping of str to str, optional
            Names of the ports to use, ``y[1]`` for one element of a vector; a mapping gives each a new name. By default all but
            random inputs. A vector becomes ``y[0]``, ``y[1]``, and dots become ``_``.
        seed : int or None
            Seed of the random inputs that are not among `inputs`. They are drawn for the step that contains the given time, as
            in a diagram in which the block has the same name. None for no noise.
        engine : {"auto", "compiled", "interpreted"}
            See `Diagram.simulate`.
        name : str, optional
            Name of the system; by default the name under which a diagram adds the block.

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


def sample_time_of(block: Block) -> Fraction | None:
    """Return the sample time of a block as an exact fraction; None if it can run at any.

    Raises
    ------
    StepSizeError
        If it is not a positive number.
    """
    given = block.sample_time
    return None if given is None else rational_step(given, f"The sample_time of {type(block).__name__}")


class ExternalBlock(Block):
    """Base of blocks whose step functions are compiled C functions: an FMU, or a plant in a library of your own.

    To write an external block you must:

    1. keep rules 1, 2 and 6 of `Block`. The C functions read and write the ports as flat arrays, in the order of the ports. A
       plant sets ``checks_finite``, so that a NaN in its outputs stops the run;
    2. state in `timing` when outputs are computed, and declare ``feedthrough=False`` for inputs without direct feedthrough;
    3. return from ``instantiate(step, name)`` an `External`, the running instance. Each run has its own instances;
    4. write the step functions in C, with the engine's signature::

           int32_t step(double *state, int64_t *table, const double *inputs, double *outputs, double t, int64_t k)

       ``table`` is a copy of the instance's table: at most 32 words, addresses and numbers. ``t`` is the time in seconds at
       the beginning of the step, ``k`` the step count of the block. ``state`` is not used. The functions return 0, or a status
       below a million that stops the run. `External.explain` returns the message for it;
    5. give the same two functions in Python, for the interpreted engine. They must give the same numbers.

    Examples
    --------
    >>> from fractions import Fraction
    >>> import numpy as np
    >>> from bayesftc import cosim, fmus
    >>> car, v = cosim.FMU(fmus.path("CruiseControl")), np.zeros(1)
    >>> isinstance(car, cosim.ExternalBlock), car.timing
    (True, 'plant')
    >>> running = car.instantiate(Fraction("0.02"), "car")
    >>> for k in range(50):
    ...     status = running.update(np.array([500.0, 0.0]), v, k * 0.02)
    >>> running.output(np.zeros(2), v, 1.0), v.round(3).tolist()
    (0, [4.879])
    >>> running.close()
    """

    #: ``"plant"``: the output function reads the outputs at t_k, which do not depend on the inputs at t_k. Then the update
    #: function makes a step. ``"direct"``: the same, but the outputs do depend on the inputs at t_k. ``"sampled"``: the output
    #: function makes the step with the inputs at t_k, and its outputs are those at t_k, as of a controller. There is no update.
    timing: Literal["plant", "direct", "sampled"] | None = "plant"

    def instantiate(self, step: Fraction, name: str) -> External:
        """Return a new running instance that makes steps of `step` seconds."""
        raise KernelError(f"{type(self).__name__} cannot be run: give it a method instantiate(step, name).")


class External(Protocol):
    """A running instance of an external block.

    If a coupling iterates or changes step sizes, compiled code calls ``save``, ``restore`` and ``forget``, which are slow
    because they are Python. If C functions with the signatures of FMI 2 save the instance, its attribute ``state_functions``
    can list them: the address of the instance, and those of the three functions.
    """

    table: NDArray[np.int64]

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 if there is only an output function."""

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """Write the outputs; return 0, or a status that stops the run."""

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """Make one step from time `t`; return 0, or a status that stops the run."""

    def explain(self, status: int) -> str:
        """Return the meaning of a status, with the last messages of the instance."""

    @property
    def has_ended(self) -> bool:
        """Whether the last status given to `explain` is no failure: the instance itself ends the simulation."""

    @property
    def can_save(self) -> bool:
        """Whether `save` and `restore` work."""

    def expect_return(self) -> None:
        """Prepare to return to earlier states from now on. Instances that always can do nothing."""

    def save(self) -> object:
        """Return the present state, for `restore`. It can be pickled if the instance can serialise it.

        Raises
        ------
        FMUError
            If the state cannot be saved.
        """

    def restore(self, saved: object) -> None:
        """Return to a saved state. This can be done repeatedly.

        Raises
        ------
        FMUError
            If it is not a state of this block, or is a state of another run that cannot be serialised.
        """

    def forget(self, saved: object) -> None:
        """Free the memory of a saved state, which cannot be restored any more. `close` frees all saved states."""

    def close(self) -> None:
        """Free the instance."""


class VariableStep(External, Protocol):
    """A running instance whose steps may be of any size, as `Coupling.step_error` requires."""

    step_word: int  #: The word of the table that holds the step size in seconds, as a double.

    @property
    def can_resize(self) -> bool:
        """Whether the step size can really be changed."""

    def resize(self, h: float) -> None:
        """Make steps of `h` seconds from now on, in interpreted runs; compiled runs change the word of the table."""
