"""Settings whose default is a design choice, with the reason."""

from __future__ import annotations

from dataclasses import field
from typing import Any


def chosen(value: Any, why: str) -> Any:
    """Return a dataclass field with a default and the reason for it."""
    return field(default=value, metadata={"why": why})
