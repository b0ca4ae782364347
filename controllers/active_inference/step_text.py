"""The text of active inference's step function, which is written for each controller's modalities, law and options."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import indent
from typing import Any

from bayesftc.controllers.active_inference import curvature as _curvature, descent as _descent
from bayesftc.controllers.estimation import absurd as _absurd, consistency as _consistency
from bayesftc.controllers.estimation.absurd import Reading, Screen
from bayesftc.controllers.estimation.belief import SAMPLE
from bayesftc.controllers.estimation.consistency import MOTION, OBSERVER_BANK
from bayesftc.controllers.precision.base import NAN, Trust
from bayesftc.cosim.ops import select
from bayesftc.cosim.stepping.records import named_alike, written

# In braces are the calls of the modalities' functions and of the law, and lines that depend on the options.
_STEP = """
{records}
{measure}
screen_samples(reading, sample, screen)
count_doubts(reading, sample, screen)
accept_confirmed(reading, sample, screen)
read(samples, expected, limit, e, present)
for i in range(e.shape[0]):
    innovation[i] = select(present[i] > 0.5, y[i] - expected[i], NAN)
learn(sample, trust, memory, settings, work)
mark_absurd(screen, fault_probability)
report(memory, settings, nominal, first, outputs)
alarm(doubts, outputs)
log_determinant = weigh(R, used, sigma, gain, L, inverse, weights) + prior_log_determinant[0]
for s in range(inner_steps):
    if s > 0:
        {measure_again}
        read(samples, expected, limit, e, present)
    {differentiate}
    prior_error(mean, predicted, eps_x)
    energy = quadratic(e, weights, weighted) + quadratic(eps_x, Px, weighted_x)
    belief_gradient(weighted, G, weighted_x, slope)
    curvature_of_belief(G, weights, prior_curvature, PG, H)
    {descent}
    free_energy[0] = free_energy_of(energy, log_determinant, used, means)
{decide}
act(control, applied, u)
{law_update}
predict_state(mean, applied, A, B, predicted)
place(mean, 0, x_hat)
{watch}
"""

_WATCH = """
check_consistency(samples, x_hat, G, nominal, bank)
follow(applied, B, bank, motion)
"""

_DESCENT_BY_GRADIENT = """
{law_output}
{law_derivative}
prior_error(control, law_control, eps_u)
energy = energy + quadratic(eps_u, Pu, weighted_u)
add_control_gradient(weighted_u, D, slope)
curvature_of_control(D, Pu, PD, H)
fraction = shortening(H, root_rate, largest, squarings, scaled, squared)
descend(fraction, rate, slope, mean)
descend(fraction, rate_u, weighted_u, control)
"""

_DESCENT_OF_THE_BELIEF = """
fraction = shortening(H, root_rate, largest, squarings, scaled, squared)
descend(fraction, rate, slope, mean)
"""

_DECISION_BY_LAW = """
{law_output}
place(law_control, 0, control)
for i in range(eps_u.shape[0]):
    eps_u[i] = 0.0 * control[i]
"""

_RECORDS = {
    "reading": named_alike(Reading),
    "sample": SAMPLE,
    "trust": named_alike(Trust),
    "screen": named_alike(Screen),
    "bank": OBSERVER_BANK,
    "motion": MOTION,
}

FUNCTIONS: dict[str, Any] = {
    **{type(record).__name__: type(record) for record in _RECORDS.values()},
    "NAN": NAN,
    "select": select,
    **{
        name: getattr(_descent, name)
        for name in (
            "act",
            "add_control_gradient",
            "belief_gradient",
            "descend",
            "free_energy_of",
            "place",
            "place_rows",
            "predict_state",
            "prior_error",
            "quadratic",
            "read",
            "weigh",
        )
    },
    **{name: getattr(_absurd, name) for name in ("mark_absurd", "count_doubts", "accept_confirmed", "screen_samples")},
    **{name: getattr(_consistency, name) for name in ("check_consistency", "follow")},
    **{name: getattr(_curvature, name) for name in ("curvature_of_belief", "curvature_of_control", "shortening")},
}
"""Functions that the text calls, besides those of modalities, law and learner."""


def step_lines(calls: Mapping[str, str], *, descends: bool, watches: bool) -> list[str]:
    """Return the lines of the step function's body.

    Parameters
    ----------
    calls : mapping of str to str
        The statements ``measure`` and ``differentiate`` of the modalities, ``law_output`` and, if they exist, ``law_update`` and
        ``law_derivative``.
    descends : bool
        Whether the control descends the free energy; else it is set by the law.
    watches : bool
        Whether the model is checked.
    """
    descent = (_DESCENT_BY_GRADIENT if descends else _DESCENT_OF_THE_BELIEF).format_map(calls).strip("\n")
    records = {name: record for name, record in _RECORDS.items() if watches or name not in ("bank", "motion")}
    text = _STEP.format(
        records="\n".join(f"{name} = {written(record)}" for name, record in records.items()),
        measure=calls["measure"],
        measure_again=indent(calls["measure"], " " * 8).lstrip(),
        differentiate=indent(calls["differentiate"], " " * 4).lstrip(),
        descent=indent(descent, " " * 4).lstrip(),
        decide="" if descends else _DECISION_BY_LAW.format_map(calls).strip("\n"),
        law_update=calls.get("law_update", ""),
        watch=_WATCH.strip("\n") if watches else "",
    )
    return text.strip("\n").split("\n")
