"""Block diagrams: blocks, connections, and the order of computation."""
