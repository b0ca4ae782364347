"""The base of all faults: channel, window, ports and state."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import partial
from math import inf, isfinite
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import check_count, real
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.faults import kernels
from bayesftc.cosim.blocks.faults.conditions import BY_HAND, HAND, When, Window, conditional
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Kernel

DRAWS: Mapping[str, Literal["uniform", "normal"]] = {
    "transition": "uniform",
    "pick": "uniform",
    "chance": "uniform",
    "noise": "normal",
}


@dataclass(frozen=True, kw_only=True)
class Fault(Block):
    """Base of all faults.

    Input ``u``, outputs ``y`` (both of shape (channels,)) and ``active`` (1 while the fault is present, else 0). While
    the fault is absent, ``y`` is ``u`` (a negative zero becomes a positive one). The other channels are always unchanged. A
    missing sample (NaN) passes through like any other. It has no effect on the times at which the fault begins and ends.

    Parameters
    ----------
    sensor : int
        Number of the channel, from 0; 0 for a scalar input of a plant.
    start, stop : float, When or str
        Seconds: the fault can be present while start <= t < stop. Or conditions on a signal, such as ``"plant.v > 22"``, which
        stands for ``cosim.when("plant.v", ">", 22.0)``: the fault can be present from the step at which the start condition is
        fulfilled until the step at which the stop condition is fulfilled. The fault can begin again each time the start condition
        is fulfilled anew. While the stop condition is fulfilled, the fault cannot begin. Or start="by hand": the fault is present
        while its input ``start_signal`` is set to 1, as by `Session.set`.
    duration : float
        Seconds from the start to the end of the fault, rounded to whole steps, at least one; a stop may end it before.
    latching : bool
        Whether the fault remains when the condition of its start is no longer fulfilled, until its stop or duration.
    mean_time_to_fault, mean_time_to_recovery : float, optional
        Mean seconds until the fault begins, and until it ends again; give both, or none of them. If given, the fault begins and
        ends at random in the window from `start` to `stop`: at every step with the probabilities step / mean_time_to_fault and
        step / mean_time_to_recovery. Else it is present in the whole window.
    channels : int, optional
        Length of the signal; `closed_loop` sets it.
    spacing : int
        For a slow sensor, the number of steps from one sample to the next; `closed_loop` sets it from ``every`` of its `Sensors`.
        The fault acts on these samples alone: a `Freeze` repeats the last sample at the steps at which the sensor has samples.
    name : str, optional
        Name in the diagram, by default kind and channel (``freeze_0``). The random numbers depend on this name, and not on
        the order or the number of the faults.

    Raises
    ------
    ModelError
        If a setting is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=1.0)
    >>> source = diagram.add(cosim.Ramp(1.0), "source")
    >>> fault = diagram.add(cosim.Stuck(at=0.0, start=cosim.when("source.y >= 2"), duration=3.0, channels=1), "fault")
    >>> diagram.connect(source["y"], fault["u"])
    >>> run = diagram.simulate(6.0, engine="interpreted")
    >>> run["fault.y"][:, 0].tolist(), run["fault.active"].tolist()
    ([0.0, 1.0, 0.0, 0.0, 0.0, 5.0, 6.0], [0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    """

    value: ClassVar[Callable[..., Any]]
    draws: ClassVar[tuple[str, ...]] = ()
    remembers: ClassVar[bool] = False

    sensor: int = 0
    start: float | When | str = field(default=0.0, metadata={"unit": "s"})
    stop: float | When | str = field(default=inf, metadata={"unit": "s"})
    duration: float = field(default=inf, metadata={"unit": "s"})
    latching: bool = True
    mean_time_to_fault: float | None = None
    mean_time_to_recovery: float | None = None
    channels: int | None = None
    spacing: int = 1
    name: str | None = None

    def __post_init__(self) -> None:
        kind = type(self).__name__
        for which in ("start", "stop"):
            if isinstance(text := getattr(self, which), str):
                if (condition := When.read(text)) is None:
                    ways = (
                        ", a condition such as 'plant.v > 22', or 'by hand'" if which == "start" else ", or a condition"
                    )
                    raise ModelError(f"{kind} has {which}={text!r}; it must be seconds{ways}.")
                object.__setattr__(self, which, condition)
        if self.stop == BY_HAND:
            raise ModelError(f"{kind} has stop={HAND!r}; give start={HAND!r}, which ends the fault by hand, too.")
        if not (real(self.sensor) >= 0 and real(self.sensor).is_integer()):
            raise ModelError(f"{kind} has sensor={brief(self.sensor)}; it must be the number of a channel, from 0.")
        if self.channels is not None and not (real(self.channels) >= 1 and real(self.channels).is_integer()):
            raise ModelError(f"{kind} has channels={brief(self.channels)}; it must be a whole number, at least 1.")
        check_count(self, "spacing")
        if self.channels is not None and self.sensor >= self.channels:
            raise ModelError(
                f"{kind} refers to sensor {self.sensor}, but there are {self.channels}, numbered from 0; "
                f"use a number up to {self.channels - 1}."
            )
        if isinstance(self.stop, When) and self.stop.after:
            raise ModelError(
                f"{kind} has a stop with after={brief(self.stop.after)}; leave it out, because only a start has such a time."
            )
        start, stop = self.times
        if not isfinite(start) or not start < stop:
            raise ModelError(
                f"{kind} has start={brief(self.start)} and stop={brief(self.stop)}; the start must be finite and before "
                "the stop. Each is a number of seconds, or a condition such as cosim.when('plant.v', '>', 22.0)."
            )
        if start < 0 or stop <= 0:
            raise ModelError(
                f"{kind} has start={brief(self.start)} and stop={brief(self.stop)}, but a run begins at 0 s. Give start=0 for a "
                "fault that is present from the beginning."
            )
        if not real(self.duration) > 0:
            raise ModelError(f"{kind} has duration={brief(self.duration)}; it must be a positive number of seconds.")
        if not isinstance(self.latching, bool) or not (self.latching or isinstance(self.start, When)):
            raise ModelError(
                f"{kind} has latching={brief(self.latching)} and start={brief(self.start)}; latching must be True or False, "
                "and False only where the start is a condition, such as cosim.when('plant.v', '>', 22.0)."
            )
        if (self.mean_time_to_fault is None) != (self.mean_time_to_recovery is None):
            raise ModelError(
                f"{kind} has only one of mean_time_to_fault and mean_time_to_recovery; give both or neither."
            )
        for which in ("mean_time_to_fault", "mean_time_to_recovery"):
            mean = getattr(self, which)
            if mean is not None and not 0 < real(mean) < inf:
                raise ModelError(f"{kind} has {which}={brief(mean)}; it must be a positive, finite number of seconds.")
        self.check()

    def check(self) -> None:
        """Raise a ModelError if one of the settings of this kind is wrong."""
        names = [f.name for f in fields(self) if f.name not in COMMON]
        for name, value in zip(names, self.settings, strict=True):
            if not isfinite(value):
                raise ModelError(
                    f"{type(self).__name__} has {name}={brief(getattr(self, name))}; it must be a finite number."
                )

    @property
    def settings(self) -> tuple[float, ...]:
        """The settings of this kind alone, in the order of its fields."""
        values = (getattr(self, f.name) for f in fields(self) if f.name not in COMMON)
        return tuple(float(value) if isinstance(value, bool) else real(value) for value in values)

    @property
    def permanent(self) -> bool:
        """Whether the fault is present from the first to the last step of every run."""
        whole = not isinstance(self.start, When) and not isinstance(self.stop, When) and self.mean_time_to_fault is None
        return whole and self.start <= 0.0 and self.stop == self.duration == inf  # type: ignore[operator]

    def numbers(self, step: Fraction) -> tuple[float, ...]:
        """Return the settings as the value function of this kind gets them, at a sample time of `step` seconds."""
        return self.settings

    def memory(self, step: Fraction) -> int:
        """Return how many numbers the value function keeps, if ``remembers`` is true."""
        return 1

    @classmethod
    def kernel(cls) -> Callable[..., Any]:
        """Return the value function of this kind, with an argument ``memory``."""
        return cls.value if cls.remembers else kernels.without_memory(cls.value)

    @property
    def default_name(self) -> str:
        """The given name, else kind and channel, such as ``noise_increase_1``."""
        return self.name or re.sub(r"(?<!^)(?=[A-Z])", "_", type(self).__name__).lower() + f"_{self.sensor}"

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``, the signals of conditions, and the random inputs of this fault."""
        used = {*self.drawn, *(() if self.mean_time_to_fault is None else ("transition",))}
        signals = (
            Port(
                f"{name}_signal",
                feedthrough=not condition.delayed,
                default=None if condition.signal else 0.0,
                description=f"The signal that decides on the {name}",
            )
            for name, condition in self._conditions.items()
        )
        return (self.signal, *signals, *(Port(n, draw=draw) for n, draw in DRAWS.items() if n in used))

    @property
    def drawn(self) -> tuple[str, ...]:
        """The random numbers that a faulty value needs."""
        return self.draws

    @property
    def named_sources(self) -> Mapping[str, str]:
        """See `Block.named_sources`: the signals of conditions."""
        return {f"{name}_signal": each.signal for name, each in self._conditions.items() if each.signal}

    @property
    def _conditions(self) -> dict[str, When]:
        """The conditions among start and stop."""
        return {name: each for name, each in (("start", self.start), ("stop", self.stop)) if isinstance(each, When)}

    @property
    def _window(self) -> Window:
        if not self._conditions and self.duration == inf:
            return Window(kernels.scheduled, {"window": self.times})
        return conditional(self._conditions, self.times, self.duration, self.latching and self.start != BY_HAND)

    @property
    def times(self) -> tuple[float, float]:
        """Earliest start and latest stop, in seconds; for conditions ``after`` and infinity. The duration does not count."""
        start, stop = self.start, self.stop
        return real(start.after if isinstance(start, When) else start), inf if isinstance(stop, When) else real(stop)

    @property
    def signal(self) -> Port:
        """Input ``u``."""
        return Port("u", self.shape, description="The signal before the fault")

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``y`` and ``active``."""
        return (
            Port("y", self.shape, description="The signal; one channel is faulty while the fault is present"),
            Port("active", description="1 while the fault is present, else 0"),
        )

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        settings, memory = [[*self.numbers(step), 0.0]], np.zeros((1, self.memory(step)))
        records = {"draws": kernels.ONE, "course": kernels.COURSE}
        kernel = partial(kernels.one_kind, self.kernel())
        return self.assembled(kernel, kernels.slow_kind, step, {"settings": settings}, memory, self.remembers, records)

    def assembled(
        self,
        kernel: Callable[[Kernel], Kernel],
        slow: Callable[[Kernel], Kernel],
        step: Fraction,
        parameters: Mapping[str, ArrayLike],
        memory: ArrayLike,
        remembers: bool,
        records: Mapping[str, tuple[Any, ...]],
        **state: ArrayLike,
    ) -> Definition:
        """Return the definition with the window of the fault.

        Parameters
        ----------
        kernel : callable
            Returns the step function, given the function that states whether the window is open.
        slow : callable
            Returns the step function for a slow sensor, given that one.
        step : Fraction
            Sample time in seconds.
        parameters, records, **state : mappings
            Those of the kinds.
        memory : array
            The memory of the value functions; a state if one of them `remembers`.
        """
        window, kept = self._window, {"memory": memory}
        fault = kernel(window.inside)
        return Definition(
            fault if self.spacing == 1 else slow(fault),
            window.update,
            state={**STATE, **state, **window.state, **(kept if remembers else {})},
            parameters={
                **self.common_parameters(step),
                **window.parameters,
                **parameters,
                **({} if remembers else kept),
            },
            records={**records, **window.records},
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of ``u`` and ``y``."""
        if self.channels is None:
            raise ModelError(
                f"{type(self).__name__} has no length of its signal; give it channels=..., or put it "
                "into the list of faults of closed_loop."
            )
        return (self.channels,)

    def common_parameters(self, step: Fraction) -> dict[str, ArrayLike]:
        """Return the parameters of the step functions of all faults, at a sample time of `step` seconds."""
        hazard = [1.0, 0.0]
        if self.mean_time_to_fault is not None and self.mean_time_to_recovery is not None:
            hazard = [float(step) / self.mean_time_to_fault, float(step) / self.mean_time_to_recovery]
            if max(hazard) > 1.0:
                raise ModelError(
                    f"{type(self).__name__} has mean times of {self.mean_time_to_fault:g} s to the fault and "
                    f"{self.mean_time_to_recovery:g} s to recovery; neither can be shorter than a step of "
                    f"{show(step)} s."
                )
        inputs = {port.name for port in self.inputs}
        return {
            "channel": self.sensor if self.spacing == 1 else [self.sensor, self.spacing],
            "hazard": hazard,
            "step": float(step),
            **{name: 0.5 for name in DRAWS if name not in inputs},  # a constant replaces each number that is not drawn
        }


COMMON = frozenset(f.name for f in fields(Fault))
STATE: Mapping[str, ArrayLike] = {"on": 0.0, "age": 0.0, "held": 0.0}
