"""How far the engine is from the machine's limit: the same loop written by hand in C, and where its time goes."""

from bayesftc.bench.measures.limit.table import measure

__all__ = ["measure"]
