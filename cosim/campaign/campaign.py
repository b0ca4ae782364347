"""Campaigns: one loop at many points of a design with many seeds, on all cores or a cluster, resumable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.base.timebase import whole_number, whole_steps
from bayesftc.cosim.blocks.faults.without_effect import warn_without_effect
from bayesftc.cosim.campaign.designs.design import Design, Grid
from bayesftc.cosim.campaign.designs.plan import Plan
from bayesftc.cosim.campaign.designs.seeds import seeds_of_points
from bayesftc.cosim.campaign.outcomes import CampaignResult
from bayesftc.cosim.campaign.runs.job import Job, Loop
from bayesftc.cosim.campaign.runs.late import faults_after_the_end
from bayesftc.cosim.campaign.runs.metrics import Metric, as_metrics
from bayesftc.cosim.campaign.working import Progress, in_memory, in_store, noting_what_is_kept
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.run.fused.compiled import LANES
from bayesftc.cosim.run.interrupts import import_engine

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.executors.base import Executor
    from bayesftc.cosim.run.result import Result

STEPS = 2_000_000
"""Largest number of steps of a piece: half a second of computing if they are quick."""
BYTES = 16_000_000
"""Largest size of the signals of a piece."""
PIECES = 32
"""Smallest number of pieces, so that slow runs also use all cores, and little is lost if the campaign is stopped."""


class Campaign:
    """Runs of a loop at many points of a design with many seeds.

    Parameters
    ----------
    loop : Diagram or callable
        A diagram, whose settings the factors change by their paths (`varied`); or a function that is called with the factors
        of a point as keywords and returns a diagram. To run in other processes it must be picklable.
    duration : float, str or Fraction
        Seconds of each run.
    grid : mapping or Design, optional
        Factor -> its values, of which all combinations are run; or another design: `Points`, `LatinHypercube`, `SobolSequence`,
        products of designs. By default the loop as it is.
    seeds : int or sequence of int
        Number of runs at each point, or their seeds. All points have the same seeds, so comparisons between them are paired.
    seed : int
        The seed from which the seeds of the runs are computed.
    independent : sequence of str
        Factors of which each value has different seeds, and so independent noise.
    record : sequence of str
        Names or patterns of the signals to keep. They must exist at every point. If ``fault_probability`` or ``beta`` of
        the controller of a closed loop is among them, two further signals are kept. For each sensor, ``sensor_faulty`` is 1 while
        a fault is present, and ``sensor_missing`` is 1 at a missing sample.
    metrics : sequence of Metric or callable, optional
        Numbers of each run: metrics such as `RMSE`, or functions from a `Result` to a number.
    decimation : int
        Keep every `decimation`-th step of the signals. Metrics use all steps.
    time_limit : float, optional
        Largest computing time of a run in seconds. A run that takes longer counts as failed.
    piece : int, optional
        Number of runs that are made, stored and resumed together. By default a 32nd of all runs, or fewer: so few that
        a piece of quick runs takes at most half a second.

    Warns
    -----
    UserWarning
        If a fault starts after the end of the run at every point.

    Raises
    ------
    BayesFTCError
        If the loop cannot be built at the first point, or a name is unknown in it.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise, gain = diagram.add(cosim.Gaussian(std=1.0), "noise"), diagram.add(cosim.Gain(2.0), "gain")
    >>> diagram.connect(noise["y"], gain["u"])
    >>> campaign = cosim.Campaign(
    ...     diagram, duration=10.0, grid={"gain.gain": [1.0, 2.0]}, seeds=3, metrics=[cosim.RMSE("gain.y", name="size")]
    ... )
    >>> table = campaign.run().table
    >>> (table["size"][3:].to_numpy() / table["size"][:3].to_numpy()).round(12).tolist()
    [2.0, 2.0, 2.0]
    """

    def __init__(
        self,
        loop: Loop,
        *,
        duration: float | str | Fraction,
        grid: Mapping[str, Sequence[Any] | Mapping[Any, Any]] | Design | None = None,
        seeds: int | Sequence[int] = 1,
        seed: int = 0,
        independent: Sequence[str] = (),
        record: Iterable[str] = (),
        metrics: Iterable[Metric | Callable[[Result], float]] = (),
        decimation: int = 1,
        time_limit: float | None = None,
        piece: int | None = None,
    ):
        import_engine()
        if not isinstance(loop, Diagram) and not callable(loop):
            raise ModelError(
                f"The loop of a campaign must be a Diagram, or a function that returns one, not {brief(loop)}."
            )
        self.design = grid if isinstance(grid, Design) or grid is None else Grid(grid)
        self.labels: list[dict[str, Any]] = self.design.labels() if self.design else [{}]
        points = self.design.points() if self.design else [{}]
        point_seeds = seeds_of_points(self.labels, seeds, seed, independent)
        names = [record] if isinstance(record, str) or not isinstance(record, Iterable) else list(record)
        whole_number(decimation, "decimation is ")
        trial = Job(
            loop,
            Plan(tuple(points), point_seeds, 1),
            duration,
            names,
            as_metrics(metrics),
            decimation=decimation,
            time_limit=time_limit,
        )
        size = _piece(trial) if piece is None else min(whole_number(piece, "piece is "), trial.plan.runs)
        trial.plan = Plan(tuple(points), point_seeds, size)
        self.job = trial
        warn_without_effect(faults_after_the_end(trial))

    @property
    def runs(self) -> int:
        """Number of all runs."""
        return self.job.plan.runs

    def run(
        self,
        store: str | PathLike[str] | None = None,
        *,
        executor: Executor | None = None,
        progress: Progress | None = None,
        retry_failed: bool = False,
        description: Mapping[str, Any] | None = None,
    ) -> CampaignResult:
        """Make all runs, or those that are missing in a store.

        Parameters
        ----------
        store : str or path, optional
            Folder for the results, made if necessary; by default they are kept in memory. After an interruption, a further call
            with the same store continues the campaign.
        executor : Executor, optional
            Such as `Threads`, `Processes` or `DaskCluster`; by default threads if every block and FMU allows it, else processes.
            The result's ``metadata["executor"]`` names the executor, with the reason. The bits are the same on each.
        progress : callable, optional
            Called as ``progress(done, of, failed)`` when a piece is done.
        retry_failed : bool
            With a store: repeat the failed runs. The new outcomes replace the old ones.
        description : mapping, optional
            Further data for the store's description of the campaign. A resumption must give the same data.

        Returns
        -------
        CampaignResult
            The table of runs, and the signals.

        Raises
        ------
        ModelError
            If `executor` is not an executor.
        StoreError
            If the store is of another campaign, another process writes to it, or it cannot be written.
        ModelError
            If the campaign cannot be sent to the processes of the executor.
        KeyboardInterrupt
            On Ctrl-C, after all workers have ended; its note has the number of runs that the store keeps.
        """
        if executor is not None and (isinstance(executor, type) or not callable(getattr(executor, "run", None))):
            from bayesftc.cosim.campaign.executors.choice import EXECUTORS

            known = ", ".join(f"{cls.__name__}()" for cls in EXECUTORS)
            raise ModelError(f"executor is {brief(executor)}; it must be one of {known}, or left out.")
        reason = f"{executor!r}, as requested."

        def choose() -> Executor:
            nonlocal executor, reason
            if executor is None:
                from bayesftc.cosim.campaign.executors.choice import choose_executor

                executor, reason = choose_executor(self.job)
            return executor

        if store is None:
            if retry_failed:
                raise ModelError(
                    "retry_failed=True needs a store, because only a store keeps failed runs; give run() the folder of a store."
                )
            with noting_what_is_kept(None, self.runs):
                result = in_memory(self.job, self.labels, choose(), progress)
        else:
            path = expanded(store).absolute()
            extra = description or {}
            with noting_what_is_kept(path, self.runs):
                result = in_store(self.job, self.labels, path, extra, choose, progress, retry_failed=retry_failed)
        if executor is not None:
            result.metadata["executor"] = reason
        return result

    def replay(self, run: int, *, record: Iterable[str] | None = None, **options: Any) -> Result:
        """Repeat one run with full recording.

        Parameters
        ----------
        run : int
            Number of the run in the table.
        record : iterable of str, optional
            Names of the signals to keep; by default all outputs.
        **options : object
            Further arguments of `Diagram.simulate`.
        """
        points, seeds = self.job.plan.of_runs()
        if isinstance(run, bool) or not isinstance(run, int | np.integer) or not 0 <= run < len(points):
            raise ModelError(f"There is no run {run!r}; the campaign has the runs 0 to {len(points) - 1}.")
        diagram = self.job.diagram(int(points[run]))
        return diagram.simulate(self.job.duration, seed=int(seeds[run]), record=record, **options)

    def __repr__(self) -> str:
        return f"<Campaign: {len(self.labels)} points, {self.runs} runs>"

    def _repr_html_(self) -> str:
        """Return a table of the factors, their values, and the kept metrics and signals, for notebooks."""
        job = self.job
        factors = {name: list(dict.fromkeys(str(label[name]) for label in self.labels)) for name in self.labels[0]}
        rows = [(name, ", ".join(values)) for name, values in factors.items()]
        rows += [
            ("duration", f"{float(job.steps * job.step):g} s, {job.steps} steps"),
            ("seeds at each point", str(len(job.plan.seeds[0]))),
            ("metrics", ", ".join(job.columns) or "none"),
            ("signals", ", ".join(job.signals) or "none"),
        ]
        return table(repr(self)[1:-1], rows)


def _piece(job: Job) -> int:
    """Return the number of runs in a piece; a multiple of `LANES`, as runs that are left over are made one by one."""
    numbers = sum(int(np.prod(s.shape)) for s in job.signals.values()) * len(job.time)
    steps = whole_steps(job.duration, job.step, "The duration")
    most = max(1, min(STEPS // max(steps, 1), BYTES // max(8 * numbers, 1), -(-job.plan.runs // PIECES)))
    return most - most % LANES if most > LANES else most


__all__ = ["Campaign"]
