"""Step functions of the faults: one gate for all, and for each kind the value of a faulty channel.

A kind is a value function ``(sample, held, age, chance, noise, settings) -> value`` of scalars: the present sample, the last
sample before the onset, seconds since the onset, a number uniform in (0, 1), a standard normal number, and the settings of the
kind (an array in the order of its fields). ``age`` is 0 at the onset and while the fault is absent. A kind that remembers has a
seventh argument, ``memory``: an array that it may write to, zeros at first.

Every kind is computed at every step, whether the fault is present or not. ``select`` then drops the value if it is not needed,
even a NaN or infinity. So the function may return any number, but must never raise.
"""

from collections.abc import Callable
from functools import cache
from math import tau
from typing import Any, NamedTuple

from bayesftc.cosim.ops import both, floor, maximum, minimum, select, sin
from bayesftc.cosim.stepping.records import named_alike
from bayesftc.cosim.types import Floats, Kernel

Value = Callable[..., Any]

NAN = float("nan")
TAU = tau
LARGEST = 1.7976931348623157e308
HALF = 0.5  # a state for yes or no is 1.0 or 0.0; comparing it with the middle is safe


def frozen(sample, held, age, chance, noise, settings):
    """Hold the last sample before the onset."""
    return held


def stuck(sample, held, age, chance, noise, settings):
    """Return a constant value; settings: at."""
    return settings[0]


def injected(sample, held, age, chance, noise, settings):
    """Add a constant and a sine; settings: magnitude, amplitude, period, phase."""
    return sample + (settings[0] + settings[1] * sin(TAU * age / settings[2] + settings[3]))


def biased(sample, held, age, chance, noise, settings):
    """Add a constant; settings: magnitude."""
    return sample + settings[0]


def drifted(sample, held, age, chance, noise, settings):
    """Add an offset that grows from the onset on; settings: slope."""
    return sample + settings[0] * age


def scaled(sample, held, age, chance, noise, settings):
    """Multiply; settings: factor."""
    return settings[0] * sample


def dropped(sample, held, age, chance, noise, settings):
    """Return no sample."""
    return NAN


def spiked(sample, held, age, chance, noise, settings):
    """Add an outlier at random steps; settings: magnitude, probability, random_size."""
    size = select(settings[2] > HALF, noise, select(noise < 0.0, -1.0, 1.0))
    return select(chance < settings[1], sample + settings[0] * size, sample)


def noisier(sample, held, age, chance, noise, settings):
    """Add normal noise; settings: std."""
    return sample + settings[0] * noise


def ageing(sample, held, age, chance, noise, settings):
    """Add normal noise that grows from the onset on; settings: slope."""
    return sample + settings[0] * age * noise


def clipped(sample, held, age, chance, noise, settings):
    """Limit to a range, but keep missing samples; settings: low, high."""
    return select(sample == sample, maximum(minimum(sample, settings[1]), settings[0]), sample)


def rounded(sample, held, age, chance, noise, settings):
    """Round to the nearest multiple, halves up; settings: resolution."""
    return floor(sample / settings[0] + 0.5) * settings[0]


def lagging(sample, held, age, chance, noise, settings, memory):
    """Follow the sample as a low-pass filter; settings: share of the difference per step; memory: the last finite value."""
    last = select(age == 0.0, held, memory[0])
    last = select(last - last == 0.0, last, sample)
    now = last + settings[0] * (sample - last)
    memory[0] = select(now - now == 0.0, now, last)
    return now


def delayed(sample, held, age, chance, noise, settings, memory):
    """Return an earlier sample; settings: steps, and the value before the first sample, infinite for the first sample itself.

    Memory: 1 after the first step, then samples, the newest last.
    """
    newest = memory.shape[0] - 1
    value, first = sample, select(settings[1] > LARGEST, sample, settings[1])
    for i in range(1, newest):
        memory[i] = select(memory[0] > HALF, memory[i + 1], first)
    memory[newest] = sample
    for i in range(1, newest):
        value = select(newest - i == settings[0], memory[i], value)
    memory[0] = 1.0
    return value


@cache
def without_memory(kind: Value) -> Value:
    """Return a value function without memory with the arguments of one with memory."""

    def value(sample, held, age, chance, noise, settings, memory):
        return kind(sample, held, age, chance, noise, settings)

    return value


def scheduled(t, window):
    """Return 1 within the window of a fault, start <= t < stop, else 0; `conditions.triggered` is that of a condition."""
    return select(both(t >= window[0], t < window[1]), 1.0, 0.0)


def gate(inside, transition, course):
    """Determine whether the fault is present.

    Inside the window the fault begins with probability ``hazard[0]`` and ends with ``hazard[1]`` at each step. A fault that is
    not random has 1 and 0. ``age`` counts the steps since the onset.
    """
    hazard, _, on, age = course
    stays = select(transition[0] < hazard[1], 0.0, 1.0)
    comes = select(transition[0] < hazard[0], 1.0, 0.0)
    present = select(inside > HALF, select(on[0] > HALF, stays, comes), 0.0)
    age[0] = select(both(present > HALF, on[0] > HALF), age[0] + 1.0, 0.0)
    on[0] = present


def element(u, channel):
    """Return the element of `u` whose number is in ``channel[0]``; a NaN in another element has no effect."""
    value = select(channel[0] == 0, u[0], 0.0)
    for i in range(1, u.shape[0]):
        value = select(channel[0] == i, u[i], value)
    return value


def replace(u, channel, value, y):
    """Copy `u` to `y` with one element replaced."""
    for i in range(u.shape[0]):
        y[i] = select(channel[0] == i, value, u[i])


def due(k, every):
    """Return 1 at every n-th step, beginning with the first, else 0."""
    return select(k - every * floor(k / every) < 0.5, 1.0, 0.0)


def pause(k, channel, before, held, y):
    """Leave out a sample of a slow sensor that is not due, and keep what was held before; `channel`: number, and spacing."""
    now = due(k, channel[1])
    held[0] = select(now > HALF, held[0], before)
    for i in range(y.shape[0]):
        y[i] = select(both(channel[0] == i, now < HALF), NAN, y[i])


class Draws(NamedTuple):
    """Random numbers of a step: for begin and end, uniform and normal numbers of the fault, and for the choice of its kind."""

    transition: Floats
    chance: Floats
    noise: Floats
    pick: Floats


class Course(NamedTuple):
    """Probabilities of begin and end, step size, whether the fault is present, and since how many steps."""

    hazard: Floats
    step: Floats
    on: Floats
    age: Floats


class Kinds(NamedTuple):
    """Cumulative ``shares`` of the kinds, the present kind, and a row of settings and of memory for each kind."""

    shares: Floats
    chosen: Floats
    settings: Floats
    memory: Floats


COURSE, KINDS = named_alike(Course), named_alike(Kinds)
ONE, SEVERAL = named_alike(Draws, pick="chance"), named_alike(Draws)


@cache
def one_kind(kind: Value, inside: Value) -> Kernel:
    """Return the step function of a fault of one kind, which has a memory; ``settings`` and ``memory`` have one row.

    ``inside(t, window)`` states whether the window of the fault is open.
    """

    def fault(t, k, u, channel, draws, window, course, settings, memory, held, y, active):
        on, age = course.on, course.age
        gate(inside(t, window), draws.transition, course)
        sample = element(u, channel)
        before = select(k == 0, sample, held[0])
        value = kind(sample, before, age[0] * course.step[0], draws.chance[0], draws.noise[0], settings[0], memory[0])
        replace(u, channel, select(on[0] > HALF, value, sample), y)
        held[0] = select(on[0] > HALF, before, sample)
        active[0] = on[0]

    return fault


@cache
def several_kinds(kinds: tuple[Value, ...], inside: Value) -> Kernel:
    """Return the step function of a fault whose kind is drawn at every onset; ``settings`` and ``memory`` have a row for each."""
    value_of = _numbered(kinds, len(kinds) - 1)

    def fault(t, k, u, channel, draws, window, course, mixture, held, y, active, kind):
        on, age = course.on, course.age
        shares, chosen, settings, memory = mixture
        gate(inside(t, window), draws.transition, course)
        sample = element(u, channel)
        before = select(k == 0, sample, held[0])
        drawn = 0.0
        for i in range(shares.shape[0] - 1):  # the last share is 1, which no draw reaches
            drawn = drawn + select(draws.pick[0] >= shares[i], 1.0, 0.0)
        chosen[0] = select(age[0] == 0.0, drawn, chosen[0])
        chance, noise = draws.chance[0], draws.noise[0]
        value = value_of(chosen[0], sample, before, age[0] * course.step[0], chance, noise, settings, memory)
        replace(u, channel, select(on[0] > HALF, value, sample), y)
        held[0] = select(on[0] > HALF, before, sample)
        active[0] = on[0]
        kind[0] = select(on[0] > HALF, chosen[0], -1.0)

    return fault


@cache
def slow_kind(fault: Kernel) -> Kernel:
    """Return the step function of a fault of a slow sensor, given that of `one_kind`: the fault acts on samples that are due."""

    def slow(t, k, u, channel, draws, window, course, settings, memory, held, y, active):
        before = held[0]
        fault(t, k, u, channel, draws, window, course, settings, memory, held, y, active)
        pause(k, channel, before, held, y)

    return slow


@cache
def slow_kinds(fault: Kernel) -> Kernel:
    """Return the step function of a fault of a slow sensor, given that of `several_kinds`."""

    def slow(t, k, u, channel, draws, window, course, mixture, held, y, active, kind):
        before = held[0]
        fault(t, k, u, channel, draws, window, course, mixture, held, y, active, kind)
        pause(k, channel, before, held, y)

    return slow


def _numbered(kinds: tuple[Value, ...], last: int) -> Value:
    """Return a function that computes the kinds up to `last` and selects one by its number."""
    this = kinds[last]
    if last == 0:

        def first(number, sample, held, age, chance, noise, settings, memory):
            return this(sample, held, age, chance, noise, settings[0], memory[0])

        return first
    others = _numbered(kinds, last - 1)

    def value(number, sample, held, age, chance, noise, settings, memory):
        result = this(sample, held, age, chance, noise, settings[last], memory[last])
        return select(number == last, result, others(number, sample, held, age, chance, noise, settings, memory))

    return value
