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
from bayesftc.controllers.precision.base import ERROR_CAP, FixedPrecision, Learner, PrecisionLearner
from bayesftc.controllers.precision.held import hold_precision
from bayesftc.controllers.signals import port
from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.types import Floats

Law = ControlLaw | Block | Callable[..., None]


@dataclass(frozen=True, eq=False)
class UnbiasedActiveInference(Block):
    """Unbiased active inference (u-AIC): the belief about state and control descends the free energy (paper, section 2.2).

    With the prediction errors ``eps_i = y_i - g_i(mu)`` of each sensor modality, ``eps_x = mu - x_pred`` of the state prior and
    ``eps_u = mu_u - f*(mu, goal)`` of the control, the free energy is::

        F = 1/2 (sum_i eps_i' P_i eps_i + eps_x' P_x eps_x + eps_u' P_u eps_u - ln |P_u P_x prod_i P_i|) + C

    where C is ln(2 pi) / 2 for each element of the errors, so that F = -ln p(mu_u, mu, y). Means move against its gradient,
    ``mu <- mu - dt belief_rate dF/dmu`` and ``mu_u <- mu_u - dt control_rate dF/dmu_u``, `inner_steps` times a sample; dF/dmu
    contains the control's error too. With a random walk and one inner step eps_x is zero where the gradient is taken: the
    prior then does nothing but start the belief where it was.

    Inputs ``y`` (the samples of all modalities, one after the other; one that is not finite is missing) and ``goal``.
    Outputs ``u`` (the control's mean), ``x_hat`` (mu), ``innovation`` (``y - g(mu)`` before the sample is used; NaN for a missing
    one), ``R`` (the learner's sensor covariance), ``precision``, ``beta``, ``fault_probability``, ``free_energy``, ``eps_x`` and
    ``eps_u``, and the precision learner's own. Free energy and prediction errors are those at which the last gradient was
    taken. With ``state_prior="kalman"`` and linear modalities there is ``model_suspect`` as well, by Kalman filters of the model;
    otherwise no model says what the sensors should read next.

    A precision learner sees the errors before the sample is used, and no uncertainty of the belief (``spread`` is zero: means
    are all this controller has). Its sensor covariance R becomes the precision ``P = S R^-1 S`` with S = diag(sqrt(gain) std):
    each sensor's `Modality.precision` at nominal trust, however small its noise. A sensor that the learner leaves out, or
    whose sample is missing, has the precision zero and no part in the log-determinant.

    To a learner, a belief that lags behind the plant looks like faulty sensors, and a belief that trusts them less lags more.
    A random walk or Euler's prior, which do not know the control, can so lose a lightly damped plant. They lost an oscillator
    of 1 Hz (damping ratio 0.01, two encoders and two tachometers, a step of the goal under a PD law) without a fault as well as
    with one of the encoders faulty: it still swung after 20 s, with the belief 17 to 214 standard deviations of a sensor away
    (root mean square). With ``state_prior="kalman"``, one inner step and ``dt * belief_rate * state_precision = 1``, where the
    belief follows the prediction in full, it came to rest as with fixed precisions; at half that only under the softer of two
    laws, with the noisier of two kinds of sensors.

    Errors are held within a million nominal standard deviations. Where learned precisions or the slopes of measurement
    functions and law make the curvature too large for the rates, a step is shortened to stay stable, at nominal trust and the
    initial mean's slopes never (`bayesftc.controllers.active_inference.curvature` has the rule; it is the same in all units).

    Parameters
    ----------
    modalities : Modality or sequence of Modality
        What the sensors measure; if there are none, the model's C and sensor covariance.
    law : block or function
        The control law f*: a block with the inputs ``x_hat`` and ``goal`` and the output ``u``, such as `Proportional`, `PID`
        or one of your own, or a step function ``law(x_hat, goal, u)``. What a block keeps from step to step
        moves on once a sample.
    dt : float, str or Fraction, optional
        Sample time in seconds; by default the model's.
    belief_rate : number or vector
        Rate of the belief's descent, for all states or for each, per second and unit of precision.
    control_rate : number or vector, optional
        Rate of the control's descent; needed for ``control="gradient"``.
    inner_steps : int
        Gradient steps a sample.
    control : {"gradient", "law"}
        Let the control's mean descend the free energy, or put it to f* (then eps_u = 0). A law of high gain needs a small
        `control_precision` to descend in a stable way, for dF/dmu contains its square.
    state_prior : {"random walk", "euler", "kalman"}
        How the state is predicted: as it was (the paper's choice); by Euler integration, where the second half of the states
        are the rates of the first half; or by the model's A and B with the control that was applied.
    model : LinearModel, optional
        For ``state_prior="kalman"``.
    state_precision, control_precision : number, vector or matrix
        P_x and P_u.
    precision : PrecisionLearner
        How sensor precisions are learned. By default they are fixed, unlike in the other controllers: what a belief lags behind
        the plant, by how its rates are set, looks like faulty sensors.
    initial_mean : number or vector
        Belief before the first sample.
    sizes : tuple of three ints, optional
        Numbers of states, goals and controls; needed where the law is a plain function.
    invalid : sequence of number, or of one for each sensor
        Values that devices send in place of a sample, as ``[-9999, 65535]``: a sample equal to one of them counts as missing.

    Raises
    ------
    ModelError
        If sizes do not fit, a setting is missing or out of range, or at nominal trust and the initial mean the descent is
        unstable (an eigenvalue of rate times curvature of 2 or more; the sentence gives the largest).
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
        invalid_values(type(self).__name__, self.invalid, self._sensors)  # wrong ones fail here
        self._learner()  # settings that do not fit fail here, not in the loop
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
        """What each sensor reads of ``x_hat``, a row of NaN where that is no linear function."""
        return frozen(np.vstack([modality.rows(self._dimensions[0]) for modality in self._groups]))

    @property
    def goal_matrix(self) -> Floats | None:
        """What each element of the goal is of ``x_hat``; None where the law does not say."""
        return getattr(self.law, "goal_matrix", None)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``y`` and ``goal``."""
        return port("y", (self._sensors,)), port("goal", (self._dimensions[1],))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The outputs named above, and the precision learner's own."""
        return *self._own_outputs, *self._learner().ports

    def held(self, outputs: Mapping[str, Floats]) -> Block:
        """See `Block.held`."""
        block: Block = hold_precision(self, self._learner().ports, outputs)
        return block

    @property
    def _own_outputs(self) -> tuple[Port, ...]:
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
            "A": A, "B": B, "Px": Px, "Pu": Pu, "nominal": nominal, "sigma": sigma, "gain": weights_of(self._groups),
            "settings": learner.settings, "limit": ERROR_CAP**0.5 * sigma, "rate": h * np.asarray(self.belief_rate),
            "rate_u": h * np.asarray(self.control_rate if self.control_rate is not None else np.zeros(p)),
            "prior_log_determinant": np.linalg.slogdet(Px)[1] + np.linalg.slogdet(Pu)[1], "means": float(n + p),
            "prior_curvature": self._prior_curvature(), "root_rate": np.sqrt(rates), "largest": largest,
            "spread": np.zeros((m, m)),  # its belief has no covariance
            **law.parameters, **sensing.parameters, **screen_parameters,
        }  # fmt: skip
        sizes: dict[str, tuple[int, ...]] = {
            **dict.fromkeys(("expected", "samples", "e", "present", "used", "weighted"), (m,)),
            **dict.fromkeys(("L", "inverse", "weights"), (m, m)),
            **dict.fromkeys(("G", "PG"), (m, n)),
            **dict.fromkeys(("pull_x", "slope"), (n,)),
            **dict.fromkeys(("law_control", "pull_u"), (p,)),
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
            watching, constants = consistency(watched, self.initial_mean)
            state, parameters = {**state, **watching}, parameters | constants
            sizes |= {"seer_row": (n,), "seer_error": (m,)}
        scratch = {**{name: np.zeros(shape) for name, shape in sizes.items()}, **sensing.scratch}
        ports = (port.name for port in (*self.inputs, *self._own_outputs))
        names = ["t", "k", "outputs", *ports, *state, *parameters, *scratch]
        first = sum(port.size for port in self._own_outputs)
        functions = {
            **FUNCTIONS, **law.functions, **sensing.functions, "learn": learner.step, "report": learner.report,
            "alarm": alarm_of(learner, first),
            "inner_steps": int(self.inner_steps), "squarings": squarings, "__name__": __name__,
            "first": first,
        }  # fmt: skip
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
        """Return what the state prior adds to the curvature: with one step a sample, only what it moves the start by."""
        Px: Floats = np.asarray(self.state_precision)
        return Px if self.inner_steps > 1 else Px @ (np.eye(len(Px)) - self._prediction()[0])

    def _learner(self) -> Learner:
        learner = self.precision.apart("UnbiasedActiveInference").without_covariance()
        return learner.learner(self._learned_model())

    @property
    def watched_model(self) -> LinearModel | None:
        """The model that is checked beside the controller; None if it has none, or its modalities are not linear."""
        C = self.measurement_matrix
        if self.state_prior != "kalman" or self.model is None or not np.isfinite(C).all():
            return None
        return replace(self.model, C=C, sensor_covariance=nominal_covariance(self._groups), names=None)

    def _learned_model(self) -> LinearModel:
        """Return what a precision learner is told about the loop: the sensors, linear around the initial mean."""
        A, B = self._prediction()
        G = jacobian_of(self._groups, np.asarray(self.initial_mean))
        return LinearModel(A, B, G, np.zeros_like(A), nominal_covariance(self._groups), self.sample_time)

    def _sizes(self) -> tuple[int, int, int]:
        known = law_sizes(self.law)
        if known is None and self.sizes is None:
            raise ModelError(
                "With a function as law give sizes=(states, goals, controls), which a function does not say."
            )
        sizes: Any = known if self.sizes is None else self.sizes
        given = tuple(sizes) if isinstance(sizes, Sequence) and not isinstance(sizes, str) else ()
        if len(given) != 3 or any(isinstance(s, bool) or not isinstance(s, int | np.integer) or s < 1 for s in given):
            raise ModelError(f"sizes is {self.sizes!r}; it must be three whole numbers (states, goals, controls).")
        if known is not None and known != given:
            raise ModelError(f"The law has {known} states, goals and controls, but sizes={given}; leave sizes out.")
        return given  # type: ignore[no-any-return]

    def _modalities(self) -> tuple[Modality, ...]:
        given: Any = self.modalities
        modalities = (given,) if isinstance(given, Modality) else tuple(given) if isinstance(given, Iterable) else ()
        if not modalities and self.model is not None:
            covariance = self.model.matrix("sensor_covariance")
            modalities = (Modality("sensors", matrix=self.model.matrix("C"), covariance=covariance),)
        if not modalities or not all(isinstance(s, Modality) for s in modalities):
            raise ModelError(
                f"modalities must be Modality objects, at least one, not {given!r}; or give a model that says what is "
                "measured."
            )
        for modality in modalities:
            modality.try_out(self._dimensions[0])
        return modalities

    def _check_choices(self) -> None:
        check_choice(self, "control", "gradient", "law")
        check_choice(self, "state_prior", "random walk", "euler", "kalman")
        check_number(self, "inner_steps", least=1, most=10_000, whole=True)
        if not isinstance(self.model, LinearModel | None):
            raise ModelError(f"model must be a LinearModel, not {self.model!r}.")
        if self.model is None and self.dt is None:
            raise ModelError("Give the controller's sample time dt= in seconds.")
        if self.dt is not None and self.model is not None and rational_step(self.dt) != self.model.step:
            raise ModelError(f"dt is {self.dt!r}, but the model's is {float(self.model.step):g} s; leave dt out.")
        if self.control == "gradient" and self.control_rate is None:
            raise ModelError("control='gradient' needs a control_rate; or put the control to its law by control='law'.")
        if not isinstance(self.precision, PrecisionLearner):
            raise ModelError(f"precision must be a precision learner such as GammaPrecision(), not {self.precision!r}.")

    def _check_prior(self) -> None:
        n, _, p = self._dimensions
        if self.state_prior == "euler" and n % 2:
            raise ModelError(f"state_prior='euler' needs as many rates as positions, but there are {n} states.")
        if self.state_prior == "kalman":
            if self.model is None:
                raise ModelError("state_prior='kalman' needs a model, whose A and B predict the state.")
            if (self.model.states, self.model.controls) != (n, p):
                raise ModelError(
                    f"The model has {self.model.states} states and {self.model.controls} controls; the law has {n} and {p}."
                )

    def _nominal_curvature(self) -> tuple[Floats, Floats]:
        """Return the curvature of the free energy at nominal trust and the initial mean, and the rates per sample."""
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
                "finite numbers into all of u."
            )
        descends = self.control == "gradient"
        H: Floats = np.empty((n + p,) * 2 if descends else (n, n))
        curvature_of_belief(G, S @ np.linalg.inv(nominal) @ S, self._prior_curvature(), np.empty_like(G), H)
        if descends:
            run_once(law, "law_derivative", arrays)
            if not np.isfinite(arrays["D"]).all():
                raise ModelError(
                    f"The control law's derivative is {arrays['D'].tolist()} at the initial mean and a goal of zero; start where "
                    "it is finite, or put the control to the law by control='law'."
                )
            curvature_of_control(arrays["D"], np.asarray(self.control_precision), np.empty((p, n)), H)
            rates = np.concatenate([rates, h * np.asarray(self.control_rate, float)])
        return H, rates


__all__ = ["UnbiasedActiveInference"]
