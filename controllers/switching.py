"""Switching between fault modes: for each sensor a hidden Markov model over the ways in which it can fail."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers import _mode_kernels as mode_kernels, _switching_kernels as kernels
from bayesftc.controllers._checks import as_number, as_vector
from bayesftc.controllers._mode_kernels import TRUST
from bayesftc.controllers.fault_modes import Drifting, DroppedOut, FaultMode, Frozen, Noisier, Offset
from bayesftc.controllers.precision import Learner, PrecisionLearner, keep_nominal, report_nothing
from bayesftc.cosim import ops
from bayesftc.cosim._written import function_from_text
from bayesftc.cosim.block import argument_names
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ports import Port

if TYPE_CHECKING:
    from bayesftc.controllers.model import LinearModel

# The functions of one sensor and the learning step function; those are written for each list of modes, whose own they call.
_PASS_TIME = """
healthy = memory[at + HEALTHY]
stays = healthy * settings[row + STAYS]
{modes}
memory[at + HEALTHY] = stays
"""

_PASS_MODE = "stays = stays + pass_mode(memory, at + {block}, healthy, settings, row + {settings})"

_WEIGH = """
error, sound = held(e, variance), log_density(minimum(e * e, FURTHEST * variance), variance)
told = select(present > 0.5, settings[row + ARRIVES] + sound, settings[row + MISSING])
{modes}
most = {most}
healthy = memory[at + HEALTHY] * share_of(told, most)
{weights}
total = {total}
part = 1.0 / total
memory[at + HEALTHY] = maximum(healthy * part, LEAST)
{probabilities}
memory[at + TRUSTED] = maximum(minimum(({trust}) * part, 1.0), LEAST_TRUST)
return most + log(total)
"""

_WEIGH_MODE = """\
block{k}, own = at + {block}, row + {settings}
told{k} = mode{k}(error, present, variance, nominal, change, sound, memory, block{k}, settings, own + OWN_SETTINGS)
told{k} = select(present > 0.5, settings[own + MODE_ARRIVES] + told{k}, settings[own + MODE_MISSING])\
"""

_LEARN = """
for i in range(y.shape[0]):
    at, row = i * LENGTH, i * SETTINGS
    variance = spread[i, i] + nominal[i, i]
    pass_time(memory, at, settings, row)
    change = y[i] - memory[at + LAST]
    weigh(e[i], present[i], variance, nominal[i, i], change, memory, at, settings, row)
    memory[at + LAST] = select(present[i] > 0.5, y[i], memory[at + LAST])
    fault_probability[i] = failed(memory, at, WIDTH, MODES)
    use_trust(memory, LENGTH, i, present, nominal, R, used, precision, beta)
memory[y.shape[0] * LENGTH] = memory[y.shape[0] * LENGTH] + 1.0
"""

_REPORT = """
report_modes(memory, LENGTH, WIDTH, MODES, nominal.shape[0], settings[nominal.shape[0] * SETTINGS], first, outputs)
"""

_OF_TIME = ("memory", "at", "settings", "row")
_OF_A_SAMPLE = ("e", "present", "variance", "nominal", "change", *_OF_TIME)


@cache
def _make_steps(
    evidence: tuple[Callable[..., float], ...], width: int, settings: int
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the learning and the reporting step function for these modes, whose blocks have these widths."""
    modes = len(evidence)
    names: dict[str, Any] = {
        **{name: value for of in (mode_kernels, kernels, ops) for name, value in vars(of).items() if not name.startswith("__")},
        **{f"mode{k}": function for k, function in enumerate(evidence)},
        "__name__": __name__, "MODES": modes, "WIDTH": width,
        "LENGTH": kernels.FIRST + modes * width, "SETTINGS": kernels.FIRST_SETTINGS + modes * settings,
    }  # fmt: skip
    places = [(kernels.FIRST + k * width, kernels.FIRST_SETTINGS + k * settings) for k in range(modes)]

    def of_modes(text: str) -> list[str]:
        return [text.format(k=k, block=block, settings=own) for k, (block, own) in enumerate(places)]

    def function(name: str, arguments: Iterable[str], text: str, **parts: str) -> Callable[..., None]:
        return function_from_text(name, arguments, text.format(**parts).strip("\n").split("\n"), names)

    def lines(text: str) -> str:
        return "\n".join(of_modes(text))

    names["pass_time"] = function("pass_time", _OF_TIME, _PASS_TIME, modes=lines(_PASS_MODE))
    names["weigh"] = function(
        "weigh", _OF_A_SAMPLE, _WEIGH,
        modes=lines(_WEIGH_MODE),
        most=_paired(["told", *of_modes("told{k}")], "maximum({}, {})"),
        weights=lines("weight{k} = memory[block{k} + WEIGHT] * share_of(told{k}, most)"),
        total=_paired(["healthy", *of_modes("weight{k}")], "({} + {})"),
        probabilities=lines("memory[block{k} + WEIGHT] = maximum(weight{k} * part, LEAST)"),
        trust=_paired(["healthy", *of_modes("weight{k} * memory[block{k} + TRUST]")], "({} + {})"),
    )  # fmt: skip
    learn = function("learn_switching", argument_names(keep_nominal), _LEARN)
    return learn, function("report_switching", argument_names(report_nothing), _REPORT)


def _paired(terms: list[str], joined: str) -> str:
    """Return the terms joined in pairs, and these again: so the processor computes them side by side."""
    while len(terms) > 1:
        pairs = [joined.format(*terms[k : k + 2]) for k in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[len(terms) - len(terms) % 2 :]
    return terms[0]


@dataclass(frozen=True)
class SwitchingPrecision(PrecisionLearner):
    """For each sensor a hidden Markov model over being healthy and failing in one of several ways.

    The precision stays what is inferred: a sensor is used with ``P(healthy) + sum_k P(mode k) trust_k`` of its nominal
    precision, where ``trust_k`` is 0 of a sensor that is frozen or has an offset, and what has been learned of one that is
    noisier (the paper's learner is that mode). At each sample time passes first (modes begin and end), then each mode says how
    probable the sample is, as a logarithm, so that none is lost. What a mode has learned about its fault is merged with what it
    expects of one that has just begun, as in an interacting-multiple-model filter.

    ``fault_probability`` is 1 - P(healthy), also of a sensor that sends nothing; ``beta`` is NaN. It adds the outputs
    ``mode_probability`` (m x 1 + modes, healthy first), and for each sensor ``fault_kind`` (the most probable mode by its
    number, 0: healthy), ``fault_size`` (of that mode: an offset in the sensor's unit, the standard deviation of a noisier
    sensor in nominal ones; NaN where there is none) and ``fault_onset`` (time in seconds since the first sample; NaN of a
    healthy sensor).

    Sensors are judged one by one by their innovation from the common prediction: two sensors that disagree by a slow drift are
    not told apart before one of them leaves the prediction behind.

    Parameters
    ----------
    modes : sequence of FaultMode
        The ways in which a sensor can fail, with how often, all on top of each other; see `FAULT_MODES`.
    loss : float or sequence of float
        Probability with which a sample of a healthy sensor is missing, for all sensors or for each: of one that is not due at
        every step (a slow one) the share of the steps without a sample.

    Raises
    ------
    ModelError
        If there is no mode, the losses are not one for each sensor, or with the model's sample time a fault would begin or end
        at each sample.
    """

    modes: Sequence[FaultMode] = (Frozen(), Offset(), Drifting(), Noisier(), DroppedOut())
    loss: float | Sequence[float] = 0.01

    def __post_init__(self) -> None:
        modes = tuple(self.modes) if isinstance(self.modes, Sequence) else ()
        if not modes or not all(isinstance(mode, FaultMode) and hasattr(mode, "evidence") for mode in modes):
            raise ModelError(
                f"SwitchingPrecision has modes={self.modes!r}; give fault modes such as Offset(), at least one."
            )
        object.__setattr__(self, "modes", modes)
        given = self.loss
        each = (tuple(given) or (given,)) if isinstance(given, list | tuple | np.ndarray) else (given,)
        for value in each:
            as_number("SwitchingPrecision has loss", value, above=0, below=1)
        object.__setattr__(self, "loss", each if len(each) > 1 else each[0])

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        m, step = model.sensors, float(model.step)
        begins = [_chance(mode, "time_to_fault", step) for mode in self.modes]
        ends = [_chance(mode, "time_to_recovery", step) for mode in self.modes]
        if sum(begins) >= 1:
            raise ModelError(
                f"SwitchingPrecision has fault modes that begin with a probability of {sum(begins):.3g} together in each sample "
                f"of {step:g} s; their times to a fault are too short."
            )
        losses = as_vector("The loss of SwitchingPrecision", self.loss, m)
        own = [[mode.settings(model, i) for mode in self.modes] for i in range(m)]
        width = TRUST + max(len(mode.first) for mode in self.modes)
        settings_width = kernels.OWN_SETTINGS + max(len(values) for values in own[0])
        settings = []
        for i in range(m):
            loss = float(losses[i])
            settings += [1.0 - sum(begins), math.log1p(-loss), math.log(loss)]
            for mode, begin, end, values in zip(self.modes, begins, ends, own[i], strict=True):
                arrives = 1.0 - loss if mode.arrival is None else mode.arrival
                block = [begin, 1.0 - end, end, math.log(arrives), math.log1p(-arrives), *values]
                settings += block + [0.0] * (settings_width - len(block))
        memory = []
        for _ in range(m):
            memory += [np.nan, 1.0, 1.0]
            for mode in self.modes:
                block = [kernels.LEAST, 0.0, 0.0, *mode.first]
                memory += block + [0.0] * (width - len(block))
        learn, report = _make_steps(tuple(type(mode).evidence for mode in self.modes), width, settings_width)
        ports = [Port("mode_probability", (m, 1 + len(self.modes)))]
        ports += [Port(name, (m,)) for name in ("fault_kind", "fault_size", "fault_onset")]
        return Learner(learn, np.array([*memory, 0.0]), np.array([*settings, step]), 1, tuple(ports), report)


def _chance(mode: FaultMode, name: str, step: float) -> float:
    """Return the probability per sample of what takes a mean time in seconds."""
    chance = step / float(getattr(mode, name))
    if chance >= 1:
        raise ModelError(
            f"{type(mode).__name__} has {name}={getattr(mode, name)!r}, which is not longer than the sample time of {step:g} s."
        )
    return chance
