"""The headless desk: a scenario that runs now, what an operator does, branches, and the engine that advances it."""
