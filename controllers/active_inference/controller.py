"""The unbiased active inference controller: belief and control descend the free energy (paper, section 2.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import FunctionType
from typing import Any, Literal

import numpy as np

from bayesftc.controllers.active_inference.curvature import (
    check_stable,
    curvature_of_belief,
    curvature_of_control,
    largest_step,
)
from bayesftc.controllers.active_inference.measured import jacobian_of, measured, nominal_covariance, weights_of
from bayesftc.controllers.active_inference.step_text import FUNCTIONS, step_lines
from bayesftc.controllers.estimation.absurd import alarm_of, screening
from bayesftc.controllers.estimation.consistency import consistency
from bayesftc.controllers.estimation.embedding import Embedded, embed, law_sizes, run_once
from bayesftc.controllers.laws import ControlLaw
from bayesftc.controllers.models.checks import Matrix, as_covariance, as_vector, check_choice, check_number, frozen
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.modality import Modality
from bayesftc.controllers.models.trial import try_out
from bayesftc.controllers.precision.base import ERROR_CAP, FixedPrecision, Learner, PrecisionLearner, made_once
from bayesftc.controllers.precision.held import hold_precision
from bayesftc.controllers.signals import port, summary_of
from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ops import sqrt
from bayesftc.cosim.ports import Port
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.types import Floats

Law = ControlLaw | Block | Callable[..., None]


@dataclass(frozen=True, eq=False)
class UnbiasedActiveInference(Block):
    """Unbiased active inference (u-AIC): the belief about state and control descends the free energy (paper, section 2.2).

    The prediction errors are ``eps_i = y_i - g_i(mu)`` of each sensor modality, ``eps_x = mu - x_pred`` of the state prior and
    ``eps_u = mu_u - f*(mu, goal)`` of the control. The free energy is::

        F = 1/2 (sum_i eps_i' P_i eps_i + eps_x' P_x eps_x + eps_u' P_u eps_u - ln |P_u P_x prod_i P_i|) + C

    where C is ln(2 pi) / 2 for each element of the errors, so that F = -ln p(mu_u, mu, y). Means move against its gradient,
    ``mu <- mu - dt belief_rate dF/dmu`` and ``mu_u <- mu_u - dt control_rate dF/dmu_u``, `inner_steps` times a sample. dF/dmu
    contains the control's error as well. With a random walk and one inner step eps_x is zero where the gradient is taken; the
    prior then only sets the start of the belief.

    Inputs are ``y`` (the samples of all modalities, one after the other; one that is not finite is missing) and ``goal``.

    Outputs, besides those of the precision learner:

    - ``u``: the control's mean; ``x_hat``: mu.
    - ``innovation``: ``y - g(mu)`` before the sample is used; NaN for a missing one.
    - ``R`` (the learner's sensor covariance), ``precision``, ``beta``, ``fault_probability``.
    - ``free_energy``, ``eps_x``, ``eps_u``: their values where the last gradient was taken.
    - ``model_suspect``: only with ``state_prior="kalman"`` and linear modalities, by Kalman filters of the model. Otherwise no
      model predicts the sensors' readings.

    A precision learner gets the errors before the sample is used. Its ``spread`` is zero, because this belief consists of means
    alone. The learner's sensor covariance R becomes the precision ``P = S R^-1 S`` with S = diag(sqrt(gain) std). At nominal
    noise that is each sensor's `Modality.precision`, however small the noise. A sensor that the learner leaves out, or whose
    sample is missing, has the precision zero and no part in the log-determinant.

    To a learner, a belief that lags behind the plant looks like faulty sensors, and lower precisions increase the lag. With a
    random walk or Euler's prior, which do not depend on the control, the belief can therefore lose a lightly damped plant. They
    lost an oscillator of 1 Hz (damping ratio 0.01, two encoders and two tachometers, a step of the goal under a PD law), both
    without a fault and with one faulty encoder. It still oscillated after 20 s, with the belief 17 to 214 standard deviations of
    a sensor away (root mean square). With ``state_prior="kalman"``, one inner step and
    ``dt * belief_rate * state_precision = 1``, where the belief follows the prediction fully, it settled as with fixed
    precisions. At half of that it settled only under the softer of two laws, with the noisier of two kinds of sensors.

    Errors are limited to a million nominal standard deviations. If learned precisions or the slopes of measurement functions and
    law make the curvature too large for the rates, a step is shortened to remain stable. At nominal precisions and the slopes at
    the initial mean no step is shortened (`bayesftc.controllers.active_inference.curvature` has the rule, which does not depend
    on units).

    Parameters
    ----------
    modalities : Modality or sequence of Modality
        The sensors' measurements; by default the model's C and sensor covariance.
    law : block or function
        The control law f*: a block with the inputs ``x_hat`` and ``goal`` and the output ``u``, such as `Proportional`, `PID`
        or your own, or a step function ``law(x_hat, goal, u)``. The state of a block advances once a sample.
    dt : float, str or Fraction, optional
        Sample time in seconds; by default that of the model.
    belief_rate : number or vector
        Rate of the belief's descent, for all states or for each, per second and unit of precision.
    control_rate : number or vector, optional
        Rate of the control's descent; required for ``control="gradient"``.
    inner_steps : int
        Gradient steps a sample.
    control : {"gradient", "law"}
        "gradient": the control's mean descends the free energy. "law": the mean is set to f*, so that eps_u = 0. With "gradient"
        a law of high gain needs a small `control_precision` for stability, because dF/dmu contains the square of the gain.
    state_prior : {"random walk", "euler", "kalman"}
        The predicted state: the last one (the paper's choice); Euler integration, where the second half of the states are the
        rates of the first half; or the model's A and B with the control that was applied.
    model : LinearModel, optional
        The model for ``state_prior="kalman"``.
    state_precision, control_precision : number, vector or matrix
        Precisions P_x and P_u.
    precision : PrecisionLearner
        Learns the sensors' precisions. By default they are fixed, unlike in the other controllers, because the belief's lag
        behind the plant, which depends on the rates, looks like faulty sensors.
    initial_mean : number or vector
        Mean of the belief before the first sample.
    sizes : tuple of three ints, optional
        Numbers of states, goals and controls; required if the law is a plain function.
    invalid : sequence of number, or of one for each sensor
        Values that mark a missing sample, such as ``[-9999, 65535]``: a sample equal to one of them counts as missing.

    Raises
    ------
    ModelError
        If sizes do not fit, a setting is missing or out of range, or the descent is unstable at nominal precisions and the
        initial mean (rate times curvature has an eigenvalue of 2 or more, which the message gives).

    Examples
    --------
    >>> from bayesftc import controllers
    >>> sensors = controllers.Modality("positions", matrix=[[1.0], [1.0]], std=0.1)
    >>> controller = controllers.UnbiasedActiveInference(
    ...     sensors, controllers.Proportional(gain=2.0), dt=0.05, belief_rate=4.0, control_rate=2.0
    ... )
    >>> step = controller.online(compiled=False)
    >>> out = [step(y=[0.5, 0.5], goal=[1.0]) for _ in range(100)][-1]
    >>> out.x_hat.round(2).tolist(), out.u.round(2).tolist()
    ([0.51], [0.96])
    """

    modalities: Modality | Sequence[Modality] = ()
    law: Law | None = None
    dt: float | str | Fraction | None = None
    belief_rate: float | Sequence[float] = 1.0
    control_rate: float | Sequence[float] | None = None
    inner_steps: int = 1
    control: Literal["gradient", "law"] = "gradient"
    state_prior: Literal["random walk", "euler", "kalman"] = "random walk"
    model: LinearModel | None = None
    state_precision: Matrix = 1.0
    control_precision: Matrix = 1.0
    precision: PrecisionLearner = field(default_factory=FixedPrecision)
    initial_mean: float | Sequence[float] = 0.0
    sizes: Sequence[int] | None = None
    invalid: Invalid = field(default=(), kw_only=True)

    def __str__(self) -> str:
        """Return the sizes of the model and the kind of learner, for ``print``; the ``repr`` has all settings."""
        return summary_of(self)

    def __post_init__(self) -> None:
        self._check_choices()
        n, goals, p = self._sizes()
        object.__setattr__(self, "sizes", (n, goals, p))
        if isinstance(self.law, FunctionType):
            try_out(f"The control law {self.law.__name__!r}", self.law, "law(x_hat, goal, u)", [n, goals], [(p,)])
        object.__setattr__(self, "modalities", self._modalities())
        values = {
            "belief_rate": as_vector("The belief_rate", self.belief_rate, n),
            "state_precision": as_covariance("The state_precision", self.state_precision, n),
            "control_precision": as_covariance("The control_precision", self.control_precision, p),
            "initial_mean": as_vector("The initial_mean", self.initial_mean, n),
        }
        if self.control_rate is not None:
            values["control_rate"] = as_vector("The control_rate", self.control_rate, p)
        for name, value in values.items():
            if name.endswith("rate") and (value <= 0).any():
                raise ModelError(f"The {name} is {value.tolist()}; it must be positive.")
            object.__setattr__(self, name, value)
        self._check_prior()
        invalid_values(type(self).__name__, self.invalid, self._sensors)  # raises for wrong values
        self._learner()  # raises now, not in the loop, for settings that do not fit
        remedy = "belief_rate" if self.control == "law" else "belief_rate, control_rate, the control_precision"
        check_stable(*self._nominal_curvature(), remedy)

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return "controller"

    @property
    def sample_time(self) -> Fraction:
        """The sample time in seconds."""
        dt: Any = self.model.dt if self.dt is None and self.model is not None else self.dt
        return rational_step(dt, "The controller's sample time")

    @property
    def measurement_matrix(self) -> Floats:
        """Matrix from ``x_hat`` to each sensor's reading; NaN in rows that are not linear."""
        return frozen(np.vstack([modality.rows(self._dimensions[0]) for modality in self._groups]))

    @property
    def goal_matrix(self) -> Floats | None:
        """Matrix from ``x_hat`` to what has a goal; None if the law does not define it."""
        return getattr(self.law, "goal_matrix", None)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``y`` and ``goal``."""
        return port("y", (self._sensors,)), port("goal", (self._dimensions[1],))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The outputs named above, and those of the precision learner."""
        return *self._common_outputs, *self._learner().ports

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """See `Block.held`."""
        block: Block = hold_precision(self, self._learner().ports, outputs)
        return block

    @property
    def _common_outputs(self) -> tuple[Port, ...]:
        (n, _, p), m = self._dimensions, self._sensors
        shapes: dict[str, tuple[int, ...]] = {"u": (p,), "x_hat": (n,), "innovation": (m,), "R": (m, m)}
        shapes |= dict.fromkeys(("precision", "beta", "fault_probability"), (m,))
        shapes |= {} if self.watched_model is None else {"model_suspect": ()}
        shapes |= {"free_energy": (), "eps_x": (n,), "eps_u": (p,)}
        return tuple(port(name, shape) for name, shape in shapes.items())

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        (n, _, p), m, h = self._dimensions, self._sensors, float(step)
        learner, law = self._learner(), self._embedded()
        sensing, nominal = measured(self._groups, n), nominal_covariance(self._groups)
        A, B = self._prediction()
        sigma = np.sqrt(np.diag(nominal))
        Px, Pu = np.asarray(self.state_precision), np.asarray(self.control_precision)
        curvature, rates = self._nominal_curvature()
        largest, squarings = largest_step(curvature, rates)
        q = len(rates)
        screens, screen_parameters = screening(self, self._learned_model())
        parameters = {
            "A": A,
            "B": B,
            "Px": Px,
            "Pu": Pu,
            "nominal": nominal,
            "sigma": sigma,
            "gain": weights_of(self._groups),
            "settings": learner.settings,
            "limit": sqrt(ERROR_CAP) * sigma,
            "rate": h * np.asarray(self.belief_rate),
            "rate_u": h * np.asarray(self.control_rate if self.control_rate is not None else np.zeros(p)),
            "prior_log_determinant": np.linalg.slogdet(Px)[1] + np.linalg.slogdet(Pu)[1],
            "means": float(n + p),
            "prior_curvature": self._prior_curvature(),
            "root_rate": np.sqrt(rates),
            "largest": largest,
            "spread": np.zeros((m, m)),  # the belief has no covariance
            **law.parameters,
            **sensing.parameters,
            **screen_parameters,
        }
        sizes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(("expected", "samples", "e", "present", "used", "weighted"), (m,)),
            **dict.fromkeys(("L", "inverse", "weights"), (m, m)),
            **dict.fromkeys(("G", "PG"), (m, n)),
            **dict.fromkeys(("weighted_x", "slope"), (n,)),
            **dict.fromkeys(("law_control", "weighted_u"), (p,)),
            **dict.fromkeys(("D", "PD"), (p, n)),
            **dict.fromkeys(("H", "scaled", "squared"), (q, q)),
            "work": (learner.work, m, m),
        }
        state = {
            "mean": self.initial_mean,
            "predicted": self.initial_mean,
            "memory": learner.memory,
            "control": np.zeros(p),
            "applied": np.zeros(p),
            **law.state,
            **screens,
        }
        watched = self.watched_model
        if watched is not None:
            check = consistency(watched, self.initial_mean)
            state, parameters, sizes = state | check.state, parameters | check.parameters, sizes | check.scratch
        scratch = {**{name: np.zeros(shape) for name, shape in sizes.items()}, **sensing.scratch}
        ports = (port.name for port in (*self.inputs, *self._common_outputs))
        names = ["t", "k", "outputs", *ports, *state, *parameters, *scratch]
        first = sum(port.size for port in self._common_outputs)
        functions = {
            **FUNCTIONS,
            **law.functions,
            **sensing.functions,
            "learn": learner.step,
            "report": learner.report,
            "alarm": alarm_of(learner, first),
            "inner_steps": int(self.inner_steps),
            "squarings": squarings,
            "__name__": __name__,
            "first": first,
        }
        lines = step_lines(
            {**law.calls, **sensing.calls}, descends=self.control == "gradient", watches=watched is not None
        )
        step_function = function_from_text("unbiased_active_inference", names, lines, functions)
        return Definition(step_function, state=state, parameters=parameters, scratch=scratch)

    @property
    def _dimensions(self) -> tuple[int, int, int]:
        n, goals, p = self.sizes or (0, 0, 0)
        return int(n), int(goals), int(p)

    @property
    def _groups(self) -> tuple[Modality, ...]:
        return self.modalities  # type: ignore[return-value]

    @property
    def _sensors(self) -> int:
        return sum(modality.samples for modality in self._groups)

    def _embedded(self) -> Embedded:
        return embed(self.law, self._dimensions, self.sample_time, differentiate=self.control == "gradient")

    def _prediction(self) -> tuple[Floats, Floats]:
        n, _, p = self._dimensions
        if self.state_prior == "kalman" and self.model is not None:
            return self.model.matrix("A"), self.model.matrix("B")
        A = np.eye(n)
        if self.state_prior == "euler":
            A[: n // 2, n // 2 :] = float(self.sample_time) * np.eye(n // 2)
        return A, np.zeros((n, p))

    def _prior_curvature(self) -> Floats:
        """Return the state prior's part of the curvature; with one step a sample, only its shift of the start."""
        Px: Floats = np.asarray(self.state_precision)
        return Px if self.inner_steps > 1 else Px @ (np.eye(len(Px)) - self._prediction()[0])

    @made_once
    def _learner(self) -> Learner:
        learner = self.precision.apart("UnbiasedActiveInference").without_covariance()
        return learner.learner(self._learned_model())

    @property
    def watched_model(self) -> LinearModel | None:
        """The model of the consistency check; None if there is none, or a modality is not linear."""
        C = self.measurement_matrix
        if self.state_prior != "kalman" or self.model is None or not np.isfinite(C).all():
            return None
        return replace(self.model, C=C, sensor_covariance=nominal_covariance(self._groups), names=None)

    def _learned_model(self) -> LinearModel:
        """Return the model for the precision learner: the sensors, linearised at the initial mean."""
        A, B = self._prediction()
        G = jacobian_of(self._groups, np.asarray(self.initial_mean))
        return LinearModel(A, B, G, np.zeros_like(A), nominal_covariance(self._groups), self.sample_time)

    def _sizes(self) -> tuple[int, int, int]:
        law_dimensions = law_sizes(self.law)
        if law_dimensions is None and self.sizes is None:
            raise ModelError("A law that is a function has no sizes; give sizes=(states, goals, controls).")
        sizes: Any = law_dimensions if self.sizes is None else self.sizes
        requested = tuple(sizes) if isinstance(sizes, Sequence) and not isinstance(sizes, str) else ()
        if len(requested) != 3 or any(
            isinstance(s, bool) or not isinstance(s, int | np.integer) or s < 1 for s in requested
        ):
            raise ModelError(f"sizes is {self.sizes!r}; give three whole numbers (states, goals, controls).")
        if law_dimensions is not None and law_dimensions != requested:
            raise ModelError(
                f"The law has {law_dimensions} states, goals and controls, but sizes={requested}; leave sizes out."
            )
        return requested  # type: ignore[no-any-return]

    def _modalities(self) -> tuple[Modality, ...]:
        choice: Any = self.modalities
        modalities = (
            (choice,) if isinstance(choice, Modality) else tuple(choice) if isinstance(choice, Iterable) else ()
        )
        if not modalities and self.model is not None:
            covariance = self.model.matrix("sensor_covariance")
            modalities = (Modality("sensors", matrix=self.model.matrix("C"), covariance=covariance),)
        if not modalities or not all(isinstance(s, Modality) for s in modalities):
            raise ModelError(
                f"modalities is {choice!r}; they must be Modality objects, at least one, or give a model with a C."
            )
        for modality in modalities:
            modality.try_out(self._dimensions[0])
        return modalities

    def _check_choices(self) -> None:
        check_choice(self, "control", "gradient", "law")
        check_choice(self, "state_prior", "random walk", "euler", "kalman")
        check_number(self, "inner_steps", least=1, most=10_000, whole=True)
        if not isinstance(self.model, LinearModel | None):
            raise ModelError(f"model is {self.model!r}; it must be a LinearModel.")
        if self.model is None and self.dt is None:
            raise ModelError(
                f"{type(self).__name__} has neither a model nor a sample time. Give one of them; the sample time in seconds: "
                "dt=0.01."
            )
        if self.dt is not None and self.model is not None and rational_step(self.dt) != self.model.step:
            raise ModelError(f"dt is {self.dt!r}, but that of the model is {float(self.model.step):g} s; leave dt out.")
        if self.control == "gradient" and self.control_rate is None:
            raise ModelError("control='gradient' needs a control_rate; give one, or set control='law'.")
        if not isinstance(self.precision, PrecisionLearner):
            raise ModelError(
                f"precision is {brief(self.precision)}; it must be a precision learner such as GammaPrecision()."
            )

    def _check_prior(self) -> None:
        n, _, p = self._dimensions
        if self.state_prior == "euler" and n % 2:
            raise ModelError(f"state_prior='euler' needs as many rates as positions, but there are {n} states.")
        if self.state_prior == "kalman":
            if self.model is None:
                raise ModelError("state_prior='kalman' needs a model, whose A and B predict the state; give model=.")
            if (self.model.states, self.model.controls) != (n, p):
                raise ModelError(
                    f"The model has {self.model.states} states and {self.model.controls} controls, but the law has {n} and {p}."
                )

    def _nominal_curvature(self) -> tuple[Floats, Floats]:
        """Return the curvature of the free energy at nominal precisions and the initial mean, and the rates per sample."""
        (n, goals, p), h = self._dimensions, float(self.sample_time)
        mean = np.asarray(self.initial_mean)
        G, nominal = jacobian_of(self._groups, mean), nominal_covariance(self._groups)
        S = np.diag(np.sqrt(weights_of(self._groups) * np.diag(nominal)))
        rates = h * np.asarray(self.belief_rate)
        arrays = {
            "mean": np.array(mean),
            "goal": np.zeros(goals),
            "law_control": np.full(p, np.nan),
            "D": np.zeros((p, n)),
        }
        law = self._embedded()
        run_once(law, "law_output", arrays)
        if not np.isfinite(arrays["law_control"]).all():
            raise ModelError(
                f"The control law gives {arrays['law_control'].tolist()} at the initial mean and a goal of zero; it must write "
                "finite numbers to all elements of u."
            )
        descends = self.control == "gradient"
        H: Floats = np.empty((n + p,) * 2 if descends else (n, n))
        curvature_of_belief(G, S @ np.linalg.inv(nominal) @ S, self._prior_curvature(), np.empty_like(G), H)
        if descends:
            run_once(law, "law_derivative", arrays)
            if not np.isfinite(arrays["D"]).all():
                raise ModelError(
                    f"The control law's derivative is {arrays['D'].tolist()} at the initial mean and a goal of zero. Give an "
                    "initial_mean at which it is finite, or set control='law'."
                )
            curvature_of_control(arrays["D"], np.asarray(self.control_precision), np.empty((p, n)), H)
            rates = np.concatenate([rates, h * np.asarray(self.control_rate, float)])
        return H, rates


__all__ = ["UnbiasedActiveInference"]
