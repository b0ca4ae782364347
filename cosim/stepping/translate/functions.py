"""The C functions of step functions: one for each combination of argument kinds."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from inspect import getdoc
from itertools import accumulate
from types import FunctionType
from typing import Any

from bayesftc.cosim.stepping.fingerprint import functions_called
from bayesftc.cosim.stepping.foreign import Foreign
from bayesftc.cosim.stepping.source.flat import without_records
from bayesftc.cosim.stepping.source.tree import Sections, parameters
from bayesftc.cosim.stepping.translate.kinds import FLOAT, NATURAL, Array, Constant, Kind, Number, Record
from bayesftc.cosim.stepping.translate.translator import Translator
from bayesftc.cosim.stepping.translate.values import literal

_ASSIGNMENT = re.compile(r"( *)(?:const \w+ \*?(?:const )?|double \*const )?(\w+) = (.*)")

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)

WIDTH = 120
"""Longest line of C."""

_RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
    "_Bool _Complex _Imaginary acos asin atan atan2 ceil cos cosh exp fabs floor fmod frexp ldexp log log10 modf pow "
    "sin sinh sqrt tan tanh acosh asinh atanh cbrt copysign erf erfc exp2 expm1 fdim fma fmax fmin hypot ilogb lgamma "
    "llrint llround log1p log2 logb lrint lround nan nearbyint nextafter nexttoward remainder remquo rint round "
    "scalbln scalbn tgamma trunc j0 j1 jn y0 y1 yn gamma signgam NAN INFINITY HUGE_VAL main isnan isinf isfinite "
    "signbit fpclassify isnormal isgreater isgreaterequal isless islessequal islessgreater isunordered HUGE_VALF HUGE_VALL "
    "HUGE MAXFLOAT DOMAIN SING OVERFLOW UNDERFLOW PLOSS TLOSS float_t double_t asm typeof linux unix arm int8_t int16_t "
    "int32_t int64_t uint8_t uint16_t uint32_t uint64_t intptr_t uintptr_t intmax_t uintmax_t size_t NULL errno memset "
    "alignas alignof and and_eq bitand bitor bool catch char8_t char16_t char32_t class compl concept constexpr "
    "const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export false friend mutable namespace "
    "sincos memcpy memmove exp10 abs offsetof _Alignas _Alignof _Atomic _Generic _Noreturn _Pragma _Static_assert "
    "_Thread_local __builtin_va_arg __int128 "
    "new noexcept not not_eq nullptr operator or or_eq private protected public reinterpret_cast requires static_assert "
    "static_cast template this thread_local throw true try typeid typename using virtual wchar_t xor xor_eq "
)
"""Reserved words of C, its mathematics library and C++."""

_TAKEN = frozenset(_RESERVED.split())
_TAKEN_BEGINNINGS = (
    "op_",
    "Record_",
    "M_",
    "FP_",
    "MATH_",
    "INT",
    "UINT",
    "PTRDIFF",
    "SIZE_",
    "WCHAR_",
    "WINT_",
    "SIG_",
)

OPERATIONS = {
    "op_select": "static double op_select(int condition, double a, double b)\n"
    "{\n    return (condition ? a : 0.0) + (condition ? 0.0 : b);\n}",
    "op_exponent": "static double op_exponent(double x)\n"
    "{\n    union { double number; uint64_t bits; } it;\n\n    it.number = x;\n"
    "    it.bits = ((it.bits + 2638147582215219) >> 52) | 4841369599423283200;\n    return it.number - 4503599627371519.0;\n}",
    "op_power_of_two": "static double op_power_of_two(double k)\n"
    "{\n    union { double number; uint64_t bits; } it;\n\n    it.number = k + 6755399441056767.0;\n"
    "    it.bits <<= 52;\n    return it.number;\n}",
    "op_significand": "static double op_significand(double x)\n"
    "{\n    union { double number; uint64_t bits; } it;\n\n    it.number = x;\n"
    "    it.bits = ((it.bits + 2638147582215219) & 4503599627370495) + 4604544271217802189;\n    return it.number;\n}",
    "op_isnan": "static int op_isnan(double x)\n{\n    return x != x;\n}",
    "op_index": "static int64_t op_index(int64_t i, int64_t length)\n{\n    return i < 0 ? i + length : i;\n}",
    "op_quotient": "static int64_t op_quotient(int64_t a, int64_t b)\n"
    "{\n    if (b == 0) {\n        return 0;\n    }\n    return a / b - (a % b != 0 && (a < 0) != (b < 0));\n}",
    "op_remainder": "static int64_t op_remainder(int64_t a, int64_t b)\n"
    "{\n    if (b == 0) {\n        return 0;\n    }\n    return a % b != 0 && (a < 0) != (b < 0) ? a % b + b : a % b;\n}",
}
"""C functions for operations of `bayesftc.cosim.ops` and of Python that C has no operator for."""


@dataclass(frozen=True)
class Written:
    """A C function.

    Parameters
    ----------
    name : str
        Its name in C.
    arguments : tuple of str
        The names of the Python function's arguments.
    passed, stored : frozenset of str
        Those that the C function has, too, and the arrays among them that it writes.
    returns : Kind or None
        The kind of its result.
    """

    name: str
    arguments: tuple[str, ...]
    passed: frozenset[str]
    stored: frozenset[str]
    returns: Kind | None


class Functions:
    """All functions of one C file.

    Parameters
    ----------
    taken : iterable of str
        Names that the file already uses.
    """

    def __init__(self, taken: Iterable[str] = ()):
        self._written: dict[tuple[FunctionType, tuple[Kind, ...]], Written] = {}
        self._tables: dict[Constant, tuple[str, str]] = {}
        self._names = set(taken)
        self._named: dict[tuple[str, ...], str] = {}
        self._texts: dict[str, str] = {}
        self._foreign: dict[str, str] = {}

    def step(self, kernel: FunctionType, sections: Sections) -> Written:
        """Return the C function for a step function with arguments in these sections.

        Raises
        ------
        KernelError
            If it breaks a rule of step functions, or cannot be translated to C.
        """
        functions_called(kernel)
        kinds = [FLOAT if n == "t" else NATURAL if n == "k" else Array(sections[n][2]) for n in parameters(kernel)]
        return self.require(without_records(kernel), kinds)

    def require(self, function: FunctionType, kinds: Sequence[Kind]) -> Written:
        """Return the C function for arguments of these kinds; it comes before its caller in the file."""
        key = function, tuple(kinds)
        if key not in self._written:
            translator = Translator(self, function, kinds)
            translator.translate()
            self._written[key] = self._finished(translator)
        return self._written[key]

    def name(self, name: str) -> str:
        """Reserve and return an unused name in the file, like this one."""
        plain = self.allowed(name.lstrip("_") or name)  # C reserves names with leading underscores
        unused, count = plain, 1
        while unused in self._names:
            count += 1
            unused = f"{plain}_{count}"
        self._names.add(unused)
        return unused

    @staticmethod
    def allowed(name: str) -> str:
        """Return a name that C allows."""
        plain = "".join(c if c.isascii() and (c.isalnum() or c == "_") else f"u{ord(c):x}" for c in name)
        return f"{plain}_" if plain in _TAKEN or plain.startswith(_TAKEN_BEGINNINGS) else plain

    def table(self, values: tuple[Any, ...], kind: Number) -> str:
        """Return the name of the file's table of these numbers."""
        key = Constant(values)
        if key not in self._tables:
            name = self.name("table")
            self._tables[key] = name, table_text(name, values, kind.c)
        return self._tables[key][0]

    def foreign(self, function: Foreign) -> None:
        """Declare a function of other compiled code."""
        arguments = (f"{'' if name in function.stored else 'const '}double *{name}" for name in function.arguments)
        self._foreign[function.symbol] = f"void {function.symbol}({', '.join(arguments)});"

    def text(self, lines: Iterable[str]) -> str:
        """Return the functions that some lines call, callees first, after the types, tables and operations that they need."""
        called, texts = words("\n".join(lines)), []
        for name, text in reversed(self._texts.items()):
            if name in called:  # leaves out functions for preliminary kinds of variables
                called |= words(_COMMENT.sub("", text))
                texts.append(text)
        body = "\n\n".join(reversed(texts))
        needed = [name for name in OPERATIONS if f"{name}(" in body]
        records = {w.returns.c: w.returns for w in self._written.values() if isinstance(w.returns, Record)}
        parts = [
            f"typedef struct {{ {' '.join(f'{item.c} v{i};' for i, item in enumerate(record.items))} }} {name};"
            for name, record in sorted(records.items())
            if name in called
        ]
        parts += [text for name, text in self._tables.values() if name in called]
        parts += [text for name, text in self._foreign.items() if name in called]
        return "\n\n".join([*parts, *(OPERATIONS[name] for name in needed), body])

    def _finished(self, t: Translator) -> Written:
        t.lines = _without_unread(t.lines, {t.local(v) for v in t.declared}, t.called)
        read = words("\n".join(t.lines))
        passed = [a for a, kind in t.arguments.items() if not isinstance(kind, Constant) and t.local(a) in read]
        arguments = [
            ("const " if isinstance(t.arguments[a], Array) and a not in t.stored else "")
            + declared(t.arguments[a], t.local(a))
            for a in passed
        ]
        lines = _variables(t, read)
        result = t.returns.c if isinstance(t.returns, Number | Record) else "void"
        summary = _summary(t.function)
        head, arguments_text = f"static {result} ", f"({', '.join(arguments) or 'void'})"
        body = [*lines, *([""] if lines else []), *t.lines]
        base_name = t.function.__name__.strip("<>")
        key = base_name, result, arguments_text, "\n".join(body)
        if key not in self._named:  # other shapes often give the same text
            name = self._named[key] = self.name(base_name)
            text = [f"/* {summary} */"] if summary else []
            text += [f"{head}{name}{arguments_text}", "{", *body, "}"]
            self._texts[name] = "\n".join(piece for line in text for piece in wrapped(line))
        return Written(self._named[key], tuple(t.arguments), frozenset(passed), frozenset(t.stored), t.returns)


def _without_unread(lines: Sequence[str], variables: Collection[str], functions: Collection[str]) -> list[str]:
    """Remove assignments to variables that are never read; keep calls that may have other effects."""
    result, before = list(lines), None
    while result != before:
        before, result = result, []
        assigned = [_ASSIGNMENT.match(line) for line in before]
        read = {
            word for line, match in zip(before, assigned, strict=True) for word in words(match[3] if match else line)
        }
        for line, match in zip(before, assigned, strict=True):
            if match is None or match[2] in read or not (match[2] in variables or match[2].startswith("t_")):
                result.append(line)
            elif match[3].partition("(")[0] in functions and _is_one_call(match[3].removesuffix(";")):
                result.append(f"{match[1]}{match[3]}")
    return result


def _is_one_call(text: str) -> bool:
    """Return whether some C that begins with a call is nothing but this call: an expression around it has no effects."""
    depths = list(accumulate((c == "(") - (c == ")") for c in text))
    return text.endswith(")") and 0 not in depths[text.index("(") : -1]


def _variables(t: Translator, read: Collection[str]) -> list[str]:
    """Return the declarations of variables that are read, and used in more than one block."""
    names_by_type: dict[str, list[str]] = {}
    for variable, kind in t.declared.items():
        if variable not in t.arguments and variable not in t.fresh and t.local(variable) in read:
            c_type, name = str(kind.c), t.local(variable)  # type: ignore[union-attr]
            if isinstance(kind, Array):
                c_type, name = ("double" if t.roots[variable] <= t.stored else "const double"), f"*{name}"
            begin = "{ 0 }" if isinstance(kind, Record) else "0.0" if kind == FLOAT else "0"
            names_by_type.setdefault(c_type, []).append(f"{name} = {begin}")
    return [f"    {c_type} {', '.join(names)};" for c_type, names in names_by_type.items()]


def _summary(function: FunctionType) -> str:
    """Return the first line of a docstring, for a comment in C."""
    first = (getdoc(function) or "").strip().split("\n")[0]
    return first.replace("``", "").replace("*/", "* /").replace("/*", "/ *")


def declared(kind: Kind, name: str) -> str:
    """Return the declaration of a variable or an argument."""
    assert isinstance(kind, Number | Array | Record)
    return f"double *{name}" if isinstance(kind, Array) else f"{kind.c} {name}"


def table_text(name: str, values: Sequence[Any], c_type: str = "double") -> str:
    """Return a table of numbers."""
    text = f"static const {c_type} {name}[{len(values)}] = {{ {', '.join(literal(value) for value in values)} }};"
    return "\n".join(wrapped(text))


def words(text: str) -> set[str]:
    """Return all names in some C."""
    return set(re.findall(r"[A-Za-z_]\w*", text))


def wrapped(line: str) -> list[str]:
    """Break a long line of C into pieces, after commas if it has any."""
    if len(line) <= WIDTH:
        return [line]
    margin = len(line) - len(line.lstrip())
    text = line[margin:].replace(" ", "\0").replace(",\0", ", ") if ", " in line else line[margin:]
    pieces = textwrap.wrap(text, max(WIDTH - margin - 4, 40), break_long_words=False, break_on_hyphens=False)
    return [" " * (margin + 4 * (i > 0)) + piece.replace("\0", " ") for i, piece in enumerate(pieces)]
