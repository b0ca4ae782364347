"""What a block says about the faults that its precision learner distinguishes, beside its ports."""

from __future__ import annotations

from abc import abstractmethod

from bayesftc.controllers.precision.base import Learner, PrecisionLearner


class InfersFaults:
    """Names and sizes of the kinds of faults; the block has a ``precision`` and makes a learner of it."""

    precision: PrecisionLearner

    @abstractmethod
    def _learner(self) -> Learner: ...

    @property
    def corrects_offsets(self) -> bool:
        """Whether samples minus an inferred offset still inform the state, as in the joint form of `SwitchingPrecision`."""
        return self._learner().infer is not None

    @property
    def corrected_kinds(self) -> tuple[str, ...]:
        """Names of those of `fault_kinds` whose inferred offset is subtracted from the samples, which still inform the state."""
        return self.precision.offset_kinds if self.corrects_offsets else ()

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """Names of the kinds of sensor faults that the precision learner distinguishes."""
        return self.precision.fault_kinds

    @property
    def fault_sizes(self) -> tuple[str, ...]:
        """In what the size of each of `fault_kinds` is given; see `PrecisionLearner.fault_sizes`."""
        return self.precision.fault_sizes


class InfersActuatorFaults(InfersFaults):
    """The same for a block whose learner may have modes of actuators."""

    @property
    def _precision(self) -> PrecisionLearner:
        return self.precision

    @property
    def actuator_kinds(self) -> tuple[str, ...]:
        """Names of the kinds of actuator faults that the precision learner distinguishes."""
        return tuple(type(mode).__name__ for mode in self._precision.actuator_modes)

    @property
    def actuator_sizes(self) -> tuple[str, ...]:
        """In what the size of each of `actuator_kinds` is given: the control's ``"unit"``, or a share of its ``"effect"``."""
        return tuple(mode.size_scale for mode in self._precision.actuator_modes)


__all__ = ["InfersActuatorFaults", "InfersFaults"]
