"""The cases of the family as data: the shipped plants, and the faults of their sensors.

To add a case, add it to `CASES`; to add a plant, add it to `PLANTS`. A case without a sensor fault has no faults: then the oracle
is fixed precision with all sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi, sqrt
from typing import Any

from bayesftc import cosim

CAR = "car"


@dataclass(frozen=True)
class Plant:
    """A plant, its inputs and outputs, its references, and the time of its sensor faults."""

    fmu: str  # name of the shipped FMU
    goals: tuple[str, ...]  # the outputs with a goal, whose errors are evaluated
    references: tuple[cosim.Source, ...]  # their goals over time
    measured: tuple[str, ...]  # the outputs that sensors read, in turn
    actuated: tuple[str, ...]  # the inputs that the controller drives
    std: tuple[float, ...]  # standard deviation of a sensor of each measured output
    noise: Mapping[str, float]  # standard deviation of each disturbed input, by its name
    duration: float  # seconds of a run
    window: tuple[float, float]  # start and end of the faults in seconds
    # Acceptable error and control, for `bayesftc.controllers.design`; empty for the car, which has no designed controller.
    accept: tuple[float, ...] = ()
    limits: tuple[float, float] = (-inf, inf)  # of the control
    means: Mapping[str, float] = field(default_factory=dict)  # means of disturbed inputs that are not zero
    settled: float = 0.0  # seconds from which errors are evaluated: after a step that no controller follows at once
    dt: float | None = None  # sample time in seconds, by default the FMU's


PLANTS: Mapping[str, Plant] = {
    CAR: Plant(
        "CruiseControl",
        goals=("v",),
        references=(cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),),
        measured=("v",),
        actuated=("force",),
        std=(1.0,),
        noise={"disturbance": sqrt(0.001)},
        duration=20.0,
        window=(6.0, 14.0),
    ),
    "servo": Plant(
        "PositionServo",
        goals=("angle",),
        references=(cosim.Sine(amplitude=0.5, period=4.0),),
        measured=("angle",),
        actuated=("voltage",),
        std=(0.01,),
        noise={"load": 0.02},
        duration=10.0,
        window=(3.0, 7.0),
        accept=(0.1, 5.0),
        limits=(-12.0, 12.0),
    ),
    "masses": Plant(
        "TwoMasses",
        goals=("x2",),
        references=(cosim.Step(time=2.0, after=0.5),),
        measured=("x1", "x2"),
        actuated=("force1",),
        std=(0.01, 0.01),
        noise={"force2": 0.5},
        duration=12.0,
        window=(4.0, 9.0),
        accept=(0.05, 2.0),
        limits=(-10.0, 10.0),
        settled=4.0,
    ),
    "pendulum": Plant(
        "CartPendulum",
        goals=("position",),
        references=(cosim.Step(time=2.0, after=0.3),),
        measured=("position", "angle"),
        actuated=("force",),
        std=(0.005, 0.005),
        noise={"torque": 0.02},
        duration=12.0,
        window=(5.0, 9.0),
        accept=(0.1, 5.0),
        limits=(-15.0, 15.0),
        settled=5.0,
    ),
    "turbine": Plant(
        "HydroTurbine",
        goals=("power",),
        references=(cosim.Step(time=5.0, before=0.6, after=0.7),),
        measured=("power",),
        actuated=("command",),
        std=(0.01,),
        noise={"head": 0.01},
        duration=40.0,
        window=(10.0, 30.0),
        accept=(0.05, 0.1),
        limits=(0.2, 1.0),
        means={"head": 1.0},
        settled=10.0,
    ),
    "arm": Plant(
        "TwoLinkArm",
        goals=("q1", "q2"),
        references=(cosim.Sine(amplitude=0.3, period=4.0, offset=-pi / 2), cosim.Constant(0.0)),
        measured=("q1", "q2"),
        actuated=("torque1", "torque2"),
        std=(0.01, 0.01),
        noise={"torque1": 0.5, "torque2": 0.5},
        duration=8.0,
        window=(3.0, 6.0),
        accept=(0.01, 500.0),
        dt=0.01,
    ),
}
"""The plants by name, which is the prefix of their cases; all but car and arm as in ``examples/design_from_fmu``."""


HEALTHY, MOVING, SEVERAL = "healthy sensors", "dithers, gains, oscillations", "two sensors at once, or swapped"
NOISE_BELIEVED, PLANT_BELIEVED = "noise or resolution not as believed", "plant not as believed"
GROUPS: Mapping[str, tuple[type[cosim.Fault], ...]] = {
    HEALTHY: (),
    "freezes": (cosim.Freeze,),
    "offsets and drifts": (cosim.Injection, cosim.Bias, cosim.Drift),
    MOVING: (cosim.GainFault,),
    "filtered, late, clipped, rounded, stuck": (cosim.Lag, cosim.Delay, cosim.Clipping, cosim.Rounding, cosim.Stuck),
    "noise, spikes, dropout": (cosim.NoiseIncrease, cosim.Spikes, cosim.Dropout),
    SEVERAL: (),
    NOISE_BELIEVED: (),
    PLANT_BELIEVED: (),
}
"""Groups of cases by the kinds of their faults. Differences from the model and the number of failed sensors have priority."""


@dataclass(frozen=True)
class Case:
    """A case: a plant, its sensors, and the faults or differences from the controller's model.

    Attributes
    ----------
    name : str
        Description, with the plant first unless it is the car.
    faults : tuple of Fault
        Faults of sensors, each in its window.
    plant : str
        Name of the plant.
    sensors : int
        Number of sensors of each measured output.
    std : tuple of float
        True standard deviation of each sensor relative to the plant's, by default 1; one number is for all.
    believed : tuple of float
        The controller's values for `std`, by default the true ones.
    resolution : float
        Resolution of all sensors, in standard deviations; the controller's model has none.
    parameters : mapping
        True parameters of the plant that differ from the controller's model.
    reads : mapping of int to tuple of float
        Sensors that read another quantity from the first step on, with the factors of the measured outputs.
    """

    name: str
    faults: tuple[cosim.Fault, ...] = ()
    plant: str = CAR
    sensors: int = 2
    std: tuple[float, ...] = (1.0,)
    believed: tuple[float, ...] = ()
    resolution: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    reads: Mapping[int, tuple[float, ...]] = field(default_factory=dict)

    @property
    def group(self) -> str:
        """One of `GROUPS`, or ``"other faults"``."""
        if self.parameters:
            return PLANT_BELIEVED
        if self.believed or self.resolution:
            return NOISE_BELIEVED
        if len({fault.sensor for fault in self.faults} | set(self.reads)) > 1 or self.reads:
            return SEVERAL
        if not self.faults:
            return HEALTHY
        kinds = {type(fault) for fault in self.faults}
        if len(kinds) > 1 or any(getattr(fault, "amplitude", 0.0) for fault in self.faults):
            return MOVING
        return next((group for group, known in GROUPS.items() if kinds <= set(known)), "other faults")

    @property
    def missing(self) -> tuple[cosim.Dropout, ...]:
        """The faults for the oracle: the faulty samples are missing."""
        windows = dict.fromkeys((f.sensor, f.start, f.stop) for f in self.faults)
        windows |= dict.fromkeys((sensor, 0.0, inf) for sensor in self.reads)
        return tuple(
            cosim.Dropout(sensor=sensor, start=start, stop=stop, name=f"missing_{i}")
            for i, (sensor, start, stop) in enumerate(windows)
        )


def _car() -> Iterator[Case]:
    def when(sensor: int = 0, start: float = 6.0, stop: float = 14.0) -> dict[str, Any]:
        return {"sensor": sensor, "start": start, "stop": stop}

    def offset(size: float, **of: Any) -> cosim.Fault:
        return cosim.Injection(magnitude=size, **when(**of))

    def dithered(size: float) -> tuple[cosim.Fault, ...]:
        return cosim.Freeze(**when()), cosim.NoiseIncrease(std=size, **when())

    def on_and_off(fault: cosim.Fault) -> tuple[cosim.Fault, ...]:
        return tuple(
            replace(fault, start=start, stop=start + 1.0, name=f"{fault.default_name}_from_{start:g}")
            for start in (6.0, 8.0, 10.0, 12.0)
        )

    yield Case("healthy")
    yield Case("freeze", faults=(cosim.Freeze(**when()),))
    for size in (0.1, 0.2, 0.3, 0.5):
        yield Case(f"freeze with dither of {size:g} sd", faults=dithered(size))
    for size in (1.0, 2.0, 3.0, 5.0, 7.0, 10.0):
        yield Case(f"injection of {size:g} sd", faults=(offset(size),))
    for slope in (0.5, 1.0, 2.0, 5.0, 8.0):
        yield Case(f"drift of {slope:g} sd per second", faults=(cosim.Drift(slope=slope, **when()),))
    for factor in (0.5, 0.7, 0.9, 1.3):
        yield Case(f"gain of {factor:g}", faults=(cosim.GainFault(factor=factor, **when()),))
    for period, size in ((0.2, 5.0), (0.5, 5.0), (1.0, 5.0), (3.0, 4.0), (8.0, 4.0)):
        swing = cosim.Injection(amplitude=size, period=period, **when())
        yield Case(f"oscillation of {size:g} sd, period {period:g} s", faults=(swing,))
    for times in (2.0, 5.0):
        yield Case(f"noise {times:g} times", faults=(cosim.NoiseIncrease(std=added_noise(times), **when()),))
    yield Case("spikes of 10 sd in 5 % of samples", faults=(cosim.Spikes(magnitude=10.0, probability=0.05, **when()),))
    for seconds in (0.1, 0.5, 2.0):
        yield Case(f"low-pass of {seconds:g} s", faults=(cosim.Lag(time_constant=seconds, **when()),))
    for seconds in (0.1, 0.5):
        yield Case(f"delay of {seconds:g} s", faults=(cosim.Delay(delay=seconds, **when()),))
    yield Case("clips above the mean speed", faults=(cosim.Clipping(high=20.0, **when()),))
    yield Case("clips above the mean speed plus 4 sd", faults=(cosim.Clipping(high=24.0, **when()),))
    for size in (0.5, 1.0, 2.0):
        yield Case(f"rounds to {size:g} sd", faults=(cosim.Rounding(resolution=size, **when()),))
    yield Case("dropout", faults=(cosim.Dropout(**when()),))
    yield Case("bias of 3 sd from the first step", faults=(cosim.Bias(magnitude=3.0, sensor=0),))
    yield Case("stuck at 0", faults=(cosim.Stuck(at=0.0, **when()),))
    yield Case("reads the negated speed", faults=(cosim.GainFault(factor=-1.0, **when()),))
    yield Case("freeze on and off every second", faults=on_and_off(cosim.Freeze(**when())))
    yield Case("injection of 5 sd on and off every second", faults=on_and_off(offset(5.0)))
    yield Case("freeze from the first step", faults=(cosim.Freeze(**when(start=0.0)),))
    yield Case("injection of 5 sd from the first step", faults=(offset(5.0, start=0.0),))
    yield Case("both sensors: injections of +5 sd", faults=(offset(5.0), offset(5.0, sensor=1)))
    yield Case("both sensors: injections of +5 and -5 sd", faults=(offset(5.0), offset(-5.0, sensor=1)))
    yield Case("both sensors: freeze", faults=(cosim.Freeze(**when()), cosim.Freeze(**when(1))))
    for sensors in (3, 5):
        of = f", {sensors} sensors"
        yield Case(f"healthy{of}", sensors=sensors)
        yield Case(f"freeze{of}", faults=(cosim.Freeze(**when()),), sensors=sensors)
        yield Case(f"freeze with dither of 0.3 sd{of}", faults=dithered(0.3), sensors=sensors)
        yield Case(f"injection of 3 sd{of}", faults=(offset(3.0),), sensors=sensors)
        yield Case(f"drift of 2 sd per second{of}", faults=(cosim.Drift(slope=2.0, **when()),), sensors=sensors)
        yield Case(f"gain of 0.7{of}", faults=(cosim.GainFault(factor=0.7, **when()),), sensors=sensors)
        for other, name in ((6.0, "+6 and +6 sd"), (-8.0, "+6 and -8 sd")):
            pair = offset(6.0), offset(other, sensor=1)
            yield Case(f"two at once: injections of {name}{of}", faults=pair, sensors=sensors)
        pair = cosim.Freeze(**when()), cosim.Freeze(**when(1))
        yield Case(f"two at once: freeze{of}", faults=pair, sensors=sensors)
    yield Case("car 40 % heavier than believed, healthy", parameters={"m": 140.0})
    yield Case("car 40 % lighter than believed, healthy", parameters={"m": 60.0})
    unequal = (1.0, 0.3)
    yield Case("unequal noise, healthy", std=unequal)
    yield Case("unequal noise, injection of 1 sd on the worse", faults=(offset(1.0),), std=unequal)
    yield Case("unequal noise, injection of 3 sd on the worse", faults=(offset(3.0),), std=unequal)
    yield Case("unequal noise, injection of 3 sd on the better", faults=(offset(0.9, sensor=1),), std=unequal)
    yield Case("unequal noise, freeze of the better", faults=(cosim.Freeze(**when(1)),), std=unequal)
    for times, word in ((2.0, "noisier than"), (0.5, "less noisy than")):
        of = f"sensors 2 times {word} believed"
        yield Case(f"{of}, healthy", std=(times,), believed=(1.0,))
        yield Case(f"{of}, injection of 3 sd", faults=(offset(3.0 * times),), std=(times,), believed=(1.0,))
        yield Case(f"{of}, freeze", faults=(cosim.Freeze(**when()),), std=(times,), believed=(1.0,))
        drift = cosim.Drift(slope=8.0, **when())
        yield Case(f"{of}, drift of {8.0 / times:g} sd per second", faults=(drift,), std=(times,), believed=(1.0,))
    yield Case("resolution of 1 sd untold, healthy", resolution=1.0)
    yield Case("resolution of 1 sd untold, injection of 3 sd", faults=(offset(3.0),), resolution=1.0)
    yield Case("resolution of 1 sd untold, freeze", faults=(cosim.Freeze(**when()),), resolution=1.0)


def added_noise(times: float) -> float:
    """Return the standard deviation of added noise that makes a noise of 1 `times` as large."""
    return sqrt(times * times - 1.0)


def _of_plant(name: str, sensor: int, lag: float) -> Iterator[Case]:
    """Yield the cases of a plant in which one sensor fails; `lag` is its time constant as a low-pass, in seconds."""
    plant = PLANTS[name]
    sd = plant.std[sensor % len(plant.std)]
    when: dict[str, Any] = dict(zip(("sensor", "start", "stop"), (sensor, *plant.window), strict=True))

    def case(words: str, *faults: cosim.Fault, **of: Any) -> Case:
        return Case(f"{name}: {words}", faults=faults, plant=name, **of)

    freeze = cosim.Freeze(**when)
    yield case("healthy")
    yield case("freeze", freeze)
    yield case("freeze with dither of 0.2 sd", freeze, cosim.NoiseIncrease(std=0.2 * sd, **when))
    yield case("gain of 0.7", cosim.GainFault(factor=0.7, **when))
    for size in (3.0, 10.0):
        yield case(f"injection of {size:g} sd", cosim.Injection(magnitude=size * sd, **when))
    yield case("drift of 2 sd per second", cosim.Drift(slope=2.0 * sd, **when))
    yield case("oscillation of 5 sd, period 1 s", cosim.Injection(amplitude=5.0 * sd, period=1.0, **when))
    yield case("noise 10 times", cosim.NoiseIncrease(std=added_noise(10.0) * sd, **when))
    yield case(f"low-pass of {lag:g} s", cosim.Lag(time_constant=lag, **when))
    yield case("stuck at 0", cosim.Stuck(at=0.0, **when))
    if len(plant.measured) > 1:
        one, other = plant.measured
        yield case(f"a sensor of {other} reads {one}", reads={1: (1.0, 0.0)})
        yield case(f"sensors of {one} and {other} swapped", reads={0: (0.0, 1.0), 1: (1.0, 0.0)})


def _others() -> Iterator[Case]:
    yield from _of_plant("servo", 0, 0.5)
    yield from _of_plant("masses", 1, 0.2)
    yield from _of_plant("pendulum", 1, 0.1)
    for part, parameter, mass in (("cart", "M_cart", 0.5), ("pendulum", "m", 0.2)):
        for times, word in ((1.4, "heavier"), (0.6, "lighter")):
            name = f"pendulum: {part} 40 % {word} than believed, healthy"
            yield Case(name, plant="pendulum", parameters={parameter: times * mass})
    yield from _of_plant("turbine", 0, 2.0)
    yield from _of_plant("arm", 0, 0.2)


CASES: tuple[Case, ...] = (*_car(), *_others())
"""All cases, with unique names."""
