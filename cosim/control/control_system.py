"""Blocks and diagrams as systems of python-control: `Block.to_control` and `Diagram.to_control`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import control
import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.control.equations import Equations
from bayesftc.cosim.control.machine import Machine
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.opening import Names, Signals, chosen, needed, opened, signals_of
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats


class ControlSystem(control.NonlinearIOSystem):  # type: ignore[misc]
    """A block or a diagram as a system of python-control; made by `Block.to_control` and `Diagram.to_control`.

    Its functions of time, state and inputs are pure: they can be asked in any order, and a system may stand twice in a diagram.

    Parameters
    ----------
    machine : Machine or Equations
        What evaluates the diagram, in discrete time, or a model exchange FMU, in continuous time.
    name, dt, inputs, outputs, states
        As for ``control.nlsys``.
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
        """The state in which the block or the diagram begins, for ``X0=...``: python-control itself begins at zeros."""
        return self._machine.initial.copy()

    def linearize(self, x0: Any, u0: Any = None, t: float = 0, *args: Any, **settings: Any) -> Any:
        """Return the linearization at a state and inputs, as ``control.linearize`` describes it.

        It is the linearization with the precision learners held: each sensor is trusted at all times as it is at this point, and
        what a learner remembers is no state of the result. What is not finite at the point (the fault probability of a learner
        that has none, the variance of a sensor that is left out) is constant, with derivatives of zero. So all matrices are
        finite.

        Parameters
        ----------
        x0, u0, t, args, settings
            See ``control.linearize``.

        Raises
        ------
        ModelError
            If there is an FMU in it whose state is known to itself alone.
        """
        if self._machine.opaque:
            raise ModelError(
                f"The state of the FMU {self._machine.opaque[0]!r} is known to itself alone, so that it cannot be linearized in "
                "python-control: LinearModel.from_fmu makes a linear model of it."
            )
        x0, u0 = (getattr(x0, "states", x0), getattr(x0, "inputs", 0.0) if u0 is None else u0)
        x0, u0 = _vector(x0, self.nstates), _vector(u0, self.ninputs)
        machine = self._machine
        if isinstance(machine, Machine):
            machine, x0 = machine.held(t, x0, u0)
        hints = machine.hints
        told, hints.told = hints.told, True  # whoever asks for zeros here means them
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
            return held.linearize(x0, u0, t, *args, **settings)
        finally:
            hints.told = told


def initial_state(system: Any) -> Floats:
    """Return the state in which a python-control system begins, for ``X0=...``; python-control itself begins at zeros.

    Parameters
    ----------
    system : control.InputOutputSystem
        What `Block.to_control` or `Diagram.to_control` has made, or an interconnection with such systems in it. Systems of
        python-control begin at zeros.

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
    step = block.sample_time if dt is None else dt
    continuous = step is None and isinstance(block, FMU) and block.kind == "model exchange"
    if step is None and not continuous:
        raise ModelError(f"{type(block).__name__} does not know its sample time; give to_control(dt=...) in seconds.")
    diagram = Diagram(1 if step is None else step)
    node = diagram.add(block, name)
    if inputs is None:
        inputs = [port.name for port in block.inputs if port.draw is None]
    known = {port.name: (node, port) for port in block.inputs}, {port.name: (node, port) for port in block.outputs}
    if continuous and isinstance(block, FMU):
        return _equations(block, known, inputs, outputs, node.name)
    return _system(diagram, known, inputs, outputs, seed, engine, node.name, f"{node.name}.")


def diagram_to_control(
    diagram: Diagram, inputs: Names | None, outputs: Names | None, seed: int | None, engine: str, name: str | None
) -> ControlSystem:
    """Return a diagram as a system of python-control; `Diagram.to_control` describes the arguments."""
    known_inputs, known_outputs = signals_of(diagram)
    if inputs is None:
        inputs = list(needed(diagram))
    return _system(diagram, ({**known_outputs, **known_inputs}, known_outputs), inputs, outputs, seed, engine, name)


def _system(
    diagram: Diagram,
    known: tuple[Signals, Signals],
    inputs: Names,
    outputs: Names | None,
    seed: int | None,
    engine: str,
    name: str | None,
    prefix: str = "",
) -> ControlSystem:
    given = chosen(known[0], inputs, "input", "to_control", allowed)
    shown = chosen(known[1], list(known[1]) if outputs is None else outputs, "output", "to_control", allowed)
    whole, places = opened(diagram, list(given.values()), "to_control")
    machine = Machine(whole, places, [(node.name, port.name, i) for node, port, i in shown.values()], seed, engine)
    states = [allowed(state.removeprefix(prefix)) for state in machine.names]
    return ControlSystem(machine, name, float(diagram.step), list(given), list(shown), states)


def _equations(
    fmu: FMU, known: tuple[Signals, Signals], inputs: Names, outputs: Names | None, name: str
) -> ControlSystem:
    given = chosen(known[0], inputs, "input", "to_control", allowed)
    shown = chosen(known[1], list(known[1]) if outputs is None else outputs, "output", "to_control", allowed)
    model = Equations(fmu, *([(port, i) for _, port, i in side.values()] for side in (given, shown)))
    states = [allowed(state) for state in model.names]
    return ControlSystem(model, name, 0.0, list(given), list(shown), states)


def _vector(values: Any, size: int) -> Floats:
    """Return a state or inputs as python-control takes them: a number for all, or a number or array for each part."""
    if np.ndim(values) == 0:  # type: ignore[arg-type]
        return np.full(size, float(values))
    vector = np.concatenate([np.zeros(0), *(np.ravel(part) for part in values)]).astype(np.float64)
    if len(vector) != size:
        raise ModelError(
            f"linearize has a vector of {len(vector)} numbers where the system has {size}; give one for each."
        )
    return vector


def _finite(function: Callable[..., Floats], there: Floats) -> Callable[..., Floats]:
    """Return a function of time, state and inputs in which what is not finite at the point is constant."""
    constant = ~np.isfinite(there)

    def finite(t: float, x: Any, u: Any, params: object = None) -> Floats:
        return np.where(constant, 0.0, function(t, x, u, params))

    return finite


def allowed(label: str) -> str:
    """Return a signal's name as python-control allows it: without dots, which divide systems from signals there."""
    return label.replace(".", "_")


__all__ = ["ControlSystem", "initial_state"]
