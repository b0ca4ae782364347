"""FMUs for model exchange: their equations, and integrators with events that make blocks of them."""
