"""What FMI functions return, for each status, with functions that need no compiler."""

import ctypes
from fractions import Fraction

import numpy as np
import pytest

from bayesftc.cosim.fmi.binaries import groups as _fmi_groups
from bayesftc.cosim.fmi.binaries.addresses import Addresses
from bayesftc.cosim.fmi.running import kernels as _fmi_kernels, steps as _fmi_steps, typed_kernels as _fmi_typed_kernels

STEP2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
STEP3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)
DT = Fraction(1, 100)


def fake(returns, writes=()):
    """Return a C function that returns a status and writes bytes or doubles to some of its pointer arguments."""

    def values(component, references, count, array, more=0):
        return returns["values"]

    def step2(component, t, h, flag):
        return returns["step"]

    def step3(component, t, h, flag, event, terminate, early, reached):
        for address, value in zip((event, terminate, early), writes[:3], strict=True):
            ctypes.c_uint8.from_address(address).value = value
        ctypes.c_double.from_address(reached).value = writes[3] if writes[3] is not None else t + h
        return returns["step"]

    return (
        _fmi_groups.VALUES2(values),
        _fmi_groups.VALUES3(values),
        STEP2(step2),
        STEP3(step3),
    )


STATUS = [
    # (FMI, what get and set return, what the step returns, what fmi3DoStep writes, expected status)
    (2, 0, 0, (), 0),
    (2, 1, 1, (), 0),
    (2, 0, 2, (), 302),
    (2, 0, 4, (), 304),
    (2, 0, 5, (), 305),
    (2, 3, 0, (), 203),
    (3, 0, 0, (0, 0, 0, None), 0),
    (3, 1, 1, (1, 0, 0, None), 0),
    (3, 0, 2, (0, 0, 0, None), 302),
    (3, 0, 3, (0, 1, 0, None), 303),
    (3, 4, 0, (0, 0, 0, None), 204),
    (3, 0, 0, (0, 1, 0, None), 402),
    (3, 0, 0, (0, 0, 1, 1.005), 401),
    (3, 0, 0, (0, 0, 1, float("nan")), 401),
    (3, 0, 0, (0, 0, 1, None), 0),
]


@pytest.mark.parametrize(("major", "values", "step", "writes", "expected"), STATUS)
def test_status_of_every_kind(major, values, step, writes, expected):
    functions = fake({"values": values, "step": step}, writes)
    get, advance = (functions[0], functions[2]) if major == 2 else (functions[1], functions[3])
    values_at, step_at = (ctypes.cast(f, ctypes.c_void_p).value for f in (get, advance))
    addresses = Addresses(step_at)
    into, out = (_fmi_groups.Group("", values_at, _fmi_groups.FLOAT64, major, [i], 0, 1) for i in range(2))
    u, y = np.zeros(1), np.zeros(1)
    for timing in ("plant", "sampled"):
        steps = _fmi_steps.StepFunctions(major, addresses, 1, [into], [out], DT, timing)
        assert len(steps.table) <= 32
        assert (steps.update if timing == "plant" else steps.output)(u, y, 1.0) == expected
    if values > 1:
        steps = _fmi_steps.StepFunctions(major, addresses, 1, [into], [out], DT, "plant")
        assert steps.output(u, y, 1.0) == 100 + values
    del functions


def test_python_and_compiled_code_have_the_same_types_and_tables():
    codes = ("FLOAT64", "FLOAT32", "INT8", "UINT8", "INT16", "UINT16", "INT32", "UINT32", "INT64", "UINT64")
    for i, name in enumerate(codes):
        assert getattr(_fmi_typed_kernels, name) == i
        assert np.dtype(name.lower()) == _fmi_groups.NumericType(i, 0.0, 0.0).dtype
    group = _fmi_groups.Group("", 0, _fmi_groups.FLOAT64, 2, [0], 0, 1)
    assert len(group.words()) == _fmi_typed_kernels.GROUP_WORDS
    steps = _fmi_steps.StepFunctions(2, Addresses(0), 0, [], [], DT, "plant")
    assert len(steps.table) == _fmi_kernels.WORDS
