"""The C of step functions: the bits of plain Python, for every kind of block, and sentences for what has no C."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.export.program import program_of

BASES = {cosim.Block, cosim.Fault, cosim.Source}


@pytest.mark.sampled(5)
def test_the_same_bits_as_plain_python(block, sample_time, random_inputs, compiled, same_bits):
    rng = np.random.default_rng(3)
    plain, c = block.online(sample_time(block), compiled=False), compiled(block, dt=sample_time(block))
    for _ in range(100):  # faults end at step 90
        inputs = random_inputs(block, rng)
        expected, got = plain(**inputs), c(**inputs)
        assert list(expected) == list(got)
        for name, value in expected.items():
            same_bits(got[name], np.ravel(value), name)


@pytest.mark.sampled(5)
def test_the_same_bits_where_samples_are_absurd_or_the_belief_is_lost(
    block, sample_time, random_inputs, compiled, same_bits
):
    if "y" not in {port.name for port in block.inputs}:
        return
    rng = np.random.default_rng(4)
    plain, c = block.online(sample_time(block), compiled=False), compiled(block, dt=sample_time(block))
    for k in range(100):
        inputs = random_inputs(block, rng)
        inputs["y"] += 1e9 * (k >= 50)
        chosen = rng.random(inputs["y"].shape) < 0.1
        inputs["y"][chosen] = rng.choice([1e20, -1e300, 2147483647.0, 3.4e38, -9999.0, 65535.0], chosen.sum())
        expected, got = plain(**inputs), c(**inputs)
        for name, value in expected.items():
            same_bits(got[name], np.ravel(value), name)


@pytest.mark.slow
def test_every_fault_on_a_condition_is_that_at_a_time(blocks, compiled_together, tmp_path, random_inputs, same_bits):
    """Also the C of a fault whose condition is fulfilled from step 30 to step 90: the times of the faults in `BLOCKS`."""
    at_a_time = [blocks[kind.__name__] for kind in cosim.FAULTS]
    conditions = {"start": cosim.when("plant.v", ">=", 1.0), "stop": cosim.when("plant.v", "<", 1.0)}
    programs = [
        program_of(replace(fault, name=f"f{i}", **conditions), dt="1/10") for i, fault in enumerate(at_a_time[:-1])
    ]
    for fault, c in zip(at_a_time, compiled_together(tmp_path, programs), strict=False):
        rng = np.random.default_rng(5)
        plain = fault.online("1/10", compiled=False)
        for k in range(120):
            inputs, signal = random_inputs(fault, rng), float(30 <= k < 90)
            expected, got = plain(**inputs), c(**inputs, start_signal=signal, stop_signal=signal)
            for name, value in expected.items():
                same_bits(got[name], np.ravel(value), name)


def test_every_kind_of_block_is_among_them(blocks):
    public = [getattr(module, name) for module in (cosim, controllers) for name in module.__all__]
    kinds = {kind for kind in public if inspect.isclass(kind) and issubclass(kind, cosim.Block)}
    kinds = {kind for kind in kinds - BASES if not issubclass(kind, cosim.ExternalBlock | cosim.FMU)}
    assert len(kinds) > 25
    assert not kinds - {type(block) for block in blocks.values()}
