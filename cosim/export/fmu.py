"""The model of a program for this package's FMI wrappers: its C, the code that connects both, and its description."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from math import ceil
from typing import Literal

import numpy as np

from bayesftc.cosim.base.units import BASE, parse
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.diagram.roles import MATRICES, traits
from bayesftc.cosim.diagram.wiring import is_controller, samples_ahead
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.export.c_file import CFile
from bayesftc.cosim.export.dependencies import Elements, feeding, feeding_elements
from bayesftc.cosim.export.program import Program
from bayesftc.cosim.export.signals import Signal, Tunable
from bayesftc.cosim.ports import labels
from bayesftc.fmus.spec import Model, Unit, Variable

Timing = Literal["plant", "sampled"]

_SECONDS, _STEPS = 20, 100
"""Least seconds and steps of the default experiment. It is a whole number of steps, as parts of steps are refused."""

_BEHIND_FMI = """\
/* {name} with the interface of model.h: x contains inputs, outputs and parameters as in its structures, then its memory. */
#include <string.h>

#include "model.h"
#include "{name}.h"

#define PROGRAM ({name} *)(x + X_HIDDEN)
#define INPUTS (const {name}_inputs *)x
#define OUTPUTS ({name}_outputs *)(x + {inputs})

typedef char the_structures_are_those_of_x[sizeof({name}) == MODEL_HIDDEN * sizeof(double) ? 1 : -1];

static void tune(double *x)
{{
{tune}
}}

static void begin(double *x)
{{
    {name} *program = PROGRAM;

    {name}_init(program);
    program->start = x[X_TIME];
    tune(x);
}}

/* The outputs at the start time; the first step computes them once more, from the state at the beginning. */
void model_initialize(double *x)
{{
    begin(x);
    {name}_evaluate(PROGRAM, INPUTS, OUTPUTS);
    begin(x);
}}

int model_step(double *x, double h)
{{
    (void)h; /* always the fixed step */
    tune(x);
    {name}_evaluate(PROGRAM, INPUTS, OUTPUTS);
    {name}_advance(PROGRAM);{after}
    return 0;
}}
"""


def model_of(
    program: Program, file: CFile, requested: Timing | None, description: str, stop_time: float | None = None
) -> Model:
    """Return the model of a program.

    Parameters
    ----------
    program : Program
        The program.
    file : CFile
        Its C.
    requested : {"plant", "sampled"} or None
        Whether the outputs after a step are those at its end, or computed from the inputs at its beginning; None for the
        default.
    description : str
        A sentence or two for the user of the FMU.
    stop_time : float, optional
        End of the default experiment in seconds.

    Raises
    ------
    ModelError
        If ``"plant"`` is requested but not possible.
    """
    element_sources = feeding_elements(program)
    sources = feeding(program, element_sources)
    timing = _timing(program, sources, requested, once=file.changes_state)
    return Model(
        name=file.name,
        description=description,
        source={
            f"{file.name}.h": file.header,
            f"{file.name}.c": file.source,
            f"{file.name}_fmu.c": _behind_fmi(program, file, timing),
        },
        variables=(
            *(_variable(signal, "input") for signal in program.inputs),
            *_outputs(program, sources, element_sources),
            *(_variable(tunable, "parameter") for tunable in program.tunables),
        ),
        step=float(program.step),
        fixed_step=True,
        stop_time=_stop_time(program.step, stop_time),
        hidden=file.memory + _size(program.tunables) + 2,  # time of the first step, and number of steps
        timing=timing,
        libraries=("m",),
        blocks=program.blocks,
        traits=_traits(program),
        finite=bool(program.schedule.finite),
    )


def _outputs(program: Program, sources: Mapping[str, frozenset[str]], element_sources: Elements) -> Iterator[Variable]:
    """Yield the outputs, with their dependencies in the order of the variables."""
    signals: tuple[Signal | Tunable, ...] = (*program.inputs, *program.tunables)
    names = {signal.name: i for i, signal in enumerate(signals)}
    elements = {name: i for i, name in enumerate(n for s in signals for n in labels(s.name, s.shape))}
    for signal in program.outputs:
        initial = tuple(sorted(sources[signal.name], key=names.__getitem__))
        each = tuple(tuple(sorted(of, key=elements.__getitem__)) for of in element_sources[signal.name])
        yield _variable(signal, "output", initial, each)


def _traits(program: Program) -> str:
    """Return what a controller that is exported alone says about itself, as JSON; for all else nothing."""
    nodes = [node for node in program.schedule.nodes if node.name != OUTSIDE]
    alone = len(nodes) == 1 and is_controller(nodes[0])
    known = traits(nodes[0].block) | {"preview": samples_ahead(nodes[0].block)} if alone else {}
    for name in MATRICES:
        if name in known:
            known[name] = [[None if np.isnan(x) else x for x in row] for row in known[name].tolist()]
    return json.dumps({name: value for name, value in known.items() if value})


def _stop_time(step: Fraction, requested: float | None) -> float:
    """Return the end of the default experiment, a whole number of steps, because importers cut the last step of another one."""
    if requested is None:
        return float(step * max(ceil(_SECONDS / step), _STEPS))
    return float(step * max(ceil(Fraction(str(requested)) / step), 1))


def _behind_fmi(program: Program, file: CFile, timing: Timing) -> str:
    """Return the C between the program and the wrappers."""
    inputs = _size(program.inputs)
    tune = "    (void)x;"
    if program.tunables:
        tune = f"    {file.name} *program = PROGRAM;\n\n"
        tune += f"    memcpy(&program->parameters, x + {inputs + _size(program.outputs)}, sizeof program->parameters);"
    after = f"\n    {file.name}_evaluate(PROGRAM, INPUTS, OUTPUTS);" if timing == "plant" else ""
    return _BEHIND_FMI.format(name=file.name, inputs=inputs, tune=tune, after=after)


def _size(group: Sequence[Signal | Tunable]) -> int:
    return sum(len(each.start) for each in group)


def late_outputs(program: Program) -> str:
    """Return a sentence if only some outputs of a system have direct feedthrough: all then get the timing of a controller."""
    inner = [node for node in program.schedule.nodes if node.name != OUTSIDE]
    if len(inner) != 1 or not isinstance(inner[0].block, StateSpace):
        return ""
    inputs = {signal.name for signal in program.inputs}
    acting = {output: sorted(names & inputs) for output, names in feeding(program, feeding_elements(program)).items()}
    direct, other = ([name for name, of in acting.items() if bool(of) == wanted] for wanted in (True, False))
    if not direct or not other:
        return ""
    return (
        f"The input {acting[direct[0]][0]} acts on the output {direct[0]} directly, so all outputs belong to the beginning of a "
        f"step (timing 'sampled'): in another tool, {', '.join(other)} {'is' if len(other) == 1 else 'are'} a step late. For a "
        f"plant, leave out such outputs: outputs={other!r}."
    )


def _timing(program: Program, sources: Mapping[str, frozenset[str]], requested: Timing | None, *, once: bool) -> Timing:
    """Return the timing of the outputs; with `once`, they must be computed exactly once a step."""
    inputs = {signal.name for signal in program.inputs}
    direct = next(((output, sorted(names & inputs)) for output, names in sources.items() if names & inputs), None)
    if direct is None and not once:
        return requested or "plant"
    if requested == "plant":
        reason = "computing its outputs changes a state"
        if direct is not None:
            reason = f"the input {direct[1][0]!r} acts on the output {direct[0]!r} directly"
        raise ModelError(f"{program.name} cannot be exported with timing='plant': {reason}. Give timing='sampled'.")
    return "sampled"


def _variable(
    signal: Signal | Tunable,
    causality: Literal["input", "output", "parameter"],
    initial: tuple[str, ...] = (),
    elements: tuple[tuple[str, ...], ...] = (),
) -> Variable:
    return Variable(
        signal.name,
        causality,
        signal.description,
        _unit(signal.unit),
        start=signal.start,
        variability="tunable" if causality == "parameter" else "",
        initial_dependencies=initial,
        element_dependencies=elements,
        shape=signal.shape,
        origin=_renamed(signal) if isinstance(signal, Signal) else "",
        element_descriptions=signal.element_descriptions if isinstance(signal, Signal) else (),
        element_units=tuple(map(_unit, signal.element_units)) if isinstance(signal, Signal) else (),
    )


def _renamed(signal: Signal) -> str:
    """Return the name of a signal in its diagram, if the export has renamed it; the block's name may be left out."""
    return "" if signal.name in {signal.origin, signal.origin.partition(".")[2]} else signal.origin


def _unit(text: str | None) -> Unit | None:
    """Return a unit with its definition, if it is known."""
    if not text:
        return None
    meaning = parse(text)
    if meaning is None:
        return Unit(text, defined=False)
    kg, m, s, A, K, mol, cd, rad = (meaning.powers.get(base, 0) for base in BASE)
    return Unit(text, kg, m, s, A, K, mol, cd, rad, meaning.factor, meaning.offset)
