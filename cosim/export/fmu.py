"""The model of a program for the FMI wrappers of this package: its C, what puts it behind them, and its description."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil
from typing import Literal

from bayesftc.cosim.base.units import BASE, parse
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.export.c_file import CFile
from bayesftc.cosim.export.dependencies import Elements, feeding, feeding_elements
from bayesftc.cosim.export.program import Program
from bayesftc.cosim.export.signals import Signal, Tunable
from bayesftc.cosim.ports import labels
from bayesftc.fmus.spec import Model, Unit, Variable

Timing = Literal["plant", "sampled"]

_SECONDS, _STEPS = 20, 100
"""How long an importer that is told nothing runs it, at least. It is a whole number of steps: part of one is refused."""

_BEHIND_FMI = """\
/* {name} behind the contract of model.h: inputs, outputs and parameters lie in x as in its structures, its memory behind. */
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


def model_of(program: Program, file: CFile, asked: Timing | None, description: str) -> Model:
    """Return the model of a program.

    Parameters
    ----------
    program : Program
        The program.
    file : CFile
        Its C.
    asked : {"plant", "sampled"} or None
        Whether the outputs after a step are those at its end, or those that were computed from the inputs at its beginning;
        None for what fits.
    description : str
        A sentence or two for the user of the FMU.

    Raises
    ------
    ModelError
        If the outputs cannot be those at the end of a step.
    """
    fed = feeding_elements(program)
    whole = feeding(program, fed)
    timing = _timing(program, whole, asked, once=file.changes_state)
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
            *_outputs(program, whole, fed),
            *(_variable(tunable, "parameter") for tunable in program.tunables),
        ),
        step=float(program.step),
        fixed_step=True,
        stop_time=float(program.step * max(ceil(_SECONDS / program.step), _STEPS)),
        hidden=file.memory + _size(program.tunables) + 2,  # time of the first step, and how many have been made
        timing=timing,
        libraries=("m",),
        blocks=program.blocks,
        finite=any(node.block.checks_finite for node in program.schedule.nodes),
    )


def _outputs(program: Program, whole: Mapping[str, frozenset[str]], fed: Elements) -> Iterator[Variable]:
    """Yield the outputs; what each depends on, in the order of the variables."""
    given: tuple[Signal | Tunable, ...] = (*program.inputs, *program.tunables)
    names = {signal.name: i for i, signal in enumerate(given)}
    elements = {name: i for i, name in enumerate(n for s in given for n in labels(s.name, s.shape))}
    for signal in program.outputs:
        initial = tuple(sorted(whole[signal.name], key=names.__getitem__))
        each = tuple(tuple(sorted(of, key=elements.__getitem__)) for of in fed[signal.name])
        yield _variable(signal, "output", initial, each)


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


def _timing(program: Program, fed: Mapping[str, frozenset[str]], asked: Timing | None, *, once: bool) -> Timing:
    """Return when the outputs hold; `once` says that they must be computed once a step."""
    inputs = {signal.name for signal in program.inputs}
    direct = next(((output, sorted(by & inputs)) for output, by in fed.items() if by & inputs), None)
    if direct is None and not once:
        return asked or "plant"
    if asked == "plant":
        why = "computing its outputs changes a state"
        if direct is not None:
            why = f"the input {direct[1][0]!r} acts on the output {direct[0]!r} directly"
        raise ModelError(f"{program.name} cannot be exported with timing='plant': {why}; leave it 'sampled'.")
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
    )


def _renamed(signal: Signal) -> str:
    """Return what a signal is called in its diagram, where the outside does not call it so, with or without its block's name."""
    return "" if signal.name in {signal.origin, signal.origin.partition(".")[2]} else signal.origin


def _unit(text: str | None) -> Unit | None:
    """Return a unit with its meaning; without one where nobody knows it."""
    if not text:
        return None
    meaning = parse(text)
    if meaning is None:
        return Unit(text, defined=False)
    kg, m, s, A, K, mol, cd, rad = (meaning.powers.get(base, 0) for base in BASE)
    return Unit(text, kg, m, s, A, K, mol, cd, rad, meaning.factor, meaning.offset)
