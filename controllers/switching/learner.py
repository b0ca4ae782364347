"""Switching between fault modes: a hidden Markov model for each sensor over its fault modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.models.checks import as_number, as_vector, check_flags, check_number
from bayesftc.controllers.precision.base import TOGETHER, Learner, PrecisionLearner
from bayesftc.controllers.signals import port
from bayesftc.controllers.switching import mode_kernels, sensor_kernels as kernels
from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.actuator_settings import actuator_settings, chance
from bayesftc.controllers.switching.bank.infer import make_infer
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.default_time import DefaultTime, time_at
from bayesftc.controllers.switching.fault_modes import (
    OFFSET_VARIANCES,
    Drifting,
    DroppedOut,
    FaultMode,
    Frozen,
    Noisier,
    Offset,
    Ramping,
    Unmodelled,
)
from bayesftc.controllers.switching.filter_share import filter_share
from bayesftc.controllers.switching.forgotten import most_variances
from bayesftc.controllers.switching.given import (
    as_actuator_modes,
    as_fault_modes,
    as_process_modes,
    first_of,
    settings_of,
)
from bayesftc.controllers.switching.mode_kernels import TRUST
from bayesftc.controllers.switching.process_modes import PROCESS_MODES, NoisierProcess
from bayesftc.controllers.switching.step_text import learner_functions, sensor_functions
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import square

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


KNOWN = 1e12
"""Shape of the gamma distribution of a precision that is not learned, and therefore certain."""


def _kept(mode: FaultMode) -> int:
    """Return the number of a mode's numbers that are merged: up to its age if its faults have no further numbers."""
    return TRUST if type(mode).evidence in (mode_kernels.freezes, mode_kernels.drops) else TRUST + len(mode.first)


MOST_MODES = 32
"""Largest number of modes of each kind; the time of a step grows with its square."""


LOSS = 0.01
"""Probability that a sample of a healthy sensor is missing, unless given."""
LEAST_LOSS = 1e-6
"""A share of lost samples below this is an error of rounding."""


def _with_pauses(loss: float, every: int, before: int) -> float:
    """Return the share of steps without a sample of a sensor with a sample in every n-th step, given that for another n."""
    if every != before and loss >= 1.0 - 1.0 / before > 0.0:
        loss = 1.0 - (1.0 - loss) * before  # of the samples that were due
        loss = loss if loss > LEAST_LOSS else LOSS  # the user gave the pauses alone, and no losses
    return 1.0 - (1.0 - loss) / every if loss < 1.0 - 1.0 / every else loss


@dataclass(frozen=True)
class SwitchingPrecision(PrecisionLearner):
    """For each sensor a hidden Markov model over healthy and several fault modes.

    A sensor has ``P(healthy) + sum_k P(mode k) trust_k`` of its nominal precision. ``trust_k`` is 0 for a frozen sensor or one
    with an offset, and learned for a noisier one (that mode is the paper's learner). At each sample, modes may begin and end, and
    the density of the sample in each mode changes the probabilities of the modes. What a mode has learned about its fault is
    merged with the prior of a fault that has just begun, as in an interacting-multiple-model filter.

    The model's standard deviations of sensors are a first guess. The noise of each sensor is learned while it is healthy, by a
    gamma distribution of its precision, and ``precision`` and ``R`` follow it (`noise_factor`). The share of samples that a
    healthy sensor repeats exactly is learned as well (`Frozen`).

    ``fault_probability`` is the total probability of all modes that are faults (all but `Burst`). A sensor without samples also
    has one. ``beta`` is NaN. The further outputs are:

    - ``mode_probability`` (m x 1 + modes): healthy first.
    - ``fault_kind`` (m): number of the most probable mode; 0 is healthy.
    - ``fault_size`` (m): size of that mode's fault; NaN without one. For offsets it is in the sensor's unit. For a noisier
      sensor it is the standard deviation of the noise, and for an unmodelled fault the root mean square of the innovations, both
      as multiples of the nominal standard deviation.
    - ``fault_onset`` (m): time in seconds since the first sample; NaN for a healthy sensor.
    - ``log_density``: log density of these samples given the earlier ones. Its sum over a recording measures how well the
      settings explain it (a pseudo-likelihood if an offset exceeds its `jump`).

    The joint form estimates offsets together with the state, with a hypothesis for each sensor and kind of offset. It therefore
    distinguishes a slow drift of one of two sensors from the state's motion, and a sensor with a known offset still informs
    the estimate.
    Further hypotheses are:

    - A sensor fails in a way without a mode (`Unmodelled`); the state is inferred without it.
    - The plant moves by more than its process noise, or the model is less precise than assumed.
    - All sensors, if they measure one quantity, have jumped alike (`alike`).
    - An actuator has failed.

    The joint form is for controllers with a linear model and sensors of independent noise. With other controllers, in
    `ExplicitDetection`, and with correlated noise, the per-sensor form judges each sensor by its innovation from the common
    prediction.

    Parameters
    ----------
    modes : sequence of FaultMode
        The fault modes of a sensor, with their rates; see `FAULT_MODES`.
    loss : float or sequence of float
        Probability that a sample of a healthy sensor is missing, for all sensors or for each. For a slow sensor it is the share
        of steps without a sample; `closed_loop` computes it from `every` of its `Sensors`, unless the given loss is at least
        that share.
    joint : bool
        Whether offsets are estimated together with the state, and the state without an `Unmodelled` sensor. The per-sensor form
        is faster, but detects slow drifts later, has more false alarms where the process noise is stated too large, and follows
        an offset of the only sensor of a quantity.
    actuator_modes : sequence of ActuatorMode
        The fault modes of each actuator and of the process, such as ``[InputOffset(), LostEffect()]``: instances of classes in
        `ACTUATOR_MODES`, or of your own. They belong to the joint form. With them there are, for each actuator, the outputs
        ``actuator_mode_probability`` (p x 1 + modes, healthy first), ``actuator_fault_probability``, ``actuator_fault_kind``
        (number of the most probable mode, 0: healthy) and ``actuator_fault_size`` (size of that mode's fault; NaN for a healthy
        actuator). The control compensates the inferred faults: give the controller its limits ``u_min`` and ``u_max``. By default
        there are no actuator modes. An actuator that is slower than in the model also looks faulty, and compensating that can
        make the loop unstable.
    process_modes : sequence of NoisierProcess
        Times with more process noise than nominal: by default kicks, and longer ones in which the belief fades, slowly or fast,
        because the model is less precise than assumed. Without any, a common deviation of all sensors counts as faults of all
        of them. They belong to the joint form, which then has the output ``process_mode_probability`` (2 + modes): healthy first;
        last the probability that a mode has recently ended. The default ones are left out without the joint form, without a mode
        that has hypotheses (`Offset`, `Unmodelled`), or without process noise.
    alike : float
        Prior probability, from 0 to below 1, that an equal jump of all sensors is a fault of the sensors, not a kick of the plant
        (a process mode with a `scale` above 1). Only later samples can decide that. The estimate follows the sensors unless a
        fault is more probable. It belongs to the joint form, with two or more sensors of one quantity, such a process mode and
        an `Offset`; otherwise it has no effect.
    start_doubt : float
        Prior probability, from 0 to below 1, that the plant's initial state is not the one that the controller believes before
        the first sample. If the first samples of the sensors agree on another state, the estimate becomes that state, and no
        sensor is blamed. It belongs to the joint form with a process mode; otherwise it has no effect.
    duration_shape : float
        Shape, above 1, of the Lomax distribution of a fault's duration, whose mean is its ``time_to_recovery``. Near 1 many
        faults are short and a few very long. Infinity gives the exponential distribution, which all other modes have, for
        faults of known mean duration. It belongs to the joint form, for offsets that jump and for `Unmodelled`.
    gain_limit : float
        Limit of the estimate's gain while the belief fades (a process mode with `fading` above 1), relative to the gain of the
        model's filter. It holds in proportion to the probability of such a mode. A larger gain would make a loop with a late
        control unstable. If the product of limit and gain is at least 1, there is no limit. Infinity means no limit: use it for
        an estimate without a control loop. It belongs to the joint form.
    noise_factor : float
        A healthy sensor's standard deviation is learned within this factor of the model's, up or down. With 1 it is the model's,
        as always under `UnbiasedActiveInference`, whose belief has no covariance.
    noise_strength : float
        Weight of the model's standard deviations in samples.
    noise_forgetting : float
        Forgetting factor in (0, 1] per sample of the learned noise.
    outages : bool
        Whether a step without any sample is an outage, as of a logger, and says nothing about the sensors. At least two sensors
        must be silent unexpectedly: sensors that usually have a sample in most of the steps (a `loss` below .5), and that have
        not dropped out before. Otherwise all sensors have probably dropped out.

    Raises
    ------
    ModelError
        If there is no mode or an invalid one (for example with other arguments of its step function), if the losses are not one
        for each sensor, or if the model's sample time is so long that a fault would begin or end at each sample.
    """

    modes: Sequence[FaultMode] = (Frozen(), Offset(), Drifting(), Ramping(), Unmodelled(), Noisier(), DroppedOut())
    loss: float | Sequence[float] = LOSS
    joint: bool = True
    actuator_modes: Sequence[ActuatorMode] = ()
    process_modes: Sequence[NoisierProcess] = PROCESS_MODES
    alike: float = 0.2
    start_doubt: float = 0.1
    duration_shape: float = 1.1
    gain_limit: float = 1.0
    noise_factor: float = 3.0
    noise_strength: float = 5.0
    noise_forgetting: float = 0.9998
    outages: bool = False

    def __post_init__(self) -> None:
        check_flags(self, "joint", "outages")
        check_number(self, "alike", least=0, below=1)
        check_number(self, "start_doubt", least=0, below=1)
        check_number(self, "duration_shape", above=1, finite=False)
        check_number(self, "gain_limit", above=0, finite=False)
        check_number(self, "noise_factor", least=1, most=1e3)
        check_number(self, "noise_strength", above=0)
        check_number(self, "noise_forgetting", above=0, most=1)
        object.__setattr__(self, "modes", as_fault_modes(self.modes))
        object.__setattr__(self, "actuator_modes", as_actuator_modes(self.actuator_modes))
        object.__setattr__(self, "process_modes", as_process_modes(self.process_modes))
        for name in ("modes", "actuator_modes", "process_modes"):
            if (count := len(getattr(self, name))) > MOST_MODES:
                raise ModelError(f"SwitchingPrecision has {count} {name}; give at most {MOST_MODES}.")
        loss = self.loss
        each = (tuple(loss) or (loss,)) if isinstance(loss, list | tuple | np.ndarray) else (loss,)
        for value in each:
            as_number("SwitchingPrecision has loss", value, above=0, below=1)
        object.__setattr__(self, "loss", each if len(each) > 1 else each[0])

    def for_rates(self, every: Sequence[int], before: Sequence[int]) -> SwitchingPrecision:
        """See `PrecisionLearner.for_rates`: a `loss` that does not count the steps between the samples is increased by them."""
        losses = [float(loss) for loss in as_vector("The loss of SwitchingPrecision", self.loss, len(every))]
        new = [_with_pauses(loss, *steps) for loss, *steps in zip(losses, every, before, strict=True)]
        return self if new == losses else replace(self, loss=tuple(new))

    def slowed(self, factor: float) -> SwitchingPrecision:
        """Return the learner for a plant that is `factor` times slower: all mean times of its modes are multiplied by it.

        Parameters
        ----------
        factor : float
            Positive factor of the mean times.

        Examples
        --------
        >>> from bayesftc.controllers import SwitchingPrecision
        >>> SwitchingPrecision().slowed(100.0).modes[0].time_to_recovery
        1000.0
        """
        factor = as_number("SwitchingPrecision.slowed() has factor", factor, above=0)
        return self._timed(lambda value: factor * value)

    def rarer(self, factor: float) -> SwitchingPrecision:
        """Return the learner for devices that fail `factor` times more rarely: an alarm needs more evidence, and few are false.

        Default times still grow with the sample time. Harmless modes and process modes keep their mean times.

        Parameters
        ----------
        factor : float
            Positive factor of the mean times to a fault.

        Examples
        --------
        >>> from bayesftc.controllers import SwitchingPrecision
        >>> learner = SwitchingPrecision().rarer(100.0)
        >>> learner.modes[0].time_to_fault, learner.paced(300.0).modes[0].time_to_fault
        (30000.0, 450000000.0)
        """
        factor = as_number("SwitchingPrecision.rarer() has factor", factor, above=0)

        def rare(mode: Any) -> Any:
            if not getattr(mode, "is_fault", True):
                return mode
            time = mode.time_to_fault
            usual = getattr(time, "usual_step", None)
            longer = factor * time if usual is None else DefaultTime(factor * time, usual)
            return replace(mode, time_to_fault=longer)

        return replace(self, modes=tuple(map(rare, self.modes)), actuator_modes=tuple(map(rare, self.actuator_modes)))

    def paced(self, step: float) -> SwitchingPrecision:
        """Return the learner with the mean times for samples `step` seconds apart; `learner` uses these.

        Times from the user do not change. Default times are for samples of 5 to 20 ms. For longer steps they grow with the step
        (those of `Burst` beyond 0.1 s), for shorter ones, as in power electronics, they shrink with it.

        Parameters
        ----------
        step : float
            Sample time in seconds, positive.

        Examples
        --------
        >>> from bayesftc.controllers import Frozen, Offset, SwitchingPrecision
        >>> modes = SwitchingPrecision([Frozen(), Offset(time_to_fault=3600.0)]).paced(2.0).modes
        >>> [(mode.time_to_fault, mode.time_to_recovery) for mode in modes]
        [(30000.0, 1000.0), (3600.0, 1000.0)]
        """
        step = as_number("SwitchingPrecision.paced() has step", step, above=0)
        return self._timed(lambda value: time_at(value, step))

    def _timed(self, time: Callable[[float], float]) -> SwitchingPrecision:
        """Return the learner with other mean times, each a function of the former one."""

        def other(modes: Sequence[Any]) -> tuple[Any, ...]:
            names = ("time_to_fault", "time_to_recovery")
            return tuple(replace(mode, **{name: time(getattr(mode, name)) for name in names}) for mode in modes)

        return replace(
            self,
            modes=other(self.modes),
            actuator_modes=other(self.actuator_modes),
            process_modes=other(self.process_modes),
        )

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        modes: tuple[Any, ...] = (*self.modes, *self.actuator_modes, *self.process_modes)
        times = [time for mode in modes for time in (mode.time_to_fault, mode.time_to_recovery)]
        step = float(model.step)
        paced = self if all(time_at(time, step) == time for time in times) else self.paced(step)
        return paced._learner(model)

    def _learner(self, model: LinearModel) -> Learner:
        m, step = model.sensors, float(model.step)
        chances = self.chances(model)
        losses = as_vector("The loss of SwitchingPrecision", self.loss, m)
        mode_settings = [[settings_of(mode, mode.settings(model, i)) for mode in self.modes] for i in range(m)]
        bank = self._has_bank(model)
        harmless = sum(begin for mode, begin in zip(self.modes, chances[0], strict=True) if not mode.is_fault)
        units = self.offset_units(model) / np.diag(model.matrix("sensor_covariance"))
        first = [first_of(mode)[: 2 if bank and mode.own_hypothesis else None] for mode in self.modes]
        width = TRUST + max(map(len, first))
        settings_width = kernels.OWN_SETTINGS + max(len(values) for of_sensor in mode_settings for values in of_sensor)
        shape = 0.5 * self.noise_strength if self.noise_factor > 1 else KNOWN
        settings = []
        for i in range(m):
            loss = float(losses[i])
            settings += [1.0 - loss, loss, self.noise_forgetting, shape]
            settings += [1.0 / square(self.noise_factor), square(self.noise_factor), *self._repeats(model, i)]
            for mode, of_mode, values in zip(self.modes, chances.T, mode_settings[i], strict=True):
                arrives = (1.0 - loss) * (1.0 if mode.arrival is None else mode.arrival)
                if isinstance(mode, Offset):
                    values = np.concatenate([values[:OFFSET_VARIANCES] * units[i], values[OFFSET_VARIANCES:]])
                # A faulty sensor is also harmless as often as a healthy one; only a sample can tell that it is not.
                seen = arrives * (1.0 - harmless) if mode.is_fault else arrives
                block = [*of_mode, seen, 1.0 - arrives, *values]
                settings += block + [0.0] * (settings_width - len(block))
        memory = []
        for _ in range(m):
            memory += [np.nan, 1.0, 1.0, 1.0, 1.0, shape, shape, 0.0, 0.0, 0.0, kernels.UNKNOWN]
            for values in first:
                block = [kernels.LEAST, 0.0, 1.0, 0.0, *values]
                memory += block + [0.0] * (width - len(block))
        evidence = tuple(type(mode).evidence for mode in self.modes)
        single = tuple(k for k, mode in enumerate(self.modes) if not mode.joint_only)
        process_modes = self._acting(model)
        outages = self.outages and m > 1
        layout = self._layout(model, width, settings_width, process_modes, outages)
        redundant = tuple(int(model.quantity.count(quantity) > 1) for quantity in model.quantity)
        learn, report = learner_functions(
            evidence, single, self._faults, width, settings_width, layout, outages, redundant
        )
        kinds = self.fault_kinds
        ports = [port("mode_probability", (m, 1 + len(kinds)), elements=["healthy", *kinds] * m)]
        ports += [
            port("fault_kind", (m,), numbered=kinds),
            *(port(f"fault_{name}", (m,)) for name in ("size", "onset")),
        ]
        ports.append(port("log_density"))
        if layout is None:
            memory += [0.0, 0.0, *[1.0] * m, *([0.0, 0.0] if outages else [])]
            return Learner(learn, np.array(memory), np.array([*settings, step]), 1, tuple(ports), report)
        if layout.actuator_modes:
            kinds, p = tuple(type(mode).__name__ for mode in self.actuator_modes), layout.p
            ports.append(port("actuator_mode_probability", (p, 1 + len(kinds)), elements=["healthy", *kinds] * p))
            ports.append(port("actuator_fault_probability", (p,)))
            ports += [port("actuator_fault_kind", (p,), numbered=kinds), port("actuator_fault_size", (p,))]
        if layout.process_modes:
            ports.append(port("process_mode_probability", (2 + layout.process_modes,)))
        kept = np.array([*memory, 0.0, 0.0, *layout.start(np.asarray(memory))])
        settings += [step, *actuator_settings(self.actuator_modes, model)]
        settings += [value for mode in process_modes for value in mode.settings(step)]
        settings += [self._jumps_alike(process_modes[layout.kick], step) for _ in layout.groups]
        settings.append(1.0 / (self.duration_shape - 1.0))
        settings.append(min(1.0, self.gain_limit * filter_share(model)) if any(layout.fades) else 1.0)
        if process_modes:
            settings += [self.start_doubt, *model.state_at_samples.ravel().tolist(), *model.unread.tolist()]
            settings += most_variances(model).tolist()
        return Learner(
            learn,
            kept,
            np.array(settings),
            1,
            tuple(ports),
            report,
            infer=self._infer(layout, evidence),
        )

    def chances(self, model: LinearModel) -> Floats:
        """Return the probabilities per sample that each mode begins, lasts and ends (3 x modes); else another fault begins.

        Raises
        ------
        ModelError
            If a mode ends within a sample, or the modes begin with a total probability of 1 or more.
        """
        step = float(model.step)
        begins = [chance(mode, "time_to_fault", step) for mode in self.modes]
        ends = np.array([chance(mode, "time_to_recovery", step) for mode in self.modes])
        if sum(begins) >= 1:
            raise ModelError(
                f"SwitchingPrecision has fault modes that begin with a total probability of {sum(begins):.3g} in each sample of "
                f"{step:g} s. Their times to a fault are too short: lengthen time_to_fault."
            )
        joint = self._has_bank(model)
        used = [mode.is_fault and (joint or not mode.joint_only) for mode in self.modes]
        failing = sum(begin for begin, is_used in zip(begins, used, strict=True) if is_used)
        alone = np.array([mode.alone(failing - begin) for mode, begin in zip(self.modes, begins, strict=True)])
        return np.array([begins, alone * (1.0 - ends), alone * ends])

    def apart(self, who: str, instead: str = TOGETHER) -> SwitchingPrecision:
        """See `PrecisionLearner.apart`."""
        if self.actuator_modes:
            raise ModelError(
                f"{who} learns precisions apart from the state, so that actuator faults cannot be inferred; {instead}, or leave "
                "the actuator modes out."
            )
        if self.process_modes and not self._usual_process:
            raise ModelError(
                f"{who} learns precisions apart from the state, so that process modes cannot be inferred; {instead}, or leave "
                "the process modes out."
            )
        return replace(self, process_modes=(), joint=False)

    def without_covariance(self) -> SwitchingPrecision:
        """See `PrecisionLearner.without_covariance`."""
        return replace(self, noise_factor=1.0)

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """See `PrecisionLearner.fault_kinds`."""
        return tuple(type(mode).__name__ for mode in self.modes)

    @property
    def fault_sizes(self) -> tuple[str, ...]:
        """See `PrecisionLearner.fault_sizes`."""
        return tuple(mode.size_scale for mode in self.modes)

    @property
    def offset_kinds(self) -> tuple[str, ...]:
        """See `PrecisionLearner.offset_kinds`."""
        return tuple(type(mode).__name__ for mode in self.modes if isinstance(mode, Offset))

    def offset_units(self, model: LinearModel) -> Floats:
        """Return the variance for each sensor of a model in which its offsets are expected, see `Offset` (m)."""
        return model.quantity_noise if self._has_bank(model) else np.diag(model.matrix("sensor_covariance"))

    @property
    def _usual_process(self) -> bool:
        """Whether the process modes are the default ones, with any times; these are left out where they have no effect."""
        return [(m.scale, m.fading) for m in self.process_modes] == [(m.scale, m.fading) for m in PROCESS_MODES]

    @property
    def _faults(self) -> tuple[int, ...]:
        return tuple(int(mode.is_fault) for mode in self.modes)

    def _repeats(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """Return the settings for repetitions of a healthy sensor, by default those of `Frozen`."""
        frozen = next((mode for mode in self.modes if isinstance(mode, Frozen)), Frozen())
        return frozen.healthy(model, sensor)

    @property
    def _kinds(self) -> tuple[int, ...]:
        """The modes that are estimated together with the state in the joint form."""
        return tuple(k for k, mode in enumerate(self.modes) if isinstance(mode, Offset))

    @property
    def _lost(self) -> tuple[int, ...]:
        """The modes in which the state is inferred without the sensor, in the joint form."""
        return tuple(k for k, mode in enumerate(self.modes) if mode.own_hypothesis)

    def _is_joint(self, model: LinearModel) -> bool:
        nominal = model.matrix("sensor_covariance")
        return self.joint and not np.any(nominal != np.diag(np.diag(nominal)))

    def _has_bank(self, model: LinearModel) -> bool:
        """Return whether the joint form has any hypotheses."""
        return self._is_joint(model) and bool(self._kinds or self._lost or self.actuator_modes)

    def _acting(self, model: LinearModel) -> tuple[NoisierProcess, ...]:
        """Return the process modes that have an effect; refuse modes from the user that have none."""
        plant = model.states - model.disturbances
        if self._has_bank(model) and np.any(model.matrix("process_covariance")[:plant, :plant]):
            return tuple(self.process_modes)
        if self.process_modes and not self._usual_process:
            raise ModelError(
                "SwitchingPrecision has process_modes, which need the joint form and scale the process noise of the plant. Leave "
                "joint=True, give sensors of independent noise, an Offset or Unmodelled among the modes and a process "
                "covariance, or leave the process modes out."
            )
        return ()

    def _layout(
        self,
        model: LinearModel,
        width: int,
        settings: int,
        process_modes: Sequence[NoisierProcess],
        outages: bool = False,
    ) -> Layout | None:
        """Return the layout of the joint form's bank; None for the per-sensor form."""
        kinds, actuator_modes = self._kinds, self.actuator_modes
        if not self._has_bank(model):
            if actuator_modes:
                raise ModelError(
                    "SwitchingPrecision has actuator_modes, which need the joint form. Leave joint=True and give sensors of "
                    "independent noise, or leave the actuator modes out."
                )
            return None
        step = float(model.step)
        begins = model.sensors * sum(chance(self.modes[k], "time_to_fault", step) for k in kinds)
        begins += model.sensors * sum(chance(self.modes[k], "time_to_fault", step) for k in self._lost)
        begins += model.controls * sum(chance(mode, "time_to_fault", step) for mode in actuator_modes)
        begins += sum(mode.settings(step)[0] for mode in process_modes)
        kick = next((q for q, mode in enumerate(process_modes) if mode.scale > 1), -1)
        common = next((k for k in kinds if getattr(self.modes[k], "jump", 0.0) > 0), -1)
        competing = self.alike > 0 and min(kick, common) >= 0
        groups = tuple(group for group in model.alike if 1 < len(group) == model.sensors) if competing else ()
        begins += sum(self._jumps_alike(process_modes[kick], step) for _ in groups)
        if begins >= 1:
            raise ModelError(
                f"The offsets and unmodelled faults of {model.sensors} sensors, the actuator faults and the process modes begin "
                f"with a total probability of {begins:.3g} in each sample of {step:g} s. Their times to a fault are too short "
                "for the joint form of SwitchingPrecision: lengthen time_to_fault, or take joint=False."
            )
        jumping = tuple(q for q, k in enumerate(kinds) if getattr(self.modes[k], "jump", 0.0) > 0)
        becomes = (*range(len(kinds)), *jumping)
        kinds += tuple(kinds[q] for q in jumping)
        slow = tuple(int(self.modes[k].needs_witness) for k in kinds)
        spans = [
            tuple((k in of) * _kept(mode) for k, mode in enumerate(self.modes)) for of in self._parts(model.sensors)
        ]
        return Layout(
            n=model.states,
            m=model.sensors,
            p=model.controls,
            plant=model.states - model.disturbances,
            kinds=kinds,
            becomes=becomes,
            slow=slow,
            lost=self._lost,
            quantity=model.quantity,
            groups=groups,
            common=common,
            kick=kick,
            fades=tuple(int(mode.fading > 1) for mode in process_modes),
            alone=spans[0],
            other=spans[1],
            faults=self._faults,
            actuator_modes=len(actuator_modes),
            process_modes=len(process_modes),
            width=width,
            width_of_settings=settings,
            outages=outages,
            drops=tuple(k for k, mode in enumerate(self.modes) if type(mode).evidence is mode_kernels.drops),
            repeats=next((k for k, mode in enumerate(self.modes) if isinstance(mode, Frozen)), -1),
        )

    def _jumps_alike(self, kick: NoisierProcess, step: float) -> float:
        """Return the probability per sample that all sensors of a quantity jump alike: that of a kick times the odds."""
        return kick.settings(step)[0] * self.alike / (1.0 - self.alike)

    def _parts(self, sensors: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the modes judged sensor by sensor without an offset, and those of the other sensors with one.

        With an offset, a drift needs a third sensor as a witness.
        """
        alone = tuple(k for k, mode in enumerate(self.modes) if not (isinstance(mode, Offset) or mode.own_hypothesis))
        witness = sensors > 2
        other = (
            k
            for k, mode in enumerate(self.modes)
            if not (mode.joint_only or mode.own_hypothesis) and (witness or not mode.needs_witness)
        )
        return alone, tuple(other)

    def _infer(self, layout: Layout, evidence: tuple[Callable[..., float], ...]) -> Callable[..., None]:
        alone, other = (
            sensor_functions(evidence, of, layout.width, layout.width_of_settings) for of in self._parts(layout.m)
        )
        return make_infer(layout, *alone, *other)
