"""The nonlinear Gaussian model of plant and sensors: functions of motion and measurement, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.models.checks import Matrix, as_covariance, as_number, as_vector
from bayesftc.controllers.models.linear import LinearModel, SignalNames, sizes_of
from bayesftc.controllers.models.trial import try_out
from bayesftc.cosim.base.arguments import NamedArguments
from bayesftc.cosim.base.html import Printed, settings
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.stepping.differentiation import jacobian
from bayesftc.cosim.types import Floats, Kernel, argument_names


@dataclass(frozen=True, eq=False)
class NonlinearModel(Printed, NamedArguments):
    """``x_t+1 = f(x_t, u_t) + q``, ``y_t = g(x_t) + eta`` with Gaussian ``q`` and ``eta``.

    The functions are step functions by the rules of `bayesftc.cosim.Block`: plain Python, scalar loops, all mathematics from
    `bayesftc.cosim.ops`. Each writes every element of its last argument. They may use constants of the code around them.

    Parameters
    ----------
    f : function
        ``f(x, u, x_next)``: writes the state one step later.
    g : function
        ``g(x, y)``: writes the reading of each sensor; redundant sensors are equal elements.
    states, controls, sensors : int
        Numbers n of states, p of controls, m of sensors.
    process_covariance : number, vector or matrix
        Covariance of ``q`` per step (n x n); a number or vector stands for a diagonal. May be singular.
    sensor_covariance : number, vector or matrix
        Nominal covariance of ``eta`` (m x m), positive definite.
    dt : float, str or Fraction
        Sample time in seconds.
    f_jacobian : function, optional
        ``f_jacobian(x, u, F, B)``: writes the derivatives of the next state by the state (n x n) and by the control (n x p).
        By default `bayesftc.cosim.jacobian` derives it from `f`.
    g_jacobian : function, optional
        ``g_jacobian(x, C)``: writes the derivatives of the readings by the state (m x n). By default derived from `g`.
    disturbances : int
        Number of states, the last ones, that are disturbances, not states of the plant. They have no goals.
    names : SignalNames, optional
        Names of controls, sensors and states.
    start : sequence of float, optional
        The state in which the plant starts, for `initial_mean` of a controller.

    Raises
    ------
    ModelError
        If sizes do not fit, a function does not write all of its result or writes anything else, or a covariance is not positive
        (semi-)definite.
    KernelError
        If a function breaks the rules of step functions.

    Examples
    --------
    >>> from bayesftc.controllers import NonlinearModel
    >>> from bayesftc.cosim.ops import sin
    >>> def swing(x, u, x_next):
    ...     x_next[0] = x[0] + 0.02 * x[1]
    ...     x_next[1] = x[1] + 0.02 * (u[0] - 9.81 * sin(x[0]))
    >>> def angle_twice(x, y):
    ...     y[0] = x[0]
    ...     y[1] = x[0]
    >>> pendulum = NonlinearModel(swing, angle_twice, 2, 1, 2, process_covariance=1e-6, sensor_covariance=1e-4, dt=0.02)
    >>> pendulum.linearised([0.0, 0.0]).A.round(4).tolist()
    [[1.0, 0.02], [-0.1962, 1.0]]
    """

    f: Kernel
    g: Kernel
    states: int
    controls: int
    sensors: int
    process_covariance: Matrix
    sensor_covariance: Matrix
    dt: float | str | Fraction
    f_jacobian: Kernel | None = None
    g_jacobian: Kernel | None = None
    disturbances: int = 0
    names: SignalNames | None = None
    start: Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name in ("states", "controls", "sensors"):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 1:
                raise ModelError(f"The model has {name}={number!r}; it must be a whole number, at least 1.")
        n, p, m = self.states, self.controls, self.sensors
        as_number("The model has disturbances", self.disturbances, least=0, most=n - 1, whole=True)
        values: dict[str, Any] = {
            "process_covariance": as_covariance(
                "The model's process_covariance", self.process_covariance, n, singular=True
            ),
            "sensor_covariance": as_covariance("The model's sensor_covariance", self.sensor_covariance, m),
            "dt": rational_step(self.dt, "The model's sample time"),
        }
        if self.start is not None:
            values["start"] = tuple(as_vector("The model's start", self.start, n).tolist())
        for name, value in values.items():
            object.__setattr__(self, name, value)
        try_out("The model's f", self.f, "f(x, u, x_next)", [n, p], [(n,)])
        try_out("The model's g", self.g, "g(x, y)", [n], [(m,)])
        if self.f_jacobian is not None:
            try_out("The model's f_jacobian", self.f_jacobian, "f_jacobian(x, u, F, B)", [n, p], [(n, n), (n, p)])
        if self.g_jacobian is not None:
            try_out("The model's g_jacobian", self.g_jacobian, "g_jacobian(x, C)", [n], [(m, n)])
        self.derivatives  # noqa: B018 - raises for a function that cannot be differentiated

    @property
    def derivatives(self) -> tuple[Kernel, Kernel]:
        """The Jacobians of f and of g as step functions, ``(x, u, F, B)`` and ``(x, C)``: the given ones, else derived."""
        of_f = self.f_jacobian or _derived("f", self.f, (self.states, self.controls), self.states)
        return of_f, self.g_jacobian or _derived("g", self.g, (self.states,), self.sensors)

    #: Past signals are states like others, which f moves on; see `LinearModel.with_delays`.
    delays: ClassVar[None] = None

    @property
    def plant_states(self) -> int:
        """Number of the plant's own states, without disturbances; they are the first ones."""
        return self.states - self.disturbances

    @property
    def sizes(self) -> str:
        """Numbers of states, controls and sensors, and the sample time, as text."""
        return sizes_of(self)

    def __str__(self) -> str:
        """Return the sizes, for ``print(model)``; ``repr(model)`` has all settings."""
        return f"{type(self).__name__} of {self.sizes}"

    def _repr_html_(self) -> str:
        """Return the settings as a table, for notebooks."""
        return settings(self, [("sizes", self.sizes)])

    @property
    def step(self) -> Fraction:
        """Sample time in seconds, exact."""
        return rational_step(self.dt)

    def matrix(self, name: str) -> Floats:
        """Return one of the covariances by name, as an array."""
        return np.asarray(getattr(self, name), dtype=np.float64)

    def linearised(self, x: ArrayLike, u: ArrayLike = 0.0) -> LinearModel:
        """Return the linear model of small deviations from a state and a control.

        Parameters
        ----------
        x : vector
            The state.
        u : number or vector
            The control.

        Raises
        ------
        ModelError
            If f, g or a derivative is not finite there.
        """
        n, p, m = self.states, self.controls, self.sensors
        x, u = as_vector("The state x", x, n), as_vector("The control u", u, p)
        A, B, C = np.empty((n, n)), np.empty((n, p)), np.empty((m, n))
        following, reading = np.empty(n), np.empty(m)
        of_f, of_g = self.derivatives
        with np.errstate(all="ignore"):
            self.f(x, u, following)
            self.g(x, reading)
            of_f(x, u, A, B)
            of_g(x, C)
        for name, value in (
            ("f", following),
            ("g", reading),
            ("derivative of f", A),
            ("derivative of f", B),
            ("derivative of g", C),
        ):
            if not np.isfinite(value).all():
                raise ModelError(
                    f"The model's {name} is not finite at x = {x.tolist()}, u = {u.tolist()}, where the controller begins. Give "
                    "an initial_mean at which it is."
                )
        return LinearModel(
            A,
            B,
            C,
            self.process_covariance,
            self.sensor_covariance,
            self.dt,
            disturbances=self.disturbances,
            names=self.names,
        )

    @classmethod
    def from_fmu(
        cls,
        fmu: Any,
        *,
        measured: str | Sequence[str],
        actuated: str | Sequence[str],
        states: Mapping[str, str] | Sequence[str] | None = None,
        dt: float | str | Fraction | None = None,
        at: Mapping[str, float | Sequence[float]] | None = None,
        substeps: int | None = None,
        noise: Mapping[str, float | Sequence[float]] | None = None,
        process_covariance: Matrix | None = None,
        sensors: int | Sequence[int] | None = None,
        sensor_std: float | Sequence[float] = 0.01,
        disturbance: Matrix | None = None,
    ) -> NonlinearModel:
        """Return the model of an FMU: its own equations, for any state.

        The model uses instances of the FMU of its own, beside the plant's. They stay loaded until the process ends. The states
        are those of the FMU, and `names` has their order. Where the FMU reports an error, the model is not finite. A step of
        the model always begins at 0 s, so the plant must not depend on time.

        *Model exchange* (also where the file supports both): the classical Runge-Kutta method with a fixed number of substeps
        integrates the FMU's derivatives. Jacobians are the exact ones of that method where the FMU has directional derivatives,
        else central differences. FMUs with event indicators, a time event or discrete variables are refused. So are FMUs whose
        derivatives or outputs at equal states and inputs differ between 0, 0.73, 1.3, 13.7 and 1009.3 s.

        *Co-simulation*: the FMU is initialized at the state and makes one step, and Jacobians are central differences. This
        needs an FMU that saves its state (canGetAndSetFMUstate) and whose states can be set before initialization. Events are
        refused in FMI 3 (hasEventMode). In FMI 2 there is no check for them.

        The construction compares the model with the first ten steps of the FMU, and refuses an FMU with further states. In
        co-simulation this is the only check for a dependence on time.

        Parameters
        ----------
        fmu : FMU or path
            The plant. Its parameters are those of the model.
        measured, actuated : str or sequence of str
            Names of the outputs that sensors measure, and of the inputs that the controller drives.
        states : mapping of str to str, or sequence of str, optional
            For co-simulation only: the variables that are the states, and for each the variable that sets it before
            initialization, as ``{"angle": "angle_0"}``. In a sequence each sets itself. The default is all outputs and local
            variables ``v`` with a parameter ``v_0``, or else those that can be set themselves.
        dt : float, str or Fraction, optional
            Sample time in seconds; by default the step size that the FMU recommends.
        at : mapping of input to number or vector, optional
            Values of inputs that are not actuated; by default their start values.
        substeps : int, optional
            For model exchange: Runge-Kutta steps in a sample. By default as many as make the error less than 1e-8 of the states'
            nominal values, about the start.
        noise : mapping of input to number or vector, optional
            Inputs at which process noise acts, and its standard deviation, as in `LinearModel.from_fmu`. Their effect is that at
            the start.
        process_covariance : number, vector or matrix, optional
            Covariance of the process noise, in place of `noise`.
        sensors, sensor_std
            See `LinearModel.from_fmu`.
        disturbance : number, vector or matrix, optional
            Covariance per sample of an unknown load on each control, a random walk that is estimated.

        Raises
        ------
        ModelError
            If a check above fails, the FMU has no states or states that cannot be set, or in model exchange an output depends
            directly on an input.
        FMUError
            If the FMU fails.
        UnknownNameError
            If the FMU has no variable of a name.

        Examples
        --------
        >>> from bayesftc import fmus
        >>> model = NonlinearModel.from_fmu(fmus.path("TwoLinkArm"), measured=["q1", "q2"], actuated=["torque1", "torque2"])
        >>> model.names.states
        ('q1', 'q2', 'dq1', 'dq2')
        >>> model.linearised(model.start).A.shape
        (4, 4)
        """
        from bayesftc.controllers.models.fmu.model import model_of_fmu

        if noise is not None and process_covariance is not None:
            raise ModelError("Both noise and process_covariance are given; leave one of them out.")
        arguments = model_of_fmu(
            fmu,
            measured=measured,
            actuated=actuated,
            states=states,
            dt=dt,
            at=at,
            substeps=substeps,
            noise=noise,
            disturbance=disturbance,
            sensors=sensors,
            sensor_std=sensor_std,
        )
        if process_covariance is not None:
            n, q = arguments["states"], arguments["disturbances"]
            whole = np.array(arguments["process_covariance"])
            whole[: n - q, : n - q] = as_covariance(
                "The model's process_covariance", process_covariance, n - q, singular=True
            )
            arguments["process_covariance"] = whole
        return cls(**arguments)

    @classmethod
    def from_linear(cls, model: LinearModel) -> NonlinearModel:
        """Return a linear model as a nonlinear one.

        Parameters
        ----------
        model : LinearModel
            The model.
        """
        if model.delays is not None:
            raise ModelError(
                "The model has delays, which a nonlinear model does not know. Write the past signals into f and g as states."
            )
        if model.constant:
            raise ModelError(
                "The model has the constant 1 as a state (LinearModel.about), which a nonlinear model does not need. Write the "
                "constants into f and g, or use model.moving and work with deviations."
            )
        A, B, C = (tuple(map(tuple, model.matrix(name).tolist())) for name in "ABC")
        n, p, m = model.states, model.controls, model.sensors

        def move(x, u, x_next):
            for i in range(n):
                total = A[i][0] * x[0]
                for j in range(1, n):
                    total = total + A[i][j] * x[j]
                for j in range(p):
                    total = total + B[i][j] * u[j]
                x_next[i] = total

        def read(x, y):
            for i in range(m):
                total = C[i][0] * x[0]
                for j in range(1, n):
                    total = total + C[i][j] * x[j]
                y[i] = total

        noise = model.process_covariance, model.sensor_covariance
        return cls(move, read, n, p, m, *noise, model.dt, disturbances=model.disturbances)


def _derived(name: str, function: Kernel, inputs: tuple[int, ...], size: int) -> Kernel:
    *arguments, output = argument_names(function)
    shapes = {**dict(zip(arguments, inputs, strict=True)), output: size}
    try:
        return jacobian(function, shapes, output, arguments)
    except KernelError as error:
        raise KernelError(f"The model's {name}: {error} Or give its derivatives as {name}_jacobian.") from None


__all__ = ["NonlinearModel"]
