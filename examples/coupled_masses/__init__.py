"""Two masses joined by a stiff spring, split into two FMUs, and stepped by every way of coupling."""
