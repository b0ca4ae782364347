"""Formats of messages: numbers as bytes or text, with an optional time stamp or sequence number of the sender."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from math import isfinite, nan
from typing import Any, Literal, NamedTuple

Format = Literal["doubles", "stamped doubles", "json", "text"]
"""``doubles``: 8 bytes for each number, little-endian. ``stamped doubles``: the first is the sender's time in seconds.
``json``: a number, a list of numbers, or an object with ``value`` or ``values`` and perhaps ``time`` (seconds) and ``sequence``.
``text``: numbers with commas, semicolons or spaces between them."""

LONGEST = 65536
"""Largest message in bytes."""

VALUE, TIME, SEQUENCE = ("value", "values"), ("time", "t", "timestamp"), ("sequence", "seq")
"""Keys of a JSON object."""


class Message(NamedTuple):
    """The content of one message.

    Attributes
    ----------
    values : tuple of float
        The numbers; NaN for null.
    sent : float or None
        The sender's time in seconds.
    sequence : int or None
        The sender's sequence number.
    """

    values: tuple[float, ...]
    sent: float | None = None
    sequence: int | None = None


def decode(payload: bytes, form: Format) -> Message:
    """Return the content of a message.

    Raises
    ------
    ValueError
        If it is not of this format. The text is the reason in a few words.
    """
    if len(payload) > LONGEST:
        raise ValueError("too long")
    return _DECODERS[form](payload)


def encode(values: Sequence[float], time: float | None, form: Format) -> bytes:
    """Return a message with the values of the step at `time`, in seconds; in JSON, None leaves the time out."""
    if form == "doubles":
        return struct.pack(f"<{len(values)}d", *values)
    if form == "stamped doubles":
        return struct.pack(f"<{len(values) + 1}d", nan if time is None else time, *values)
    if form == "text":
        return ",".join(map(repr, map(float, values))).encode()
    numbers = [float(value) if isfinite(value) else None for value in values]
    content: dict[str, Any] = {} if time is None else {"time": time}
    content |= {"value": numbers[0]} if len(numbers) == 1 else {"values": numbers}
    return json.dumps(content, allow_nan=False).encode()


def _doubles(payload: bytes) -> Message:
    if not payload or len(payload) % 8:
        raise ValueError("not a whole number of doubles")
    return Message(struct.unpack(f"<{len(payload) // 8}d", payload))


def _stamped(payload: bytes) -> Message:
    sent, *values = _doubles(payload).values
    if not values:
        raise ValueError("a time stamp without values")
    if not isfinite(sent):
        raise ValueError("a time stamp that is not a number")
    return Message(tuple(values), sent)


def _text(payload: bytes) -> Message:
    try:
        text = payload.decode("ascii")
        # Between semicolons, a comma is a decimal one.
        words = (text.replace(",", ".").replace(";", " ") if ";" in text else text.replace(",", " ")).split()
        values = tuple(map(float, words))
    except ValueError:
        raise ValueError("not a number") from None
    if not values:
        raise ValueError("empty")
    return Message(values)


def _json(payload: bytes) -> Message:
    try:
        content = json.loads(payload.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise ValueError("no JSON") from None
    sent = sequence = None
    if isinstance(content, dict):
        sent, sequence = _stamp(content, TIME), _sequence(content)
        content = next((content[key] for key in VALUE if key in content), [])
    values = tuple(map(_number, content if isinstance(content, list) else [content]))
    if not values:
        raise ValueError("empty")
    return Message(values, sent, sequence)


def _given(content: dict[str, Any], keys: Sequence[str]) -> Any:
    return next((content[key] for key in keys if content.get(key) is not None), None)


def _sequence(content: dict[str, Any]) -> int | None:
    given = _given(content, SEQUENCE)
    if isinstance(given, int) and not isinstance(given, bool):
        return given  # a double does not tell neighbours beyond 2^53 apart
    stamp = _stamp(content, SEQUENCE)
    return None if stamp is None else int(stamp)


def _stamp(content: dict[str, Any], keys: Sequence[str]) -> float | None:
    given = _given(content, keys)
    if given is None:
        return None
    stamp = _number(given)
    if not isfinite(stamp):
        raise ValueError("a time stamp that is not a number")
    return stamp


def _number(value: Any) -> float:
    if value is None:
        return nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("not a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError("too large for a number") from None


_DECODERS = {"doubles": _doubles, "stamped doubles": _stamped, "json": _json, "text": _text}

__all__ = ["Format", "Message", "decode", "encode"]
