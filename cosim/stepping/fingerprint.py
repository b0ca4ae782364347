"""A hash of everything that a step function's compiled form depends on, and the check of the block contract.

The hash is computed from code objects, not from text. It includes every called function, in any file (or in none: a notebook, the
REPL), and the constants in globals and closures. It ignores comments and line numbers.
"""

from __future__ import annotations

import ast
import builtins
import dis
import hashlib
import linecache
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import cache, lru_cache
from numbers import Number
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

from bayesftc.cosim import ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.foreign import Foreign
from bayesftc.cosim.stepping.instead import instead_of, line_of
from bayesftc.cosim.stepping.records import as_written, is_record_class

_OPERATIONS = frozenset(getattr(ops, name) for name in (*ops.NAMES, *ops.BITS))
_BUILTINS = frozenset({range, len})
_ATTRIBUTES = frozenset({"shape", "size", "ndim"}) | frozenset(ops.NAMES)
_FORBIDDEN = {
    "IMPORT_NAME": "contains an import; import from bayesftc.cosim.ops at the top of the file",
    "STORE_GLOBAL": "writes a global variable; declare a state instead",
    **dict.fromkeys(
        ("BUILD_LIST", "BUILD_SET", "BUILD_MAP", "LIST_APPEND", "SET_ADD", "MAP_ADD"),
        "creates a list, set or dictionary, but must not allocate memory; declare a state, or a constant outside the function",
    ),
    "STORE_DEREF": "writes a variable of the enclosing function; declare a state instead",
}


@cache
def environment() -> str:
    """Return what numba's code depends on besides the function: versions, the processor, this package's compiling modules."""
    import platform

    import llvmlite
    import llvmlite.binding as llvm
    import numba

    from bayesftc.cosim.stepping import by_address, numba_ops as _numba_ops

    features = ",".join(sorted(name for name, present in llvm.get_host_cpu_features().items() if present))
    # From the loaded code, as the files may have been edited since.
    options = _numba_ops.OPTIONS
    sources = [composed(), str(options), _code_text(by_address.as_floats._defn.__code__)]
    sources += [_code_text(f.__code__) for _, f in sorted(vars(_numba_ops).items()) if isinstance(f, FunctionType)]
    for pipeline in (options["pipeline_class"],) if "pipeline_class" in options else ():
        classes = [c for _, c in sorted(vars(sys.modules[pipeline.__module__]).items()) if isinstance(c, type)]
        methods = [f for c in classes if c.__module__ == pipeline.__module__ for _, f in sorted(vars(c).items())]
        sources += [_code_text(f.__code__) for f in methods if isinstance(f, FunctionType)]
    parts = [platform.python_version(), numba.__version__, llvmlite.__version__, llvm.get_host_cpu_name(), features]
    return "|".join(parts + sources)


@cache
def composed() -> str:
    """Return hashes of the functions behind operations, which the fingerprints of their callers leave out."""
    return str([fingerprint(function, "") for function in ops.COMPOSED.values() if function not in _OPERATIONS])


def functions_called(function: FunctionType) -> list[FunctionType]:
    """Return `function` and every plain function that it calls, callees first; check that each keeps the contract."""
    ordered: list[FunctionType] = []
    _visit(function, ordered, [], _fields(function, set()))
    return ordered


def _visit(
    function: FunctionType, ordered: list[FunctionType], path: list[FunctionType], fields: Collection[str]
) -> None:
    if function in path:
        names = " -> ".join(f.__name__ for f in [*path, function])
        at = where(path[-1], line_of(path[-1], function.__name__))
        raise KernelError(
            f"The step function calls itself ({names}) in {at}. A recursion cannot be compiled; write a loop."
        )
    if function in ordered:
        return
    for name, value in references(function):
        if isinstance(value, FunctionType) and value not in _OPERATIONS:
            _visit(value, ordered, [*path, function], fields)
        elif not _allowed(value):
            at = where(function, line_of(function, name))
            raise KernelError(
                f"Step function {at} uses {name!r} ({_describe(value)}). A step function may use only numbers, "
                "range, len, other step functions, classes of records, and the mathematics of bayesftc.cosim.ops "
                f"({', '.join(ops.NAMES)})."
                f"{instead_of(function, name, value)}"
            )
    if not hasattr(function, "tree"):  # a function with a tree was generated from one that was checked
        _check_code(function, function.__code__, fields)
    ordered.append(function)


def references(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each global and closure variable that `function` reads."""
    for name in _globals_read(function.__code__):
        if name in function.__globals__:
            yield name, function.__globals__[name]
        elif hasattr(builtins, name):
            yield name, getattr(builtins, name)
        else:
            at = where(function, line_of(function, name))
            raise KernelError(f"Step function {at} uses {name!r}, which is not defined; define it.")
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:  # the variable of the enclosing function has no value yet
            raise KernelError(
                f"Step function {where(function)} uses {name!r}, which has no value yet; assign it before."
            ) from None


@lru_cache(maxsize=4096)  # called a dozen times for each function until it is compiled
def _globals_read(code: CodeType) -> tuple[str, ...]:
    return tuple(dict.fromkeys(str(i.argval) for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"))


def foreign_functions(function: FunctionType) -> list[Foreign]:
    """Return the functions of other compiled code that `function` and the step functions that it calls may call."""
    values = [value for called in functions_called(function) for _, value in references(called)]
    return list(dict.fromkeys(value for value in values if isinstance(value, Foreign)))


def depends_on(function: FunctionType) -> list[Any]:
    """Return all objects on which a step function's code depends.

    While these are the same objects, the fingerprint (which takes longer to compute) and all results from the code stay valid.
    """
    objects: list[Any] = []
    functions = [function]
    for reached in functions:  # the list grows by what it calls
        values = [reached.__globals__.get(name) for name in reached.__code__.co_names]
        values += reached.__closure__ or ()
        values += [cell.cell_contents for cell in reached.__closure__ or () if _filled(cell)]
        objects += [reached.__code__, reached.__defaults__, reached.__kwdefaults__, *values]
        functions += [value for value in values if isinstance(value, FunctionType) and value not in functions]
    return objects


def _filled(cell: CellType) -> bool:
    try:
        cell.cell_contents  # noqa: B018 - an empty cell raises
    except ValueError:
        return False
    return True


def _allowed(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(_allowed(item) for item in value)
    if is_record_class(value) or isinstance(value, Foreign):
        return True
    return value is ops or isinstance(value, Number) or (callable(value) and value in _OPERATIONS | _BUILTINS)


def _check_code(function: FunctionType, code: CodeType, fields: Collection[str]) -> None:
    if any(isinstance(constant, CodeType) for constant in code.co_consts):
        raise KernelError(
            f"Step function {where(function)} contains a function or comprehension. Move the function outside, and write a loop "
            "instead of the comprehension."
        )
    if not all(
        _allowed(value) for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values())
    ):
        raise KernelError(
            f"Function {where(function)} has a default that is no number, so a step function cannot call it; use a number."
        )

    for line, attribute, called, error in _doubtful(code):
        at = where(function, line)
        if error:
            raise KernelError(f"Step function {at} {error}")
        if attribute not in ops.NAMES and (called or (attribute not in _ATTRIBUTES and attribute not in fields)):
            raise KernelError(
                f"Step function {at} uses the attribute {attribute!r}. A step function may use only shape, "
                "size, ndim and indexing of arrays, and fields of records."
            )


@lru_cache(maxsize=4096)  # the functions of a learner are checked for each diagram that contains one
def _doubtful(code: CodeType) -> tuple[tuple[int | None, str, bool, str], ...]:
    """Return what in a function's code may break the contract: its line, an attribute, whether it is called, or an error."""
    found = []
    for instruction in dis.get_instructions(code):
        error, attribute = "", ""
        if instruction.opname in _FORBIDDEN:
            error = f"{_FORBIDDEN[instruction.opname]}."
        elif instruction.opname == "BINARY_OP" and instruction.argrepr.startswith("@"):
            error = "uses '@', which allocates memory and sums in another order; write loops."
        elif instruction.opname == "BINARY_OP" and instruction.argrepr.startswith("**"):
            error = "uses '**', which rounds differently in compiled code. Multiply, or use ops.square, ops.sqrt or ops.exp."
        elif instruction.opname in {"LOAD_ATTR", "LOAD_METHOD"}:
            attribute = str(instruction.argval)
        if error or attribute:
            # A method, or a function of a module.
            called = "METHOD" in instruction.opname or "NULL" in instruction.argrepr
            line = instruction.positions.lineno if instruction.positions else None
            found.append((line, attribute, called, error))
    return tuple(found)


def _fields(function: FunctionType, seen: set[FunctionType]) -> set[str]:
    """Return the field names of all records that a function, or one that it calls, refers to."""
    seen.add(function)
    names: set[str] = set()
    for _, value in references(function):
        names |= set(getattr(value, "_fields", ()))
        if isinstance(value, FunctionType) and value not in seen:
            names |= _fields(value, seen)
    return names


def where(function: Callable[..., Any], line: int | None = None) -> str:
    """Return the name, file and line of a function, or of a line in it, as text."""
    code = as_written(function).__code__
    return f"{function.__name__!r} ({Path(code.co_filename).name}, line {line or code.co_firstlineno})"


def _describe(value: Any) -> str:
    if isinstance(value, ModuleType):
        return f"the module {value.__name__}"
    return f"a {type(value).__name__}"


def fingerprint(function: FunctionType, specialisation: str) -> str:
    """Return a hexadecimal hash of `function`, all functions that it calls, and the specialisation."""
    return _hash(functions_called(function), specialisation, lambda reached: _code_text(reached.__code__))


def fingerprint_of_files(function: FunctionType, specialisation: str) -> tuple[str, set[Path]]:
    """Return a hash that does not depend on the version of Python while certain files are the same, and these files.

    A function stands for itself by its place and names in its file, and one that was generated by its text.
    """
    called = functions_called(function)
    files = {reached.__code__.co_filename for reached in called if not hasattr(reached, "tree")}

    def text(reached: FunctionType) -> str:
        if hasattr(reached, "tree"):
            return ast.unparse(reached.tree)
        code = reached.__code__
        written = "".join(linecache.getlines(code.co_filename)) if code.co_filename.startswith("<") else ""
        place = f"{reached.__module__}.{reached.__qualname__} {code.co_firstlineno}"
        return f"{place} {code.co_names} {code.co_varnames} {written}"

    return _hash(called, specialisation, text), {Path(file) for file in files if not file.startswith("<")}


def _hash(called: Sequence[FunctionType], specialisation: str, text: Callable[[FunctionType], str]) -> str:
    digest = hashlib.sha256(f"{specialisation}\n".encode())
    number = {reached: f"function {i}" for i, reached in enumerate(called)}
    for reached in called:
        digest.update(text(reached).encode())
        for name, value in references(reached):
            digest.update(f"{name}={_text(value, number)};".encode())
        digest.update(repr((reached.__defaults__, reached.__kwdefaults__)).encode())
    return digest.hexdigest()[:24]


def service_fingerprint(function: FunctionType, text: str) -> str:
    """Return a hexadecimal hash of a service function of the engine, all functions that it calls, and its wrapper.

    It is computed from the loaded code, as the files may have been edited since.
    """
    digest = hashlib.sha256(f"{environment()}\n{text}\n".encode())
    visited: list[FunctionType] = []
    package = function.__module__.split(".")[0]

    def visit(value: Any) -> None:
        value = getattr(value, "_defn", value)  # an intrinsic's Python function
        if isinstance(value, FunctionType) and value.__module__.split(".")[0] == package:
            if value in visited:
                digest.update(f"function {visited.index(value)}".encode())
                return
            visited.append(value)
            digest.update(f"{_code_text(value.__code__)} {value.__defaults__!r}".encode())
            for name in sorted(set(_names(value.__code__)) & value.__globals__.keys()):
                digest.update(f"{name}=".encode())
                visit(value.__globals__[name])
            for cell in value.__closure__ or ():
                visit(cell.cell_contents)
        elif isinstance(value, ModuleType | FunctionType | type):
            digest.update(f"{value.__name__}{getattr(value, '_fields', '')};".encode())
        elif isinstance(value, Number | str | tuple):
            digest.update(f"{value!r};".encode())
        else:
            digest.update(f"{type(value).__name__};".encode())

    visit(function)
    return digest.hexdigest()[:24]


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _text(value: Any, number: dict[FunctionType, str]) -> str:
    if isinstance(value, tuple):
        fields = ",".join(getattr(value, "_fields", ()))
        return f"{fields}({','.join(_text(item, number) for item in value)})"
    if isinstance(value, ModuleType):
        return "ops"  # no other module passes the check
    if is_record_class(value):
        return f"record {value.__name__}({','.join(value._fields)})"
    if isinstance(value, Foreign):
        return value.symbol
    if callable(value):  # the index distinguishes functions of the same name
        return number.get(value) or f"{value.__module__}.{value.__name__}"
    return f"{type(value).__name__} {value!r}"


def _code_text(code: CodeType) -> str:
    constants = [_code_text(c) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    return repr((code.co_code, code.co_names, code.co_varnames, code.co_freevars, constants))
