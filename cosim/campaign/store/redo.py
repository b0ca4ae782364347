"""Replace several files together: the new files are collected, declared valid by one rename, and then moved to their places.

`Redo.read` finds the valid file during a replacement, and after a writer was killed in the middle of one.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path, PurePosixPath

from bayesftc.cosim.campaign.store.durable import sync_folder

COLLECTED, VALID = "redo.tmp", "redo"


class Redo:
    """Files of a folder that will replace those of the same names.

    Parameters
    ----------
    root : pathlib.Path
        The folder.
    """

    def __init__(self, root: Path):
        self._root, self._collected, self._valid = root, root / COLLECTED, root / VALID

    def stage(self, name: PurePosixPath | str) -> Path:
        """Return the path for writing the new file of that name, and make its folder."""
        path = self._collected / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def commit(self) -> None:
        """Declare the collected files valid, all at once, and move them to their places."""
        for folder in {path.parent for path in self._collected.rglob("*") if path.is_file()}:
            sync_folder(folder)
        os.replace(self._collected, self._valid)
        sync_folder(self._root)
        self.recover()

    def recover(self) -> None:
        """Move valid files to their places, and remove files that were never declared valid."""
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
        """Remove collected files that were not declared valid."""
        shutil.rmtree(self._collected, ignore_errors=True)

    def names(self, folder: str) -> set[str]:
        """Return the names of all valid files in a folder of the root."""
        try:
            new = os.listdir(self._valid / folder)
        except (FileNotFoundError, NotADirectoryError):
            new = []
        return {
            *new,
            *os.listdir(self._root / folder),
        }  # in this order, because files move from the first to the second

    def read(self, name: PurePosixPath | str) -> bytes:
        """Return the content of the valid file of that name.

        Raises
        ------
        OSError
            If there is none, or it cannot be read.
        """
        try:
            return (self._valid / name).read_bytes()
        except (FileNotFoundError, NotADirectoryError):  # the usual case, or the file was just moved to its place
            return (self._root / name).read_bytes()


__all__ = ["Redo"]
