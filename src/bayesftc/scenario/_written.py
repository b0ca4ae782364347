"""Write the content of a scenario as TOML."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from bayesftc.cosim.errors import ScenarioError, brief


def toml(content: Mapping[str, Any]) -> str:
    """Return a TOML document with this content; `tomllib` reads the same numbers from it, to the bit.

    Parameters
    ----------
    content : mapping
        Tables, lists, texts, numbers and truth values.

    Raises
    ------
    ScenarioError
        If a value is of another type.
    """
    return "\n".join(_lines(content, ())).strip() + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table: first its values, then the tables in it, each with a header."""
    inner = {
        name: value for name, value in table.items() if _has_header(value) or (not path and isinstance(value, dict))
    }
    for name, value in table.items():
        if name not in inner:
            yield f"{_key(name)} = {_value(value)}"
    for name, value in inner.items():
        below = (*path, name)
        header = ".".join(map(_key, below))
        for each in value if isinstance(value, list) else [value]:
            if isinstance(value, list) or not each or any(not _has_header(v) for v in each.values()):
                yield ""
                yield f"[[{header}]]" if isinstance(value, list) else f"[{header}]"
            yield from _lines(each, below)


def _has_header(value: Any) -> bool:
    """Return whether a value gets a header of its own: a table, or a list of tables, that does not fit on a line."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(each, dict) for each in value)
    return isinstance(value, dict) and (
        any(isinstance(each, dict) for each in value.values()) or len(_value(value)) > 100 or not _is_small(value)
    )


def _is_small(table: Mapping[str, Any]) -> bool:
    return len(table) <= 4 and "kind" not in table


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(name)} = {_value(each)}' for name, each in value.items())} }}" if value else "{}"
    raise ScenarioError(
        f"{brief(value)} cannot be written into a scenario file. Give a text, a number, a list or a table."
    )


__all__ = ["toml"]
