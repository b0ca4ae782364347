"""Whether a model exchange FMU gives what it says it has given, and no more: zeros would look like values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.guards import Guarded
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.exchange.model import ExchangeModel

UNWRITTEN = 0x7FF8_5AFE_C0DE_0001
"""The bits of a NaN that no computation makes."""


def check_written(model: ExchangeModel) -> None:
    """Refuse an FMU that says OK and does not write, or writes too much.

    Raises
    ------
    FMUError
        If it does not.
    """
    outputs = model.ports.names[1]
    reads: list[tuple[int, Callable[[Floats], None], Sequence[str]]] = [
        (model.nx, lambda array: model.read("get_states", array), ["its continuous states"]),
        (model.nx, lambda array: model.read("get_derivatives", array), ["the derivatives of its states"]),
        (model.nz, lambda array: model.read("get_indicators", array), ["its event indicators"]),
        (len(outputs), model.read_outputs, [f"the output {name!r}" for name in outputs]),
    ]
    missing = []
    for size, read, names in reads:
        guarded = Guarded(size, np.dtype(np.int64))
        values = guarded.values
        values[:] = UNWRITTEN
        try:
            read(values.view(np.float64))
        except (CallError, StopError):
            continue  # the run will say so
        too_far = model.ports.beyond(model.component)
        if too_far or not guarded.intact:
            raise FMUError(
                f"The FMU {model.library.description.name!r} writes beyond the memory that it is given for "
                f"{too_far or names[0]} ({model.name!r}), where it would damage what belongs to others: its binary and its model "
                "description do not agree. Export it again."
            )
        bad = np.flatnonzero(values == UNWRITTEN)
        if len(bad):
            missing.append(names[min(int(bad[0]), len(names) - 1)])
    unwritten = (group.unwritten(model.component) for group in model.ports.groups[1] if group.kind.code)
    missing += [f"the output {outputs[place]!r}" for place in unwritten if place >= 0]
    if missing:
        raise FMUError(
            f"The FMU {model.library.description.name!r} says that it has given {missing[0]}, but has not written all of it "
            f"({model.name!r}): its binary and its model description do not agree. Export it again."
        )
