"""Compare loops run by run: with the same seeds, and so the same noise and faults, for each loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.numbers import with_and
from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.campaign.campaign import Campaign
from bayesftc.cosim.campaign.designs.design import Points
from bayesftc.cosim.campaign.outcomes import CampaignResult
from bayesftc.cosim.campaign.runs.metrics import LoopFigures
from bayesftc.cosim.comparison.pairing import check_pairs
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.diagram.wiring import find_controller, find_sensors, lies_ahead
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.judging.signals import LoopSignals
from bayesftc.cosim.statistics import compare as compare_levels
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from bayesftc.cosim.campaign.executors.base import Executor
    from bayesftc.cosim.campaign.working import Progress

ROWS = 2000
"""Approximate largest number of instants of each run that are kept for the figure."""

FIGURES = ("tracking.*.overall", "tracking.*.during", "sensors.*.false_alarm_rate")
SAME = 1e-9
"""Largest relative difference of two errors that count as equal: two ways to compute the same differ by rounding."""
KEPT = 0.5
"""Least share of the seeds for an interval: if more are left out because a run failed, the others are no sample of all runs."""
PHASES = {"overall": "", "during": "_in_faults"}
"""The compared phases of a run, and the endings of their columns."""


@dataclass(frozen=True)
class _Chosen:
    """A picklable function that returns one of several loops by its name."""

    loops: Mapping[str, Diagram]

    def __call__(self, loop: str) -> Diagram:
        return self.loops[loop]


class _Run(dict[str, Floats]):
    """Recorded signals of one run, with the time of their rows."""

    def __init__(self, time: Floats, signals: Mapping[str, Floats]):
        super().__init__(signals)
        self.time = time


@dataclass(frozen=True)
class Comparison:
    """The comparison of several loops with the same noise and faults; the result of `compare`.

    Attributes
    ----------
    table : pandas.DataFrame
        A row for each loop and tracked signal, with the columns

        - ``loop``, ``signal``, ``unit``, ``runs`` and ``failed``;
        - ``error``: mean over the runs of the root-mean-square difference between signal and reference, and
          ``error_in_faults``: the same while a fault is present;
        - ``false_alarm_rate``: how often healthy sensors are blamed. It is the share of fault-free steps with an alarm, as the
          mean over all sensors. Alarms that began during a fault count as well;
        - ``difference``: difference of the error to that of the first loop in the same runs, with its paired interval ``low``,
          ``high``, both without the seeds where a run of either loop failed. There is no interval if these are more than half;
        - ``wins``: number of runs with a smaller error than the first loop, and ``pairs``: number of all pairs;
        - the same differences with the ending ``_in_faults``.

        NaN means undefined: the differences of the first loop to itself, the errors in faults if there is no fault, and the false
        alarms of a controller without fault probabilities.
    runs : pandas.DataFrame
        A row for each run, as in `CampaignResult.table`, with the loop's name in the column ``loop``.
    loops : dict of str to Diagram
        The loops by name.
    result : CampaignResult
        The campaign's result with the recorded signals.
    level : float
        Probability that an interval contains the true value.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> system = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 1e-3, 0.04, dt=0.1)
    >>> def loop(goal_covariance):
    ...     controller = controllers.LQGController(model, goal_covariance=goal_covariance)
    ...     return cosim.closed_loop(
    ...         cosim.StateSpace(system), controller, control="u", measured="y", sensors=cosim.Sensors(1, 0.2),
    ...         reference=1.0,
    ...     )
    >>> comparison = cosim.compare({"weak": loop(1.0), "strong": loop(0.01)}, duration=5.0, seeds=5)
    >>> comparison.table[["loop", "error", "wins"]].round(2)
         loop  error  wins
    0    weak   0.27  <NA>
    1  strong   0.15     5
    >>> comparison.runs.shape, len(comparison.signals("strong"))
    ((10, 10), 5)
    """

    loops: Mapping[str, Diagram]
    result: CampaignResult = field(repr=False)
    level: float = 0.95

    @property
    def runs(self) -> pd.DataFrame:
        """See the class."""
        return self.result.table

    @cached_property
    def table(self) -> pd.DataFrame:
        """See the class."""
        import pandas as pd

        runs, units = self.runs, self._units
        alarms = [name for name in map(str, runs) if name.startswith("sensors.")]
        rows = []
        for signal in units:
            differences = {phase: self._differences(f"tracking.{signal}.{phase}") for phase in PHASES}
            for name in self.loops:
                of_loop = runs[runs["loop"] == name]
                row: dict[str, Any] = {
                    "loop": name,
                    "signal": signal,
                    "unit": units[signal] or "",
                    "runs": len(of_loop),
                }
                row["failed"] = int((of_loop["status"] != "ok").sum())
                for phase, ending in PHASES.items():
                    row[f"error{ending}"] = of_loop[f"tracking.{signal}.{phase}"].mean()
                row["false_alarm_rate"] = of_loop[alarms].mean(axis=None) if alarms else np.nan
                for phase, ending in PHASES.items():
                    row |= {f"{key}{ending}": value for key, value in differences[phase].get(name, _NOTHING).items()}
                rows.append(row)
        counts = [f"{name}{ending}" for name in ("wins", "pairs") for ending in PHASES.values()]
        return pd.DataFrame(rows).astype(dict.fromkeys(counts, "Int64"))

    def signals(self, loop: str) -> list[LoopSignals]:
        """Return the signals of each complete run of a loop, by their role in it.

        Parameters
        ----------
        loop : str
            Name of the loop.
        """
        if loop not in self.loops:
            raise UnknownNameError(f"The comparison has no loop {loop!r}; {did_you_mean(loop, self.loops)}")
        dataset = self.result.dataset
        kept = np.flatnonzero((dataset["loop"].values == loop) & (dataset["status"].values == "ok"))
        time, arrays = dataset["time"].values, {str(name): dataset[name].values for name in dataset.data_vars}
        runs: list[Any] = [_Run(time, {name: values[i] for name, values in arrays.items()}) for i in kept]
        return [loop_signals(self.loops[loop], run, drawn=False) for run in runs]

    def plot(self) -> Figure:
        """Return a figure of each tracked signal: the median over the runs of each loop, a band, the reference, faults shaded.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it; a script saves it (``figure.savefig("comparison.png")``) or shows it with ``pyplot.show()``.
        """
        from bayesftc.cosim.comparison.figure import plot_comparison
        from bayesftc.cosim.judging.figures.panels import shown_figure

        runs = {name: self.signals(name) for name in self.loops}
        return plot_comparison(runs, list(self._units), shown_figure(), self.failed)

    @property
    def failed(self) -> dict[str, int]:
        """The number of runs of each loop that failed."""
        return {str(name): int(count) for name, count in zip(self.table["loop"], self.table["failed"], strict=True)}

    @property
    def remark(self) -> str:
        """A sentence on runs that failed, which the table leaves out; empty if there are none."""
        failed = [
            f"{count} runs of {name}" if count > 1 else f"1 run of {name}"
            for name, count in self.failed.items()
            if count
        ]
        if not failed:
            return ""
        return (
            f"{with_and(failed)} failed. Errors are those of the other runs, which may be the easy ones. Differences and "
            "wins leave out each seed where a run failed, and have no interval if these are more than half."
        )

    @property
    def _units(self) -> dict[str, str | None]:
        """The tracked signals with their units."""
        roles = find_roles(next(iter(self.loops.values())))
        return {q.name: q.unit for q in roles.quantities if q.goal is not None and q.truth}

    def _differences(self, metric: str) -> dict[str, dict[str, float]]:
        """Return for each loop except the first the differences of its runs from those of the first."""
        first = next(iter(self.loops))
        table = compare_levels(self.runs, metric, "loop", against=first, level=self.level).set_index("first")
        by_loop = self.runs.pivot(index="seed", columns="loop", values=metric)
        good = self.runs.assign(good=self.runs["status"] == "ok").pivot(index="seed", columns="loop", values="good")
        gaps = by_loop.sub(by_loop[first], axis=0)
        gaps = gaps.mask(gaps.abs().le(SAME * by_loop[first].abs(), axis=0), 0.0)
        return {
            str(name): {
                **{key: 0.0 if (gaps[name] == 0).all() else float(row[key]) for key in ("difference", "low", "high")},
                **({} if (good[name] & good[first]).mean() >= KEPT else dict.fromkeys(("low", "high"), np.nan)),
                "wins": float((gaps[name] < 0).sum()),
                "pairs": float(row["n_first"]),
            }
            for name, row in table.iterrows()
        }

    def __repr__(self) -> str:
        return "\n\n".join(filter(None, [self._shown().to_string(), self.remark]))

    def _repr_html_(self) -> str:
        return self._shown().to_html() + (f"\n<p>{escape(self.remark)}</p>" if self.remark else "")

    def _shown(self) -> pd.DataFrame:
        """Return the table with a column for each loop and signal, and four digits: pandas makes 0.000006 of 5.9e-06."""
        import pandas as pd

        def digits(value: Any) -> str:
            if pd.isna(value):
                return ""
            return f"{value:.4g}" if isinstance(value, float) else str(value)

        whole = self.table.set_index(["loop", "signal"])
        shown = pd.DataFrame({key: [digits(each) for each in row] for key, row in whole.iterrows()}, whole.columns)
        return shown[(shown != "").any(axis=1)]


_NOTHING = dict.fromkeys(("difference", "low", "high", "wins", "pairs"), np.nan)


def compare(
    loops: Mapping[str, Diagram],
    *,
    duration: float | str | Fraction,
    seeds: int | Sequence[int] = 50,
    seed: int = 0,
    level: float = 0.95,
    time_limit: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Run several loops with the same seeds on all cores, and compare their errors run by run.

    Runs of the same seed have the same noise and the same faults in each loop. So the difference of two loops is much more
    certain than the error of either.

    Parameters
    ----------
    loops : mapping of str to Diagram
        At least two closed loops by name; the others are compared with the first. They may differ in controller and plant, but
        a plant that draws noise must be the same in all. Controllers may have different previews: the errors are those from
        the present goal.
    duration : float, str or Fraction
        Seconds of each run.
    seeds : int or sequence of int
        Number of runs of each loop, or their seeds.
    seed : int
        The seed from which the seeds of the runs are computed.
    level : float
        Probability that an interval contains the difference.
    time_limit : float, optional
        Largest computing time of a run in seconds. A run that takes longer counts as failed.
    executor, progress : optional
        See `Campaign.run`.

    Returns
    -------
    Comparison
        It has ``table`` and ``plot()``.

    Warns
    -----
    UserWarning
        If a fault starts after the end of the run.

    Raises
    ------
    ModelError
        If there are fewer than two loops, one is not a closed loop, their noise, faults or references differ, or no measured
        signal has a goal.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> system = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    >>> loops = {}
    >>> for name, precision in {"fixed": controllers.FixedPrecision(), "SER": controllers.SERFDI()}.items():
    ...     controller = controllers.LQGController(model, precision=precision, goal_covariance=0.01)
    ...     loops[name] = cosim.closed_loop(
    ...         cosim.StateSpace(system, process_noise=[[1e-3]]), controller, control="u", measured="y",
    ...         sensors=cosim.Sensors(2, 0.2), faults=[cosim.Bias(sensor=0, magnitude=3.0, start=2.0)], reference=1.0,
    ...     )
    >>> cosim.compare(loops, duration=5.0, seeds=10).table[["loop", "runs", "wins"]]
        loop  runs  wins
    0  fixed    10  <NA>
    1    SER    10    10
    """
    if not isinstance(loops, Mapping) or len(loops) < 2:
        raise ModelError(
            "compare needs at least two loops by name: compare({'fixed': loop_a, 'switching': loop_b}, duration=20.0)."
        )
    for name, loop in loops.items():
        if not isinstance(name, str) or not isinstance(loop, Diagram):
            raise ModelError(f"compare has {name!r}: {loop!r}; give a mapping from names (texts) to diagrams.")
    check_pairs(loops)
    if (len(seeds) if np.ndim(seeds) else seeds) == 1:  # type: ignore[arg-type]
        raise ModelError("compare has one seed; intervals and tests need at least two. Give seeds=2 or more.")
    first = next(iter(loops.values()))
    record = _recorded(first)
    for name, loop in loops.items():
        if _recorded(loop) != record:
            raise ModelError(
                f"The loop {name!r} measures or tracks other signals ({', '.join(_recorded(loop))}) than the first one "
                f"({', '.join(record)}). Compare loops that track the same signals of plants of the same name; goal_names of a "
                "controller says which signal a goal is for that no sensor measures."
            )
    for name, loop in loops.items():
        if not any(quantity.goal is not None and quantity.truth for quantity in find_roles(loop).quantities):
            raise ModelError(
                f"No known signal of the loop {name!r} has a goal, so that there is no tracking error. Track a measured signal, "
                "or name what the goal is for: a controller by goal_names=['angle'] (also a block of your own), a Subsystem of "
                "yours by goals=['angle']."
            )
    campaign = Campaign(
        _Chosen(dict(loops)),
        duration=duration,
        grid=Points([{"loop": name} for name in loops]),
        seeds=seeds,
        seed=seed,
        record=record,
        metrics=[LoopFigures(only=FIGURES)],
        decimation=max(1, whole_steps(duration, first.step, "The duration") // ROWS),
        time_limit=time_limit,
    )
    return Comparison(dict(loops), campaign.run(executor=executor, progress=progress), level)


def _recorded(loop: Diagram) -> list[str]:
    """Return the names of the signals in the figure: sources of the sensors and goals, true values, and activity of faults.

    Of a goal that lies ahead it is the present one.
    """
    sensors, controller = find_sensors(loop), find_controller(loop)
    faults = [f"{node.name}.active" for node in loop.nodes if isinstance(node.block, Fault)]
    true = [place[0] for quantity in find_roles(loop).quantities for _, place in quantity.truth or ()]
    read = [f"{origin.node.name}.{origin.port.name}" for origin in _sources(loop, sensors, "u")]
    goals = [
        f"{origin.node.name}.{'y' if lies_ahead(origin) else origin.port.name}"
        for origin in _sources(loop, controller, "goal")
    ]
    return list(dict.fromkeys([*read, *true, *goals, *faults]))


def _sources(loop: Diagram, node: Node, port: str) -> list[PortRef]:
    into = node.port(port)
    origins = [loop.source_of(node, into, i) for i in range(into.size)]
    return [origin[0] for origin in origins if origin is not None]


__all__ = ["Comparison", "compare"]
