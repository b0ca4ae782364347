"""Addresses of the compiled functions at both ends of the connection to an isolated FMU."""

from __future__ import annotations

from typing import Any


def address(role: str) -> int:
    """Return the address of a function of `bayesftc.cosim.isolation.kernels`: ``output`` and ``update``, or ``serve``."""
    from bayesftc.cosim.stepping.machine.services import service_address

    def find() -> Any:
        from bayesftc.cosim.isolation import kernels

        return getattr(kernels, role)

    return service_address(f"isolated_{role}", find)
