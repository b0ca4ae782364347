"""Blocks and diagrams as systems of python-control: `Block.to_control` and `Diagram.to_control`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import control
import numpy as np

from bayesftc.cosim.block import Block, sample_time_of
from bayesftc.cosim.control.differences import parted, slopes
from bayesftc.cosim.control.equations import Equations
from bayesftc.cosim.control.machine import Machine
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.opening import Names, Signals, chosen, needed, opened, signals_of
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats

EPS = 2
"""Place of the step of differences among further arguments of python-control's ``linearize``."""


class ControlSystem(control.NonlinearIOSystem):  # type: ignore[misc]
    """A block or a diagram as a system of python-control; made by `Block.to_control` and `Diagram.to_control`.

    Its functions of time, state and inputs are pure: they can be called in any order, and a diagram may contain the system twice.

    Parameters
    ----------
    machine : Machine or Equations
        Evaluates a diagram in discrete time, or a model exchange FMU in continuous time.
    name, dt, inputs, outputs, states
        See ``control.nlsys``.
    """

    def __init__(
        self,
        machine: Machine | Equations,
        name: str | None,
        dt: float,
        inputs: Sequence[str],
        outputs: Sequence[str],
        states: Sequence[str],
    ):
        super().__init__(
            machine.update,
            machine.output,
            name=name,
            dt=dt,
            inputs=list(inputs),
            outputs=list(outputs),
            states=list(states),
        )
        self._machine = machine

    @property
    def initial_state(self) -> Floats:
        """The initial state of the block or the diagram, for ``X0=...``; by default python-control starts at zeros."""
        return self._machine.initial.copy()

    def linearize(self, x0: Any, u0: Any = None, t: float = 0, *args: Any, **settings: Any) -> Any:
        """Return the linearization at a state and inputs, as ``control.linearize`` describes it.

        The derivatives are central differences with a suitable step for each element. With ``eps`` python-control makes a step of
        this size; its default of 1e-6 is too large for a state of 1e-5, and imprecise for one of 1e5.

        In the linearization precision learners do not learn: the precision of each sensor is constant, with its value at this
        point, and the memory of a learner is no state of the result. Numbers that are not finite at the point (the fault
        probability of a learner without one, the variance of an ignored sensor) are constant, with derivatives of zero. So all
        matrices are finite.

        Parameters
        ----------
        x0, u0, t, args, settings
            See ``control.linearize``.

        Raises
        ------
        ModelError
            If it contains an FMU with a hidden state.
        """
        if self._machine.opaque:
            raise ModelError(
                f"The state of the FMU {self._machine.opaque[0]!r} is hidden, so that it cannot be linearized in python-control; "
                "make a linear model of it with LinearModel.from_fmu."
            )
        x0, u0 = (getattr(x0, "states", x0), getattr(x0, "inputs", 0.0) if u0 is None else u0)
        x0, u0 = _vector(x0, self.nstates), _vector(u0, self.ninputs)
        machine = self._machine
        if isinstance(machine, Machine):
            machine, x0 = machine.held(t, x0, u0)
        hints = machine.hints
        has_warned, hints.has_warned = hints.has_warned, True  # no warning, because here zeros are intended
        names = {
            "inputs": self.input_labels,
            "outputs": self.output_labels,
            "states": [allowed(n) for n in machine.names],
        }
        held = control.NonlinearIOSystem(
            _finite(machine.update, machine.update(t, x0, u0)),
            _finite(machine.output, machine.output(t, x0, u0)),
            name=self.name,
            dt=self.dt,
            **names,
        )
        try:
            linear = held.linearize(x0, u0, t, *args, **settings)
            if "eps" not in settings and len(args) < EPS:
                _refine(linear, held, x0, u0, t)
        finally:
            hints.has_warned = has_warned
        return linear


def initial_state(system: Any) -> Floats:
    """Return the initial state of a python-control system, for ``X0=...``; by default python-control starts at zeros.

    Parameters
    ----------
    system : control.InputOutputSystem
        A system from `Block.to_control` or `Diagram.to_control`, or an interconnection with such systems. For other systems of
        python-control the result is zero.

    Returns
    -------
    ndarray
        A number for each state.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> cosim.initial_state(cosim.UnitDelay(initial=3.0).to_control(dt=0.1)).tolist()
    [3.0]
    """
    if isinstance(system, control.InterconnectedSystem):
        return np.concatenate([np.zeros(0), *(initial_state(part) for part in system.syslist)])
    if isinstance(system, ControlSystem):
        return system.initial_state
    return np.zeros(system.nstates or 0)


def block_to_control(
    block: Block,
    dt: float | str | Fraction | None,
    inputs: Names | None,
    outputs: Names | None,
    seed: int | None,
    engine: str,
    name: str | None,
) -> ControlSystem:
    """Return a block as a system of python-control; `Block.to_control` describes the arguments."""
    step = sample_time_of(block) if dt is None else dt
    continuous = step is None and isinstance(block, FMU) and block.kind == "model exchange"
    if step is None and not continuous:
        raise ModelError(f"{type(block).__name__} has no sample time; give to_control(dt=...) in seconds.")
    diagram = Diagram(1 if step is None else step)
    node = diagram.add(block, name)
    if inputs is None:
        inputs = [port.name for port in block.inputs if port.draw is None]
    signals = {port.name: (node, port) for port in block.inputs}, {port.name: (node, port) for port in block.outputs}
    if continuous and isinstance(block, FMU):
        return _equations(block, signals, inputs, outputs, node.name)
    return _system(diagram, signals, inputs, outputs, seed, engine, node.name, f"{node.name}.")


def diagram_to_control(
    diagram: Diagram, inputs: Names | None, outputs: Names | None, seed: int | None, engine: str, name: str | None
) -> ControlSystem:
    """Return a diagram as a system of python-control; `Diagram.to_control` describes the arguments."""
    all_inputs, all_outputs = signals_of(diagram)
    if inputs is None:
        inputs = list(needed(diagram))
    return _system(diagram, ({**all_outputs, **all_inputs}, all_outputs), inputs, outputs, seed, engine, name)


def _system(
    diagram: Diagram,
    signals: tuple[Signals, Signals],
    inputs: Names,
    outputs: Names | None,
    seed: int | None,
    engine: str,
    name: str | None,
    prefix: str = "",
) -> ControlSystem:
    ins = chosen(signals[0], inputs, "input", "to_control", allowed)
    outs = chosen(signals[1], list(signals[1]) if outputs is None else outputs, "output", "to_control", allowed)
    whole, places = opened(diagram, list(ins.values()), "to_control")
    machine = Machine(whole, places, [(node.name, port.name, i) for node, port, i in outs.values()], seed, engine)
    states = [allowed(state.removeprefix(prefix)) for state in machine.names]
    return ControlSystem(machine, name, float(diagram.step), list(ins), list(outs), states)


def _equations(
    fmu: FMU, signals: tuple[Signals, Signals], inputs: Names, outputs: Names | None, name: str
) -> ControlSystem:
    ins = chosen(signals[0], inputs, "input", "to_control", allowed)
    outs = chosen(signals[1], list(signals[1]) if outputs is None else outputs, "output", "to_control", allowed)
    model = Equations(fmu, *([(port, i) for _, port, i in side.values()] for side in (ins, outs)))
    states = [allowed(state) for state in model.names]
    return ControlSystem(model, name, 0.0, list(ins), list(outs), states)


def _vector(values: Any, size: int) -> Floats:
    """Return a state or inputs as python-control takes them: a number for all, or a number or array for each part."""
    if np.ndim(values) == 0:  # type: ignore[arg-type]
        return np.full(size, float(values))
    vector = np.concatenate([np.zeros(0), *(np.ravel(part) for part in values)]).astype(np.float64)
    if len(vector) != size:
        raise ModelError(
            f"linearize has a vector of {len(vector)} numbers, but the system has {size}; give one number for each."
        )
    return vector


def _refine(linear: Any, system: Any, x0: Floats, u0: Floats, t: float) -> None:
    """Replace the matrices of a linearization by more precise ones, where the functions can be evaluated about the point."""
    n = len(x0)

    def both(z: Floats) -> Floats:
        return np.concatenate([system.updfcn(t, z[:n], z[n:], {}), system.outfcn(t, z[:n], z[n:], {})])

    parts = parted(slopes(both, np.concatenate([x0, u0]))[0], n)
    for matrix, part in zip((linear.A, linear.B, linear.C, linear.D), parts, strict=True):
        matrix[:] = np.where(np.isfinite(part), part, matrix)


def _finite(function: Callable[..., Floats], values: Floats) -> Callable[..., Floats]:
    """Return a function of time, state and inputs that is constant where its `values` at a point are not finite."""
    constant = ~np.isfinite(values)

    def finite(t: float, x: Any, u: Any, params: object = None) -> Floats:
        return np.where(constant, 0.0, function(t, x, u, params))

    return finite


def allowed(label: str) -> str:
    """Return a signal's name as python-control allows it: without dots, which separate systems from signals there."""
    return label.replace(".", "_")


__all__ = ["ControlSystem", "initial_state"]
