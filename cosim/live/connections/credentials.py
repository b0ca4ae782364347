"""Passwords and certificates of connections, from places outside the file of wires."""

from __future__ import annotations

import os
from pathlib import Path

from bayesftc.cosim.errors import ModelError


def password_of(kind: str, password: str | None, variable: str | None, file: str | None) -> str | None:
    """Return a password that is given in one of three ways, or None.

    Parameters
    ----------
    kind : str
        The kind of the bridge, for messages.
    password : str, optional
        The password.
    variable : str, optional
        Name of the environment variable with the password.
    file : str, optional
        Path of a file with the password in its first line.

    Raises
    ------
    ModelError
        If it is given twice, or cannot be read.
    """
    if sum(given is not None for given in (password, variable, file)) > 1:
        raise ModelError(f"{kind} has more than one password. Give one of password_env, password_file and password.")
    if variable is not None:
        if variable not in os.environ:
            raise ModelError(
                f"{kind} reads its password from the environment variable {variable}, which is not set. Set it, or give "
                "password_file."
            )
        return os.environ[variable]
    if file is not None:
        lines = readable(kind, "password_file", file).read_text(encoding="utf-8").splitlines()
        if not lines or not lines[0]:
            raise ModelError(
                f"{kind} has password_file={file!r}, but its first line is empty. Write the password there."
            )
        return lines[0]
    return password


def check_login(kind: str, user: str | None, *passwords: str | None) -> None:
    """Check that there is a password with a user only, and at most one.

    Raises
    ------
    ModelError
        If this is not so.
    """
    given = sum(each is not None for each in passwords)
    if given > 1:
        raise ModelError(f"{kind} has more than one password. Give one of password_env, password_file and password.")
    if given and not user:
        raise ModelError(f"{kind} has a password without a user. Add user = ...")


def readable(kind: str, key: str, file: str) -> Path:
    """Return the path of a file that can be read.

    Raises
    ------
    ModelError
        If it cannot be read.
    """
    try:
        with open(file, "rb"):
            return Path(file)
    except OSError as error:
        raise ModelError(
            f"{kind} has {key}={file!r}, which cannot be read ({error.strerror}). Correct the path."
        ) from None


__all__ = ["check_login", "password_of", "readable"]
