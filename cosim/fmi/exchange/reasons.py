"""Why a step of a model exchange FMU stopped, as a sentence."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS
from bayesftc.cosim.fmi.reading.messages import ENDS, status_word

REMEDY = "give larger tolerances, a shorter step or another solver, or check what the model does there"

CHATTERS = (
    f"{words.QUIET_EVENTS} occurred one after the other at the same time (chattering). Give the switch a hysteresis or a dead "
    "time, or export a model that regularises it"
)

_CVODE = {
    -1: f"it needed more than {INTERNAL_STEPS} internal steps",
    -2: "the tolerances are smaller than the precision of doubles",
    -3: "its error test fails repeatedly, or with the smallest step",
    -4: "the equations of a step do not converge, repeatedly or with the smallest step",
    -27: "the remaining time is too short to start",
}
"""The meaning of those of CVODE's flags that a model can cause."""

_CALLBACK_FAILED = frozenset({-8, -9, -10, -11, -12})


def reason(model: ExchangeModel, solver: str, message: str) -> str:
    """Return the error message, without its full stop, for the results of the compiled functions in the table.

    Parameters
    ----------
    model : ExchangeModel
        The instance.
    solver : str
        Name of the integrator.
    message : str
        The last message of the integrator.
    """
    table, reals = model.table, model.reals
    cause, flag, role, status = (int(table[w]) for w in (words.REASON, words.FLAG, words.ROLE, words.STATUS))
    if cause == words.CALL or (cause == words.GIVES_UP and flag in _CALLBACK_FAILED and role):
        return _call(model, role, status, float(reals[words.WHEN]))
    now, reached = model.time, max(model.time, float(reals[words.REACHED]))
    sentences = {
        words.ENDS: f"{ENDS} (terminateSimulation)",
        words.ENDS_AFTER_STEP: f"{ENDS} (terminateSimulation, after a step of the integrator)",
        words.ENDLESS: f"Its event iteration does not end: after {words.ITERATIONS} passes at t = {now:g} s it still requests "
        f"another {model.library.names['update_discrete']}",
        words.NO_TIME: "The FMU gives t = NaN as the time of its next event",
        words.CHATTERS: _endless_events(model),
        words.TOO_MANY_EVENTS: f"More than {words.MOST_EVENTS:,} events occurred within one step, up to t = {now:.9g} s: "
        "give the switch a wider hysteresis, or the run a shorter step",
        words.TOO_MANY: f"{solver} gives up at t = {reached:g} s: {_CVODE[-1]}; {REMEDY}",
        words.TOO_SMALL: f"{solver} gives up at t = {reached:g} s: it reached the smallest possible step; {REMEDY}",
        words.GIVES_UP: f"{solver} gives up at t = {reached:g} s: {_CVODE.get(flag) or f'it returned {flag} ({message})'}; "
        f"{REMEDY}",
    }
    if cause in {words.UNFIT_INPUT, words.UNFIT_OUTPUT}:
        return model.ports.misfit(int(table[words.UNFIT]), is_input=cause == words.UNFIT_INPUT)
    return sentences.get(cause, f"The step stopped for an unknown reason ({cause})")


def _call(model: ExchangeModel, role: int, status: int, when: float) -> str:
    if role == words.NAN_INDICATOR:
        return f"An event indicator came out NaN or infinite at t = {when:g} s, and smaller steps of the integrator do not help"
    if role == words.NAN_DERIVATIVE:
        return f"{nan_derivative(model)} at t = {when:g} s, and smaller steps of the integrator do not help"
    if role == words.NAN_STATE:
        return model.nan_state()
    model.note(status)
    if role in {words.SET_VALUES, words.GET_VALUES}:
        called = model.ports.function_of(int(model.table[words.UNFIT]), is_input=role == words.SET_VALUES)
    else:
        called = model.library.names[words.NAMES[role]]
    return f"{called} returned {status_word(status)} at t = {when:g} s"


def _endless_events(model: ExchangeModel) -> str:
    """Return the message for repeated events at the same time."""
    if model.next_event <= model.time:
        return (
            f"Its events do not end at t = {model.time:.9g} s: the time of the next event (nextEventTime) is repeatedly not "
            f"later, but t = {model.next_event:.9g} s. Correct the time events of the model and export it again"
        )
    return f"Its events do not end at t = {model.time:.9g} s: {CHATTERS}"


def nan_derivative(model: ExchangeModel) -> str:
    """Return which derivative is NaN at the FMU's present point, as the beginning of a sentence."""
    values = np.zeros(model.nx)
    try:
        model.read("get_derivatives", values)
    except CallError:
        return "A derivative came out NaN or infinite"
    bad = [v.name for v, x in zip(model.info.derivatives, values, strict=False) if not np.isfinite(x)]
    return f"The derivative {bad[0]!r} came out NaN or infinite" if bad else "A derivative came out NaN or infinite"
