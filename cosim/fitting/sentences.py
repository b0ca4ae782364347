"""What a fit lacks, as sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.base.recordings.silences import Silence, held_notes
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.fitting.uncertainty import Combination
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats

UNKNOWN = 12**-0.5
"""Standard deviation of a uniform distribution over a range: with more, the recording says less than the range does."""

LEFT_OUT = 0.01
"""Share of a sensor's samples from which on a sentence states that they do not count."""

NEAR = 2.0
"""Largest error of a sensor that is near the FMU, relative to its noise: an error of the FMU as large as the noise makes 1.4."""

FAR = 4.0
"""Error of a sensor from which on it is far from the FMU, relative to its noise: twice that of one that is near."""

FEWEST = 5
"""Least number of samples of a sensor that show whether it is near the FMU."""

LOST = 3.0
"""Error of an output, relative to the motion of its samples, from which on the FMU does not follow them at all."""

WORSE = 1.5
"""Ratio of the error in the held-out part to that in the fitted part from which on there is a sentence."""

MATTERS = 0.1
"""Least share of a parameter in a combination that a sentence names."""


def at_bounds(places: Mapping[str, float], parameters: Mapping[str, float], margin: float) -> Iterator[str]:
    """Give a sentence for each parameter at a bound of its range; `places` are between 0 and 1."""
    for name, place in places.items():
        if min(place, 1.0 - place) < margin:
            end = "lower" if place < 0.5 else "upper"
            yield (
                f"{name} = {parameters[name]:.6g} is at the {end} bound of its range, and so has no standard error. "
                "Widen the range."
            )


def undetermined(
    profile: Sequence[Combination], widths: Mapping[str, float], stepwise: Mapping[str, int]
) -> Iterator[str]:
    """Give a sentence for each combination that the recording does not determine.

    `stepwise` are the parameters of which a small change has no effect, but a large one has, with the number of values tried.
    """
    for combination in profile:
        if combination.std <= UNKNOWN:
            continue
        changes = [
            f"{name} by {share * widths[name]:+.3g}"
            for name, share in combination.direction.items()
            if abs(share) > MATTERS
        ]
        names = [change.split(" by ")[0] for change in changes]
        if len(names) == 1 and names[0] in stepwise:
            yield (
                f"{names[0]} has no standard error: a small change of it changes no output, but other values in its range do. "
                f"The FMU may round it. Its value is the best of {stepwise[names[0]]} over its range, beside the other "
                "parameters as they were. Their standard errors are for this value. Compare fits with several fixed values of it."
            )
        elif len(names) == 1:
            yield (
                f"{names[0]} cannot be determined: the outputs hardly depend on it in its range. Fix it, or record a motion that "
                "depends on it."
            )
        else:
            yield (
                f"{' and '.join(names)} cannot be told apart: the outputs hardly change if one changes {' and '.join(changes)}. "
                "Fix one of them, or record another motion."
            )


def correlated(columns: Sequence[str], found: Sequence[bool], white: Floats, used: Floats) -> Iterator[str]:
    """Give a sentence if residuals are correlated; `white` and `used` are standard errors without and with that."""
    names = [column for column, is_correlated in zip(columns, found, strict=True) if is_correlated]
    if names:
        with np.errstate(all="ignore"):
            factor = float(np.nanmax(used / white)) if np.isfinite(used / white).any() else np.nan
        yield (
            f"The residuals of {', '.join(names)} are not white: the noise is coloured, or the FMU differs from the plant. The "
            f"standard errors take this into account (up to {factor:.2g} times those of white noise), but not a systematic error."
        )


def offsets(sensors: Mapping[str, Sequence[str]], found: Floats, units: Mapping[str, str]) -> Iterator[str]:
    """Give a sentence for each output whose sensors differ by constants, which the fit has subtracted."""
    of = dict(zip((column for columns in sensors.values() for column in columns), found.tolist(), strict=True))
    for output, columns in sensors.items():
        largest = max(abs(of[column]) for column in columns)
        if largest:
            digits, unit = 1 - int(np.floor(np.log10(largest))), behind(units.get(output))
            errors = ", ".join(f"{column} {round(of[column], digits) + 0.0:+g}{unit}" for column in columns)
            yield (
                f"The sensors of {output} differ by a constant in most of the recording. This counts as an error of calibration, "
                f"not as a fault. The fit estimates these errors and subtracts them: {errors}. Only the FMU shows which sensor "
                "errs. The standard errors contain that this is uncertain, but no larger error that the sensors share. If you "
                "know which sensor is right, correct the columns of the others."
            )


def gaps(
    sensors: Mapping[str, Sequence[str]],
    gaps: Sequence[tuple[int, int]],
    late: Flags,
    weights: Floats,
    present: Flags,
    time: Floats,
) -> Iterator[str]:
    """Give a sentence for each gap from which the FMU has not recovered at once; `late` are the samples up to then.

    Only where it recovers later has no sensor failed: an error up to the end may be of the FMU or of the sensors.
    """
    output_of = np.repeat(np.arange(len(sensors)), [len(columns) for columns in sensors.values()])
    for k, (before, after) in enumerate(gaps):
        part = slice(after, gaps[k + 1][0] + 1 if k + 1 < len(gaps) else None)
        steps = {name: np.flatnonzero(late[part, output_of == j].any(axis=1)) for j, name in enumerate(sensors)}
        until = [f"{name} up to {time[after + found[-1]]:g} s" for name, found in steps.items() if len(found)]
        if not until:
            continue
        counted = (weights[part][late[part]] >= 0.5).any()
        differing = [(j, name) for j, name in enumerate(sensors) if len(steps[name])]
        back = [name for j, name in differing if (present & ~late)[after:, output_of == j].any()]
        never = [name for _, name in differing if name not in back]
        yield (
            f"From {time[before]:g} to {time[after]:g} s the recording has a gap, in which the inputs are unknown. They keep "
            f"their last values in the FMU. Its outputs differ after the gap: {', '.join(until)}. These samples "
            f"{'count all the same' if counted else 'do not count'}.{'' if counted else _no_faults(back, never)}{_open(never)}"
        )


def _no_faults(back: Sequence[str], never: Sequence[str]) -> str:
    """Return that the samples of outputs that the FMU follows again are no faults; `never` are the others."""
    if not back:
        return ""
    return f" Those of {', '.join(back)} are no faults." if never else " They are no faults."


def _open(never: Sequence[str]) -> str:
    """Return what is not known of outputs that the FMU never follows again."""
    if not never:
        return ""
    return (
        f" {', '.join(never)} differ{'s' * (len(never) == 1)} up to the end: either the state of the FMU or the sensors are "
        "wrong from the gap on. The fit cannot tell which: see the figure."
    )


def left_out(
    sensors: Mapping[str, Sequence[str]], weights: Floats, late: Flags, present: Flags, time: Floats
) -> Iterator[str]:
    """Give a sentence for each sensor of which samples do not count because it is probably faulty.

    `sensors` are those of each output. Samples that are `late`, before the FMU has recovered from a gap, are no faults. So they
    end a stretch, and missing samples do not.
    """
    alone = [len(columns) == 1 for columns in sensors.values() for _ in columns]
    columns = [column for columns in sensors.values() for column in columns]
    for i, out, stretch in _faulty(weights, late, present):
        yield (
            f"{columns[i]}: {out.sum() / present[:, i].sum():.0%} of its samples are probably faulty and do not count; the "
            f"longest stretch is from {time[stretch[0]]:g} to {time[stretch[-1]]:g} s."
            + " A single sensor does not show whether it or the FMU is wrong: see the figure."
            * alone[i]
        )


def held(found: Sequence[Silence], weights: Floats, late: Flags, present: Flags, time: Floats) -> Iterator[str]:
    """Give a sentence for each input without samples in a time in which samples of a sensor are probably faulty."""
    times = [time[out] for _, out, _ in _faulty(weights, late, present)]
    return held_notes(found, lambda each: any(((t > each.start) & (t < each.end)).any() for t in times))


def contradicted(
    sensors: Mapping[str, Sequence[str]],
    errors: Floats,
    weights: Floats,
    late: Flags,
    present: Flags,
    time: Floats,
    units: Mapping[str, str],
) -> Iterator[str]:
    """Give a sentence for each sensor that does not count although it is near the FMU, while one that counts is far from it.

    `errors` are the differences between samples and FMU. Of two sensors that move apart slowly, the learner may believe the
    faulty one; the parameters and the other outputs then still hold the FMU near the healthy one.
    """
    columns = [(output, column) for output, columns in sensors.items() for column in columns]
    for i, _, stretch in _faulty(weights, late, present):
        part = slice(stretch[0], stretch[-1] + 1)
        own, noise = _root_mean_square(errors[stretch, i]), _noise(errors[present[:, i], i])
        if len(stretch) < FEWEST or own > NEAR * noise:
            continue
        for k, (output, other) in enumerate(columns):
            counted = (weights[part, k] >= 0.5) & present[part, k]
            if k == i or output != columns[i][0] or counted.sum() < FEWEST:
                continue
            apart, usual = _root_mean_square(errors[part, k][counted]), _noise(errors[present[:, k], k])
            if apart > FAR * max(usual, own / NEAR):
                unit, name = behind(units.get(output)), columns[i][1]
                yield (
                    f"The fit contradicts its weights from {time[stretch[0]]:g} to {time[stretch[-1]]:g} s: {other}, which "
                    f"counts, differs from the FMU by {apart:.3g}{unit} (noise {usual:.2g}{unit}), and {name}, which does not "
                    f"count, by {own:.2g}{unit} (noise {noise:.2g}{unit}). Probably {other} has failed, and not {name}. Fit "
                    f"again without the column {other}, or with its cells in this time empty."
                )


def _faulty(weights: Floats, late: Flags, present: Flags) -> Iterator[tuple[int, Flags, Any]]:
    """Give each sensor with many faulty samples, which these are, and the steps of those in the longest stretch."""
    for i in range(weights.shape[1]):
        out = (weights[:, i] < 0.5) & present[:, i] & ~late[:, i]
        if out.sum() > LEFT_OUT * present[:, i].sum():
            spans = periods(out | ~present[:, i])
            begin, end = max(spans, key=lambda span: int(out[slice(*span)].sum()))
            yield i, out, begin + np.flatnonzero(out[begin:end])


def _root_mean_square(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _noise(errors: Floats) -> float:
    """Return the standard deviation of white noise by the changes, which a slow fault hardly enlarges."""
    return MAD * float(np.median(np.abs(np.diff(errors)))) / 2**0.5 if len(errors) > 1 else 0.0


def not_followed(columns: Sequence[str], measured: Floats, fitted: Floats, present: Flags) -> Iterator[str]:
    """Give a sentence if outputs of the FMU are further from the samples than these from their mean, as of an unstable plant."""
    lost = []
    for i, column in enumerate(columns):
        y, apart = measured[present[:, i], i], (fitted - measured)[present[:, i], i]
        if len(y) and np.sqrt(np.mean(apart**2)) > LOST * np.std(y) > 0.0:
            lost.append(f"{column} ({np.sqrt(np.mean(apart**2)):.3g} beside a motion of {np.std(y):.3g})")
    if lost:
        yield (
            f"The FMU does not follow the recording: its error is far larger than the motion in {', '.join(lost)}. Do not use "
            "these parameters. If the plant is unstable and was recorded under a controller, the FMU runs away, because the "
            "recorded inputs alone drive it: identify a linear model instead (LinearModel.identify), or fit a short stretch."
        )


def held_out_worse(rms: Mapping[str, float], held_out: Mapping[str, float]) -> Iterator[str]:
    """Give a sentence for each sensor whose error is larger in the held-out part."""
    for column, value in held_out.items():
        if value > WORSE * rms[column]:
            yield (
                f"{column}: in the held-out part the error is {value / rms[column]:.2g} times that in the fitted part. The FMU "
                "differs from the plant, or the plant has changed."
            )
