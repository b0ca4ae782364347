"""The compiled generator of random numbers; see `bayesftc.cosim.random` for what it computes."""

import math

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic, overload, register_jitable

from bayesftc.cosim.elementary import logarithm_of_normal
from bayesftc.cosim.random import SPARE
from bayesftc.cosim.stepping.by_address import as_floats, as_integers


def _root(x):
    return math.sqrt(x)


@intrinsic
def _square_root(typingctx, x):
    """Return the square root by the processor's instruction: the machine code needs no library."""

    def codegen(context, builder, sig, args):
        return builder.call(builder.module.declare_intrinsic("llvm.sqrt", [ir.DoubleType()]), args)

    return types.float64(types.float64), codegen


@overload(_root)
def _root_compiled(x):
    return lambda x: _square_root(x)


@register_jitable(error_model="numpy", forceinline=True)
def _multiply(a, b):
    """Return the high and low words of a 128-bit product, of products of 32 bits, which processors have for vectors."""
    low, half = np.uint64(0xFFFFFFFF), np.uint64(32)
    a0, a1, b0, b1 = a & low, a >> half, b & low, b >> half
    first = a0 * b0
    middle = a1 * b0 + (first >> half)
    rest = a0 * b1 + (middle & low)
    return a1 * b1 + (middle >> half) + (rest >> half), (rest << half) | (first & low)


@register_jitable(error_model="numpy", forceinline=True)
def _philox(c0, c1, c2, c3, k0, k1):
    for _ in range(10):
        high0, low0 = _multiply(np.uint64(0xD2E7470EE14C6C93), c0)
        high1, low1 = _multiply(np.uint64(0xCA5A826395121157), c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0 = k0 + np.uint64(0x9E3779B97F4A7C15)
        k1 = k1 + np.uint64(0xBB67AE8584CAA73B)
    return c0, c1, c2, c3


@register_jitable(error_model="numpy", forceinline=True)
def _of_uniform(word):
    """Return the bits of the number 2**52 plus the first 52 bits of a word."""
    return (word >> np.uint64(12)) | np.uint64(0x4330000000000000)


@register_jitable(error_model="numpy")
def _to_uniform(row):
    """Turn such numbers into uniform ones, of 52 bits and a half: the largest is 1 - 2**-53.

    With 53 bits it would round to 1, whose normal number is infinite.
    """
    for i in range(row.shape[0]):
        row[i] = ((row[i] - 4503599627370496.0) + 0.5) * (1.0 / 4503599627370496.0)


CENTRAL = 0.425
"""Largest distance of the probability from 0.5 for which Wichura's central formula holds."""


@register_jitable(error_model="numpy", forceinline=True)
def _central(q):
    # fmt: off
    r = 0.180625 - q * q
    top = ((((((2509.0809287301226727 * r + 33430.575583588128105) * r + 67265.770927008700853) * r
        + 45921.953931549871457) * r + 13731.693765509461125) * r + 1971.5909503065514427) * r
        + 133.14166789178437745) * r + 3.387132872796366608
    bottom = ((((((5226.495278852545925 * r + 28729.085735721942674) * r + 39307.89580009271061) * r
        + 21213.794301586595867) * r + 5394.1960214247511077) * r + 687.1870074920579083) * r
        + 42.313330701600911252) * r + 1.0
    # fmt: on
    return q * top / bottom


@register_jitable(error_model="numpy", forceinline=True)
def _tail(r):
    # fmt: off
    r -= 1.6
    top = ((((((7.7454501427834140764e-4 * r + 0.0227238449892691845833) * r + 0.24178072517745061177) * r
        + 1.27045825245236838258) * r + 3.64784832476320460504) * r + 5.7694972214606914055) * r
        + 4.6303378461565452959) * r + 1.42343711074968357734
    bottom = ((((((1.05075007164441684324e-9 * r + 5.475938084995344946e-4) * r + 0.0151986665636164571966) * r
        + 0.14810397642748007459) * r + 0.68976733498510000455) * r + 1.6763848301838038494) * r
        + 2.05319162663775882187) * r + 1.0
    # fmt: on
    return top / bottom


@register_jitable(error_model="numpy")
def _far_tail(r):
    # fmt: off
    r -= 5.0
    top = ((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r + 0.0012426609473880784386) * r
        + 0.026532189526576123093) * r + 0.29656057182850489123) * r + 1.7848265399172913358) * r
        + 5.4637849111641143699) * r + 6.6579046435011037772
    bottom = ((((((2.04426310338993978564e-15 * r + 1.4215117583164458887e-7) * r + 1.8463183175100546818e-5) * r
        + 7.868691311456132591e-4) * r + 0.0148753612908506148525) * r + 0.13692988092273580531) * r
        + 0.59983220655588793769) * r + 1.0
    # fmt: on
    return top / bottom


@register_jitable(error_model="numpy")
def _to_normal(row, tails, places):
    """Turn uniform numbers into normal ones: the inverse of the distribution function (Wichura 1988, AS 241, PPND16).

    The loops have no branches, so that the compiler makes vector instructions of them. So the numbers in the tails, one in seven,
    are moved to `tails` first.
    """
    count = 0
    for i in range(row.shape[0]):
        places[count] = i
        count += abs(row[i] - 0.5) > CENTRAL
    for i in range(count):
        p = row[places[i]]
        tails[i] = p if p < 0.5 else 1.0 - p
    for i in range(count):
        tails[i] = _root(-logarithm_of_normal(tails[i], 0.0))
    furthest = 0.0
    for i in range(count):
        furthest = max(furthest, tails[i])
    if furthest > 5.0:  # one number in 36 billion
        for i in range(count):
            tails[i] = _tail(tails[i]) if tails[i] <= 5.0 else _far_tail(tails[i])
    else:
        for i in range(count):
            tails[i] = _tail(tails[i])
    for i in range(count):
        tails[i] = -tails[i] if row[places[i]] < 0.5 else tails[i]
    for i in range(row.shape[0]):
        row[i] = _central(row[i] - 0.5)
    for i in range(count):
        row[places[i]] = tails[i]


@register_jitable(error_model="numpy")
def fill(seed, streams, first, buffer):
    """Draw the chunk of steps that begins at `first`, a multiple of four.

    ``streams`` has a row (key, channel, draw, 1 for uniform) for each number; ``buffer`` has a row for each number, `SPARE`
    others, and a column for each step.
    """
    tails, places = buffer[streams.shape[0]], buffer[streams.shape[0] + 1].view(np.int64)
    for j in range(streams.shape[0]):
        row, bits = buffer[j], buffer[j].view(np.uint64)
        # Unsigned, so that numba generates no code for negative indices.
        key, channel, draw, block = streams[j, 0], streams[j, 1], streams[j, 2], np.uint64(first >> 2)
        for i in range(np.uint64(row.shape[0] >> 2)):
            words = _philox(block + np.uint64(i), channel, draw, np.uint64(0), seed, key)
            at = np.uint64(i) << np.uint64(2)
            bits[at] = _of_uniform(words[0])
            bits[at + np.uint64(1)] = _of_uniform(words[1])
            bits[at + np.uint64(2)] = _of_uniform(words[2])
            bits[at + np.uint64(3)] = _of_uniform(words[3])
        _to_uniform(row)
        if streams[j, 3] == np.uint64(0):
            _to_normal(row, tails, places)


def draw(state, parameters, inputs, outputs, t, k):
    """Call `fill` with what six words at the address `parameters` say: streams, their number, first step, buffer, steps, seed."""
    words = carray(as_integers(parameters), (6,))
    streams = carray(as_integers(words[0]), (words[1], 4)).view(np.uint64)
    fill(np.uint64(words[5]), streams, words[2], carray(as_floats(words[3]), (words[1] + SPARE, words[4])))
    return 0
