"""Plants exported by other tools, in closed loops with failing sensors."""
