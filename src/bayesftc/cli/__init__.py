"""The command line: ``commands`` has a module for each command, `application` lists them."""

from bayesftc.cli.application import app

__all__ = ["app"]
