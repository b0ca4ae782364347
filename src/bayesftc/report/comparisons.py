"""The effect of the compared factor: differences of its levels over all points and in each cell, and sentences on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesftc.cosim.base.numbers import with_half
from bayesftc.report.levels import MOST_COMPARED, Pair, compared_levels, pair, ranked
from bayesftc.report.tables import ROWS, Table, mean_text, p_text, text_of

if TYPE_CHECKING:
    import pandas as pd

    from bayesftc.report.contents import Contents


def overall(contents: Contents) -> Table | None:
    """Return the differences between each two levels over all points."""
    if contents.metric is None or contents.compared is None:
        return None
    pairs = [each for each in compared_levels(contents) if each.difference.runs]
    if not pairs:
        return None
    rows = []
    for each in pairs:
        value, half = each.difference.value, each.half
        text = with_half(value, half)
        rows.append([_minus(each), str(each.points), str(each.difference.runs), text, p_text(each.p)])
    paired, apart = (any(each.paired is way for each in pairs) for way in (True, False))
    how = [
        *(["differences of runs with the same seed at the same point"] if paired else []),
        *(["differences of means of independent runs"] if apart else []),
    ]
    note = f"{' and '.join(how).capitalize()}; ± is half of the 95 % confidence interval over seeds"
    every = pairs[0].pairs
    note += f". Interval and p hold for all {every} pairs together (Bonferroni)." if every > 1 else "."
    if len(contents.levels()) > MOST_COMPARED:
        note += " With so many levels only the two with the lowest means are compared."
    if contents.others:
        note += f" Means over the combinations of {', '.join(contents.others)}; a single combination can differ."
    kind = "pairs of runs" if not apart else "runs, at least"
    difference = f"difference of {contents.heading(contents.metric)}"
    columns = [contents.heading(contents.compared), "combinations", kind, difference, "p"]
    return Table("Comparison", columns, rows, note)


def in_cells(contents: Contents) -> Table | None:
    """Return the differences between each two levels in each combination of the other factors."""
    tests = _tests(contents) if contents.others else None
    if tests is None:
        return None
    frame, by, paired = tests
    rows = [
        [
            *(text_of(row[name]) for name in by),
            f"{text_of(row['first'])} − {text_of(row['second'])}",
            with_half(row["difference"], row["high"] - row["difference"]),
            f"{row['effect']:.3g}" if row["effect"] == row["effect"] else "–",
            p_text(row["p_corrected"]),
        ]
        for row in frame.head(ROWS).to_dict("records")
    ]
    how = "Paired t-tests of runs with the same noise" if paired else "Welch's t-tests"
    note = f"{how}; ± is half of a single 95 % confidence interval, p is corrected for {len(frame)} tests (Holm)."
    note += f" Effect: {'mean over standard deviation of the differences' if paired else 'Cohen’s d'}."
    note += f" {len(frame) - ROWS} further rows are left out here." if len(frame) > ROWS else ""
    factors = map(contents.heading, (*by, str(contents.compared)))
    columns = [*factors, f"difference of {contents.heading(str(contents.metric))}", "effect", "p"]
    return Table("Comparison in each combination", columns, rows, note)


def sentences(contents: Contents) -> list[str]:
    """Return the findings in sentences, as far as intervals and tests support them."""
    metric, factor = contents.metric, contents.compared
    if metric is None:
        return []
    order, unit = ranked(contents), contents.behind(metric)
    (best, lowest), runs = order[0], sum(each.runs for _, each in order)
    if factor is None or len(order) < 2:
        where = f" with {factor} = {text_of(best)}{contents.behind(factor)}" if factor else ""
        mean = mean_text(lowest, None, contents.positive(metric)) + unit
        return [f"{metric} is {mean} on average over {runs} run{'s' if runs > 1 else ''}{where}."]
    every = len(contents.levels()) * (len(contents.levels()) - 1) // 2
    beside = [pair(contents, level, best, every) for level, _ in order[1:4]]
    level = f"{factor} = {text_of(best)}{contents.behind(factor)}"
    head = f"{metric} is lowest with {level}, {lowest.value:.4g}{unit} on average"
    if not beside[0].points:
        return [f"{head}. The levels have no point in common, so the effect of {factor} alone is not known."]
    if not beside[0].certain:
        return [head + _undecided(beside[0], unit), *_cells(contents, beside[0])]
    sure = [each for each in beside if each.certain]
    by = [f"by {with_half(each.difference.value, each.half)}{unit} with {text_of(each.first)}" for each in sure]
    more = by[0] if len(by) == 1 else f"{', '.join(by[:-1])} and {by[-1]}"
    return [f"{head}. It is higher {more}.", *_cells(contents, beside[0])]


def _undecided(each: Pair, unit: str) -> str:
    value, half = each.difference.value, each.half
    if half != half:
        return f". {text_of(each.first)} has {value:.3g}{unit} more, but with one seed this may be noise."
    if value == 0.0 and half == 0.0:
        return f", the same as with {text_of(each.first)} in every run."
    return (
        f", but not certainly: {text_of(each.first)} − {text_of(each.second)} is {value:.3g}{unit}, with a 95 % interval from "
        f"{value - half:.3g}{unit} to {value + half:.3g}{unit}."
    )


def _cells(contents: Contents, beside: Pair) -> list[str]:
    """Return a sentence on the combinations of the other factors."""
    tests = _tests(contents)
    if tests is None or not tests[1]:
        return []
    frame, by, _ = tests
    best, other = beside.second, beside.first
    rows = frame[frame["first"].isin([best, other]) & frame["second"].isin([best, other])]
    sign = rows["first"].map(lambda level: 1.0 if level == best else -1.0)
    certain = rows["p_corrected"] < 0.05
    lower = int((certain & (sign * rows["difference"] < 0)).sum())
    higher = int((certain & (sign * rows["difference"] > 0)).sum())
    rest = len(rows) - lower - higher
    points = f"{len(rows)} {'values' if len(by) == 1 else 'combinations'} of {', '.join(by)}"
    tested = (
        f"The difference of {text_of(best)} and {text_of(other)} is tested at each of the {points} (level 5 %, corrected for "
        "several tests)."
    )
    if rest == len(rows):
        none = "It is not" if len(rows) == 1 else f"None of these {len(rows)} is"
        return [f"{tested} {none} significant. Other pairs are in the tables below."]
    parts = [f"{word} at {count}" for word, count in (("lower", lower), ("higher", higher)) if count]
    others = "the other one" if rest == 1 else f"the other {rest}"
    more = f", and not significantly different at {others}" if rest else ""
    return [f"{tested} {text_of(best)} is significantly {' and '.join(parts)} of these {len(rows)}{more}."]


def _tests(contents: Contents) -> tuple[pd.DataFrame, list[str], bool] | None:
    """Return the tests in each combination of the other factors with runs of all levels, these factors, and whether paired."""
    from bayesftc.cosim.errors import ModelError
    from bayesftc.cosim.statistics import compare

    levels, factor, metric = len(contents.levels()), contents.compared, contents.metric
    if factor is None or metric is None or not 2 <= levels <= MOST_COMPARED:
        return None
    table = contents.table.assign(**{"combination ": contents.combinations})
    table = table.drop_duplicates(["combination ", factor, "seed"])  # a point may occur twice
    same = table[table.groupby(["combination ", "seed"])[factor].transform("nunique") == levels]
    paired = bool(len(same))
    used = same if paired else table[table.groupby("combination ")[factor].transform("nunique") == levels]
    if not len(used):
        return None
    try:
        tests = compare(used, metric, factor, by=contents.others or None, paired=paired, correction="holm")
    except ModelError:
        return None
    return tests, contents.others, paired


def _minus(each: Pair) -> str:
    return f"{text_of(each.first)} − {text_of(each.second)}"
