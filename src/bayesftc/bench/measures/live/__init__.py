"""Live runs: how punctual a controller at 1 kHz is, beside a loop that only sleeps."""

from bayesftc.bench.measures.live.punctuality import measure

__all__ = ["measure"]
