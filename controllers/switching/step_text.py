"""The step functions of switching, as text for each list of modes, whose step functions they call."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from bayesftc.controllers.precision.base import keep_nominal, report_nothing
from bayesftc.controllers.switching import calm, mode_kernels, sensor_kernels as kernels
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.bank.samples import report_actuators, report_process
from bayesftc.controllers.switching.outages import make_outage, prolonged
from bayesftc.cosim import ops
from bayesftc.cosim.stepping.source.written import function_from_text
from bayesftc.cosim.types import argument_names

_PASS_TIME = """
healthy = memory[at + HEALTHY]
stays = healthy
{modes}
memory[at + HEALTHY] = stays
"""

_PASS_MODE = "stays = stays + pass_mode(memory, at + {block}, healthy, settings, row + {settings})"

_WEIGH = """
{outage}
sound = log_density(e * e, variance)
logp = select(present > 0.5, sound + wider(e * e, variance, nominal, doubt), 0.0)
{modes}
most = {most}
share = share_of(logp, most)
healthy = memory[at + HEALTHY] * select(present > 0.5, settings[row + ARRIVES], {missing}) * share
{weights}
total = {total}
part = 1.0 / total
memory[at + HEALTHY] = healthy * part + LEAST
{probabilities}
memory[at + TRUSTED] = maximum(({trust}) * part, LEAST_TRUST)
memory[at + DENSITY] = total
return most
"""

_WEIGH_MODE = """\
block{k}, place = at + {block}, row + {settings}
{tells}
factor{k} = select(present > 0.5, settings[place + MODE_ARRIVES] * memory[block{k} + FACTOR]{times}, {missing})\
"""

_TELLS = """\
logp{k} = mode{k}(e, present, variance, nominal, change, {healthy}, memory, block{k}, settings, place + OWN_SETTINGS)
{repeats}
logp{k} = select(present > 0.5, logp{k}, 0.0)\
"""

_REPEATS = """
logp{k} = select(step > 0.0, as_coarse(logp, sound, e, variance, step), logp{k})\
"""

_LEARN = """
logp = 0.0 * sample.nominal[0, 0]
{outage}
surprise, weighed, weights = sample.y.shape[0] * LENGTH + 2, 0.0 * logp, 0.0 * logp
for i in range(sample.y.shape[0]):
    share = sample.spread[i, i] / (sample.spread[i, i] + sample.nominal[i, i] * memory[i * LENGTH + NOISE])
    weighed = weighed + share * memory[surprise + i]
    weights = weights + share
for i in range(sample.y.shape[0]):
    at, row = i * LENGTH, i * SETTINGS
    noise = sample.nominal[i, i] * memory[at + NOISE]
    variance = sample.spread[i, i] + noise
    pass_time(memory, at, settings, row)
    change = sample.y[i] - memory[at + LAST]
    error = held(sample.e[i], variance)
    own = REDUNDANT[i] * sample.spread[i, i] / variance
    quiet = maximum(weighed - own * memory[surprise + i], LEAST) / maximum(weights - own, LEAST)
{calm}
    repeats = repetition(change, sample.nominal[i, i], 1.0, memory, at, settings, row)
    step = indifferent(change, sample.nominal[i, i], 1.0, memory, at, settings, row)
    frozen = select(step > 0.0, 1.0 / at_rest(step, sample.nominal[i, i], memory, at, settings, row), repeats)
    doubt = 0.5 / memory[at + NOISE_SHAPE]
    logp = logp + weigh(error, {present}, variance, noise, doubt, change, frozen, step, memory, at, settings, row)
    logp = logp + log(memory[at + DENSITY] / repeats)
    memory[surprise + i] = surprised(
        memory[surprise + i],
        error * error,
        variance,
        sample.spread[i, i],
        sample.nominal[i, i],
        sample.present[i],
        memory[at + HEALTHY],
        memory[sample.y.shape[0] * LENGTH],
    )
    part = noise / variance
    squared = part * (part * error * error + sample.spread[i, i])
    counts = sample.present[i] * memory[at + HEALTHY]{counts}
    squared = not_less(squared / sample.nominal[i, i], step, sample.nominal[i, i])
    learn_noise(squared, counts, memory, at, settings, row)
    learn_repeats(change, counts, sample.nominal[i, i], memory, at, settings, row)
    memory[at + LAST] = select(sample.present[i] > 0.5, sample.y[i], memory[at + LAST])
    trust.fault_probability[i] = failed(memory, at, WIDTH, FAULTS)
    use_trust(memory, LENGTH, i, sample, trust)
memory[sample.y.shape[0] * LENGTH] = memory[sample.y.shape[0] * LENGTH] + 1.0
memory[sample.y.shape[0] * LENGTH + 1] = logp
"""

_OUTAGE = """\
at = sample.y.shape[0] * (LENGTH + 1) + 2
outage = prolonged(is_outage(sample, memory, settings), sample, memory, at)\
"""

_NOTE_OUTAGE = "outage, present = maximum(-present, 0.0), maximum(present, 0.0)"
_IN_AN_OUTAGE = "select(outage > 0.5, 1.0, {})"
"""Probability of a missing sample where outages are possible: the same for all modes in an outage."""

_REPORT = """
report_modes(memory, LENGTH, WIDTH, MODES, nominal.shape[0], settings[nominal.shape[0] * SETTINGS], first, outputs)
"""

_REPORT_ACTUATORS = """
report_actuators(memory, ACTUATORS, ACTUATOR_MODES, P, first + nominal.shape[0] * (MODES + 4) + 1, outputs)
"""

_REPORT_PROCESS = """
report_process(memory, PROCESS, STRIDE, PROCESS_MODES, first + PROCESS_OUTPUTS, outputs)
"""

_OF_TIME = ("memory", "at", "settings", "row")
_OF_A_SAMPLE = ("e", "present", "variance", "nominal", "doubt", "change", "repeats", "step", *_OF_TIME)

Evidence = tuple[Callable[..., float], ...]


@cache
def sensor_functions(
    evidence: Evidence, chosen: tuple[int, ...], width: int, settings: int, outages: bool = False
) -> tuple[Callable[..., None], Callable[..., float]]:
    """Return the functions for the transitions of a sensor's modes, and for their weights by a sample.

    The latter returns the sample's log density up to a factor (`DENSITY`). Only the ``chosen`` modes are used.

    Parameters
    ----------
    evidence : tuple of function
        The modes' step functions.
    chosen : tuple of int
        Numbers of the modes in use.
    width, settings : int
        Widths of the block of a mode in the memory and in the settings.
    outages : bool
        Whether ``present`` may be -1 for an outage, in which a missing sample says nothing.
    """
    # Without its own density a mode uses that of a healthy sample, whose noise is uncertain (`wider`): a dropped-out sensor, and
    # the first sample of a frozen or unmodelled one.
    telling = [k for k in chosen if evidence[k] is not mode_kernels.drops]
    waiting = (mode_kernels.freezes, mode_kernels.regresses)
    missing = _IN_AN_OUTAGE if outages else "{}"

    def of_modes(text: str, of: Iterable[int] = chosen) -> list[str]:
        return [
            text.format(
                k=k,
                block=kernels.FIRST + k * width,
                settings=kernels.FIRST_SETTINGS + k * settings,
                tells=_TELLS.format(
                    k=k,
                    healthy="logp" if evidence[k] in waiting else "sound",
                    repeats=_REPEATS.format(k=k) if evidence[k] is mode_kernels.freezes else "",
                )
                if k in telling
                else "",
                share=f"share_of(logp{k}, most)" if k in telling else "share",
                times=" * repeats" if evidence[k] is mode_kernels.freezes else "",
                missing=missing.format("settings[place + MODE_MISSING]"),
            )
            for k in of
        ]

    def lines(text: str) -> str:
        return "\n".join(of_modes(text))

    names = _names(evidence)
    passing = _PASS_TIME.format(modes=lines(_PASS_MODE))
    weighing = _WEIGH.format(
        modes=lines(_WEIGH_MODE),
        outage=_NOTE_OUTAGE if outages else "",
        missing=missing.format("settings[row + MISSING]"),
        most=_paired(["logp", *of_modes("logp{k}", telling)], "maximum({}, {})"),
        weights=lines("weight{k} = memory[block{k} + WEIGHT] * factor{k} * {share}"),
        total=_paired(["healthy", *of_modes("weight{k}")], "({} + {})"),
        probabilities=lines("memory[block{k} + WEIGHT] = weight{k} * part + LEAST"),
        trust=_paired(["healthy", *of_modes("weight{k} * memory[block{k} + TRUST]")], "({} + {})"),
    )
    return _function("pass_time", _OF_TIME, passing, names), _function("weigh", _OF_A_SAMPLE, weighing, names)


@cache
def learner_functions(
    evidence: Evidence,
    chosen: tuple[int, ...],
    faults: tuple[int, ...],
    width: int,
    settings: int,
    layout: Layout | None,
    outages: bool,
    redundant: tuple[int, ...],
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return the learning and the reporting step function of the per-sensor form for these modes.

    Parameters
    ----------
    evidence, chosen, width, settings, outages
        See `sensor_functions`.
    faults : tuple of int
        Whether each mode is a fault (1 or 0).
    layout : Layout or None
        Layout of the joint form's bank, if there is one, for the reports of actuators and process.
    redundant : tuple of int
        Whether another sensor measures the same quantity, for each sensor (1 or 0). Then only the others' innovations can tell
        that the process is quiet, for this one may be filtered. Beside an only sensor all innovations can.
    """
    modes = len(evidence)
    pass_time, weigh = sensor_functions(evidence, chosen, width, settings, outages)
    names = _names(evidence) | {
        "MODES": modes,
        "FAULTS": faults,
        "REDUNDANT": redundant,
        "WIDTH": width,
        "pass_time": pass_time,
        "weigh": weigh,
        "LENGTH": kernels.FIRST + modes * width,
        "SETTINGS": kernels.FIRST_SETTINGS + modes * settings,
    }
    if outages:
        drops = tuple(k for k in chosen if evidence[k] is mode_kernels.drops)
        names |= {"is_outage": make_outage(names["LENGTH"], names["SETTINGS"], width, drops), "prolonged": prolonged}
    learning = _LEARN.format(
        outage=_OUTAGE if outages else "",
        present="select(outage > 0.5, -1.0, sample.present[i])" if outages else "sample.present[i]",
        counts=" * (1.0 - outage)" if outages else "",
        calm="\n".join(
            f"    memory[at + {kernels.FIRST + k * width + mode_kernels.SURPRISE}] = quiet"
            for k in chosen
            if evidence[k] is mode_kernels.regresses
        ),
    )
    learn = _function("learn_switching", argument_names(keep_nominal), learning, names)
    report = _REPORT
    if layout is not None and layout.actuator_modes:
        report += _REPORT_ACTUATORS
        names |= {
            "report_actuators": report_actuators,
            "ACTUATORS": layout.actuators,
            "P": layout.p,
            "ACTUATOR_MODES": layout.actuator_modes,
        }
    if layout is not None and layout.process_modes:
        report += _REPORT_PROCESS
        sensors = layout.m * (modes + 4) + 1
        names |= {
            "report_process": report_process,
            "PROCESS": layout.first + layout.process * layout.length,
            "STRIDE": layout.length,
            "PROCESS_MODES": layout.process_modes,
            "PROCESS_OUTPUTS": sensors + layout.p * (layout.actuator_modes + 4) * (layout.actuator_modes > 0),
        }
    return learn, _function("report_switching", argument_names(report_nothing), report, names)


def _names(evidence: Evidence) -> dict[str, Any]:
    """Return the global names of the text."""
    functions = {name: value for of in (calm, mode_kernels, kernels, ops) for name, value in vars(of).items()}
    evidence_functions = {f"mode{k}": function for k, function in enumerate(evidence)}
    return (
        {name: value for name, value in functions.items() if not name.startswith("__")}
        | evidence_functions
        | {"__name__": __name__}
    )


def _function(name: str, arguments: Iterable[str], text: str, names: dict[str, Any]) -> Callable[..., Any]:
    lines = [line for line in text.strip("\n").split("\n") if line]
    return function_from_text(name, arguments, lines, names)


def _paired(terms: list[str], joined: str) -> str:
    """Return the terms joined in pairs, recursively, so that the processor computes them in parallel."""
    while len(terms) > 1:
        pairs = [joined.format(*terms[k : k + 2]) for k in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[len(terms) - len(terms) % 2 :]
    return terms[0]
