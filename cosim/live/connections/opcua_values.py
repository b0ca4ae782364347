"""Values of OPC UA as samples, and controls as values of the type of a node."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.cosim.live.inbox import Inbox

POLICIES = ("Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss")
MODES = ("Sign", "SignAndEncrypt")
NODE = re.compile(r"(?:ns=(?P<index>\d+);|nsu=(?P<uri>[^;]+);)?(?P<name>i=\d+|[sgb]=.+)")
RANGES = {
    f"{sign}{name}": (0, 2**bits - 1) if sign == "U" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for sign in ("", "U")
    for name, bits in (("Int16", 16), ("Int32", 32), ("Int64", 64))
} | {"SByte": (-128, 127), "Byte": (0, 255)}
"""Least and largest values of the types of whole numbers."""


def check_url(kind: str, url: str) -> tuple[str, int]:
    """Return host and port of the address of a server.

    Raises
    ------
    ModelError
        If it is not one.
    """
    shown = url.rpartition("@")[2]  # without a login
    wrong = ModelError(f'{kind} has url={shown!r}; it must have the form "opc.tcp://host:4840".')
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme != "opc.tcp" or not host:
        raise wrong
    if parts.username or parts.password:
        raise ModelError(f"{kind} has a user or a password in its url. Give user and password_env instead.")
    return host, port or 4840


def check_security(kind: str, security: str | None, certificate: str | None, key: str | None) -> None:
    """Check the security policy, and that there are files for it.

    Raises
    ------
    ModelError
        If a policy is unknown, or a file is not given.
    """
    if security is not None:
        policy, _, mode = security.partition(",")
        if policy not in POLICIES or mode not in MODES:
            raise ModelError(
                f'{kind} has security={security!r}; it must be a policy and a mode, such as "Basic256Sha256,SignAndEncrypt". '
                f"Policies: {', '.join(POLICIES)}. Modes: {', '.join(MODES)}."
            )
    if bool(certificate) != bool(key) or (security is not None and not certificate):
        raise ModelError(f"{kind} has security, certificate or key without the others. Give all three, or none.")


def check_node(kind: str, node: str) -> None:
    """Check the text of a node id.

    Raises
    ------
    ModelError
        If it is none.
    """
    if not NODE.fullmatch(node):
        raise ModelError(
            f'{kind} has node={node!r}, which is no node id. It must have the form "ns=2;s=Car.Speed", "ns=2;i=1001" or '
            '"nsu=urn:factory;s=Car.Speed".'
        )


def give(value: Any, inbox: Inbox, *, kept: bool = False) -> None:
    """Give a value of a node (``asyncua.ua.DataValue``) to an inbox; with a status other than good, it is no sample."""
    status = value.StatusCode
    if status is not None and not status.is_good():
        inbox.fail(status.name)
        return
    content: Any = None if value.Value is None else value.Value.Value
    numbers: list[Any] = content if isinstance(content, list) else [content]
    if not numbers or not all(isinstance(each, int | float) for each in numbers):
        inbox.reject("not a number")
        return
    inbox.put([float(each) for each in numbers], seconds(value.SourceTimestamp), kept=kept)


def seconds(stamp: datetime | None) -> float | None:
    """Return a time stamp in seconds since 1970; without a zone it is UTC. None for the zero time of OPC UA (1601)."""
    if stamp is None or stamp.year < 1970:
        return None
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


def converted(values: Sequence[float], kind: str) -> list[Any]:
    """Return values as those of a type of OPC UA.

    Parameters
    ----------
    values : sequence of float
        The values.
    kind : str
        Name of the type: ``"Double"``, ``"Int16"``, ``"Boolean"``.

    Raises
    ------
    ValueError
        If they cannot be of this type. The text is a sentence.
    """
    if kind in ("Double", "Float"):
        return [float(value) for value in values]
    if kind != "Boolean" and kind not in RANGES:
        raise ValueError(f"The node is of the type {kind}, but controls are numbers. Choose another node.")
    if not all(isfinite(value) for value in values):
        raise ValueError(f"A control is not a finite number, and the type {kind} of the node has no such values.")
    if kind == "Boolean":
        return [value != 0 for value in values]
    low, high = RANGES[kind]
    whole = [round(value) for value in values]
    if not all(low <= value <= high for value in whole):
        raise ValueError(
            f"A control is outside the type {kind} of the node ({low} to {high}). Set low and high of the wire."
        )
    return whole


__all__ = ["check_node", "check_security", "check_url", "converted", "give", "seconds"]
