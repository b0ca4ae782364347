"""Packages that only some campaigns need: imported when they are, or named with the command that installs them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from bayesftc.cosim.errors import BayesFTCError


def extra(module: str, purpose: str) -> Any:
    """Return a module of the extra ``campaign``.

    Parameters
    ----------
    module : str
        Its full name, as ``"pyarrow.parquet"``.
    purpose : str
        What needs it, for the message: "A stored campaign".

    Raises
    ------
    BayesFTCError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise BayesFTCError(
            f"{purpose} needs the package {module.split('.')[0]}, which is not installed: pip install 'bayesftc[campaign]'."
        ) from None


__all__ = ["extra"]
