"""The kinds of blocks that scenario files choose from.

``docs/reference/extend.md`` states where else a new block is listed.
"""

from __future__ import annotations

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.combining import Compare, Logic, Maximum, Minimum, Product, Switch
from bayesftc.cosim.blocks.elementwise import Abs, DeadZone, Polynomial, Quantizer, Saturation, Sign
from bayesftc.cosim.blocks.excitation import PRBS, Chirp, Pulse
from bayesftc.cosim.blocks.mathblocks import Gain, Sum, UnitDelay
from bayesftc.cosim.blocks.memory import (
    Counter,
    ExponentialFilter,
    Hysteresis,
    Integrator,
    MovingAverage,
    RateLimiter,
    SampleAndHold,
    VariableDelay,
)
from bayesftc.cosim.blocks.sources import Constant, Gaussian, Ramp, Sine, Step, Table
from bayesftc.cosim.blocks.tables import LookupTable, LookupTable2D
from bayesftc.cosim.blocks.transfer_function import TransferFunction

SOURCES: tuple[type[Block], ...] = (Constant, Step, Ramp, Sine, Table, Gaussian, Pulse, PRBS, Chirp)
"""Blocks without an input."""

BLOCKS: tuple[type[Block], ...] = (
    *SOURCES,
    Gain,
    Saturation,
    DeadZone,
    Abs,
    Sign,
    Quantizer,
    Polynomial,
    LookupTable,
    LookupTable2D,
    Sum,
    Product,
    Minimum,
    Maximum,
    Switch,
    Logic,
    Compare,
    UnitDelay,
    VariableDelay,
    Integrator,
    TransferFunction,
    ExponentialFilter,
    MovingAverage,
    RateLimiter,
    Hysteresis,
    SampleAndHold,
    Counter,
)
"""All kinds whose settings are numbers and texts, except for faults and sensors."""

__all__ = ["BLOCKS", "SOURCES"]
