"""Import what runs diagrams, whole."""

from __future__ import annotations

from functools import cache

from bayesftc._interrupt import import_whole


@cache
def import_engine() -> None:
    """Import the modules that run diagrams. This takes a moment."""
    import_whole("bayesftc.cosim.run.session", "bayesftc.cosim.stepping.machine.services")
