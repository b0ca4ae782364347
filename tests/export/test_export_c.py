"""The C of step functions: the bits of plain Python, for every kind of block, and sentences for what has no C."""

import numpy as np


def test_the_same_bits_as_plain_python(block, sample_time, random_inputs, compiled, same_bits):
    rng = np.random.default_rng(3)
    plain, c = block.online(sample_time(block), compiled=False), compiled(block, dt=sample_time(block))
    for _ in range(150):
        inputs = random_inputs(block, rng)
        expected, got = plain(**inputs), c(**inputs)
        assert list(expected) == list(got)
        for name, value in expected.items():
            same_bits(got[name], np.ravel(value), name)
