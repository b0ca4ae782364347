"""The linear Gaussian model of plant and sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.models.checks import ROWS, Matrix, as_covariance, as_matrix, as_numbers, as_vector, frozen
from bayesftc.controllers.models.delays import Delays, with_delays
from bayesftc.controllers.models.disturbances import with_loads, with_sensor_errors
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.arguments import NamedArguments
from bayesftc.cosim.base.html import Printed, settings
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.blocks.linear_system import is_system
from bayesftc.cosim.errors import ModelError, StepSizeError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.identification.identify import Identification


def sizes_of(model: Any) -> str:
    """Return the numbers of states, controls and sensors of a model, and its sample time, as text."""
    parts = [counted(getattr(model, f"{name}s"), name) for name in ("state", "control", "sensor")]
    return f"{', '.join(parts)}, dt = {float(model.step):g} s"


SAME_DIRECTION = 1e-9
"""Relative size of rounding up to which two rows of C are multiples of each other."""


@dataclass(frozen=True)
class SignalNames:
    """Names of the signals of a model, as in python-control or the FMU.

    Parameters
    ----------
    controls, sensors, states : sequence of str
        A name for each control, each sensor, and each state of the plant (without disturbances). Sensors may share a name.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> names = controllers.SignalNames(controls=["force"], sensors=["v_1", "v_2"], states=["v"])
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1, names=names)
    >>> model.to_control().output_labels
    ['v_1', 'v_2']
    """

    controls: tuple[str, ...]
    sensors: tuple[str, ...]
    states: tuple[str, ...]

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, tuple(getattr(self, each.name)))


@dataclass(frozen=True, eq=False)
class LinearModel(Printed, NamedArguments):
    """``x_t+1 = A x_t + B u_t + q``, ``y_t = C x_t + eta`` with Gaussian ``q`` and ``eta`` (paper, section 2.1).

    Parameters
    ----------
    A : matrix, n x n
        Transition of the state in one step. `from_control` converts matrices of continuous time, ``dx/dt = A x + B u``.
    B : matrix, n x p
        Effect of the controls in one step.
    C : matrix, m x n
        Maps the state to the sensors; redundant sensors have equal rows.
    process_covariance : number, vector or matrix
        Covariance of ``q`` per step (n x n); a number or vector stands for a diagonal. May be singular.
    sensor_covariance : number, vector or matrix
        Nominal covariance of ``eta`` (m x m), positive definite.
    dt : float, str or Fraction
        Sample time in seconds.
    disturbances : int
        Number of states, the last ones, that are estimated disturbances: of the inputs (`with_disturbance`) or of the sensors
        (`with_sensor_errors`). They have no goals.
    constant : bool
        Whether the last disturbance is the constant 1, which turns a model of deviations into one of values (`about`). It has no
        uncertainty.
    names : SignalNames, optional
        Names of controls, sensors and the plant's states, for `to_control` and for messages.
    operating_control, operating_state : sequence of float, optional
        Control, and state of the plant without disturbances, at the operating point: results of `about`; leave them out.
    held_inputs : sequence of (str, float)
        Inputs that are not controls, with the values at which the plant was linearised (``at=``); leave it out.
    noise_effects : sequence of (str, sequence of float)
        Inputs with noise (``noise=``), each with its effect on the plant's states in a step; leave it out.
    delays : Delays, optional
        Result of `with_delays`; leave it out.

    Raises
    ------
    ModelError
        If dimensions do not fit or a covariance is not positive (semi-)definite.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    process_covariance: Matrix
    sensor_covariance: Matrix
    dt: float | str | Fraction
    disturbances: int = 0
    constant: bool = False
    names: SignalNames | None = field(default=None, kw_only=True)
    operating_control: Sequence[float] | None = field(default=None, kw_only=True, metadata={"derived": True})
    operating_state: Sequence[float] | None = field(default=None, kw_only=True, metadata={"derived": True})
    held_inputs: Sequence[tuple[str, float]] = field(default=(), kw_only=True, metadata={"derived": True})
    noise_effects: Sequence[tuple[str, Sequence[float]]] = field(default=(), kw_only=True, metadata={"derived": True})
    delays: Delays | None = field(default=None, kw_only=True, metadata={"derived": True})

    def __post_init__(self) -> None:
        if is_system(self.A):
            raise ModelError(
                "LinearModel takes matrices. For a system of python-control use LinearModel.from_control(system, "
                "process_covariance=..., sensor_covariance=..., dt=...), which also samples a continuous one."
            )
        of_a_model = isinstance(self.A, np.ndarray) and not self.A.flags.writeable  # which has warned already
        A = as_matrix("The model's A", self.A)
        n = A.shape[0]
        if A.shape != (n, n):
            raise ModelError(
                f"The model's A is {A.shape[0]} x {A.shape[1]}; it must be square, with a row for each state."
            )
        C = as_matrix("The model's C", np.atleast_2d(as_numbers("The model's C", self.C, ROWS)), columns=n)
        values = {
            "A": A,
            "B": as_matrix("The model's B", self.B, rows=n),
            "C": C,
            "process_covariance": as_covariance(
                "The model's process_covariance", self.process_covariance, n, singular=True
            ),
            "sensor_covariance": as_covariance("The model's sensor_covariance", self.sensor_covariance, C.shape[0]),
            "dt": rational_step(self.dt, "The model's sample time"),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if not 0 <= self.disturbances < n:
            raise ModelError(
                f"The model has disturbances={self.disturbances} among {n} states; at least one must be the plant's."
            )
        if self.constant and (not self.disturbances or not _is_constant(self, n)):
            raise ModelError(
                "The model has constant=True, but its last state is not constant; use about(), as the last change of the model."
            )
        if self.names is not None:
            sizes = {"controls": self.controls, "sensors": self.sensors, "states": n - self.disturbances}
            for kind, size in sizes.items():
                if len(given := getattr(self.names, kind)) != size:
                    raise ModelError(
                        f"The model has names for {len(given)} {kind}, but it has {size} {kind}; give each a name."
                    )

        if not (of_a_model or self.names is not None or self.disturbances or self.delays is not None):
            _warn_of_continuous_time(A, self.step)

    @property
    def states(self) -> int:
        """Number of states n, disturbances included."""
        return len(self.matrix("A"))

    @property
    def controls(self) -> int:
        """Number of controls p."""
        return int(self.matrix("B").shape[1])

    @property
    def sensors(self) -> int:
        """Number of sensors m."""
        return len(self.matrix("C"))

    @property
    def sizes(self) -> str:
        """Numbers of states, controls and sensors, and the sample time, as text."""
        return sizes_of(self)

    def __str__(self) -> str:
        """Return the sizes, for ``print(model)``; ``repr(model)`` has all settings."""
        return f"{type(self).__name__} of {self.sizes}"

    def _repr_html_(self) -> str:
        """Return the sizes and matrices as a table, for notebooks."""
        return settings(self, [("sizes", self.sizes)])

    @property
    def step(self) -> Fraction:
        """Sample time in seconds, exact."""
        return rational_step(self.dt)

    @property
    def quantities(self) -> Floats:
        """Matrix that maps the plant's states to what each sensor measures, without disturbances, errors and delays (m x n)."""
        rows = self.matrix("C").copy()
        if self.delays is not None:
            rows[:, : self.delays.plant] += rows[:, self.delays.places] @ self.delays.present
            rows[:, self.delays.places] = 0.0
        rows[:, self.states - self.disturbances : self.states - self.constant] = 0.0
        return frozen(rows)

    @property
    def alike(self) -> tuple[tuple[int, ...], ...]:
        """The sensors in groups that measure the same quantity."""
        groups: dict[bytes, list[int]] = {}
        for i, row in enumerate(self.quantities):
            groups.setdefault((row + 0.0).tobytes(), []).append(i)  # 0 and -0 are the same
        return tuple(tuple(group) for group in groups.values())

    @property
    def proportional(self) -> tuple[tuple[int, ...], ...]:
        """The sensors in groups whose readings are multiples of each other but for a constant, as a depth and an altitude.

        Sensors in such a group are compared by the states that they imply. Sensors in a group of `alike` can be compared sample
        by sample.
        """
        rows = self.quantities[:, : self.states - self.constant]
        rows = rows / np.maximum(np.abs(rows).max(axis=0), np.finfo(float).tiny)  # the units of states do not matter
        groups: list[list[int]] = []
        for i, row in enumerate(rows):
            largest = int(np.argmax(np.abs(row)))
            for group in groups:
                other = rows[group[0]]
                apart = row * other[largest] - other * row[largest]
                same = row.any() == other.any()  # what reads no state is a multiple of nothing else
                if same and np.abs(apart).max() <= SAME_DIRECTION * np.abs(row[largest]) * np.abs(other).max():
                    group.append(i)
                    break
            else:
                groups.append([i])
        return tuple(tuple(group) for group in groups)

    @property
    def quantity(self) -> tuple[int, ...]:
        """For each sensor, the number of its group in `alike`."""
        return tuple(next(q for q, group in enumerate(self.alike) if i in group) for i in range(self.sensors))

    @property
    def quantity_noise(self) -> Floats:
        """For each sensor, the geometric mean of the variances of noise of the sensors that measure the same quantity (m)."""
        own, alike = np.diag(self.matrix("sensor_covariance")), [list(self.alike[q]) for q in self.quantity]
        return frozen(np.array([own[i] * np.exp(np.log(own[alike[i]] / own[i]).mean()) for i in range(self.sensors)]))

    @property
    def plant_states(self) -> int:
        """Number of the plant's own states, without disturbances and past signals (`with_delays`); they are the first ones."""
        return self.states - self.disturbances if self.delays is None else self.delays.plant

    @property
    def effects(self) -> Floats:
        """Effect of the controls on the states, without delays (n x p)."""
        effects = self.matrix("B").copy()
        if self.delays is not None:
            last = self.delays.plant - 1
            for j, steps in enumerate(self.delays.inputs):
                last += steps
                if steps:
                    effects[:, j] = self.matrix("A")[:, last]
        return frozen(effects)

    @property
    def undelayed(self) -> LinearModel:
        """The model without the delays of `with_delays`."""
        if self.delays is None:
            return self
        keep = self.delays.others(self.states)
        disturbances = slice(self.states - self.disturbances, self.states)
        C = self.quantities.copy()
        C[:, disturbances] = self.matrix("C")[:, disturbances]
        return replace(
            self,
            A=self.matrix("A")[np.ix_(keep, keep)],
            B=self.effects[keep],
            C=C[:, keep],
            process_covariance=self.matrix("process_covariance")[np.ix_(keep, keep)],
            delays=None,
            names=self.names and replace(self.names, states=self.names.states[: self.delays.plant]),
        )

    @property
    def state_at_samples(self) -> Floats:
        """For each sensor, the least deviation of the state at which all sensors of its quantity deviate by 1 (n x m).

        Other quantities do not deviate, as far as the plant's states permit that, nor do disturbances. Past readings deviate as
        the present ones.
        """
        rest = self._rest()
        together = np.equal.outer(self.quantity, self.quantity).astype(float)
        states: Floats = rest @ np.linalg.pinv(self.matrix("C") @ rest) @ together
        return states

    @property
    def unread(self) -> Floats:
        """The share of each of the plant's states that no sensor reads at one instant; 0 for all other states (n)."""
        read, share = self.matrix("C") @ self._rest(), np.zeros(self.states)
        share[: self.plant_states] = 1.0 - np.diag(np.linalg.pinv(read) @ read)
        return np.where(share > 1e-9, share, 0.0)

    def _rest(self) -> Floats:
        """Return the map of the plant's states to all states at rest: past readings are the present ones, disturbances 0."""
        rest = np.zeros((self.states, self.plant_states))
        rest[: self.plant_states] = np.eye(self.plant_states)
        if self.delays is not None:
            rest[self.delays.places] = self.delays.present
        return rest

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of all states: of the plant, else ``x[0]``, ..; of past signals (``u[-1]``); disturbances; ``constant``.

        A disturbance that only sensors read is ``sensor_error[0]``, with the numbers of these sensors.
        """
        plant = tuple(f"x[{i}]" for i in range(self.plant_states))
        past = () if self.delays is None else self.delays.labels
        last = ("constant",) * self.constant
        return (*((*plant, *past) if self.names is None else self.names.states), *self._disturbance_names(), *last)

    def _disturbance_names(self) -> list[str]:
        A, C = self.matrix("A"), self.matrix("C")
        first, end = self.states - self.disturbances, self.states - self.constant
        names: list[str] = []
        for i in range(first, end):
            readers = ",".join(map(str, np.flatnonzero(C[:, i])))
            only_read = readers and not np.delete(A[:, i], i).any()
            name = (
                f"sensor_error[{readers}]"
                if only_read
                else f"disturbance[{sum(n.startswith('disturbance') for n in names)}]"
            )
            same = sum(each.startswith(name) for each in names)  # a sensor may have several errors
            names.append(f"{name}_{same + 1}" if same else name)
        return names

    @property
    def moving(self) -> LinearModel:
        """The model without its constant, for deviations from the operating point."""
        if not self.constant:
            return self
        return replace(
            self,
            A=self.matrix("A")[:-1, :-1],
            B=self.matrix("B")[:-1],
            C=self.matrix("C")[:, :-1],
            process_covariance=self.matrix("process_covariance")[:-1, :-1],
            disturbances=self.disturbances - 1,
            constant=False,
        )

    def matrix(self, name: str) -> Floats:
        """Return one of the matrices by name, as an array."""
        return np.asarray(getattr(self, name), dtype=np.float64)

    def to_control(self) -> Any:
        """Return the model as a discrete-time `control.StateSpace` with its sample time and names.

        Outputs are the sensors; sensors of the same name become ``v[0]``, ``v[1]``. A model about an operating point (`about`)
        gives the system of deviations from it. The system contains no covariances; `from_control` needs them as arguments.

        Examples
        --------
        >>> from bayesftc.controllers import LinearModel
        >>> LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1).to_control().output_labels
        ['y[0]', 'y[1]']
        """
        import control

        from bayesftc.cosim.control.control_system import allowed

        model = self.moving
        sizes = {"u": model.controls, "y": model.sensors}
        controls, readings = (tuple(f"{x}[{i}]" for i in range(size)) for x, size in sizes.items())
        names = self.names or SignalNames(controls, readings, model.state_names)
        sensors = names.sensors
        repeated = {name for name in sensors if sensors.count(name) > 1}
        outputs = [f"{name}[{sensors[:i].count(name)}]" if name in repeated else name for i, name in enumerate(sensors)]
        return control.ss(
            *(model.matrix(name) for name in "ABC"),
            np.zeros((model.sensors, model.controls)),
            float(self.step),
            inputs=[allowed(name) for name in names.controls],
            outputs=[allowed(name) for name in outputs],
            states=[allowed(name) for name in model.state_names],
        )

    @classmethod
    def from_control(
        cls,
        system: Any,
        *,
        process_covariance: Matrix | None = None,
        sensor_covariance: Matrix | None = None,
        dt: float | str | Fraction | None = None,
        sensors: int | Sequence[int] | None = None,
    ) -> LinearModel:
        """Return the model of a python-control linear system.

        Parameters
        ----------
        system : control.StateSpace or control.TransferFunction
            A continuous system (discretised by zero-order hold at `dt`) or a discrete one. Its outputs must not depend on its
            inputs at the same instant (D = 0).
        process_covariance : number, vector or matrix
            Covariance of the process noise per step; required.
        sensor_covariance : number, vector or matrix
            Covariance of the sensors' noise; required.
        dt : float, str or Fraction, optional
            Sample time in seconds; required for a continuous system.
        sensors : int or sequence of int, optional
            Number of sensors, a multiple of the system's outputs: sensor i measures output i modulo their number. Or the number
            of sensors of each output. By default the number of rows of `sensor_covariance`, or one sensor an output.

        Returns
        -------
        LinearModel
            The model, with the system's names of inputs, outputs and states.
        """
        import control

        from bayesftc.controllers.models.names import measured_by

        if process_covariance is None or sensor_covariance is None:
            raise ModelError(
                "from_control() needs process_covariance= and sensor_covariance=, the squares of the standard deviations of the "
                "process noise per step and of the sensors' noise, such as LinearModel.from_control(system, "
                "process_covariance=1e-4, sensor_covariance=0.01, dt=0.1)."
            )
        linear = control.ss(system)
        states = linear.state_labels  # lost when the system is sampled
        if linear.isctime(strict=True) or linear.dt is None or linear.dt == 0:
            if dt is None:
                raise StepSizeError("The system is continuous; give the controller's sample time dt= in seconds.")
            linear = control.sample_system(linear, float(rational_step(dt)), method="zoh")
            step = rational_step(dt)
        else:
            given = linear.dt if linear.dt is not True else dt
            if given is None:
                raise StepSizeError("The system is discrete without a sample time (dt=True); give dt= in seconds.")
            step = rational_step(float(given)) if not isinstance(given, str | Fraction) else rational_step(given)
            if dt is not None and rational_step(dt) != step:
                raise StepSizeError(
                    f"The system's sample time is {float(step):g} s, but dt={dt!r} is given; resample the system first."
                )
        if np.any(linear.D != 0):
            raise ModelError(
                "The system has direct feedthrough (D is not 0), which the model y = C x cannot represent. Put a lag before the "
                "input: it becomes a state of the plant."
            )
        outputs = linear.C.shape[0]
        if sensors is None:
            rows = np.asarray(sensor_covariance, float)
            sensors = rows.shape[0] if rows.ndim else outputs
        order = measured_by(sensors, outputs)
        names = SignalNames(tuple(system.input_labels), tuple(system.output_labels[i] for i in order), tuple(states))
        return cls(linear.A, linear.B, linear.C[order], process_covariance, sensor_covariance, step, names=names)

    @classmethod
    def from_fmu(
        cls,
        fmu: Any,
        *,
        measured: str | Sequence[str],
        actuated: str | Sequence[str],
        dt: float | str | Fraction | None = None,
        at: Mapping[str, float | Sequence[float]] | None = None,
        order: int | None = None,
        noise: Mapping[str, float | Sequence[float]] | None = None,
        sensors: int | Sequence[int] | None = None,
        sensor_std: float | Sequence[float] = 0.01,
        disturbance: Matrix | None = None,
    ) -> LinearModel:
        """Return the model of an FMU about a steady state, in the FMU's values.

        *Model exchange* (also where the file supports both): the steady state is searched from the start values, with the inputs
        held. If there is none, actuated inputs that `at` does not give may change. If there is still none, a steady motion
        suffices, in which states on which nothing depends (a car's position) change at a constant rate. The model uses the FMU's
        directional derivatives, or central differences if it has none, with exact sampling (zero-order hold). States are those
        of the FMU, without integrators that no output sees.

        *Co-simulation*, without access to states: the FMU runs from its start until its outputs are constant. Then it gets short
        pulses of each input, up and down, of several sizes; only the sizes whose responses agree best are used. The model is the
        eigensystem realisation of the responses (as python-control's `era`). Its order is the number of singular values above the
        uncertainty of the responses. Each experiment starts from a saved state, or in a new instance if the FMU cannot save its
        state. States are balanced and have no physical meaning. A mode that no input moves is not in the model.

        For a plant that never reaches a steady state use `identify` with a recording.

        Parameters
        ----------
        fmu : FMU or path
            The plant, whose parameters determine its start.
        measured, actuated : str or sequence of str
            Names of the outputs that sensors measure, and of the inputs that the controller drives. The name of an array of FMI 3
            stands for all its elements, ``"y[1]"`` (of a matrix ``"T[0,1]"``) for one.
        dt : float, str or Fraction, optional
            Sample time in seconds; by default the step size that the FMU recommends.
        at : mapping of input to number or vector, optional
            Inputs at the operating point; by default their start values.
        order : int, optional
            Number of states of a model by pulse responses. With it, an FMU for model exchange gives such a model as well.
        noise : mapping of input to number or vector, optional
            Inputs of the FMU at which process noise acts, and its standard deviation in each sample. By default the actuated
            inputs, with 5 % of their value at the operating point or of 1, whichever is larger.
        sensors : int or sequence of int, optional
            Number of sensors, a multiple of the measured outputs: sensor i measures output i modulo their number. Or the number
            of sensors of each output: ``(1, 3)`` is one sensor of the first output, then three of the second one. By default one
            sensor an output.
        sensor_std : number or vector
            Standard deviation of the sensors' noise: one for all, for each output, or for each sensor.
        disturbance : number, vector or matrix, optional
            Covariance per sample of an unknown load on each control, a random walk that is estimated: see `with_disturbance`.

        Raises
        ------
        ModelError
            If there is no steady state, or an output depends directly on an input.
        FMUError
            If the FMU fails.

        Warns
        -----
        PoorFitWarning
            If the model does not reproduce the responses from which it is made.

        Examples
        --------
        >>> from bayesftc import fmus
        >>> from bayesftc.controllers import LinearModel
        >>> model = LinearModel.from_fmu(fmus.path("PositionServo"), measured="angle", actuated="voltage")
        >>> sorted(np.linalg.eigvals(model.A).round(6).tolist())
        [0.82853, 0.968606, 1.0]
        """
        from bayesftc.controllers.models.linearization import linearize
        from bayesftc.controllers.models.names import names_of

        linear = linearize(fmu, measured=measured, actuated=actuated, noise=noise, dt=dt, at=at, order=order)
        return linear.model(
            names_of(measured, "measured"),
            names_of(actuated, "actuated"),
            noise=noise,
            sensors=sensors,
            sensor_std=sensor_std,
            disturbance=disturbance,
        )

    @classmethod
    def identify(
        cls,
        data: Any,
        *,
        inputs: str | Sequence[str],
        outputs: str | Sequence[str] | Mapping[str, str | Sequence[str]],
        order: int | None = None,
        dt: float | str | Fraction | None = None,
        time: str | None = None,
        held_out: float = 0.3,
        past: int | None = None,
        input_delays: int | Sequence[int] = 0,
        sensor_delays: int | Sequence[int] = 0,
    ) -> Identification:
        """Identify a model from a recording; the result has it as `model`, with measures of its quality.

        The method is subspace identification in predictor form (SSARX with canonical variables), which also works with feedback:
        a plant that must be held by a controller can be recorded in operation. Something else must move the inputs as well, such
        as a changing goal or a dither. Process and sensor covariances, with independent noise of the sensors, are those whose
        Kalman filter is nearest to the innovations model. Fewer than (n + 1) / 2 outputs do not determine the process covariance
        of n states; one of several equally good ones is then taken. States are canonical variables of unit variance and have no
        physical meaning.

        A few missing samples are left out, with all rows that need them. If less than half of the stretches are complete, for
        example with a sensor that delivers every fifth sample, a Kalman filter bridges the gaps. Expectation and maximisation
        then maximise the likelihood of the present samples over model and noise (Gibson and Ninness, Automatica 41, 2005). The
        order is that of the best Bayesian information criterion.

        The last part of the recording is held out for tests: the share of each output that the model explains one sample ahead
        and by simulation, the whiteness of residuals, and a comparison with a long autoregression.

        Parameters
        ----------
        data : Result, path of a CSV file, or pandas.DataFrame
            The recording. An input holds from its row to the next. Empty cells and missing rows are missing samples; a slower
            sensor has a value in every fifth row, for example.
        inputs : str or sequence of str
            Columns of the controls. The name of a vector signal stands for all its elements.
        outputs : str, sequence of str, or mapping of quantity to these
            Columns of the sensors, each of a quantity of its own. Redundant sensors have the name of what they measure:
            ``outputs={"oxygen": ["pO2_A", "pO2_B", "pO2_C"], "temperature": "T"}`` are three sensors of one quantity, and one of
            another.
        order : int, optional
            Number of states; by default from the singular values (Bauer's criterion).
        dt : float, str or Fraction, optional
            Sample time in seconds; by default that of the times, which must then be evenly spaced. Rows may be missing. With
            `dt`, each row belongs to the nearest step, as in `cosim.fit`. Without a column of times, each row is a step.
        time : str, optional
            Name of the column of times, in seconds or in the unit that ends its name, as in ``t_ms``; by default a column that
            is called t, time or timestamp, also with a unit, else the first one with dates (ISO 8601).
        held_out : float
            Share of the recording, at its end, that is held out for tests.
        past : int, optional
            Length of the underlying autoregression; by default chosen by Akaike's criterion.
        input_delays, sensor_delays : int or sequence of int
            Known dead times in samples, of all inputs and outputs or of each. The rest of the plant is then identified, and the
            model gets the delays by `with_delays`. Without them a delay of d samples needs d states of the identified model.

        Returns
        -------
        Identification
            The model with ``model``, ``fit``, ``whiteness``, ``describe()``, ``plot()``; `design` accepts it as a plant.

        Raises
        ------
        ModelError
            If there are too few samples (the message gives the number needed), or an input or output is constant.
        RecordingError
            If the file cannot be read, or the recording does not fit its step.
        StepSizeError
            If the times are not evenly spaced and `dt` is not given.

        Warns
        -----
        PoorFitWarning
            If the inputs are not persistently exciting of an order that is twice the model's (as a single step, or a sine), if
            they hardly move in the held-out part, or if they follow from the outputs. Also if a long autoregression predicts the
            held-out part better, if residuals are correlated, or if nothing is explained.
        """
        from bayesftc.controllers.identification.identify import identify

        with reported("Identifying a model of the recording, for seconds to a minute."):
            return identify(
                data,
                inputs=inputs,
                outputs=outputs,
                order=order,
                dt=dt,
                time=time,
                held_out=held_out,
                past=past,
                input_delays=input_delays,
                sensor_delays=sensor_delays,
            )

    def with_disturbance(self, covariance: Matrix = 1e-4) -> LinearModel:
        """Return the model with an unknown disturbance on each control, which the controller then estimates.

        The disturbance ``d`` adds to the control, ``x_t+1 = A x_t + B (u_t + d_t) + q``, and drifts as a random walk. Under a
        flat control prior, a constant load then leaves no steady error (Pannocchia and Rawlings, AIChE J. 49, 2003). A proper
        control prior moves the control towards the prior mean, which leaves a steady error. A load that acts elsewhere than at
        the control also leaves one if further outputs are measured. Make such a load a state of the plant.

        The disturbances follow the plant's states and its past signals, whatever other changes the model has or gets:
        `with_disturbance`, `with_sensor_errors`, `with_delays` and `about` may be applied in any order.

        Parameters
        ----------
        covariance : number, vector or matrix
            Covariance of the walk per step (p x p), in units of the control.
        """
        return with_loads(self, covariance)

    def with_sensor_errors(
        self,
        std: float | Sequence[float],
        time_constant: float | Sequence[float],
        sensors: Sequence[int] | None = None,
        *,
        common: bool = False,
    ) -> LinearModel:
        """Return the model with errors of the sensors that are correlated in time, which are then estimated.

        Each error is a first-order autoregressive process (Ornstein and Uhlenbeck's, sampled), ``c_t+1 = exp(-dt /
        time_constant) c_t + w``. It adds to the sensor's reading. It is coloured noise, or, if the time constant is far longer
        than the recording, a bias. `sensor_covariance` remains the sensor's white noise. Apply this method several times for a
        sensor with several kinds of errors. An equal constant error of all sensors cannot be distinguished from the state.

        Parameters
        ----------
        std : number or vector
            Standard deviation of the error in the sensor's unit, for all sensors or for each of `sensors`.
        time_constant : number or vector
            Seconds in which the autocorrelation falls to 1/e.
        sensors : sequence of int, optional
            Numbers of the sensors with the error; by default all.
        common : bool
            Whether all sensors have the same error (wheels of one axle), scaled by `std`, instead of one each.
        """
        return with_sensor_errors(self, std, time_constant, sensors, common)

    def with_delays(self, inputs: int | Sequence[int] = 0, sensors: int | Sequence[int] = 0) -> LinearModel:
        """Return the model with dead times: controls that act late, and sensors that deliver old values.

        The model ``x_t+1 = A x_t + B u_t-d`` gets a state for each past control, and for each past value that a late sensor
        still has to deliver. Late sensors of one quantity share these states. The result has no delay, so that belief,
        precision learners, `LQGController`, `StateEstimator` and exports need no further setting.

        The plant's states stay the first ones of ``x_hat``. Past signals follow (`state_names`: ``u[-1]`` is the control of the
        sample before), then disturbances and the constant of `about`. Past signals have no process noise and no goals. Matrices
        over the states, initial means and initial covariances may leave them out. If an initial mean or
        covariance leaves them out, past controls count as known: 0, or the control at the operating point of `about`. Past
        readings then count as equal to the present ones, and as uncertain.

        Estimated disturbances of the controls act without delay.

        Parameters
        ----------
        inputs : int or sequence of int
            Samples by which each control acts late, in addition to the one sample of every sampled plant.
        sensors : int or sequence of int
            Samples by which the values of each sensor are old.

        Raises
        ------
        ModelError
            If a delay is no whole number of samples, or the model has delays already.

        Examples
        --------
        >>> from bayesftc.controllers import LinearModel
        >>> model = LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1).with_delays(inputs=2, sensors=[0, 1])
        >>> model.state_names
        ('x[0]', 'u[-1]', 'u[-2]', 'y1[-1]')
        """
        late: LinearModel = with_delays(self, inputs, sensors)
        return late

    def about(self, x: ArrayLike, u: ArrayLike, y: ArrayLike, *, following: ArrayLike | None = None) -> LinearModel:
        """Return this model of deviations from an operating point as a model of values; its last state is the constant 1.

        Parameters
        ----------
        x, u, y : vector
            Operating point: state of the plant (without disturbances), control and readings.
        following : vector, optional
            The state one step later; by default `x`, as at a steady state.
        """
        if self.constant:
            raise ModelError("The model is already one of values; apply about() once.")
        if self.delays is not None:  # past controls count as those of the operating point
            plain = self.undelayed.about(x, u, y, following=following)
            return plain.with_delays(self.delays.inputs, self.delays.sensors)
        n, plant = self.states, self.states - self.disturbances
        A, B, C = (self.matrix(name) for name in "ABC")
        x, u, y = (
            as_vector("The x", x, plant),
            as_vector("The u", u, self.controls),
            as_vector("The y", y, self.sensors),
        )
        reached = x if following is None else as_vector("The following state", following, plant)
        drift = np.zeros((n, 1))
        drift[:plant, 0] = reached - A[:plant, :plant] @ x - B[:plant] @ u
        reading = (y - C[:, :plant] @ x)[:, None]
        Q = np.zeros((n + 1, n + 1))
        Q[:n, :n] = self.matrix("process_covariance")
        return replace(
            self,
            A=np.block([[A, drift], [np.zeros((1, n)), np.ones((1, 1))]]),
            B=np.vstack([B, np.zeros((1, self.controls))]),
            C=np.hstack([C, reading]),
            process_covariance=Q,
            disturbances=self.disturbances + 1,
            constant=True,
            operating_control=tuple(u.tolist()),
            operating_state=tuple(x.tolist()),
        )


def _warn_of_continuous_time(A: Floats, step: Fraction) -> None:
    """Warn of a transition matrix with eigenvalues that no sampled plant has, but plants in continuous time have.

    Sampling makes exp(a h) of an eigenvalue a, which is no negative number. Slow modes have eigenvalues near 1, also where a fast
    one has a negative real part.
    """
    values = np.linalg.eigvals(A)
    least = values[np.argmin(values.real)]
    alone = abs(least.imag) < 1e-9 and np.sum(np.abs(values - least) < 1e-6) == 1
    if (alone and least.real < -1.0 - 1e-9) or (least.real < -1e-9 and values.real.max() <= 1e-9):
        value = f"{least if least.imag else least.real:.3g}"
        warn_user(
            f"The model's A has the eigenvalue {value}, so that a mode changes its sign within two steps of {show(step)} s. "
            "LinearModel takes the matrices of one step, x_t+1 = A x_t + B u_t. If yours are of dx/dt = A x + B u, use "
            "LinearModel.from_control(control.ss(A, B, C, 0), process_covariance=..., sensor_covariance=..., dt=...)."
        )


def _is_constant(model: LinearModel, n: int) -> bool:
    """Return whether the last state is constant."""
    last = np.eye(n)[-1]
    Q = model.matrix("process_covariance")
    return np.array_equal(model.matrix("A")[-1], last) and not (model.matrix("B")[-1].any() or Q[-1].any())
