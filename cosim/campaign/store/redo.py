"""Several files that change together: the new ones are collected, declared valid by one rename, and then put in their places.

Whoever reads meanwhile, or after a writer was killed in the middle, asks `Redo.current` where the valid file is.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path, PurePosixPath

from bayesftc.cosim.campaign.store.durable import sync_folder

COLLECTED, VALID = "redo.tmp", "redo"


class Redo:
    """Files of a folder that are about to replace those of the same names.

    Parameters
    ----------
    root : pathlib.Path
        The folder.
    """

    def __init__(self, root: Path):
        self._root, self._collected, self._valid = root, root / COLLECTED, root / VALID

    def stage(self, name: PurePosixPath | str) -> Path:
        """Return where the new file of that name is to be written; its folder is there."""
        path = self._collected / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def commit(self) -> None:
        """Declare the collected files valid, all at once, and put them in their places."""
        for folder in {path.parent for path in self._collected.rglob("*") if path.is_file()}:
            sync_folder(folder)
        os.replace(self._collected, self._valid)
        sync_folder(self._root)
        self.recover()

    def recover(self) -> None:
        """Put files that are valid in their places, and drop those that were never declared so."""
        self.discard()
        if not self._valid.is_dir():
            return
        moved = set()
        for path in sorted(self._valid.rglob("*")):
            if path.is_file():
                target = self._root / path.relative_to(self._valid)
                os.replace(path, target)
                moved.add(target.parent)
        for folder in moved:
            sync_folder(folder)
        shutil.rmtree(self._valid)

    def discard(self) -> None:
        """Drop what was collected and not declared valid."""
        shutil.rmtree(self._collected, ignore_errors=True)

    def names(self, folder: str) -> set[str]:
        """Return the names of all valid files in a folder of the root."""
        try:
            found = os.listdir(self._valid / folder)
        except (FileNotFoundError, NotADirectoryError):
            found = []
        return {*found, *os.listdir(self._root / folder)}  # in this order: files move from the one to the other

    def read(self, name: PurePosixPath | str) -> bytes:
        """Return what is in the valid file of that name.

        Raises
        ------
        OSError
            If there is none, or it cannot be read.
        """
        try:
            return (self._valid / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):  # as almost always; or it was just put in its place
            return (self._root / name).read_bytes()


__all__ = ["Redo"]
