"""The C of a program: a file and its header, which need only the mathematics of the C library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import prod
from textwrap import wrap
from types import FunctionType

from bayesftc.cosim.diagram.opening import OUTSIDE
from bayesftc.cosim.diagram.schedule import Call
from bayesftc.cosim.export.layout import Layout, member
from bayesftc.cosim.export.program import Program
from bayesftc.cosim.export.signals import Signal, Tunable
from bayesftc.cosim.stepping.translate.functions import Functions, Written, words, wrapped
from bayesftc.cosim.stepping.translate.values import literal

_PARTS = ("inputs", "outputs", "parameters", "init", "step", "evaluate", "advance")
_COMMENT = 110
"""Most characters of a line of a comment."""
_VARIABLES = ("c", "u", "y", "m", "k", "t", "i", "j", "initial")
_FILL = (
    "for (size_t i = 0; i < sizeof initial / sizeof *initial; ++i) {",
    "    for (int j = 0; j < initial[i].count; ++j) {",
    "        c->memory[initial[i].begin + j] = initial[i].value;",
    "    }",
    "}",
)
CAREFUL = """\
#if defined __FAST_MATH__ || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__) || defined __ASSOCIATIVE_MATH__ \\
    || defined __RECIPROCAL_MATH__ || defined _M_FP_FAST
#error "Compile without -ffast-math or parts of it: a NaN is a missing sample, and the order of sums must stay."
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
/* Every product and sum is rounded separately; and gcc 12 replaces 0.0 - n by -n where n cannot be a negative zero. */
#pragma GCC optimize("fp-contract=off", "rounding-math")
#endif"""
"""Lines at the beginning of a C file, by which compilers compute what the text says."""

_FAST = """\
#if defined __GNUC__ && !defined __clang__ && !defined __OPTIMIZE_SIZE__
#pragma GCC optimize("peel-loops") /* short loops are unrolled: a fifth faster, and a fifth longer */
#endif"""
_HOW = """\
/* {name}: a step every {step} s.
 *
 *     static {name} c;
 *     {name}_inputs u;
 *     {name}_outputs y;
 *
 *     {name}_init(&c);
 *     every {step} s: fill u, then {name}_step(&c, &u, &y), then use y
 *
 * A step computes the outputs at this time from the inputs at this time, and then the next state. If the outputs are needed
 * before the state changes, call {name}_evaluate and then {name}_advance, which are the two halves of a step.
 * All memory is in the structure: nothing is allocated, there are no global variables, and several instances can run at once.
 * A NaN among the inputs is a missing sample, if nothing else is said of it below. Arrays are stored row by row.
 * For the same bits as the original, the compiler must not fuse products and sums (-ffp-contract=off; the file sets this for
 * gcc and clang) nor reorder them (never -ffast-math), and must compute doubles in double precision.
 */"""


@dataclass(frozen=True)
class CFile:
    """The C of a program.

    Parameters
    ----------
    name : str
        Prefix of types and functions, and name of both files.
    header, source : str
        Their texts.
    memory, constants : int
        Numbers of doubles in memory (including scratch) and in constant tables.
    changes_state : bool
        Whether computing outputs changes the state of a block; then they must be computed exactly once a step.
    """

    name: str
    header: str
    source: str
    memory: int
    constants: int
    changes_state: bool


def write_c(program: Program) -> CFile:
    """Return the C of a program."""
    name = Functions.allowed(program.name)
    functions = Functions([name, *(f"{name}_{part}" for part in _PARTS), *_VARIABLES])
    layout = Layout(program, functions)
    runs = layout.runs()
    evaluate = [
        *layout.tuned(),
        *_phase(program, layout, functions, program.schedule.evaluate),
        *_shown(program, layout),
    ]
    if "u" not in words("\n".join(evaluate)):
        evaluate.append("(void)u;")
    advance = [*_phase(program, layout, functions, program.schedule.advance), "c->step += 1.0;"]
    read = words("\n".join([*evaluate, *advance]))
    tables = [table for name, table in layout.tables.items() if name in read]
    parts = [*(text for text, _ in tables), *_initial(runs), functions.text([*evaluate, *advance])]
    size = len(layout.initial)
    return CFile(
        name,
        _header(program, name, size),
        _source(program, name, parts, _beginning(program, runs), evaluate, advance),
        size,
        2 * len(runs) + sum(count for _, count in tables),
        _changes_state(program, functions),
    )


def _shown(program: Program, layout: Layout) -> list[str]:
    """Return the lines that write the outputs for the caller."""
    return [f"y->{member(s)}[{e}] = {layout.element(at)};" for s in program.outputs for e, at in enumerate(s.places)]


def _beginning(program: Program, runs: Sequence[tuple[int, int, float]]) -> list[str]:
    """Return the lines that set the initial state and parameters."""
    return [
        "for (size_t i = 0; i < sizeof c->memory / sizeof *c->memory; ++i) {",
        "    c->memory[i] = 0.0;",
        "}",
        *(_FILL if runs else ()),
        *(f"c->parameters.{member(t)}[{e}] = {literal(v)};" for t in program.tunables for e, v in enumerate(t.start)),
        "c->start = 0.0;",
        "c->step = 0.0;",
    ]


def _changes_state(program: Program, functions: Functions) -> bool:
    """Return whether computing outputs changes the state of a block."""
    for call in program.schedule.evaluate:
        written, definition = _written(program, functions, call), program.schedule.definitions[call.node]
        if written is not None and definition is not None and written.stored & set(definition.state):
            return True
    return False


def _source(
    program: Program,
    name: str,
    parts: Sequence[str],
    init: Sequence[str],
    evaluate: Sequence[str],
    advance: Sequence[str],
) -> str:
    """Return the C file: tables and functions, and then the functions of the header, from their lines."""
    step = program.step
    variables = {
        "m": "double *const m = c->memory;",
        "k": "const int64_t k = (int64_t)c->step;",
        # The quotient of two whole numbers: the double nearest to the time, as in the engines.
        "t": f"const double t = c->start + c->step * {step.numerator}.0 / {step.denominator}.0;",
    }
    body = "\n\n".join(parts)
    signature = f"({name} *c, const {name}_inputs *u, {name}_outputs *y)"
    lines = [
        f"/* {name}: see {name}.h for its use. */",
        "#if defined _MSC_VER && !defined _UCRT_NOISY_NAN",
        "#define _UCRT_NOISY_NAN /* else NAN is no constant in the Windows SDK 10.0.26100 */",
        "#endif",
        "#include <math.h>",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "",
        f'#include "{name}.h"',
        "",
        CAREFUL,
        _FAST,
        "",
        body,
        "",
        *_function(f"void {name}_init({name} *c)", {}, init),
        *_function(f"void {name}_evaluate{signature}", variables, evaluate),
        *_function(f"void {name}_advance({name} *c)", variables, advance),
        *_function(f"void {name}_step{signature}", {}, [f"{name}_evaluate(c, u, y);", f"{name}_advance(c);"]),
    ]
    return "\n".join(lines)


def _initial(runs: Sequence[tuple[int, int, float]]) -> list[str]:
    """Return the table of initial values that are not zero."""
    if not runs:
        return []
    rows = ", ".join(f"{{ {begin}, {count}, {literal(value)} }}" for begin, count, value in runs)
    text = "static const struct { int begin, count; double value; } initial[] = " + f"{{ {rows} }};"
    return ["\n".join(wrapped(text))]


def _written(program: Program, functions: Functions, call: Call) -> Written | None:
    """Return the C of a call's step function; None if the call only copies inputs."""
    kernel = program.schedule.kernel(call)
    if kernel is None:
        return None
    assert isinstance(kernel, FunctionType)
    return functions.step(kernel, program.schedule.slots[call.node].sections)


def _phase(program: Program, layout: Layout, functions: Functions, calls: Iterable[Call]) -> list[str]:
    """Return the lines of calls; before each, its inputs are copied."""
    lines: list[str] = []
    for call in calls:
        if program.schedule.nodes[call.node].name == OUTSIDE:
            continue
        call_lines = [f"{layout.element(to)} = {layout.element(origin)};" for to, origin in call.gathers]
        written, every = _written(program, functions, call), program.schedule.every(call)
        if written is not None:
            time_arguments = {"t": "t", "k": "k" if every == 1 else f"k / {every}"}
            arguments = [
                time_arguments.get(n) or layout.pointer(call.node, n) for n in written.arguments if n in written.passed
            ]
            call_lines.append(f"{written.name}({', '.join(arguments)});")
        lines += (
            call_lines if every == 1 else [f"if (k % {every} == 0) {{", *(f"    {line}" for line in call_lines), "}"]
        )
    return lines


def _function(head: str, variables: dict[str, str], lines: Sequence[str]) -> list[str]:
    """Return a function that begins with the definitions of the variables that it uses."""
    definitions = [line for name, line in variables.items() if name in words("\n".join(lines))]
    body = [*definitions, *([""] if definitions else []), *lines]
    return [head, "{", *(piece for line in body for piece in wrapped(f"    {line}" if line else "")), "}", ""]


def _header(program: Program, name: str, memory: int) -> str:
    guard = f"{name.upper()}_H"
    lines = [
        _HOW.format(name=name, step=program.step),
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *_sizes(program, name, memory),
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *_structure(f"{name}_inputs", program.inputs),
        *_structure(f"{name}_outputs", program.outputs),
        *(_structure(f"{name}_parameters", program.tunables) if program.tunables else []),
        "typedef struct {",
        f"    double memory[{name.upper()}_MEMORY];",
        *([f"    {name}_parameters parameters; /* may be changed between steps */"] if program.tunables else []),
        "    double start; /* time of the first step in seconds */",
        "    double step;  /* number of steps so far */",
        f"}} {name};",
        "",
        f"void {name}_init({name} *c);",
        f"void {name}_step({name} *c, const {name}_inputs *u, {name}_outputs *y);",
        f"void {name}_evaluate({name} *c, const {name}_inputs *u, {name}_outputs *y);",
        f"void {name}_advance({name} *c);",
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _sizes(program: Program, name: str, memory: int) -> list[str]:
    """Return the sizes of arrays, and the step, as constants."""
    groups = (("IN", program.inputs), ("OUT", program.outputs), ("PARAMETER", program.tunables))
    sizes = [(f"{what}_{member(s)}", len(s.start)) for what, group in groups for s in group]
    if len({title.upper() for title, _ in sizes}) == len(sizes):  # y and Y may be different signals
        sizes = [(title.upper(), size) for title, size in sizes]
    step = program.step
    return [
        f"#define {name.upper()}_SECONDS ({step.numerator}.0 / {step.denominator}.0) /* step size */",
        "",
        "enum {",
        *(f"    {name.upper()}_{title} = {size}," for title, size in sizes),
        f"    {name.upper()}_MEMORY = {memory}",
        "};",
        "",
    ]


def _structure(title: str, members: Sequence[Signal | Tunable]) -> list[str]:
    lines = []
    for each in members:
        lines += [*_description(each), f"    double {member(each)}[{max(int(prod(each.shape)), 1)}];{_remark(each)}"]
    return ["typedef struct {", *(lines or ["    double none; /* C has no empty structures */"]), f"}} {title};", ""]


def _description(signal: Signal | Tunable) -> list[str]:
    """Return the comment above a member: what an FMU says of the variable. A user's own text must not end the comment."""
    text = " ".join(signal.description.split()).replace("*/", "* /").replace("/*", "/ *")
    lines = wrap(text, _COMMENT, break_long_words=False, break_on_hyphens=False)
    return [f"    {'   ' if i else '/* '}{line}{' */' * (i == len(lines) - 1)}" for i, line in enumerate(lines)]


def _remark(signal: Signal | Tunable) -> str:
    parts = [f"{signal.shape[0]} row{'s' * (signal.shape[0] != 1)}"] if len(signal.shape) > 1 else []
    of_elements = [unit or "-" for unit in getattr(signal, "element_units", ())]
    parts += [signal.unit] if signal.unit else [", ".join(of_elements)] if of_elements else []
    return f" /* {', '.join(parts)} */" if parts else ""
