"""Compare loops with each other over many seeds."""
