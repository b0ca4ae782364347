"""Where this package keeps compiled code and extracted FMUs: one directory per user, in which nobody else can leave anything.

What lies there is run. So a folder that belongs to someone else, or that others can write, is refused; and what others have left
in one that was open to them before is made anew. A group of which its user is the only member is nobody else: on Debian and
Ubuntu each user has one, and what the user makes is open to it.
"""

from __future__ import annotations

import os
import stat
import tempfile
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

from bayesftc.cosim.errors import BayesFTCError

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


@cache
def _directory(root: str | None, kind: str) -> Path:
    base = Path(root) if root else user_cache_path("bayesftc", appauthor=False)
    path = base / kind
    try:
        for folder in (base, path):
            _make(folder)
        tempfile.TemporaryFile(dir=path).close()  # mkdir does not tell whether an existing folder can be written
    except OSError as error:
        raise BayesFTCError(
            f"The cache folder {path} cannot be written ({error.strerror}); set BAYESFTC_CACHE to a folder that can be written."
        ) from None
    for folder in (base, path):
        _check(folder)
    return path


def _make(folder: Path) -> None:
    """Make a folder for this user alone, unless it is there."""
    try:
        folder.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        if not folder.is_dir():
            raise
    else:
        folder.chmod(0o700)  # which default permissions of the folder above it may have changed


def _check(folder: Path) -> None:
    """Refuse a folder of someone else, or one that others can write."""
    if not hasattr(os, "geteuid"):  # Windows: a user's folders are the user's own
        return
    found = folder.stat()
    if found.st_uid != os.geteuid() or not is_own(folder):
        raise BayesFTCError(
            f"The cache folder {folder} belongs to another user (number {found.st_uid}), who could have left code there that "
            "would be run here; set BAYESFTC_CACHE to a folder of your own."
        )
    others = OTHERS_WRITE if not _is_private(found.st_gid) else stat.S_IWOTH
    if found.st_mode & others:
        raise BayesFTCError(
            f"Other users can write into the cache folder {folder} and could leave code there that would be run here; remove "
            f"what is in it and take that away (chmod go-w {folder}), or set BAYESFTC_CACHE to another folder of your own."
        )


def _is_private(group: int) -> bool:
    """Return whether a group is this user's own: the main one, of the user's name, with no other member."""
    try:
        import grp
        import pwd

        user, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except (ImportError, KeyError):  # no such system, or a user or group that it does not know
        return False
    return user.pw_gid == group and found.gr_name == user.pw_name and set(found.gr_mem) <= {user.pw_name}


def is_own(path: Path) -> bool:
    """Return whether a file or folder that is there is this user's own; of a link also what it leads to."""
    if not hasattr(os, "geteuid"):
        return True
    return path.lstat().st_uid == os.geteuid() == path.stat().st_uid


def cache_directory(kind: str) -> Path:
    """Return the folder for ``compiled`` code or ``fmus``, made if need be; ``BAYESFTC_CACHE`` moves it.

    Raises
    ------
    BayesFTCError
        If it cannot be written, belongs to someone else, or others can write there.
    """
    return _directory(os.environ.get("BAYESFTC_CACHE"), kind)
