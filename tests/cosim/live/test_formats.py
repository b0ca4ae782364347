"""Formats of messages: what is encoded is decoded, and any bytes are decoded or refused with a reason."""

import json
import math
import struct

import pytest
from hypothesis import given, strategies as st

from bayesftc.cosim.live.formats import LONGEST, Message, decode, encode

FORMS = ("doubles", "stamped doubles", "json", "text")
numbers = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20)


def decoded(payload, form):
    """Return the message, or None and the reason."""
    try:
        return decode(payload, form), None
    except ValueError as error:
        return None, str(error)


@given(numbers, st.floats(0, 1e9), st.sampled_from(FORMS))
def test_what_is_encoded_is_decoded(values, time, form):
    message = decode(encode(values, time, form), form)
    assert list(message.values) == values
    assert message.sent == (time if form in {"stamped doubles", "json"} else None)


@given(st.binary(max_size=200), st.sampled_from(FORMS))
def test_any_bytes_are_decoded_or_refused_with_a_reason(payload, form):
    message, reason = decoded(payload, form)
    if message is None:
        assert reason
        assert "\n" not in reason
    else:
        assert message.values
        assert all(isinstance(value, float) for value in message.values)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["value", "values", "time", "sequence", "x"]), inner, max_size=4)
    ),
    max_leaves=8,
)


@given(json_values)
def test_any_json_is_decoded_or_refused(content):
    message, _ = decoded(json.dumps(content).encode(), "json")
    assert message is None or message.sent is None or math.isfinite(message.sent)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3", Message((3.0,))),
        ("[1, 2.5]", Message((1.0, 2.5))),
        ('{"value": 4, "time": 0.5}', Message((4.0,), 0.5)),
        ('{"values": [4, 5], "seq": 7}', Message((4.0, 5.0), None, 7)),
        ('{"value": 4, "seq": 7.0}', Message((4.0,), None, 7)),
        ('{"value": 4, "seq": 9007199254740993}', Message((4.0,), None, 2**53 + 1)),
    ],
)
def test_json_is_a_number_a_list_or_an_object(text, message):
    assert decode(text.encode(), "json") == message


def test_between_semicolons_commas_are_decimal():
    assert decode(b"1,5;2;-3,25e1", "text") == Message((1.5, 2.0, -32.5))
    assert decode(b"1.5,2", "text") == Message((1.5, 2.0))


def test_null_is_a_missing_number():
    assert math.isnan(decode(b"[null]", "json").values[0])
    assert encode([math.nan, 1.0], 0.0, "json") == b'{"time": 0.0, "values": [null, 1.0]}'


@pytest.mark.parametrize(
    ("payload", "form", "reason"),
    [
        (b"", "doubles", "not a whole number of doubles"),
        (b"12345", "doubles", "not a whole number of doubles"),
        (struct.pack("<d", 1.0), "stamped doubles", "a time stamp without values"),
        (struct.pack("<2d", math.nan, 1.0), "stamped doubles", "a time stamp that is not a number"),
        (b"warm", "text", "not a number"),
        (b" ", "text", "empty"),
        (b"{}", "json", "empty"),
        (b"true", "json", "not a number"),
        (b"1" * 400, "json", "too large for a number"),
        (b"[" * 60_000, "json", "no JSON"),
        (b"1" * (LONGEST + 1), "text", "too long"),
    ],
)
def test_reasons_are_short(payload, form, reason):
    with pytest.raises(ValueError, match=reason):
        decode(payload, form)
