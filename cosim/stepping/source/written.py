"""Generated step functions: Jacobians, and blocks that contain other blocks."""

from __future__ import annotations

import linecache
import zlib
from collections.abc import Iterable, Mapping
from types import FunctionType
from typing import Any


def function_from_text(
    name: str, arguments: Iterable[str], lines: Iterable[str], names: Mapping[str, Any]
) -> FunctionType:
    """Return the function with these arguments and lines. The text is always generated, never a user's.

    Parameters
    ----------
    name : str
        Its name.
    arguments : iterable of str
        Its argument names.
    lines : iterable of str
        The statements of its body, without the function's indentation.
    names : mapping of str to object
        Its global names, such as the functions that it calls.
    """
    text = f"def {name}({', '.join(arguments)}):\n" + "".join(f"    {line}\n" for line in lines)
    file = f"<{name} {zlib.crc32(text.encode()):08x}>"  # each function has its own source, even with equal names
    namespace = dict(names)
    exec(compile(text, file, "exec"), namespace)
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)  # for debuggers
    result = namespace[name]
    assert isinstance(result, FunctionType)
    return result
