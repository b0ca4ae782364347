"""Optional packages: imported when needed; if missing, the error names the command that installs them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from bayesftc.cosim.errors import BayesFTCError


def extra(module: str, purpose: str, of: str = "campaign") -> Any:
    """Return a module of an extra.

    Parameters
    ----------
    module : str
        Its full name, as ``"pyarrow.parquet"``.
    purpose : str
        The feature that needs it, for the message: "A stored campaign".
    of : str
        The extra that brings it.

    Raises
    ------
    BayesFTCError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise BayesFTCError(f"{purpose} needs {_missing(module.split('.')[0], of)}") from None


def why_missing(*packages: str, purpose: str, of: str = "campaign") -> str | None:
    """Return the message of `extra` if one of the packages of an extra is not installed, else None; nothing is imported."""
    missing = next((package for package in packages if find_spec(package) is None), None)
    return None if missing is None else f"{purpose} needs {_missing(missing, of)}"


def _missing(package: str, of: str = "campaign") -> str:
    return f"the package {package}, which is not installed: pip install 'bayesftc[{of}]'."


__all__ = ["extra", "why_missing"]
