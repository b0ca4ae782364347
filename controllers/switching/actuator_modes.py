"""Actuator modes: the ways in which an actuator or the process can fail, which `SwitchingPrecision` infers beside sensor faults.

Each is a number c that acts through the control channel: the plant gets ``u + c`` (`InputOffset`), ``(1 - c) u`` (`LostEffect`)
or ``c`` (`StuckActuator`). c is estimated together with the state. A mode is linear and consists of numbers; it needs no step
function. To write one you must:

1. make it a frozen dataclass, a subclass of `ActuatorMode`, whose settings all have defaults;
2. give it a method ``expected(self, scale)`` that returns three numbers: mean and variance of c at its onset, and the variance of
   its walk per sample. ``scale`` is the control that moves the state in one sample as far as its process noise does; use it as
   the unit of a c in units of the control;
3. define its effect by attributes of the class: the plant gets ``(1 + takes + relative c) u + absolute c``; `follows` is 1 if c
   begins at the last control, else 0.

This suffices in Python: ``SwitchingPrecision(actuator_modes=[Released()])``; ``docs/reference/extend.md`` has an example.
Scenario files and tests use `ACTUATOR_MODES`; add the mode to it for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.cosim.ops import square


@dataclass(frozen=True)
class ActuatorMode:
    """Base of all actuator modes.

    The default times grow with the sample time, as for `FaultMode`.

    Parameters
    ----------
    time_to_fault : float
        Mean time in seconds until a healthy actuator fails in this way. By default it is ten times that of a sensor, so that the
        modes cost nothing while all is healthy.
    time_to_recovery : float
        Mean time in seconds until it is healthy again.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from bayesftc import controllers
    >>> @dataclass(frozen=True)
    ... class Reversed(controllers.ActuatorMode):  # crossed wires: the plant gets -u
    ...     relative = -1.0
    ...     def expected(self, scale):
    ...         return 2.0, 0.01, 0.0
    >>> model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0], [1.0]], 0.01, 0.04, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(actuator_modes=[Reversed()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y in (0.0, -1.0, -1.9, -2.7):
    ...     out = step(y=[y, y], u=[1.0])
    >>> out.actuator_fault_probability.round(2).tolist()
    [1.0]
    """

    time_to_fault: float = DefaultTime(3000.0)
    time_to_recovery: float = DefaultTime(20.0)

    absolute: ClassVar[float] = 0.0
    relative: ClassVar[float] = 0.0
    takes: ClassVar[float] = 0.0
    follows: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        for name in ("time_to_fault", "time_to_recovery"):
            check_number(self, name, above=0)

    @property
    def size_scale(self) -> str:
        """What its size is in: the control's ``"unit"``, or a share of its ``"effect"``."""
        return "unit" if self.absolute else "effect"

    def expected(self, scale: float) -> tuple[float, float, float]:
        """Return mean and variance of c at the onset, and the variance of its walk per sample."""
        raise TypeError(f"{type(self).__name__} has no method expected(scale); give it one.")


@dataclass(frozen=True)
class InputOffset(ActuatorMode):
    """An unknown offset of the control: an additive fault of actuator or process, such as a leak or an external force.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `ActuatorMode`.
    jump : float
        Standard deviation at the onset, in units of the control that moves the state in one sample as far as process noise does.
    walk : float
        Standard deviation of its random walk per sample, in the same units.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0], [1.0]], 0.01, 0.04, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(actuator_modes=[controllers.InputOffset()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y in (0.0, 0.0, 0.5, 0.95, 1.36, 1.72, 2.05):  # a load of 0.5, while u is 0
    ...     out = step(y=[y, y], u=[0.0])
    >>> out.actuator_fault_probability.round(2).tolist(), out.actuator_fault_size.round(1).tolist()
    ([1.0], [0.5])
    """

    jump: float = 5.0
    walk: float = 0.05

    absolute: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "jump", least=0)
        check_number(self, "walk", least=0)

    def expected(self, scale: float) -> tuple[float, float, float]:
        """See `ActuatorMode.expected`."""
        jump, walk = self.jump * scale, self.walk * scale
        return 0.0, jump * jump, walk * walk  # a power would raise an OverflowError


@dataclass(frozen=True)
class LostEffect(ActuatorMode):
    """The actuator has lost a share of its effectiveness.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `ActuatorMode`.
    share : float
        Mean of the lost share at the onset.
    spread : float
        Standard deviation of the lost share.
    walk : float
        Standard deviation of its random walk per sample.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0], [1.0]], 0.01, 0.04, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(actuator_modes=[controllers.LostEffect()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y in (0.0, 1.2, 2.28, 3.25, 4.13, 4.92):  # 60 % of the control has an effect
    ...     out = step(y=[y, y], u=[2.0])
    >>> out.actuator_fault_probability.round(2).tolist(), out.actuator_fault_size.round(1).tolist()
    ([1.0], [0.4])
    """

    share: float = 0.5
    spread: float = 0.3
    walk: float = 0.001

    relative: ClassVar[float] = -1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "share", least=-1, most=1)
        check_number(self, "spread", least=0)
        check_number(self, "walk", least=0)

    def expected(self, scale: float) -> tuple[float, float, float]:
        """See `ActuatorMode.expected`."""
        return self.share, square(self.spread), square(self.walk)


@dataclass(frozen=True)
class StuckActuator(ActuatorMode):
    """The actuator is stuck at or near the last control: the plant gets a constant, whatever the control.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `ActuatorMode`.
    spread : float
        Standard deviation of the stuck value around the last control, in units of the control that moves the state in one sample
        as far as process noise does.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0], [1.0]], 0.01, 0.04, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(actuator_modes=[controllers.StuckActuator()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y, u in zip([0.0, 1.0, 1.9, 2.71, 3.44, 4.1], [1.0, 1.0, 0.5, -0.5, -1.0, -2.0]):  # stuck at 1
    ...     out = step(y=[y, y], u=[u])
    >>> out.actuator_fault_probability.round(2).tolist(), out.actuator_fault_size.round(1).tolist()
    ([1.0], [1.0])
    """

    spread: float = 5.0

    absolute: ClassVar[float] = 1.0
    takes: ClassVar[float] = -1.0
    follows: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "spread", least=0)

    def expected(self, scale: float) -> tuple[float, float, float]:
        """See `ActuatorMode.expected`."""
        spread = self.spread * scale
        return 0.0, spread * spread, 0.0


ACTUATOR_MODES: tuple[type[ActuatorMode], ...] = (InputOffset, LostEffect, StuckActuator)
"""To add an actuator mode, write it by the rules above and list it here."""

__all__ = ["ACTUATOR_MODES", "ActuatorMode", "InputOffset", "LostEffect", "StuckActuator"]
