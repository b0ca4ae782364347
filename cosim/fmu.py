"""FMUs as blocks: plants from any tool, or controllers that were exported, of FMI 2.0 or 3.0, of either kind."""

from __future__ import annotations

import math
import warnings
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Literal

from bayesftc.cosim._fmi_archive import Archive, open_archive
from bayesftc.cosim._fmi_description import FMUDescription, FMUVariable, Value, read_description
from bayesftc.cosim._model_exchange_settings import checked_settings
from bayesftc.cosim.block import External, ExternalBlock
from bayesftc.cosim.errors import FMUError, FMUVersionError, ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port


@dataclass(frozen=True)
class FMU(ExternalBlock):
    """An FMU of FMI 2.0 or 3.0; its scalar Real (Float64) inputs and outputs become ports.

    The file is read and checked when the block is made; it is unpacked (once per machine) and its binary loaded (once per
    process) when a run begins, and each run has a new instance. Time starts at 0 and has no end.

    Parameters
    ----------
    path : str or path
        The ``.fmu`` file.
    parameters : mapping, optional
        Start values by name, in the variables' own units: parameters, and whatever else may be set before initialization
        (an input's start value is its value while nothing is connected to it).
    inputs, outputs : sequence of str, optional
        Names of the variables that become ports; all scalar Real ones by default. An input that is left out keeps its start
        value. After construction these hold the ports.
    timing : {"plant", "direct", "sampled"}, optional
        ``"plant"``: the outputs at t_k are read before the step that the inputs at t_k take to t_k+1. ``"sampled"``: the FMU
        makes its step with the inputs at t_k and its outputs count at t_k, as a controller's do. ``"direct"``, for model
        exchange only: the outputs at t_k are computed from the inputs at t_k, before the step; inputs on which an output
        depends feed through. By default what the FMU says of itself (exports of this package do); else ``"direct"`` for
        model exchange where an output depends on an input or nothing is said of that, and ``"plant"`` otherwise; for
        co-simulation a ``"plant"`` that was not asked for warns where outputs depend at once on inputs.
    name : str, optional
        Name under which a diagram adds it; the model's name in small letters by default.
    validate : bool
        False to accept a model description that breaks the rules of FMI, at your own risk.
    kind : {"co-simulation", "model exchange"}, optional
        As what to use it: by default for co-simulation where it can, else for model exchange, as an ordinary differential
        equation that is integrated here, with its events.
    solver : str, optional
        For model exchange: ``"cvode"`` (by default) or ``"scipy:METHOD"`` with a method of ``scipy.integrate.solve_ivp``, as
        ``"scipy:RK45"``.
    rtol, atol : float, optional
        For model exchange: relative tolerance (by default the FMU's own, else 1e-6), and absolute tolerance of all states (by
        default rtol times each state's nominal value).

    Raises
    ------
    FMUError
        If the file is missing or damaged, no FMU of FMI 2.0 or 3.0 of that kind, has no binary for this platform, or a
        variable cannot be what it was asked to be.
    ModelError
        If a solver or tolerance is none, or is given for co-simulation.
    UnknownNameError
        If it has no variable of that name.

    Warns
    -----
    UserWarning
        If outputs depend at once on inputs by the FMU's own account (or for lack of one), and `timing` is not given: as a
        plant's, these outputs show the inputs of the step before.

    Examples
    --------
    >>> from bayesftc import cosim, fmus
    >>> car = cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 120.0})
    >>> [port.name for port in car.inputs], [port.name for port in car.outputs]
    (['force', 'disturbance'], ['v'])
    """

    path: str | PathLike[str]
    parameters: Mapping[str, Value] | None = field(default=None, kw_only=True, hash=False)
    inputs: Sequence[str | Port] | None = field(default=None, kw_only=True)  # type: ignore[assignment]
    outputs: Sequence[str | Port] | None = field(default=None, kw_only=True)  # type: ignore[assignment]
    timing: Literal["plant", "direct", "sampled"] | None = field(default=None, kw_only=True)
    name: str | None = field(default=None, kw_only=True)
    validate: bool = field(default=True, kw_only=True)
    kind: Literal["co-simulation", "model exchange"] | None = field(default=None, kw_only=True)
    solver: str | None = field(default=None, kw_only=True)
    rtol: float | None = field(default=None, kw_only=True)
    atol: float | None = field(default=None, kw_only=True)

    checks_finite: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.timing not in {None, "plant", "direct", "sampled"}:
            raise ModelError(f"FMU has timing={self.timing!r}; it must be 'plant', 'direct' or 'sampled'.")
        set_ = object.__setattr__
        set_(self, "path", Path(self.path).expanduser().absolute())
        archive, description = self._read()
        kind = _chosen_kind(archive, description, self.kind)
        exchange = kind == "model exchange"
        set_(self, "kind", kind)
        settings = checked_settings(archive, description, exchange, self.solver, self.rtol, self.atol)
        for name, value in settings.items():
            set_(self, name, value)
        asked = self.timing
        if asked == "direct" and not exchange:
            raise ModelError(
                f"FMU has timing='direct', but {archive.path.name} is used for co-simulation, where an output cannot show the "
                "inputs of the same instant without a step: give timing='plant' or 'sampled', or kind='model exchange'."
            )
        own = "direct" if exchange else "plant"
        set_(self, "timing", asked or description.timing or own)
        set_(self, "name", self.name or "".join(description.name.lower().split()))
        set_(self, "parameters", _start_values(archive, description, self.parameters or {}))
        chosen = {side: _choose(archive, description, side, getattr(self, f"{side}s")) for side in ("input", "output")}
        through = [description.feedthrough.get(v.name) for v in chosen["output"]]
        reaching = {v.name for v in chosen["input"] if any(names is None or v.name in names for names in through)}
        if asked is None and self.timing == "direct" and not reaching:
            set_(self, "timing", "plant")  # there it is the same
        for side, variables in chosen.items():
            set_(self, f"{side}s", tuple(self._port(v, reaching) for v in variables))
        if asked is None and self.timing == "plant" and not exchange:
            late = _late_outputs(archive, description, self._ports[: self._count], self._ports[self._count :])
            if late:
                warnings.warn(late, stacklevel=3)  # at the line that makes the block

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return str(self.name)

    @property
    def description(self) -> FMUDescription:
        """What the FMU says of itself."""
        return self._read()[1]

    def start_value(self, name: str) -> Value | None:
        """Return the value of a variable before initialization: what `parameters` gives it, else what the FMU says.

        Parameters
        ----------
        name : str
            Name of the variable.

        Returns
        -------
        float, int, bool or str, or None
            In the variable's own unit; None where the FMU computes it.

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
        starts = {v.name: v.start for v in self.description.variables} | dict(self.parameters or {})
        if name not in starts:
            raise UnknownNameError(
                f"The FMU {Path(self.path).name} has no variable {name!r}; {did_you_mean(name, starts)}"
            )
        return starts[name]

    def instantiate(self, step: Fraction, name: str) -> External:
        """Return a new initialized instance that makes steps of `step` seconds; close it in the end.

        Raises
        ------
        FMUError
            If the binary cannot be loaded, or the FMU refuses to be instantiated or initialized.
        """
        archive, description = self._read()
        start, inputs, outputs = self._variables()
        timing = self.timing or "plant"
        if self.kind == "model exchange":
            from bayesftc.cosim._model_exchange_instance import ExchangeInstance

            from bayesftc.cosim._model_exchange_library import load_model

            solver = self.solver or "cvode", self.rtol or 0.0, self.atol
            return ExchangeInstance(
                load_model(archive, description), name, step, timing, start, inputs, outputs, solver
            )
        from bayesftc.cosim._fmi_instance import Instance
        from bayesftc.cosim._fmi_library import load_library

        return Instance(load_library(archive, description), name, step, timing, start, inputs, outputs)

    def _variables(self) -> tuple[dict[FMUVariable, Value], dict[FMUVariable, Value], list[FMUVariable]]:
        """Return the start values, the inputs with their start values, and the outputs, by variable."""
        variables = {v.name: v for v in self.description.variables}
        missing = [n for n in (*(p.name for p in self._ports), *(self.parameters or {})) if n not in variables]
        if missing:
            raise FMUError(
                f"The FMU {self.path} was changed since it was read and has no {missing[0]!r} any more; read it again."
            )
        inputs: dict[FMUVariable, Value] = {variables[p.name]: p.default or 0.0 for p in self._ports[: self._count]}
        start = {variables[n]: value for n, value in (self.parameters or {}).items()}
        return start, inputs, [variables[p.name] for p in self._ports[self._count :]]

    @property
    def _ports(self) -> tuple[Port, ...]:
        return tuple(p for p in (*(self.inputs or ()), *(self.outputs or ())) if isinstance(p, Port))

    @property
    def _count(self) -> int:
        return len(self.inputs or ())

    def _read(self) -> tuple[Archive, FMUDescription]:
        archive = open_archive(Path(self.path))
        return archive, read_description(archive, validate=self.validate)

    def _port(self, variable: FMUVariable, reaching: Container[str]) -> Port:
        if variable.causality == "output":
            return Port(variable.name, unit=variable.unit)
        default = (self.parameters or {}).get(variable.name, variable.start)
        feedthrough = self.timing == "sampled" or (self.timing == "direct" and variable.name in reaching)
        return Port(variable.name, unit=variable.unit, feedthrough=feedthrough, default=float(default or 0.0))


def describe(path: str | PathLike[str], *, validate: bool = True) -> FMUDescription:
    """Return what an FMU of FMI 2.0 or 3.0 says of itself, without unpacking it or loading its binary.

    Parameters
    ----------
    path : str or path
        The ``.fmu`` file, of any kind (co-simulation or not) and for any platform.
    validate : bool
        False to accept a model description that breaks the rules of FMI.

    Returns
    -------
    FMUDescription
        Name, version, kinds, platforms, variables, capabilities and default experiment, as plain data.

    Raises
    ------
    FMUError
        If the file is missing or damaged, or no FMU of FMI 2.0 or 3.0.
    """
    return read_description(open_archive(Path(path).expanduser().absolute()), validate=validate)


def _chosen_kind(archive: Archive, description: FMUDescription, asked: str | None) -> str:
    """Return as what an FMU is used: what was asked for, else co-simulation where it can, else model exchange."""
    names = {
        "coSimulation": "co-simulation",
        "modelExchange": "model exchange",
        "scheduledExecution": "scheduled execution",
    }
    have = [names[kind] for kind in description.kinds]
    usable = [kind for kind in ("co-simulation", "model exchange") if kind in have]
    if asked is not None and asked not in {"co-simulation", "model exchange"}:
        raise ModelError(f"FMU has kind={asked!r}; it must be 'co-simulation' or 'model exchange'.")
    if asked is not None and asked not in usable:
        raise FMUVersionError(
            f"The FMU {archive.path} cannot be used for {asked}, only for {' and '.join(have) or 'nothing'}: leave kind= out, "
            "or export it for that."
        )
    if not usable:
        raise FMUVersionError(
            f"The FMU {archive.path} is for {' and '.join(have) or 'nothing'} only, and only co-simulation and model exchange "
            "can be used: export it for one of these."
        )
    return asked or usable[0]


def _choose(
    archive: Archive, description: FMUDescription, causality: str, wanted: Sequence[str | Port] | None
) -> list[FMUVariable]:
    """Return the variables that become ports of one side."""
    candidates = {v.name: v for v in description.variables if v.causality == causality}
    if wanted is None:
        return [v for v in candidates.values() if v.is_real_scalar and not v.alias]
    if isinstance(wanted, str):
        raise ModelError(f"FMU has {causality}s={wanted!r}; give a list of names, as [{wanted!r}].")
    chosen = []
    for item in wanted:
        name = item.name if isinstance(item, Port) else item
        if name not in candidates:
            other = next((v for v in description.variables if v.name == name), None)
            hint = f"it is of causality {other.causality}." if other else did_you_mean(name, candidates)
            raise UnknownNameError(f"The FMU {archive.path.name} has no {causality} {name!r}; {hint}")
        variable = candidates[name]
        if not variable.is_real_scalar:
            what = f"an array of shape {variable.shape}" if variable.shape else f"of type {variable.type}"
            what = "clocked" if variable.clocked else what
            raise FMUError(
                f"The {causality} {name!r} of the FMU {archive.path.name} is {what}; only scalar Real (Float64) variables can be "
                f"ports: leave it out of {causality}s, or export it as scalars."
            )
        if variable in chosen:
            raise ModelError(f"FMU has {name!r} twice among its {causality}s; name it once.")
        chosen.append(variable)
    return chosen


def _late_outputs(
    archive: Archive, description: FMUDescription, inputs: Sequence[Port], outputs: Sequence[Port]
) -> str | None:
    """Return the sentence that names the outputs which are declared to depend at once on inputs, or None.

    FMI forbids to set inputs and read outputs without a step in between (FMI 2), so that no order of calls would show them.
    Most plants whose exporter declares nothing have no such outputs; ``bayesftc inspect`` says that they do not say.
    """
    here = [port.name for port in inputs]
    reached = {port.name: description.feedthrough.get(port.name) for port in outputs}
    fed = {name: [u for u in through or () if u in here] for name, through in reached.items()}
    declared = [f"{name} depends on {' and '.join(through)}" for name, through in fed.items() if through]
    if not declared:
        return None
    return (
        f"The FMU {archive.path.name} declares that at the same instant {', '.join(declared)}, but a plant's outputs at t_k are "
        "read before its inputs of t_k are set, so such an output shows the inputs of the step before: give timing='sampled' if "
        "the FMU is a controller or has no memory, or timing='plant' if this is as it should be."
    )


def _start_values(archive: Archive, description: FMUDescription, values: Mapping[str, Any]) -> dict[str, Value]:
    """Check start values by name, causality and type; return them as plain Python numbers."""
    variables = {v.name: v for v in description.variables}
    checked: dict[str, Value] = {}
    for name, value in values.items():
        if name not in variables:
            settable = [v.name for v in variables.values() if v.settable]
            raise UnknownNameError(
                f"The FMU {archive.path.name} has no variable {name!r}; {did_you_mean(name, settable)}"
            )
        variable = variables[name]
        if not variable.settable:
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} cannot be set: it is {_a(variable.causality)} that the FMU computes "
                f"({variable.variability}); set what it depends on."
            )
        if variable.shape or variable.causality == "structuralParameter" or variable.type in {"Binary", "Clock"}:
            what = (
                f"an array of shape {variable.shape}"
                if variable.shape
                else f"{_a(variable.causality)} of type {variable.type}"
            )
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} is {what}, which cannot be set from here; leave it at its start value."
            )
        checked[name] = _converted(archive, variable, value)
    return checked


def _a(word: str) -> str:
    return ("an " if word[0] in "aeiou" else "a ") + word


def _converted(archive: Archive, variable: FMUVariable, value: Any) -> Value:
    kind = variable.type
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if kind in {"Real", "Float64", "Float32"}:
        if is_number and math.isfinite(value):
            return float(value)
        wanted = "a finite number"
    elif kind == "Boolean":
        if isinstance(value, bool):
            return value
        wanted = "True or False"
    elif kind == "String":
        if isinstance(value, str):
            return value
        wanted = "a text"
    else:
        low, high = _range(kind)
        if is_number and isinstance(value, Integral) and low <= int(value) <= high:
            return int(value)
        wanted = f"a whole number from {low} to {high}"
    raise FMUError(
        f"{variable.name!r} of the FMU {archive.path.name} is {kind}, so it must be {wanted}, not {value!r}."
    )


def _range(kind: str) -> tuple[int, int]:
    bits = {"Integer": 32, "Enumeration": 32}.get(kind) or int(kind.removeprefix("U").removeprefix("Int"))
    if kind.startswith("U"):
        return 0, 2**bits - 1
    return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


__all__ = ["FMU", "FMUDescription", "FMUVariable", "describe"]
