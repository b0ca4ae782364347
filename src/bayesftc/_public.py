"""The public names of a package, loaded on first use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lazy_loader  # type: ignore[import-untyped]


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package from its ``__init__.pyi``.

    A wrong name gets similar ones, as in error messages elsewhere.
    """
    load, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name in names or name.startswith("_"):
            return load(name)
        from bayesftc.cosim.errors import did_you_mean

        raise AttributeError(f"{package} has no {name!r}; {did_you_mean(name, names)}")

    return get, listed, names


__all__ = ["public_names"]
