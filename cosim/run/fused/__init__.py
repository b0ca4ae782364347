"""One compiled function for the whole loop of a diagram, for long runs."""
