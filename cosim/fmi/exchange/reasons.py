"""Why a step of a model exchange FMU stopped, as a sentence."""

from __future__ import annotations

import numpy as np

from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS
from bayesftc.cosim.fmi.reading.messages import ENDS, status_word

REMEDY = "give larger tolerances, a shorter step or another solver, or look at what the model does there"

CHATTERS = (
    f"{words.QUIET_EVENTS} came one after the other without time going on between them (chattering). Give the switch a "
    "hysteresis or a dead time, or export a model that regularises it"
)

_CVODE = {
    -1: f"it needed more than {INTERNAL_STEPS} steps of its own",
    -2: "more accuracy is asked for than numbers of 64 bits have",
    -3: "its error test fails again and again, or its step became as small as can be",
    -4: "its equations for a step do not converge, again and again or with the smallest step",
    -27: "the time to go is too short to begin",
}
"""What CVODE's flags mean, of those that a model can bring about."""

_CALLBACK_FAILED = frozenset({-8, -9, -10, -11, -12})


def reason(model: ExchangeModel, solver: str, said: str) -> str:
    """Return the sentence, without its full stop, for what the compiled functions wrote into the table.

    Parameters
    ----------
    model : ExchangeModel
        The instance.
    solver : str
        What the integrator is called.
    said : str
        The last words of the integrator.
    """
    table, reals = model.table, model.reals
    why, flag, role, status = (int(table[w]) for w in (words.REASON, words.FLAG, words.ROLE, words.STATUS))
    if why == words.CALL or (why == words.GIVES_UP and flag in _CALLBACK_FAILED and role):
        return _call(model, role, status, float(reals[words.WHEN]))
    now, reached = model.time, max(model.time, float(reals[words.REACHED]))
    sentences = {
        words.ENDS: f"{ENDS} (terminateSimulation)",
        words.ENDS_AFTER_STEP: f"{ENDS} (terminateSimulation, after a step of the integrator)",
        words.ENDLESS: f"Its event iteration does not end: after {words.ITERATIONS} turns at t = {now:g} s it still wants "
        f"another {model.library.names['update_discrete']}",
        words.NO_TIME: "The FMU says that its next event is at t = NaN",
        words.CHATTERS: _endless_events(model),
        words.TOO_MANY_EVENTS: f"More than {words.MOST_EVENTS:,} events came within one step, which has come to t = {now:.9g} s: "
        "give the switch a wider hysteresis, or the run a shorter step",
        words.TOO_MANY: f"{solver} gives up at t = {reached:g} s: {_CVODE[-1]}; {REMEDY}",
        words.TOO_SMALL: f"{solver} gives up at t = {reached:g} s: its step became as small as can be; {REMEDY}",
        words.GIVES_UP: f"{solver} gives up at t = {reached:g} s: {_CVODE.get(flag) or f'it returned {flag} ({said})'}; {REMEDY}",
    }
    if why in {words.UNFIT_INPUT, words.UNFIT_OUTPUT}:
        return model.ports.misfit(int(table[words.UNFIT]), is_input=why == words.UNFIT_INPUT)
    return sentences.get(why, f"The step stopped for an unknown reason ({why})")


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
    """Return the sentence for events one after the other without time going on."""
    if model.next_event <= model.time:
        return (
            f"Its events do not end at t = {model.time:.9g} s: the time that it gives for the next one (nextEventTime) is not "
            f"later, again and again: t = {model.next_event:.9g} s. Its model of time events is wrong; export it again"
        )
    return f"Its events do not end at t = {model.time:.9g} s: {CHATTERS}"


def nan_derivative(model: ExchangeModel) -> str:
    """Return which derivative is NaN where the FMU is: the beginning of a sentence."""
    values = np.zeros(model.nx)
    try:
        model.read("get_derivatives", values)
    except CallError:
        return "A derivative came out NaN or infinite"
    bad = [v.name for v, x in zip(model.info.derivatives, values, strict=False) if not np.isfinite(x)]
    return f"The derivative {bad[0]!r} came out NaN or infinite" if bad else "A derivative came out NaN or infinite"
