"""Fit parameters of an FMU to a recording with gaps and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from os import PathLike
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.numbers import MAD, real
from bayesftc.cosim.base.recordings.columns import bare_name
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import FMUError, ModelError, SimulationError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.fitting import sentences
from bayesftc.cosim.fitting.fitted import FittedFMU
from bayesftc.cosim.fitting.offsets import constant_offsets, std_of_common
from bayesftc.cosim.fitting.recovery import recovering
from bayesftc.cosim.fitting.samples import Columns, Samples, sample
from bayesftc.cosim.fitting.search import Box, Problem, without_slope
from bayesftc.cosim.fitting.settings import FitSettings
from bayesftc.cosim.fitting.simulator import Simulator
from bayesftc.cosim.fitting.uncertainty import Combination, combinations, covariance, is_correlated
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

Weigh = Callable[[Floats, Floats, float], Floats]
"""The weights of samples, each from 0 to 1 (steps x sensors): from the samples of one output's sensors (NaN where there is
none), the output that the fit predicts (steps), and the seconds between two steps."""

FINEST = 1e-9
"""Least noise of a sensor, as a share of its typical sample, for recordings without noise."""

FEWEST = 5
"""Least number of samples of a sensor for each parameter: with fewer, its residuals do not show its noise."""

TINY = 1e-150
"""Least noise of a sensor that is always 0: its square is a number."""


def fit(
    fmu: FMU | str | PathLike[str],
    recording: Any,
    parameters: Mapping[str, tuple[float, float]],
    *,
    outputs: Columns,
    inputs: Columns = (),
    time: str | None = None,
    dt: float | str | Fraction | None = None,
    held_out: float = 0.2,
    weigh: Weigh | Literal["learner"] | None = "learner",
    jobs: int | None = None,
    settings: FitSettings | None = None,
) -> FittedFMU:
    """Fit parameters of an FMU to a recording by least squares; samples that are probably faulty do not count.

    The FMU runs with the recorded inputs. Parameters are sought in their ranges by `scipy.optimize.least_squares` (trust region,
    several starts), first with a robust loss. Then the learner of `bayesftc monitor` gives the probability of each sample that
    its sensor is healthy, which is the weight of the sample. The fit and the weights alternate until the parameters move by less
    than a tenth of their standard errors. Each sensor counts by its noise, which is estimated, too. A constant difference between
    redundant sensors is no fault, and is subtracted.

    Parameters
    ----------
    fmu : FMU, str or path
        The FMU. Its `parameters` are start values that are not fitted.
    recording : Result, pandas.DataFrame, str or path
        Evenly spaced samples, of which rows may be missing, or a CSV or Parquet file with them. An empty cell, or NaN, is no
        sample. An input keeps its last value until the next one. Values are in the FMU's units.
    parameters : mapping
        Name -> ``(low, high)``: the range of each fitted parameter, in the FMU's unit. Start values of states are parameters like
        others. The FMU begins at the first row of the recording.
    outputs : mapping, sequence of str or str
        Output of the FMU -> its column, or columns of redundant sensors. A name alone stands for a column of the same name.
    inputs : mapping, sequence of str or str, optional
        Input of the FMU -> its column. Other inputs keep their start values, with a warning if the recording has a column of
        that name.
    time : str, optional
        Name of the column of times, in seconds or in the unit that ends its name, as in ``t_ms``; by default a column that
        is called t, time or timestamp, also with a unit, else the first one with dates (ISO 8601).
    dt : float, str or Fraction, optional
        Seconds between two steps; by default that of the times, which must then be evenly spaced. Rows may be missing. With `dt`,
        each row belongs to the nearest step.
    held_out : float
        Share of the steps, at the end, that the fit does not use; 0 for none.
    weigh : callable, optional
        What weighs the samples: by default the learner. A function of samples, prediction and `dt` returns weights from 0 to 1.
        None: all samples count.
    jobs : int, optional
        Number of threads; by default one for each core.
    settings : FitSettings, optional
        How it searches, and when it ends.

    Returns
    -------
    FittedFMU
        Parameters with standard errors, correlations and what cannot be told apart.

    Raises
    ------
    ModelError
        If a range, a setting or a column is wrong, or there are too few samples.
    UnknownNameError
        If the FMU has no such parameter, input or output, or the recording no such column.
    StepSizeError
        If the times are not evenly spaced and `dt` is not given.
    RecordingError
        If an input has no first value, or the recording does not fit its step.
    FMUError
        If the FMU cannot be used.
    SimulationError
        If the FMU runs at no point of the ranges.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from bayesftc import cosim, fmus
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> car = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"m": 110.0}), "car")
    >>> push = diagram.add(cosim.PRBS(500.0, 2.0), "push")
    >>> diagram.connect(push["y"], car["force"])
    >>> run = diagram.simulate(60.0)
    >>> v = run["car.v"] + 0.1 * np.random.default_rng(0).standard_normal(len(run["car.v"]))
    >>> table = pd.DataFrame({"time": run.time, "u": run["push.y"], "v": v})
    >>> fitted = cosim.fit(fmus.path("CruiseControl"), table, {"m": (80, 120)}, inputs={"force": "u"}, outputs="v")
    >>> abs(fitted.parameters["m"] - 110.0) < 2 * fitted.std["m"]
    True
    """
    settings = settings or FitSettings()
    box = Box.of(parameters)
    fmu = _with_parameters(fmu if isinstance(fmu, FMU) else FMU(fmu), box)
    samples = sample(recording, inputs, outputs, time, dt)
    split = _split(samples, held_out, len(box.names))
    _warn_of_columns(fmu, samples)
    problem = Problem(
        Simulator(fmu, samples, jobs),
        box,
        settings,
        samples.y[:split],
        samples.output_of,
        np.zeros((0, 0)),
        np.full(samples.y.shape[1], np.nan),
    )
    with reported(f"Fitting {', '.join(box.names)} to {len(samples.y)} steps, for seconds to minutes."):
        found = _rounds(problem, samples, _weigh(weigh), _known(fmu, box))
    return _result(fmu, samples, problem, found)


@dataclass(frozen=True, eq=False)
class _Found:
    """The end of a search.

    It has the place, the weights of the samples, the run, the derivatives of the weighted residuals, the constant offsets of the
    sensors, and the samples after gaps from which the FMU has not recovered.
    """

    place: Floats
    weights: Floats
    outputs: Floats
    jacobian: Floats
    residuals: Floats
    offsets: Floats
    late: Flags
    settled: bool


def _rounds(problem: Problem, samples: Samples, weigh: Weigh | None, known: Floats) -> _Found:
    """Search with a robust loss, then weigh and fit by turns until the parameters settle."""
    rows, settings = len(problem.y), problem.settings
    present = np.isfinite(samples.y)
    weights, least = present.astype(float), FINEST * np.nanmedian(np.abs(samples.y), axis=0) + TINY
    noise = np.maximum(_spread(samples.y[:rows] - np.nanmedian(samples.y[:rows], axis=0)), least)
    loss: Literal["linear", "soft_l1"] = "soft_l1" if weigh else "linear"
    place = problem.weighted(weights[:rows], noise).search(known, loss)
    outputs = _run(problem, place, len(samples.y))
    offsets = further = np.zeros(samples.y.shape[1])
    if weigh:  # a constant offset of a redundant sensor is no fault, but would look like one in every sample
        offsets = constant_offsets((samples.y - outputs[:, samples.output_of])[:rows], samples.output_of)
        samples = replace(samples, y=samples.y - offsets)
        problem = replace(problem, y=samples.y[:rows], common=std_of_common(offsets, samples.output_of))
        noise = np.maximum(_spread((samples.y - outputs[:, samples.output_of])[:rows]), least)
        weighted = problem.weighted(weights[:rows], noise)
        place = weighted.descend(place, loss, coarse=True).x
        outputs = _run(problem, place, len(samples.y))
        further, problem = weighted.offsets(outputs[:rows]), replace(problem, free=True)
    for _ in range(settings.rounds):
        corrected = replace(samples, y=samples.y - further)
        late = recovering(corrected, outputs, least)
        if weigh:
            weights = _weights(weigh, corrected, outputs, late)
        _refuse_few(samples, weights[:rows], len(place))
        noise = np.maximum(_noise(corrected, outputs, weights, rows, len(place)), least)
        weighted = problem.weighted(weights[:rows], noise)
        before, end = place, weighted.descend(place, "linear")
        place, outputs = end.x, _run(problem, end.x, len(samples.y))
        further = weighted.offsets_at_same_times(outputs[:rows])
        settled = float(np.linalg.norm(end.jac @ (place - before))) < settings.settled
        if settled:
            break
    return _Found(place, weights, outputs, end.jac, end.fun, offsets + further, late, settled)


def _result(fmu: FMU, samples: Samples, problem: Problem, found: _Found) -> FittedFMU:
    box, columns, split = problem.box, samples.columns, len(problem.y)
    values, settings, names = box.at(found.place), problem.settings, np.array(box.names)
    margin = settings.difference
    free = np.minimum(found.place, 1.0 - found.place) >= margin
    errors = samples.y - found.offsets - found.outputs[:, samples.output_of]
    counted = np.where(found.weights >= 0.5, errors, np.nan)
    correlated = is_correlated(counted[:split], settings.white)
    jacobian = found.jacobian.reshape(split, len(columns), -1)[:, :, free]
    residuals = found.residuals.reshape(split, len(columns))
    spread = np.full((len(names), len(names)), np.nan)
    white = np.full(len(names), np.nan)
    profile: tuple[Combination, ...] = ()
    if free.any():
        white[free] = np.sqrt(np.diag(covariance(jacobian, residuals, samples.output_of, correlated=False)))
        inside = covariance(jacobian, residuals, samples.output_of, correlated=any(correlated))
        spread[np.ix_(free, free)] = inside
        profile = combinations(tuple(names[free].tolist()), inside)
    std = np.sqrt(np.diag(spread))
    rms, rest = (_rms(counted[part], columns) for part in (slice(split), slice(split, None)))
    present = np.isfinite(samples.y)
    units = {variable.name: variable.unit or "" for variable in fmu.description.variables}
    found_sentences = [
        *sentences.not_followed(columns, samples.y - found.offsets, found.outputs[:, samples.output_of], present),
        *sentences.at_bounds(dict(zip(box.names, found.place.tolist(), strict=True)), values, margin),
        *sentences.undetermined(
            profile, dict(zip(box.names, box.width.tolist(), strict=True)), _stepwise(problem, found)
        ),
        *sentences.correlated(columns, correlated, white, std),
        *sentences.offsets(samples.sensors, found.offsets, units),
        *sentences.gaps(samples.sensors, samples.gaps, found.late, found.weights, present, samples.time),
        *sentences.left_out(samples.sensors, found.weights, found.late, present, samples.time),
        *sentences.held(samples.silences, found.weights, found.late, present, samples.time),
        *sentences.contradicted(samples.sensors, errors, found.weights, found.late, present, samples.time, units),
        *sentences.held_out_worse(rms, rest),
    ]
    if not found.settled:
        found_sentences.append(
            f"The parameters still move after {settings.rounds} rounds of weighing the samples. Look at the figure for what the "
            "FMU does not explain, or give more rounds."
        )
    return FittedFMU(
        plant=replace(fmu, parameters={**(fmu.parameters or {}), **values}),
        parameters=values,
        std=dict(zip(box.names, (box.width * std).tolist(), strict=True)),
        undetermined=tuple(names[std > sentences.UNKNOWN].tolist()),
        correlation=spread / np.outer(std, std),
        profile=profile,
        sensors=samples.sensors,
        offsets=dict(zip(columns, found.offsets.tolist(), strict=True)),
        rms=rms,
        held_out=rest,
        sentences=tuple(found_sentences),
        time=samples.time,
        measured=samples.y,
        weights=found.weights,
        fitted=found.outputs,
        split=split,
    )


def _stepwise(problem: Problem, found: _Found) -> dict[str, int]:
    """Return the parameters of which only a large change has an effect, and the number of values that the search has tried."""
    steps = {}
    for i in without_slope(found.jacobian):
        *runs, here = problem.along(found.place, i)[1]
        if any(isinstance(run, str) or (run != here).any() for run in runs):
            steps[problem.box.names[i]] = len(runs)
    return steps


def _with_parameters(fmu: FMU, box: Box) -> FMU:
    """Return the FMU, after a check that it has the parameters and that they are numbers that a fit can vary."""
    variables = {variable.name: variable for variable in fmu.description.variables}
    for name in box.names:
        if name not in variables:
            settable = [v.name for v in variables.values() if v.causality in ("parameter", "local")]
            raise UnknownNameError(f"The FMU has no parameter {name!r}; {did_you_mean(name, settable)}")
        variable = variables[name]
        if variable.shape or variable.type not in ("Real", "Float32", "Float64"):
            kind = "an array" if variable.shape else f"of the type {variable.type}"
            raise FMUError(f"The parameter {name!r} is {kind}, which cannot be fitted. Fit scalars of floating point.")
        if variable.causality == "input":
            raise FMUError(
                f"The parameter {name!r} is an input of the FMU. Name it among inputs= with its column, or fit another."
            )
    replace(
        fmu, parameters={**(fmu.parameters or {}), **box.at(np.full(len(box.names), 0.5))}
    )  # raises if one cannot be set
    return fmu


def _warn_of_columns(fmu: FMU, samples: Samples) -> None:
    """Warn of each input that keeps its start value although the recording has a column of its name."""
    unused = {*samples.unused, *map(bare_name, samples.unused)}
    for port in fmu._sides[0]:
        if port.name in unused and port.name not in {*samples.inputs, *(fmu.parameters or {})}:
            warn_user(
                f"The input {port.name} is not given and stays at its start value; the recording has a column of that name. "
                f'Add inputs=["{port.name}"], or --input {port.name} on the command line.'
            )


def _known(fmu: FMU, box: Box) -> Floats:
    """Return the place of the FMU's start values; the middle of a range that does not contain one."""
    starts = np.array([real(fmu.start_value(name)) for name in box.names])
    places = (starts - box.low) / box.width
    return np.where((places >= 0.0) & (places <= 1.0), places, 0.5)


def _split(samples: Samples, held_out: float, parameters: int) -> int:
    share = real(held_out)
    if not 0 <= share < 1:
        raise ModelError(f"fit() has held_out={brief(held_out)}; it must be a share, at least 0 and below 1.")
    split = round(len(samples.y) * (1 - share))
    for name, count in zip(samples.columns, np.isfinite(samples.y[:split]).sum(axis=0).tolist(), strict=True):
        if count < FEWEST * parameters:
            raise ModelError(
                f"The column {name!r} has {count} samples in the fitted part of the recording. A fit of {parameters} "
                f"parameter(s) needs {FEWEST * parameters}. Record more, or leave the column out."
            )
    return split


def _weigh(weigh: Weigh | Literal["learner"] | None) -> Weigh | None:
    if weigh == "learner":
        from bayesftc.monitoring.healthy import healthy

        return healthy
    if weigh is not None and not callable(weigh):
        raise ModelError(f"fit() has weigh={brief(weigh)}; give 'learner', a function, or None to count all samples.")
    return weigh


def _weights(weigh: Weigh, samples: Samples, outputs: Floats, late: Flags) -> Floats:
    """Return the weight of each sample, output by output: 0 where the FMU has not recovered from a gap, which is no fault."""
    weights = np.empty(samples.y.shape)
    for j in range(outputs.shape[1]):
        of_output = samples.output_of == j
        y = np.where(late, np.nan, samples.y)[:, of_output]
        given = np.asarray(weigh(y, outputs[:, j], float(samples.step)), dtype=np.float64)
        if given.shape != y.shape or not ((given >= 0) & (given <= 1)).all():
            raise ModelError(
                f"The function weigh= has returned {brief(given)}; it must return an array of shape {y.shape}, of numbers from 0 "
                "to 1."
            )
        weights[:, of_output] = np.where(np.isfinite(y), given, 0.0)
    return weights


def _refuse_few(samples: Samples, weights: Floats, parameters: int) -> None:
    if weights.sum() <= parameters:
        raise ModelError(
            "Nearly all samples are probably faulty, so that none are left for the fit. Check columns and units, or count all "
            "samples: weigh=None, or --all-samples on the command line."
        )


def _run(problem: Problem, place: Floats, rows: int) -> Floats:
    """Return the outputs over the whole recording."""
    (outputs,) = problem.simulator.runs([problem.box.at(place)], rows)
    if isinstance(outputs, str):
        raise SimulationError(f"The FMU runs only in the fitted part of the recording. {outputs}")
    return outputs


def _noise(samples: Samples, outputs: Floats, weights: Floats, rows: int, parameters: int) -> Floats:
    """Return the standard deviation of each sensor's counted residuals, with the parameters' share of the degrees of freedom."""
    squares = np.nan_to_num(samples.y - outputs[:, samples.output_of])[:rows] ** 2 * weights[:rows]
    counted = weights[:rows].sum(axis=0)
    # A sensor of which nearly no sample counts keeps a finite noise.
    return np.asarray(np.sqrt(squares.sum(axis=0) / np.maximum(counted * (1 - parameters / weights[:rows].sum()), 1.0)))


def _spread(residuals: Floats) -> Floats:
    return np.asarray(MAD * np.nanmedian(np.abs(residuals), axis=0))


def _rms(residuals: Floats, columns: Sequence[str]) -> dict[str, float]:
    """Return the root mean square of each column's finite numbers, NaN if there is none."""
    counts = np.isfinite(residuals).sum(axis=0)
    with np.errstate(invalid="ignore"):
        values = np.sqrt(np.nansum(residuals**2, axis=0) / np.where(counts, counts, np.nan))
    return dict(zip(columns, values.tolist(), strict=True))
