"""The command line: one small module for what each command does, and `commands` for how they are called."""

from bayesftc.cli.commands import app

__all__ = ["app"]
