"""Damage to texts: other values, lines that are lost, doubled or misplaced, and bytes that flip."""

from __future__ import annotations

import re

import numpy as np

NUMBERS = (
    *("0", "-1", "1", "2", "3", "0.5", "7.25", "-0.0", "1e-3", "1e9", "1_000"),
    *(
        "1e300",
        "-1e300",
        "1e18",
        "1e-300",
        "5e-324",
        "1e400",
        "9007199254740993",
        "9223372036854775808",
        "-9223372036854775809",
    ),
    *("nan", "inf", "-inf", "9" * 400, "9" * 5000, "0." + "3" * 400),
)
"""What stands where a number was; some are no numbers to TOML."""
VALUES = (
    *(
        '"nan"',
        '"1/3"',
        '"0.1"',
        '"1e400"',
        '""',
        '"x"',
        "true",
        "false",
        "[]",
        "[[]]",
        "{}",
        "1979-05-27T07:32:00Z",
        "07:32:00",
    ),
    *(
        "[0, 0]",
        "[1.0]",
        "[1.0, 2.0, 3.0]",
        "[[1.0]]",
        "[[1.0, 2.0], [3.0]]",
        "[[1.0, 0.0], [0.0, 1.0]]",
        '["a", "b"]',
        "[[[1.0]]]",
    ),
    *(
        "[nan, 1.0]",
        "[1e300, 1e-300]",
        "[[1e-30, 0.0], [0.0, 1e-30]]",
        "[[1.0, 2.0], [2.0, 1.0]]",
        '["v", "v"]',
        "[true]",
        "[{}]",
    ),
    *(
        '"../../../etc/passwd"',
        '"/dev/null"',
        '"' + "x" * 5000 + '"',
        r'"\u0000"',
        r'"é\n\t💥"',
        '"a.b"',
        '"[0]"',
        '"*"',
    ),
    *(
        '{ kind = "Freeze" }',
        '{ kind = "x" }',
        "{ a = 1 }",
        '[{ kind = "Offset" }]',
        "[1, [2, [3]]]",
        "[" * 200 + "]" * 200,
    ),
)
"""What stands where another value was."""
TOKEN = re.compile(r'"[^"\n]*"|(?<![\w.])[-+]?\d[\w.+-]*|\btrue\b|\bfalse\b|\[[^\[\]\n]*\]')
KEY = re.compile(r"^\s*([\w.\"\[\]]+)\s*=", re.M)


def number(rng: np.random.Generator) -> str:
    """Return a number that few have thought of."""
    return (
        str(rng.choice(NUMBERS))
        if rng.random() < 0.8
        else repr(float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-320, 308)))
    )


def mutated(text: str, rng: np.random.Generator) -> bytes:
    """Return a text of TOML with one to three mutations."""
    for _ in range(rng.geometric(0.7)):
        text = WAYS[int(rng.choice(len(WAYS), p=SHARES))](text, rng)
    data = text.encode()
    if rng.random() < 0.04:
        data = damaged(data, rng)
    return data


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes of which some are flipped, lost or new, or which end too early."""
    content = bytearray(data)
    for _ in range(1 + rng.poisson(2)):
        at = int(rng.integers(max(len(content), 1)))
        way = rng.integers(4)
        if way == 0 and content:
            content[at % len(content)] ^= 1 << int(rng.integers(8))
        elif way == 1:
            del content[at : at + int(rng.integers(1, 30))]
        elif way == 2:
            content[at:at] = rng.bytes(int(rng.integers(1, 30)))
        elif rng.random() < 0.3:
            del content[at:]
    return bytes(content)


def _other(text, rng, pattern, make):
    """Replace what one match of a pattern has in its last group."""
    found = list(pattern.finditer(text))
    if not found:
        return text
    match = found[int(rng.integers(len(found)))]
    group = match.lastindex or 0
    return text[: match.start(group)] + make(match[group]) + text[match.end(group) :]


def _number(text, rng):
    return _other(text, rng, re.compile(r"(?<![\w.\"])[-+]?\d[\w.+-]*"), lambda _: number(rng))


def _value(text, rng):
    return _other(text, rng, TOKEN, lambda _: str(rng.choice(VALUES)))


def _whole_value(text, rng):
    return _other(text, rng, re.compile(r"^[^=\n#]+= *([^\n#]+)", re.M), lambda _: str(rng.choice(VALUES)))


def _taken(text, rng):
    """Replace a value by one that stands elsewhere in the text."""
    found = TOKEN.findall(text)
    return _other(text, rng, TOKEN, lambda _: found[int(rng.integers(len(found)))])


def _key(text, rng):
    """Rename a key: as another one, or misspelt."""
    keys = KEY.findall(text)
    return _other(
        text, rng, KEY, lambda key: keys[int(rng.integers(len(keys)))] if rng.random() < 0.6 else key[:-1] + "x"
    )


def _lines(change):
    def way(text, rng):
        lines = text.splitlines()
        if len(lines) > 1:
            change(lines, *map(int, rng.integers(len(lines), size=2)))
        return "\n".join(lines) + "\n"

    return way


def _lose(lines, a, b):
    del lines[a]


def _double(lines, a, b):
    lines.insert(b, lines[a])


def _swap(lines, a, b):
    lines[a], lines[b] = lines[b], lines[a]


def _lose_many(lines, a, b):
    del lines[min(a, b) : max(a, b)]


WAYS = (_number, _value, _whole_value, _taken, _key, _lines(_lose), _lines(_double), _lines(_swap), _lines(_lose_many))
SHARES = np.array([16, 3, 2, 3, 1, 1, 0.5, 0.5, 0.3])
SHARES = SHARES / SHARES.sum()
