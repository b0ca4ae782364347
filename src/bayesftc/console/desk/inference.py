"""What a controller or monitor can infer and do, for the sentences on the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Inference:
    """What a block infers about faults, and what follows from it.

    Attributes
    ----------
    learner : str
        Kind of its precision learner, or of the block itself.
    has_probability : bool
        Whether it gives fault probabilities; those of many learners are NaN.
    corrects : bool
        Whether samples minus an inferred offset still inform the state. Otherwise a sensor with an offset is ignored.
    controls : bool
        Whether it is a controller, which can compensate; a monitor cannot.
    offset_kinds : tuple of str
        Kinds of sensor faults that are an offset.
    """

    learner: str = ""
    has_probability: bool = True
    corrects: bool = False
    controls: bool = True
    offset_kinds: tuple[str, ...] = ()

    @classmethod
    def of(cls, block: Any) -> Inference:
        """Return the abilities of a controller or an estimator."""
        precision = getattr(block, "precision", None)
        return cls(
            type(block if precision is None else precision).__name__,
            getattr(precision, "why_no_probability", None) is None,
            getattr(block, "corrects_offsets", False),
            any(port.name == "u" for port in block.outputs),
            tuple(getattr(precision, "offset_kinds", ())),
        )


__all__ = ["Inference"]
