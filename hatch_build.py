"""Puts the root folders into a real wheel; an editable install reaches them through the links in ``src/bayesftc``."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FOLDERS = ("cosim", "controllers", "fmus", "examples")


class RootFolders(BuildHookInterface):  # type: ignore[type-arg]
    """Maps each top-level folder to its place inside the ``bayesftc`` package."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folders when a standard wheel is built."""
        if version == "standard":
            for folder in FOLDERS:
                build_data["force_include"][folder] = f"bayesftc/{folder}"
