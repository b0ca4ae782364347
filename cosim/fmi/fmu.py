"""FMUs as blocks: plants from any tool, or exported controllers; FMI 1.0, 2.0 or 3.0, co-simulation or model exchange."""

from __future__ import annotations

import re
import warnings
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any, Literal, cast

from bayesftc.cosim.array_ports import gathered, scattered
from bayesftc.cosim.base.units import UnitDefinition, difference
from bayesftc.cosim.block import External, ExternalBlock
from bayesftc.cosim.errors import FMUError, FMUVersionError, ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.binaries.library import Beginning
from bayesftc.cosim.fmi.exchange.settings import checked_settings
from bayesftc.cosim.fmi.reading.archive import Archive, absolute, open_archive
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable, Given, Value, read_description
from bayesftc.cosim.fmi.reading.ports import WATCHED, choose, choose_tunable, late_outputs, ticking_clocks
from bayesftc.cosim.fmi.running.values import as_floats, resolved, start_values, value_of
from bayesftc.cosim.isolation.settings import check_isolation
from bayesftc.cosim.ports import Port, listed


@dataclass(frozen=True)
class FMU(ExternalBlock):
    """An FMU of FMI 1.0, 2.0 or 3.0; its inputs and outputs that are numbers become ports.

    The file is read and checked when the block is made. When a run begins, the file is unpacked (once per machine) and its
    binary is loaded (once per process). Each run has a new instance. Time starts at 0 and has no end.

    Parameters
    ----------
    path : str or path
        The ``.fmu`` file.
    parameters : mapping, optional
        Start values by name, of parameters and of whatever else may be set before initialization. An unconnected input keeps
        its start value. Numbers are in the variables' units, or have a unit: ``"100 km/h"`` or ``(30, "deg")``. Units are the
        FMU's and those of pint. Arrays are nested sequences, row by row; ``"K[0,1]"`` is one element. Structural
        parameters set the sizes of arrays.
        Enumerations are names or numbers. After construction: plain values in the variables' units.
    inputs, outputs : sequence of str or Port, optional
        Names of the variables that become ports; by default all inputs and outputs that are numbers. If the
        FMU declares no unit for a variable, a port such as ``Port("level", unit="m")`` gives it one, also in `parameters`. Local
        variables and parameters may be outputs as well. Arrays become vector and matrix ports. Whole numbers, Booleans (0 or 1)
        and enumerations are converted exactly. An input value that its type cannot represent stops the run. An input that is left
        out keeps its start value. After construction: the ports.
    tunable : sequence of str, optional
        Names of tunable parameters that become inputs, so that a source can change them while the FMU runs. Unconnected ones
        keep their start value.
    timing : {"plant", "direct", "sampled"}, optional
        ``"plant"``: the outputs at t_k are read before the step from t_k to t_k+1, which uses the inputs at t_k.
        ``"sampled"``: the FMU makes its step with the inputs at t_k, and its outputs count at t_k, as a controller's do.
        ``"direct"``, for model exchange only: the outputs at t_k are computed from the inputs at t_k, before the step. Inputs
        on which an output depends feed through. The default is the timing that the description states (exports of this package
        state one). Else it is ``"direct"`` for model exchange if an output depends on an input or no dependencies are
        declared, and ``"plant"`` otherwise.
    name : str, optional
        Name of the block in a diagram; by default the model's name in lower case.
    validate : bool
        False to accept a model description that breaks the rules of FMI, at your own risk.
    kind : {"co-simulation", "model exchange"}, optional
        How to use the FMU. The default is co-simulation if the FMU supports it, else model exchange. In model exchange, its
        ordinary differential equations and events are solved here.
    solver : str, optional
        For model exchange: ``"cvode"`` (default), for any plant; ``"rk45"`` (Runge-Kutta), faster and more accurate for plants
        that are not stiff; or ``"scipy:METHOD"`` with a method of ``scipy.integrate.solve_ivp``, as ``"scipy:LSODA"``.
    rtol : float, optional
        Relative tolerance; by default that of the FMU's default experiment. In model exchange, the integrator uses it; if there
        is none, it uses 1e-6. In co-simulation, the FMU gets it; if there is none, the FMU gets no tolerance.
    atol : float, optional
        For model exchange: absolute tolerance of all states; by default rtol times each state's nominal value.
    isolate : bool
        Run each instance in a separate process: a crash ends the FMU's process, not yours, and raises `FMUCrashed`. Linux
        only; an `FMUError` elsewhere.
    time_limit : float, optional
        With `isolate`: seconds that a call of the FMU (its initialization, or one step) may take. After that its process is
        ended. 10 by default, ``math.inf`` for no limit.
    arrays : bool
        True: numbers with the names of an array's elements, such as ``y[0]`` and ``y[1]``, become one port ``y``. FMI 1.0 and
        2.0 have no arrays, so exports of this package for FMI 2.0 have such names. `parameters` still has the elements.

    Raises
    ------
    FMUError
        If the file is missing or damaged, is no FMU of FMI 1.0, 2.0 or 3.0 of that kind, or has no binary for this platform.
        If a variable cannot be used as requested.
    ModelError
        If a solver or tolerance is not valid, or a solver or absolute tolerance is given for co-simulation.
    UnknownNameError
        If the FMU has no variable of that name.

    Warns
    -----
    UserWarning
        If the FMU declares that outputs depend on inputs of the same instant, but is used for co-simulation with the timing
        ``"plant"`` by default. Such outputs show the inputs of the previous step.

    Examples
    --------
    >>> from bayesftc import cosim, fmus
    >>> car = cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 120.0})
    >>> [port.name for port in car.inputs], [port.name for port in car.outputs]
    (['force', 'disturbance'], ['v'])
    """

    path: str | PathLike[str]
    parameters: Mapping[str, Given] | None = field(default=None, kw_only=True, hash=False)
    inputs: Sequence[str | Port] | None = field(default=None, kw_only=True)  # type: ignore[assignment]
    outputs: Sequence[str | Port] | None = field(default=None, kw_only=True)  # type: ignore[assignment]
    timing: Literal["plant", "direct", "sampled"] | None = field(default=None, kw_only=True)
    name: str | None = field(default=None, kw_only=True)
    tunable: Sequence[str] = field(default=(), kw_only=True)
    validate: bool = field(default=True, kw_only=True)
    kind: Literal["co-simulation", "model exchange"] | None = field(default=None, kw_only=True)
    solver: str | None = field(default=None, kw_only=True)
    rtol: float | None = field(default=None, kw_only=True)
    atol: float | None = field(default=None, kw_only=True)
    isolate: bool = field(default=False, kw_only=True)
    time_limit: float | None = field(default=None, kw_only=True)
    arrays: bool = field(default=False, kw_only=True)

    @property
    def checks_finite(self) -> bool:  # type: ignore[override]
        """Whether a NaN in the outputs stops the run: true for plants, false for exported controllers (a missing sample)."""
        return self.description.timing != "sampled" and self.description.finite

    def __post_init__(self) -> None:
        if self.timing not in (None, "plant", "direct", "sampled"):
            raise ModelError(f"FMU has timing={self.timing!r}; it must be 'plant', 'direct' or 'sampled'.")
        check_isolation(self.isolate, self.time_limit)
        path = absolute(self.path, "FMU", "an .fmu file", ModelError)
        if self.name is not None and not isinstance(self.name, str):
            raise ModelError(f"FMU has name={self.name!r}; it must be a string, as 'plant'.")
        if not isinstance(self.validate, bool):
            raise ModelError(f"FMU has validate={self.validate!r}; it must be True or False.")
        if not isinstance(self.arrays, bool):
            raise ModelError(f"FMU has arrays={self.arrays!r}; it must be True or False.")
        set_ = object.__setattr__
        set_(self, "path", path)
        archive, description = self._read()
        if description.lax:
            warnings.warn(description.lax, stacklevel=3)  # at the line that makes the block
        kind = _chosen_kind(archive, description, self.kind)
        exchange = kind == "model exchange"
        set_(self, "kind", kind)
        if exchange:
            _check_clocks(archive, description)
        settings = checked_settings(archive, description, exchange, self.solver, self.rtol, self.atol)
        for name, value in settings.items():
            set_(self, name, value)
        requested = self.timing
        if requested == "direct" and not exchange:
            raise ModelError(
                f"FMU has timing='direct', but {archive.path.name} is used for co-simulation. There outputs cannot show inputs "
                "of the same instant without a step. Give timing='plant' or 'sampled', or kind='model exchange'."
            )
        default = "direct" if exchange else "plant"
        set_(self, "timing", requested or description.timing or default)
        set_(self, "name", self.name or "".join(description.name.lower().split()))
        units = self._units_of_ports("inputs") | self._units_of_ports("outputs")
        given = start_values(archive, description, self.parameters or {}, units, validate=self.validate)
        set_(self, "parameters", given)
        set_(self, "tunable", tuple(self.tunable) if isinstance(self.tunable, list | tuple) else self.tunable)
        variables = resolved(archive, description, self._given)
        chosen = {
            side: choose(
                archive,
                variables,
                side,
                self._without_tunable(f"{side}s"),
                ticking_clocks(description, side, exchange=exchange),
            )
            for side in ("input", "output")
        }
        chosen["input"] += choose_tunable(archive, variables, self.tunable)
        states = {v.name for v in description.exchange.states} if exchange and description.exchange else set()
        # A state, or a parameter, depends on no input of the same instant.
        independent = states | {v.name for v in chosen["output"] if "arameter" in v.causality}
        dependencies = [() if v.name in independent else description.feedthrough.get(v.name) for v in chosen["output"]]
        reaching = {
            # The model structure lists inputs only: an output may depend on any tunable parameter.
            v.name
            for v in chosen["input"]
            if any(names is None or v.name in names or v.causality == "parameter" for names in dependencies)
        }
        if requested is None and self.timing == "direct" and not reaching:
            set_(self, "timing", "plant")  # the same without feedthrough
        resized = {v.name for v in description.variables if v.start is not None}
        for side, ports in chosen.items():
            scalars = tuple(self._port(v, side, reaching, description.units, resized, units) for v in ports)
            set_(self, f"_{side}s", scalars)
            set_(self, f"{side}s", gathered(scalars) if self.arrays else scalars)
        if requested is None and self.timing == "plant" and not exchange:
            late = late_outputs(archive, description, *self._sides)
            if late:
                warnings.warn(late, stacklevel=3)  # at the line that makes the block

    def __repr__(self) -> str:
        settings = [
            Path(self.path).name,
            str(self.kind),
            f"timing={self.timing!r}",
            *(["isolated"] if self.isolate else []),
        ]
        if self.parameters:
            settings.append(f"parameters={dict(self.parameters)!r}")
        into, out = listed(self._ports("input")), listed(self._ports("output"))
        return f"<FMU {', '.join(settings)}: {into} -> {out}>"

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return str(self.name)

    @property
    def description(self) -> FMUDescription:
        """The FMU's model description."""
        return self._read()[1]

    @property
    def traits(self) -> Mapping[str, Any]:
        """What an exported controller says about itself beside its ports."""
        return self.description.traits

    def start_value(self, name: str) -> Value | None:
        """Return the value of a variable before initialization: from `parameters`, else from the model description.

        Parameters
        ----------
        name : str
            Name of the variable.

        Returns
        -------
        float, int, bool, str or tuple, or None
            In the variable's unit; of an array, tuples of tuples. None if the FMU computes it, and for an array whose size
            structural parameters have changed.

        Raises
        ------
        UnknownNameError
            If the FMU has no variable of that name.

        Examples
        --------
        >>> from bayesftc import cosim, fmus
        >>> arm = cosim.FMU(fmus.path("TwoLinkArm"), parameters={"L2": 0.8})
        >>> arm.start_value("L1"), arm.start_value("L2")
        (1.0446, 0.8)
        """
        variables = resolved(*self._read(), self._given)
        starts: dict[str, Value | None] = {v.name: v.start for v in variables.values()} | dict(self._given)
        if name not in starts:
            raise UnknownNameError(
                f"The FMU {Path(self.path).name} has no variable {name!r}; {did_you_mean(name, starts)}"
            )
        return starts[name]

    @property
    def only_recorded(self) -> int:
        """See `Block.only_recorded`."""
        count: int = vars(self).get("_only_recorded", 0)
        return count

    def watching(self, names: Iterable[str], *, only_recorded: bool = False) -> FMU:
        """See `Block.watching`: an FMU has local variables and parameters."""
        variables = {v.name: v for v in self.description.variables}
        present = {port.name for side in self._sides for port in side}
        # In FMI 2 ``body.r[1]`` is the name of a variable; in FMI 3 it may be an element of ``body.r``.
        variable_names = [name if name in variables else re.sub(r"\[[\d,]+\]$", "", name) for name in names]
        further = [
            n
            for n in variable_names
            if n in variables and n not in present and variables[n].causality in ("output", *WATCHED)
        ]
        if not further:
            return self
        watching = replace(self, outputs=[*self._sides[1], *dict.fromkeys(further)])
        # Recording further outputs must not change the order of computation: the inputs keep their feedthrough.
        object.__setattr__(watching, "inputs", self.inputs)
        if only_recorded:
            more = sum(port.size for port in watching._sides[1]) - sum(port.size for port in self._sides[1])
            object.__setattr__(watching, "_only_recorded", self.only_recorded + more)
        return watching

    def instantiate(self, step: Fraction, name: str) -> External:
        """Return a new initialized instance that makes steps of `step` seconds. Close it in the end.

        Raises
        ------
        FMUError
            If the binary cannot be loaded, or the FMU's instantiation or initialization fails.
        StepSizeError
            If the FMU has a fixed step size, and `step` is no multiple of it.
        FMUCrashed
            If the FMU is isolated and its process crashes or exceeds the time limit.
        """
        if self.isolate:
            from bayesftc.cosim.isolation.instance import isolated

            return isolated(self, self._read()[0], step, name, self.time_limit)
        archive, description = self._read()
        beginning, outputs = self._variables()
        timing = self.timing or "plant"
        if self.kind == "model exchange":
            from bayesftc.cosim.fmi.binaries.model_library import load_model
            from bayesftc.cosim.fmi.exchange.integrators.instance import exchange_instance

            model, solver = load_model(archive, description), self.solver or "cvode"
            return exchange_instance(model, name, step, timing, beginning, outputs, solver, self.atol)
        from bayesftc.cosim.fmi.binaries.loading import load_library
        from bayesftc.cosim.fmi.running.clocked import ClockedInstance, has_clocks
        from bayesftc.cosim.fmi.running.instance import Instance

        kind: Literal["plant", "sampled"] = "sampled" if timing == "sampled" else "plant"
        instance = ClockedInstance if has_clocks(description, [*beginning.inputs, *outputs]) else Instance
        return instance(load_library(archive, description), name, step, kind, beginning, outputs)

    def _variables(self) -> tuple[Beginning, list[FMUVariable]]:
        """Return the start values and inputs of an instance, and the outputs."""
        given = self._given
        variables = resolved(*self._read(), given)
        missing = [n for n in (*(p.name for side in self._sides for p in side), *given) if n not in variables]
        if missing:
            raise FMUError(
                f"The FMU {self.path} has changed since it was read and no longer has {missing[0]!r}. Read it again."
            )
        input_variables = [variables[p.name] for p in self._sides[0]]
        described = {v.name: v.start for v in self.description.variables}
        free = {v for v in input_variables if v.start is None and v.name not in given and described[v.name] is not None}
        inputs = {variable: None if variable in free else value_of(variable, given) for variable in input_variables}
        start = {variables[n]: value for n, value in given.items()}
        return Beginning(start, inputs, self.rtol or 0.0), [variables[p.name] for p in self._sides[1]]

    def _without_tunable(self, side: str) -> Sequence[str | Port] | None:
        # dataclasses.replace passes the ports again, and the tunable parameters are among the inputs.
        requested: Sequence[str | Port] | None = getattr(self, side)
        if not isinstance(requested, list | tuple):
            return requested
        if self.arrays and all(isinstance(item, str | Port) for item in requested):
            requested = scattered(requested, [variable.name for variable in self.description.variables])
        if side == "outputs":
            return requested
        return [item for item in requested if not (isinstance(item, Port) and item.name in self.tunable)]

    def _units_of_ports(self, side: str) -> dict[str, str]:
        """Return the units that ports among the requested inputs or outputs have."""
        requested = self._without_tunable(side)
        ports = requested if isinstance(requested, list | tuple) else ()  # anything else is refused below
        return {p.name: p.unit for p in ports if isinstance(p, Port) and p.unit}

    @property
    def _given(self) -> Mapping[str, Value]:
        """The parameters after they were checked."""
        return cast("Mapping[str, Value]", self.parameters or {})

    @property
    def _sides(self) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
        """A port for each variable; `inputs` and `outputs` hold these after construction, or arrays of them."""
        return vars(self)["_inputs"], vars(self)["_outputs"]

    def _ports(self, side: str) -> tuple[Port, ...]:
        """Return what `inputs` or `outputs` holds after construction."""
        return cast("tuple[Port, ...]", getattr(self, f"{side}s"))

    def _read(self) -> tuple[Archive, FMUDescription]:
        archive = open_archive(Path(self.path))
        return archive, read_description(archive, validate=self.validate)

    def _port(
        self,
        variable: FMUVariable,
        side: str,
        reaching: Container[str],
        units: Mapping[str, UnitDefinition],
        resized: Container[str],
        of_ports: Mapping[str, str],
    ) -> Port:
        definition = units.get(variable.unit or "")
        meaning, given = definition.unit if definition else None, of_ports.get(variable.name)
        unit = variable.unit or given
        if unit and given and difference(given, unit, None, meaning):
            raise ModelError(
                f"FMU has the {side} {variable.name!r} in {given}, but {Path(self.path).name} has it in {unit}. Leave out the "
                "unit here, and convert the signal by a Gain."
            )
        if side == "output":
            return Port(variable.name, variable.shape, unit, meaning=meaning)
        # A start value that is NaN or infinite counts as missing: a zero in its place would look like a start value.
        has_start = variable.start is not None or variable.name in self._given or variable.name in resized
        default = as_floats(value_of(variable, self._given)) if has_start else None
        feedthrough = self.timing == "sampled" or (self.timing == "direct" and variable.name in reaching)
        return Port(variable.name, variable.shape, unit, feedthrough, default, meaning=meaning)


def _check_clocks(archive: Archive, description: FMUDescription) -> None:
    """Refuse a model exchange FMU with time-based clocks: they would not tick, and its clocked parts would not be computed."""
    timed = [v.name for v in description.variables if v.causality == "input" and v.clock and v.clock.is_timed]
    if timed:
        raise FMUError(
            f"The FMU {archive.path} has the clock {timed[0]!r}, but clocks tick in co-simulation only, not in model exchange. "
            "Export it for co-simulation with event mode, or without clocks."
        )


def describe(path: str | PathLike[str], *, validate: bool = True) -> FMUDescription:
    """Return the description of an FMU of FMI 1.0, 2.0 or 3.0, without unpacking the file or loading its binary.

    Parameters
    ----------
    path : str or path
        The ``.fmu`` file, of any kind and for any platform.
    validate : bool
        False to accept a model description that breaks the rules of FMI.

    Returns
    -------
    FMUDescription
        Name, version, kinds, platforms, variables, capabilities and default experiment, as plain data.

    Raises
    ------
    FMUError
        If the file is missing or damaged, or is no FMU of FMI 1.0, 2.0 or 3.0.
    """
    description = read_description(
        open_archive(absolute(path, "describe", "an .fmu file", FMUError)), validate=validate
    )
    if description.lax:
        warnings.warn(description.lax, stacklevel=2)
    return description


def _chosen_kind(archive: Archive, description: FMUDescription, requested: str | None) -> str:
    """Return the kind in which an FMU is used: the requested one, else co-simulation if supported, else model exchange."""
    names = {
        "coSimulation": "co-simulation",
        "modelExchange": "model exchange",
        "scheduledExecution": "scheduled execution",
    }
    supported = [names[kind] for kind in description.kinds]
    usable = [kind for kind in ("co-simulation", "model exchange") if kind in supported]
    if requested is not None and requested not in ("co-simulation", "model exchange"):
        raise ModelError(f"FMU has kind={requested!r}; it must be 'co-simulation' or 'model exchange'.")
    if requested is not None and requested not in usable:
        raise FMUVersionError(
            f"The FMU {archive.path} cannot be used for {requested}, only for {' and '.join(supported) or 'nothing'}. Leave "
            f"kind= out, or export it for {requested}."
        )
    if not usable:
        raise FMUVersionError(
            f"The FMU {archive.path} supports {' and '.join(supported) or 'nothing'} only. Export it for co-simulation or model "
            "exchange."
        )
    return requested or usable[0]


__all__ = ["FMU", "FMUDescription", "FMUVariable", "describe"]
