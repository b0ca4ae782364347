"""Whether a model exchange FMU gives what it says it has given: zeros would look like values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim._exchange.port_values import StopError
from bayesftc.cosim._fmi.library import CallError
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import FMUError

if TYPE_CHECKING:
    from bayesftc.cosim._exchange.model import ExchangeModel

UNWRITTEN = 0x7FF8_5AFE_C0DE_0001
"""The bits of a NaN that no computation makes."""


def check_written(model: ExchangeModel) -> None:
    """Refuse an FMU that says OK and does not write; its states have been read, into an array of `UNWRITTEN`.

    Raises
    ------
    FMUError
        If it does not.
    """
    outputs = model.ports.names[1]
    reads: list[tuple[int, Callable[[Floats], None], Sequence[str]]] = [
        (model.nx, lambda array: model.read("get_derivatives", array), ["the derivatives of its states"]),
        (model.nz, lambda array: model.read("get_indicators", array), ["its event indicators"]),
        (len(outputs), model.read_outputs, [f"the output {name!r}" for name in outputs]),
    ]
    missing = ["its continuous states"] if (model.x.view(np.int64) == UNWRITTEN).any() else []
    for size, read, names in reads:
        values = np.full(size, UNWRITTEN, dtype=np.int64)
        try:
            read(values.view(np.float64))
        except (CallError, StopError):
            continue  # the run will say so
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
