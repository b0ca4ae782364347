"""Users, passwords and certificates of connections, and who can reach an address."""

from __future__ import annotations

import ipaddress
import os
from dataclasses import dataclass, field
from pathlib import Path

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.bridge import PATH


@dataclass(eq=False, kw_only=True)
class Login:
    """The login of a bridge.

    Parameters
    ----------
    user : str, optional
        Name of the user.
    password_env, password_file : str, optional
        Environment variable with the password, or a file with the password in its first line.
    password : str, optional
        The password itself. Anybody who can read the file of wires can then read it.
    """

    user: str | None = None
    password_env: str | None = None
    password_file: str | None = field(default=None, metadata=PATH)
    password: str | None = field(default=None, repr=False)

    def check_login(self, kind: str) -> None:
        """Check that there is a password with a user only, and at most one; `kind` is the bridge, for messages.

        Raises
        ------
        ModelError
            If this is not so.
        """
        given = sum(each is not None for each in (self.password, self.password_env, self.password_file))
        if given > 1:
            raise ModelError(
                f"{kind} has more than one password. Give one of password_env, password_file and password."
            )
        if given and not self.user:
            raise ModelError(f"{kind} has a password without a user. Add user = ...")

    def read_password(self, kind: str) -> str | None:
        """Return the password, from where it is; None without one.

        Raises
        ------
        ModelError
            If it cannot be read.
        """
        if self.password_env is not None:
            if self.password_env not in os.environ:
                raise ModelError(
                    f"{kind} reads its password from the environment variable {self.password_env}, which is not set. Set it, "
                    "or give password_file."
                )
            return os.environ[self.password_env]
        if self.password_file is not None:
            lines = readable(kind, "password_file", self.password_file).read_text(encoding="utf-8").splitlines()
            if not lines or not lines[0]:
                raise ModelError(
                    f"{kind} has password_file={self.password_file!r}, but its first line is empty. Write the password there."
                )
            return lines[0]
        return self.password


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


def is_loopback(host: str) -> bool:
    """Return whether an address is only reachable from this machine."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


__all__ = ["Login", "is_loopback", "readable"]
