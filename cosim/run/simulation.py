"""One run of a diagram, from its beginning."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

from bayesftc.cosim.run.session import Session

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.diagram.nodes import PortRef
    from bayesftc.cosim.run.result import Result
    from bayesftc.cosim.run.running import Progress


def simulate(
    diagram: Diagram,
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
    """Run `diagram` for `duration` seconds from its initial state.

    Parameters
    ----------
    diagram : Diagram
        What to run; it is built and frozen if it is not yet.
    duration : float, str or Fraction
        Seconds; a whole number of base steps. The result has a row at both ends (with `decimation`, at the end only if it
        divides the number of steps).
    seed : int
        Seed of all random streams. The same seed gives the same numbers, whatever else is in the diagram.
    record : iterable of str, optional
        Names of the signals to keep, ``*`` allowed (``["plant.v", "controller.*"]``), or ports (``plant["v"]``); by default
        all outputs. Inputs can be recorded as well, by name.
    decimation : int
        Keep every `decimation`-th step, from step 0 on.
    engine : {"auto", "compiled", "interpreted"}
        ``auto`` is compiled where every block allows it. Both give the same bits.
    progress : callable, optional
        Called as ``progress(step, steps)`` about twenty times a second.
    time_limit : float, optional
        Seconds of computing after which the run is stopped.
    pace : float, optional
        Simulated seconds for each second of the clock, 1.0 for real time: what belongs to t_k is computed when its time has
        come. ``result.metadata["pace"]`` says how many steps were not done before the next was due (``overruns``) and by how
        many seconds at worst (``worst_overrun``). By default as fast as the machine can.

    Returns
    -------
    Result
        The recorded signals.

    Warns
    -----
    UserWarning
        If an FMU has ended the run: ``result.stopped`` says why.

    Raises
    ------
    SimulationError
        If a plant's output is NaN or infinite, an FMU reports an error, or the time limit is reached; its ``result`` has the
        signals up to the last complete step.
    KeyboardInterrupt
        On Ctrl-C, within about a twentieth of a second (an FMU's single step is not cut short). The signals so far are
        discarded; to keep those of a run that may take too long, give it a ``time_limit``.
    """
    with Session(diagram, seed=seed, record=record, decimation=decimation, engine=engine) as session:
        return session.advance(duration, progress=progress, time_limit=time_limit, pace=pace)


__all__ = ["simulate"]
