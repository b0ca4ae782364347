"""Step functions that are written as text: Jacobians, and blocks that run other blocks inside."""

from __future__ import annotations

import linecache
import zlib
from collections.abc import Iterable, Mapping
from types import FunctionType
from typing import Any


def function_from_text(
    name: str, arguments: Iterable[str], lines: Iterable[str], names: Mapping[str, Any]
) -> FunctionType:
    """Return the function with these arguments and lines, all its own text: no text of a user's ever gets here.

    Parameters
    ----------
    name : str
        What it is called.
    arguments : iterable of str
        Its argument names.
    lines : iterable of str
        The statements of its body, without the indentation of the function itself.
    names : mapping of str to object
        What it finds as global names, such as the functions that it calls.
    """
    text = f"def {name}({', '.join(arguments)}):\n" + "".join(f"    {line}\n" for line in lines)
    file = f"<{name} {zlib.crc32(text.encode()):08x}>"  # functions of one name keep each its own source
    namespace = dict(names)
    exec(compile(text, file, "exec"), namespace)
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)  # so that a debugger can show it
    made = namespace[name]
    assert isinstance(made, FunctionType)
    return made
