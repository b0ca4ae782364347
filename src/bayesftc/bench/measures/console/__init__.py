"""The console: what the engine pays for being watched, and whether twenty viewers delay a loop of 100 Hz."""

from bayesftc.bench.measures.console.watched import measure

__all__ = ["measure"]
