"""Commands for closed loops."""
