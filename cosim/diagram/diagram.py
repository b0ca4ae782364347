"""Block diagrams: add blocks, connect ports, build, simulate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Literal

from bayesftc.cosim.base.arguments import with_named_arguments
from bayesftc.cosim.base.timebase import rational_step, whole_number, whole_steps
from bayesftc.cosim.base.units import difference
from bayesftc.cosim.block import Block, ExternalBlock
from bayesftc.cosim.blocks.faults.base import Fault
from bayesftc.cosim.blocks.faults.without_effect import late_faults, short_faults, warn_without_effect
from bayesftc.cosim.diagram.coupling import Coupling, Method
from bayesftc.cosim.diagram.loop_methods import LoopMethods
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.subsystem import INSIDE, Boundary, Subsystem
from bayesftc.cosim.errors import ConnectionError, ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.ports import Port
from bayesftc.cosim.run.interrupts import import_engine

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from bayesftc.cosim.control.control_system import ControlSystem
    from bayesftc.cosim.diagram.schedule import Schedule
    from bayesftc.cosim.run.result import Result
    from bayesftc.cosim.run.running import Progress
    from bayesftc.cosim.run.session import RunState, Session


class Diagram(LoopMethods):
    """A diagram of blocks that run at multiples of one base step.

    Parameters
    ----------
    dt : float, str or Fraction
        The base step in seconds; ``"1/30"`` is exact.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> source = diagram.add(cosim.Constant(1.0), name="one")
    >>> gain = diagram.add(cosim.Gain(2.0))
    >>> diagram.connect(source["y"], gain["u"])
    >>> float(diagram.simulate(1.0)["gain.y"][-1])
    2.0
    """

    def __init__(self, dt: float | str | Fraction):
        self.step = rational_step(dt, "The diagram's step size")
        self._nodes: dict[str, Node] = {}
        self._sources: dict[tuple[str, str, int], tuple[PortRef, int]] = {}
        self._coupling: Coupling | None = None
        self._schedule: Schedule | None = None
        self._session: Session | None = None
        self._units_later: list[tuple[list[tuple[PortRef, int]], PortRef]] | None = None

    def add(self, block: Block, name: str | None = None, every: int = 1) -> Node:
        """Add a block and return its node, whose ports can be connected.

        Parameters
        ----------
        block : Block
            The block.
        name : str, optional
            Unique name in this diagram; by default the block's `Block.default_name`, for most its kind in small letters.
        every : int
            The block runs at every `every`-th base step.
        """
        self._refuse_if_built("add a block")
        if not isinstance(block, Block):
            raise ModelError(
                f"Only blocks can be added to a diagram, not {brief(block)}; wrap a python-control system in StateSpace, "
                "call the method block() of a trained classifier."
            )
        name = block.default_name if name is None else name
        if not isinstance(name, str) or not name or any(c.isspace() for c in name):
            raise ModelError(f"{name!r} cannot be a block's name: it must not be empty or contain spaces.")
        every = whole_number(every, f"Block {name!r} has every=")
        part = block if isinstance(block, Subsystem) else None
        node = Node(name, part.boundary if part else block, every)
        inner = {n.name: Node(f"{name}.{n.name}", n.block, n.every * every) for n in part.diagram.nodes} if part else {}
        for each in (node, *inner.values()):
            if each.name in self._nodes:
                raise ModelError(
                    f"The diagram already has a block {each.name!r}; give this {type(block).__name__} another name=..."
                )
        self._nodes |= {each.name: each for each in (node, *inner.values())}
        if part:
            self._connect_inside(node, part, inner)
        return node

    def _connect_inside(self, boundary: Node, block: Subsystem, inner: Mapping[str, Node]) -> None:
        """Copy the connections of a subsystem, and link its ports to those inside."""
        for (target, port, element), (origin, taken) in block.diagram._sources.items():
            self._sources[inner[target].name, port, element] = replace(origin, node=inner[origin.node.name]), taken
        for name, references in block.fed.items():
            link = boundary[name]
            for reference in references:
                for i, element in enumerate(reference.elements):
                    self._sources[inner[reference.node.name].name, reference.port.name, element] = link, i
        shown = [
            (reference, e)
            for references in block.shown.values()
            for reference in references
            for e in reference.elements
        ]
        for i, (reference, element) in enumerate(shown):
            self._sources[boundary.name, INSIDE, i] = replace(reference, node=inner[reference.node.name]), element

    def connect(self, source: PortRef | Sequence[PortRef], target: PortRef) -> None:
        """Connect an output (or several, one after the other) to an input of the same size and unit.

        Raises
        ------
        ConnectionError
            If sizes or units differ, the direction is wrong, or the input already has a source.
        """
        self._refuse_if_built("connect ports")
        sources: list[Any] = list(source) if isinstance(source, list | tuple) else [source]
        for reference, direction, role in [*((s, "output", "source") for s in sources), (target, "input", "target")]:
            if not isinstance(reference, PortRef):
                raise ConnectionError(
                    f"The {role} of a connection must be a port, such as node['y'], not {brief(reference)}."
                )
            if self._nodes.get(reference.node.name) is not reference.node:
                raise ConnectionError(
                    f"{reference.name} belongs to a block of another diagram; add the block to this one."
                )
            if reference.direction != direction:
                raise ConnectionError(
                    f"{reference.name} is an {reference.direction}, but the {role} must be an {direction}."
                )
        size = sum(len(s) for s in sources)
        if size != len(target):
            names = " + ".join(f"{s.name} (size {len(s)})" for s in sources)
            raise ConnectionError(
                f"{names} cannot be connected to {target.name} (size {len(target)}): the sizes differ; "
                "choose elements with [i], or change the block's size."
            )
        # All or nothing: a refused connection does not change the diagram.
        origins = [(s, element) for s in sources for element in s.elements]
        if self._units_later is None:
            _check_units(zip(origins, target, strict=True))
        else:
            self._units_later.append((origins, target))
        new = {
            (target.node.name, target.port.name, e): origin for e, origin in zip(target.elements, origins, strict=True)
        }
        for (block, port, element), (s, _) in new.items():
            if (block, port, element) in self._sources:
                where = f"{block}.{port}" + (f"[{element}]" if target.port.size > 1 else "")
                before = self._sources[block, port, element][0].name
                raise ConnectionError(f"{where} already has a source ({before}); it cannot also take {s.name}.")
        self._sources.update(new)

    def defer_units(self) -> None:
        """From now on, compare no units in `connect`; call `check_units` later, when some connections may have been replaced."""
        self._units_later = []

    def check_units(self) -> None:
        """Compare the units of all connections that were made since `defer_units` and still exist.

        Raises
        ------
        ConnectionError
            If two differ.
        """
        _check_units(
            [
                (origin, element)
                for origins, target in self._units_later or ()
                for origin, element in zip(origins, target, strict=True)
                if self._sources.get((target.node.name, target.port.name, element.elements[0])) == origin
            ]
        )
        self._units_later = None

    def disconnect(self, target: PortRef) -> None:
        """Remove the connection of an input, or of some of its elements; it can then be connected to another source.

        Parameters
        ----------
        target : port
            The input: ``node["u"]``, ``node["u"][0]``.
        """
        self._refuse_if_built("disconnect ports")
        for element in target.elements:
            self._sources.pop((target.node.name, target.port.name, element), None)

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The blocks in the order in which they were added."""
        return tuple(self._nodes.values())

    def __getitem__(self, name: str) -> Node:
        if name not in self._nodes:
            raise UnknownNameError(f"The diagram has no block {name!r}; {did_you_mean(name, self._nodes)}")
        return self._nodes[name]

    def source_of(self, node: Node, port: Port, element: int) -> tuple[PortRef, int] | None:
        """Return the source of one element of an input: the output and its element, or None.

        Inside a subsystem it is the output outside that feeds it. If there is none, it is the unconnected input of the
        subsystem.
        """
        *_, origin = (None, *self.origins_of(node, port, element))
        return origin

    def origins_of(self, node: Node, port: Port, element: int) -> Iterator[tuple[PortRef, int]]:
        """Yield the port to which one element of an input is connected, and the next ones on the way through subsystems."""
        origin = self._sources.get((node.name, port.name, element)) or self._by_name(node, port)
        while origin is not None:
            yield origin
            reference, i = origin
            boundary = reference.node.block
            if not isinstance(boundary, Boundary):
                return
            place = (reference.port.name, i)
            if reference.direction == "output":
                place = (INSIDE, boundary.offset(reference.port) + i)
            origin = self._sources.get((reference.node.name, *place))

    def connections(self) -> Iterator[tuple[tuple[str, str, int], tuple[PortRef, int]]]:
        """Yield each connected element of an input (block, port, element) and its source, also those by name."""
        yield from self._sources.items()
        for node in self.nodes:
            for name in node.block.named_sources:
                place = (node.name, name, 0)
                if place not in self._sources and (source := self._by_name(node, node.port(name))):
                    yield place, source

    def _by_name(self, node: Node, port: Port) -> tuple[PortRef, int] | None:
        """Return the output and its element that feed an input by name; inside a subsystem, a block inside comes first."""
        signal = node.block.named_sources.get(port.name)
        if signal is None:
            return None
        around = [n.name for n in self.nodes if isinstance(n.block, Boundary) and node.name.startswith(f"{n.name}.")]
        found = (self.find(f"{name}.{signal}") for name in sorted(around, key=len, reverse=True))
        return next(filter(None, found), None) or self.find(signal)

    def find(self, signal: str) -> tuple[PortRef, int] | None:
        """Return the output and the element of a scalar signal, such as ``sensors.y[1]``; None if there is none of this name.

        The signal of an input is its source.
        """
        for name, node in self._nodes.items():
            if signal.startswith(f"{name}."):
                try:
                    found = node[signal.removeprefix(f"{name}.")]
                except UnknownNameError:
                    continue
                if len(found) == 1:
                    element = found.elements[0]
                    if found.direction == "input":
                        return self._sources.get((name, found.port.name, element))
                    return PortRef(node, found.port, "output", tuple(range(found.port.size))), element
        return None

    def rewired(self, blocks: Mapping[str, Block]) -> Diagram:
        """Return a diagram with the same names, rates, connections and coupling, but other blocks; built if this one is.

        Parameters
        ----------
        blocks : mapping of str to Block
            A block for each name. It must have the connected ports, with the same sizes.

        Raises
        ------
        ConnectionError
            If a block lacks a connected port, or has it with another size, or is a subsystem.
        """
        other = Diagram(self.step)
        if subsystems := [name for name, block in blocks.items() if isinstance(block, Subsystem)]:
            raise ConnectionError(
                f"A subsystem cannot replace {subsystems[0]!r}; replace blocks inside of it, such as "
                f"'{subsystems[0]}.<block>', or write a function of the factors that makes the loop."
            )
        for name, node in self._nodes.items():
            other.add(blocks[name], name, node.every)
        sizes = {name: {p.name: p.size for p in node.inputs} for name, node in self._nodes.items()}
        inputs = {name: {p.name: p for p in node.inputs} for name, node in other._nodes.items()}
        outputs = {name: {p.name: p for p in node.outputs} for name, node in other._nodes.items()}
        for (target, port, element), (source, taken) in self._sources.items():
            feeder = source.node.name
            ports_of_source = outputs[feeder] if source.direction == "output" else inputs[feeder]
            for name, port_name, ports, size in (
                (feeder, source.port.name, ports_of_source, source.port.size),
                (target, port, inputs[target], sizes[target][port]),
            ):
                new = ports.get(port_name)
                if new is None or new.size != size:
                    raise ConnectionError(
                        f"{type(blocks[name]).__name__} cannot replace {name!r}: the connected port {port_name!r} "
                        f"{'is missing' if new is None else f'has size {new.size} instead of {size}'}. "
                        "To change sizes, write a function of the factors that makes the loop."
                    )
            origin = ports_of_source[source.port.name]
            whole = PortRef(other._nodes[feeder], origin, source.direction, tuple(range(origin.size)))
            other._sources[target, port, element] = whole, taken
        if self._coupling is not None:
            other.build(self._coupling)
        return other

    def watching(self, names: Iterable[object] | None) -> Diagram:
        """Return the diagram with further variables of blocks as outputs, such as local variables of FMUs.

        Returns the diagram itself if no further variable is named.

        Parameters
        ----------
        names : iterable of str, optional
            Names of signals in results: ``"plant.mass.s"``. Other names are ignored.
        """
        blocks = {name: node.block for name, node in self._nodes.items()}
        requested: dict[str, list[str]] = {}
        for name in names or ():
            nodes = [node for node in blocks if isinstance(name, str) and name.startswith(f"{node}.")]
            if nodes:
                node = max(nodes, key=len)
                requested.setdefault(node, []).append(str(name)[len(node) + 1 :])
        watching = {node: blocks[node].watching(variables, only_recorded=True) for node, variables in requested.items()}
        if all(block is blocks[node] for node, block in watching.items()):
            return self
        return self.rewired(blocks | watching)

    def build(self, coupling: Coupling | Method | None = None, **settings: Any) -> Diagram:
        """Check the diagram, determine the order of its blocks and freeze it; `simulate` does this by itself.

        Parameters
        ----------
        coupling : {"gauss-seidel", "jacobi", "iterated"} or Coupling
            How FMUs that feed each other are stepped. Gauss-Seidel, the default: if an FMU is fed directly by another
            FMU of the same rate, and that one was added before it, it gets the output of the other FMU after the other FMU's
            step. With Jacobi, it gets the output before that step. With a block between the two (such as a `Gain` that converts
            units), or with different ``every``, it gets the output before the step in both cases. Iterated: steps are repeated
            until values agree, and algebraic loops are solved. ``diagram.schedule.describe()`` lists the resulting order.
        **settings : object
            Further settings of `Coupling`: ``tolerance``, ``acceleration``, ``iterations``, ``hold``, ``step_error``.
        """
        from bayesftc.cosim.diagram.schedule import Schedule

        if coupling is None and not settings:
            requested = self._coupling or Coupling()
        elif isinstance(coupling, Coupling):
            requested = replace(coupling, **settings)
        else:
            requested = Coupling(coupling or "gauss-seidel", **settings)
        if self._coupling is not None and requested != self._coupling:
            raise ModelError(
                f"The diagram is already built with {self._coupling.method} coupling; it cannot be built again with "
                f"{requested.method if requested.method != self._coupling.method else 'other settings'}."
            )
        if self._schedule is None:
            self._schedule = Schedule(self, requested)
            self._coupling = requested
        return self

    @property
    def schedule(self) -> Schedule:
        """The order of calls and the layout of memory; access builds and freezes the diagram."""
        self.build()
        assert self._schedule is not None
        return self._schedule

    @with_named_arguments
    def simulate(
        self,
        duration: float | str | Fraction,
        *,
        seed: int = 0,
        record: Iterable[str | PortRef] | None = None,
        decimation: int = 1,
        engine: Literal["auto", "compiled", "interpreted"] = "auto",
        progress: Progress | None = None,
        time_limit: float | None = None,
        pace: float | None = None,
    ) -> Result:
        """Run the diagram for `duration` seconds from its initial state; build and freeze it before if necessary.

        Parameters
        ----------
        duration : float, str or Fraction
            Seconds; a whole number of base steps. The result has a row at both ends (with `decimation`, at the end only if it
            divides the number of steps).
        seed : int
            Seed of all random streams. With the same seed a block has the same numbers, regardless of the other blocks.
        record : iterable of str, optional
            Names of the signals to keep, ``*`` allowed (``["plant.v", "controller.*"]``), or ports (``plant["v"]``); by default
            all outputs. Inputs can be recorded as well, by name.
        decimation : int
            Keep every `decimation`-th step, from step 0 on.
        engine : {"auto", "compiled", "interpreted"}
            ``auto`` is compiled if every block allows it. Both give the same bits.
        progress : callable, optional
            Called as ``progress(step, steps)`` about twenty times a second. Without it, a run of more than two seconds gives
            messages on how far it is (logger ``bayesftc``, else stderr).
        time_limit : float, optional
            Seconds of computing after which the run is stopped.
        pace : float, optional
            Simulated seconds for each second of the clock, 1.0 for real time. Step k then does not start before its time.
            ``result.metadata["pace"]`` has the number of steps that were not done in time (``overruns``) and the largest delay
            in seconds (``worst_overrun``); for steps shorter than a millisecond also the delay up to which a step
            does not count as late (``tolerance``). By default the run is as fast as possible.

        Returns
        -------
        Result
            The recorded signals.

        Warns
        -----
        UserWarning
            If an FMU has ended the run (``result.stopped`` has the reason), or if a fault starts after the end of the run.

        Raises
        ------
        SimulationError
            If a plant's output is NaN or infinite, an FMU reports an error, or the time limit is reached; its ``result`` has the
            signals up to the last complete step.
        KeyboardInterrupt
            On Ctrl-C, within about a twentieth of a second (a single step of an FMU is not interrupted). The signals are then
            lost. Use ``time_limit`` to keep the signals of a run that may take too long.
        """
        import_engine()
        from bayesftc.cosim.run.session import Session

        with Session(self, seed=seed, record=record, decimation=decimation, engine=engine) as session:
            self._warn_of_faults_without_effect(whole_steps(duration, self.step, "The duration") * self.step)
            return session.advance(duration, progress=progress, time_limit=time_limit, pace=pace)

    def _warn_of_faults_without_effect(self, end: Fraction) -> None:
        times = {f"The fault {n.name!r}": n.block.times for n in self.nodes if isinstance(n.block, Fault)}
        late = late_faults({name: [start] for name, (start, _) in times.items()}, end)
        warn_without_effect([*late, *short_faults(times, self.step)])

    def start(
        self,
        *,
        seed: int = 0,
        record: Iterable[str | PortRef] | None = None,
        decimation: int = 1,
        engine: Literal["auto", "compiled", "interpreted"] = "auto",
    ) -> Session:
        """Start a live run, which `advance` continues piece by piece; the diagram keeps it for the methods below.

        Parameters
        ----------
        seed : int
            Seed of all random streams.
        record : iterable of str, optional
            Names or patterns of the signals that results hold; by default all outputs.
        decimation : int
            Keep every `decimation`-th step.
        engine : {"auto", "compiled", "interpreted"}
            Both give the same bits.

        Returns
        -------
        Session
            The live run at its beginning, before the first outputs are computed.
        """
        import_engine()
        from bayesftc.cosim.run.session import Session

        self._session = Session(self, seed=seed, record=record, decimation=decimation, engine=engine)
        return self._session

    def advance(self, duration: float | str | Fraction, *, pace: float | None = None) -> Result:
        """Continue the live run, or start one; see `Session.advance`.

        Parameters
        ----------
        duration : float, str or Fraction
            Seconds, a whole number of base steps.
        pace : float, optional
            Simulated seconds for each second of the clock.
        """
        return self._live().advance(duration, pace=pace)

    def set(self, name: str | PortRef, value: ArrayLike) -> None:
        """Set the value of an unconnected input of the live run; see `Session.set`.

        Parameters
        ----------
        name : str or port
            Name of the input, ``"plant.force"``.
        value : float or array
            One number for each element, or one for all.
        """
        self._live().set(name, value)

    def save_state(self) -> RunState:
        """Return the state of the live run, including that of FMUs; see `Session.save_state`."""
        return self._live().save_state()

    def restore(self, state: RunState) -> None:
        """Return the live run to a saved state; see `Session.restore`.

        Parameters
        ----------
        state : RunState
            A state from `save_state`.
        """
        self._live().restore(state)

    def reset(self, seed: int | None = None) -> None:
        """Return the live run to its beginning without loading FMUs again; see `Session.reset`.

        Parameters
        ----------
        seed : int, optional
            A new seed; by default that of the run before.
        """
        self._live().reset(seed)

    def _live(self) -> Session:
        if self._session is None or self._session.closed:
            self.start()
        assert self._session is not None
        return self._session

    def to_control(
        self,
        *,
        inputs: Sequence[str] | Mapping[str, str] | str | None = None,
        outputs: Sequence[str] | Mapping[str, str] | str | None = None,
        seed: int | None = 0,
        engine: Literal["auto", "compiled", "interpreted"] = "auto",
        name: str | None = None,
    ) -> ControlSystem:
        """Return the diagram as one discrete-time system of python-control; `Block.to_control` describes its state.

        Parameters
        ----------
        inputs : sequence of str or mapping of str to str, optional
            Inputs of the system. If you name an input of a block (``"plant.disturbance"``), the system's input replaces the
            source of that input. If you name an output of a block (``"reference.y"``, ``"controller.u"``), the system's input
            replaces that output everywhere. By default the inputs that have neither a source nor a start value. The names become
            ``plant_disturbance``, or those of the mapping.
        outputs : sequence of str or mapping of str to str, optional
            Outputs of blocks; by default all.
        seed : int or None
            Seed of the random streams, which give the same numbers as in `simulate`; None for no noise.
        engine : {"auto", "compiled", "interpreted"}
            As in `simulate`.
        name : str, optional
            Name of the system.

        Returns
        -------
        control.NonlinearIOSystem
            With the attribute ``initial_state``, for ``X0``. The diagram itself is not changed and not frozen.
        """
        from bayesftc.cosim.control.control_system import diagram_to_control

        return diagram_to_control(self, inputs, outputs, seed, engine, name)

    def __repr__(self) -> str:
        blocks = ", ".join(self._nodes)
        return f"<Diagram of {len(self._nodes)} blocks at {float(self.step):g} s: {blocks}>"

    def _repr_html_(self) -> str:
        from bayesftc.cosim.diagram.drawing import drawing

        return drawing(self)

    def _refuse_if_built(self, what: str) -> None:
        if self._coupling is not None:
            raise ModelError(f"The diagram is built and frozen; to {what}, do so before build() or simulate().")

    def __getstate__(self) -> dict[str, Any]:
        # A copy shares no table and no live run with the original, and builds its schedule again when it needs one.
        replaced = {"_nodes": dict(self._nodes), "_sources": dict(self._sources), "_schedule": None, "_session": None}
        return {**self.__dict__, **replaced}


def is_external(node: Node) -> bool:
    """Return whether the node's block is an FMU or another block with step functions in C."""
    return isinstance(node.block, ExternalBlock)


def _check_units(connections: Iterable[tuple[tuple[PortRef, int], PortRef]]) -> None:
    """Refuse elements of outputs that feed those of an input and have other units, all at once."""
    found = []
    for (source, element), target in connections:
        a, b, e = source.port, target.port, target.elements[0]
        of_source, of_target = a.unit_of(element), b.unit_of(e)
        if of_source and of_target and (gap := difference(of_source, of_target, a.meaning, b.meaning)):
            found.append(
                f"{source.with_unit_of(element)} is in {of_source}, but {target.with_unit_of(e)} is in {of_target}{gap}"
            )
    if found:
        raise ConnectionError(" ".join(dict.fromkeys(found)))
