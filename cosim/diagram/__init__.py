"""Block diagrams: which block stands where, what feeds what, and in which order all is computed."""
