"""Plants that other tools exported, in closed loops with failing sensors."""
