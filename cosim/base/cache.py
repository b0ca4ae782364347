"""The cache for compiled code and unpacked FMUs: one directory per user, into which no other user can write.

Its content is executed. So a folder that belongs to another user, or that others can write, is refused; and files of other users,
from a time when the folder was open, are replaced. A group with this user as the only member is allowed: on Debian and Ubuntu
each user has such a group, and new files are writable for it.
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
        tempfile.TemporaryFile(dir=path).close()  # mkdir does not check whether an existing folder is writable
    except OSError as error:
        raise BayesFTCError(
            f"The cache folder {path} cannot be written ({error.strerror}); set BAYESFTC_CACHE to a writable folder."
        ) from None
    for folder in (base, path):
        _check(folder)
    return path


def _make(folder: Path) -> None:
    """Create a folder for this user only, unless it exists."""
    try:
        folder.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        if not folder.is_dir():
            raise
    else:
        folder.chmod(0o700)  # default permissions of the parent folder may have changed the mode


def _check(folder: Path) -> None:
    """Refuse a folder of another user, or one that others can write."""
    if not hasattr(os, "geteuid"):  # Windows: folders in the user's profile are private
        return
    status = folder.stat()
    if status.st_uid != os.geteuid() or not is_own(folder):
        raise BayesFTCError(
            f"The cache folder {folder} belongs to another user (number {status.st_uid}), who could have put code there that "
            "would be run here. Set BAYESFTC_CACHE to a folder of your own."
        )
    others = OTHERS_WRITE if not _is_private(status.st_gid) else stat.S_IWOTH
    if status.st_mode & others:
        raise BayesFTCError(
            f"Other users can write into the cache folder {folder} and could put code there that would be run here. Delete its "
            f"content and remove that permission (chmod go-w {folder}), or set BAYESFTC_CACHE to another folder of your own."
        )


def _is_private(group: int) -> bool:
    """Return whether a group is private: the user's primary group, with the user's name and no other member."""
    try:
        import grp
        import pwd

        user, entry = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except (ImportError, KeyError):  # another system, or an unknown user or group
        return False
    return user.pw_gid == group and entry.gr_name == user.pw_name and set(entry.gr_mem) <= {user.pw_name}


def is_own(path: Path) -> bool:
    """Return whether this user owns an existing file or folder; for a link, also its target."""
    if not hasattr(os, "geteuid"):
        return True
    return path.lstat().st_uid == os.geteuid() == path.stat().st_uid


def cache_directory(kind: str) -> Path:
    """Return the folder for ``compiled`` code or ``fmus``, created if necessary; ``BAYESFTC_CACHE`` moves it.

    Raises
    ------
    BayesFTCError
        If it cannot be written, belongs to another user, or others can write there.
    """
    return _directory(os.environ.get("BAYESFTC_CACHE"), kind)
