"""The figures of a run of a closed loop as tables: errors by phase, detection by sensor, faults of inputs and actuators."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from html import escape
from math import isfinite
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.units import with_unit

if TYPE_CHECKING:
    import pandas as pd

DASH = "–"
TRACKING = "The tracking error uses the reference at the same instant."
ERRORS = "Root-mean-square errors (tracking: true value - reference; belief: estimate - true value)"
PHASES = {"overall": "whole run", "before": "before faults", "during": "during", "after": "after"}
FINDINGS = "Faults that the controller infers"
FINDINGS_REMARK = (
    "Onset: the estimated begin of the fault. From, until: the alarm (a fault probability of 0.5 or more); where its "
    f"kind changes, each kind that lasts has a row. {{}} Size: at the end of the row. {DASH}: not estimated."
)
MANY_ALARMS, ALARMS_REMARK = (
    5,
    " Alarms: how many a row contains. Many short alarms may be outliers; the size is then that of the last one.",
)
"""Alarms in a row from which on the table has their number, and what it says."""
UNIT_REMARKS = {
    "x noise": " x noise: times the standard deviation of the sensor's noise.",
    "x noise from the belief": " x noise from the belief: how far the samples are from the belief; about 1 without a fault.",
}
"""What units of sizes mean that are not those of the sensor, in the order of the sentences."""

PROCESS_REMARK = (
    " Process: for that time the plant moved more than its model expects, as after a kick or a sudden load. It is no fault of a "
    "sensor."
)
NOTHING_FOUND = "The controller infers no fault."
BEFORE = "A fault that begins while its sensor is blamed already counts as detected at once."
FALSE_ALARMS = (
    "False alarms: {}, which is {} to {} {} of each sensor (95 % interval). Each time that a fault probability of "
    "a healthy sensor rises to 0.5 counts, also within one row of inferred faults. How to have fewer: "
    "docs/how-to/alarm-threshold.md."
)
"""What is said below the table of sensors of alarms that begin without a fault."""
SECONDS = 3600.0
"""Seconds of an hour."""
BETWEEN = (
    "Where an AUC is below .5 but no fault was missed, the alarms are rare, as those at outliers (Spikes): the samples between "
    "them count as faulty, too."
)
EARLY = 0.01
"""Share of fault-free time with an alarm from which on that is said: it makes delays look short."""
MOST_NAMES = 4
"""Most names of signals that were not recorded in the sentence about them."""
MOST_FINDINGS = 20
"""Most rows of the table of inferred faults; there are more of them only with many false alarms."""
Row = tuple[str, str, str]
"""A label, the key of its numbers, and their format."""

SENSOR_ROWS: Sequence[Row] = (
    ("share of time in fault", "fault_share", "{:.1%}"),
    ("samples missing (share of those due)", "missing_share", "{:.1%}"),
    ("faults", "faults", "{:.0f}"),
    ("faults seen as missing samples", "seen_as_missing", "{:.0f}"),
    ("faults missed", "missed", "{:.0f}"),
    ("mean detection delay (s)", "delay", "{:.2f}"),
    ("blamed while healthy (share of fault-free time)", "false_alarm_rate", "{:.2%}"),
    ("AUC", "auc", "{:.3f}"),
    ("mean precision without fault", "precision_healthy", "{:.3g}"),
    ("mean precision in fault", "precision_faulty", "{:.3g}"),
)
MISSING_ROWS = frozenset({"missing_share", "seen_as_missing"})
"""Rows that are shown only if a sensor has missing samples."""
INPUT_ROWS: Sequence[Row] = (
    ("share of time in fault", "fault_share", "{:.1%}"),
    ("faults", "faults", "{:.0f}"),
    ("received - sent in fault (root mean square)", "deviation", "{:.4g}"),
)
ACTUATOR_ROWS: Sequence[Row] = (
    ("mean fault probability", "mean_probability", "{:.4f}"),
    ("alarms (share of time)", "alarm_share", "{:.1%}"),
    ("faults missed", "missed", "{:.0f}"),
    ("mean detection delay (s)", "delay", "{:.2f}"),
    ("blamed while healthy (share of fault-free time)", "false_alarm_rate", "{:.2%}"),
    ("AUC", "auc", "{:.3f}"),
    ("kind during alarms, mostly", "kind", "{}"),
    ("mean size of that kind", "size", "{:.4g}"),
)
ACTUATORS = (
    "Size: for LostEffect the lost share of the effect, otherwise in the unit of the control. With a share above 1 "
    "the plant may answer more strongly there than the model."
)


@dataclass(frozen=True)
class FiguresTable:
    """A table of the figures of a run.

    Attributes
    ----------
    key : str
        ``"errors"``, ``"findings"``, ``"sensors"``, ``"inputs"`` or ``"actuators"``.
    heading : str
        What it shows.
    columns : tuple of str
        Names of its columns.
    rows : tuple
        For each row its label, its values (None for one that does not exist), and their format, or the format of each.
    remark : str
        A sentence below it.
    """

    key: str
    heading: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Any, ...], str | tuple[str, ...]], ...]
    remark: str = ""

    def texts(self) -> Iterator[tuple[str, ...]]:
        """Yield each row as texts: its label, then its numbers."""
        for label, values, form in self.rows:
            forms = (form,) * len(values) if isinstance(form, str) else form
            yield (
                label,
                *(DASH if value is None else each.format(value) for value, each in zip(values, forms, strict=True)),
            )

    @property
    def empty(self) -> bool:
        """Whether it shows nothing, as after a run that did not record its signals.

        A column has no number then, and the others have none but 0, the number of faults of sensors without faults.
        """
        columns = list(zip(*(values for _, values, _ in self.rows), strict=True))
        unknown = [all(value is None for value in column) for column in columns]
        return any(unknown) and not any(value for column in columns for value in column)

    def html(self) -> str:
        """Return the table and the remark, for notebooks."""
        from bayesftc.cosim.base.html import table

        return table(self.heading, self.texts(), ("", *self.columns)) + f"\n<p>{escape(self.remark)}</p>"

    def frame(self) -> pd.DataFrame:
        """Return the numbers as a pandas table."""
        import pandas as pd

        numbers = [[float("nan") if value is None else value for value in values] for _, values, _ in self.rows]
        return pd.DataFrame(numbers, index=[label for label, *_ in self.rows], columns=list(self.columns))


def tables_of(numbers: Mapping[str, Any]) -> Iterator[FiguresTable]:
    """Yield the tables of a run's figures.

    Parameters
    ----------
    numbers : mapping
        Those of `bayesftc.cosim.judging.metrics.Figures.to_dict`, ``units``, the unit of each quantity, ``findings``, the
        inferred faults, which are None if nothing is inferred, and possibly ``law``, a sentence about the lag of the controller,
        ``step``, the time between two rows in seconds, ``hold``, the longest pause within an alarm in seconds, and
        ``alarms``, the figures of the alarms of all sensors (`bayesftc.cosim.Alarms.to_dict`).
    """
    if numbers["tracking"]:
        rows = [
            (
                f"{what} of {with_unit(name, numbers['units'].get(name))}",
                tuple(errors[phase] for phase in PHASES),
                "{:.4g}",
            )
            for what in ("tracking", "belief")
            for name, errors in numbers[what].items()
            if what == "belief" or _known(errors)  # a quantity without a goal has no tracking error
        ]
        tracked = any(map(_known, numbers["tracking"].values()))
        remark = f"{TRACKING} {numbers.get('law', '')}".rstrip() if tracked else ""
        yield FiguresTable("errors", ERRORS, tuple(PHASES.values()), tuple(rows), remark)
    sensors, inferred, step = numbers["sensors"], numbers.get("findings"), numbers.get("step")
    if inferred:
        yield findings_table(inferred, numbers.get("hold"))
    yield FiguresTable(
        "sensors",
        "Faults and their detection",
        tuple(s["title"] for s in sensors),
        tuple(_of_sensors(sensors, step)),
        NOTHING_FOUND if inferred == [] else _below_sensors(sensors, numbers.get("alarms")),
    )
    for key, heading, listed, remark in (
        ("inputs", "Faults between the controller and the plant", INPUT_ROWS, ""),
        ("actuators", "Actuator faults that the controller estimates", ACTUATOR_ROWS, ACTUATORS),
    ):
        if found := numbers[key]:
            rows = [(label, tuple(each[name] for each in found), form) for label, name, form in _timed(listed, step)]
            columns = tuple(with_unit(each["name"], each["unit"]) for each in found)
            yield FiguresTable(key, heading, columns, tuple(rows), remark)


def _known(errors: Mapping[str, Any]) -> bool:
    """Return whether there is an error in any phase of the run."""
    return any(value is not None and isfinite(value) for value in errors.values())


def _below_sensors(sensors: Sequence[Mapping[str, Any]], alarms: Mapping[str, Any] | None) -> str:
    """Return what is said below the table of sensors, of which some are blamed."""
    remarks = []
    if alarms and alarms["false_alarms"]:
        interval = alarms["false_alarms_per_hour_ci"]
        seconds, unit = (1.0, "a second") if interval[0] >= SECONDS else (SECONDS, "an hour")  # of loops of some kHz
        bounds = [bound * seconds / SECONDS for bound in interval]
        shown = (f"{bound:.2g}" if bound < 100 else f"{bound:.0f}" for bound in bounds)
        remarks.append(FALSE_ALARMS.format(alarms["false_alarms"], *shown, unit))
    if any(map(_blamed_before, sensors)):
        remarks.append(BEFORE)
    if any(s["auc"] is not None and s["auc"] < 0.5 and not s["missed"] and not _blamed_before(s) for s in sensors):
        remarks.append(BETWEEN)
    return " ".join(remarks)


def _blamed_before(sensor: Mapping[str, Any]) -> bool:
    return sensor["delay"] is not None and (sensor["false_alarm_rate"] or 0.0) >= EARLY


def pauses(hold: float | None) -> str:
    """Return the sentence about pauses that do not end an alarm, of at most `hold` seconds, if that is known."""
    longest = "a short pause" if hold is None else f"a pause of up to {hold:g} s"
    return f"Alarms of one kind with {longest} between them are one row."


def findings_table(inferred: Sequence[Mapping[str, Any]], hold: float | None = None) -> FiguresTable:
    """Return the table of the inferred faults, each as plain data of a `bayesftc.cosim.judging.findings.Finding`.

    Pauses of at most `hold` seconds do not end an alarm.
    """
    longest = sorted(inferred, key=lambda each: each["start"] - each["end"])[:MOST_FINDINGS]
    rows, several = [], any(each.get("alarms", 1) >= MANY_ALARMS for each in longest)
    for each in sorted(longest, key=lambda each: each["start"]):
        values = (each["kind"] or None, *(each[name] for name in ("onset", "start", "end", "size", "probability")))
        times = ["{:.5g}" if seconds is None or seconds < 1e5 else "{:.0f}" for seconds in values[1:4]]
        if values[1] is not None and values[1] < 1e3:
            times[0] = "{:.3g}" if values[1] < 10.0 else "{:.4g}"  # it is estimated
        forms = ["{}", *times, _followed_by("{:.3g}", each["unit"]), "{:.3f}"]
        if several:
            values, forms = (*values, each.get("alarms", 1)), [*forms, "{:.0f}"]
        rows.append((each["where"], values, tuple(forms)))
    columns = ("kind", "onset (s)", "from (s)", "until (s)", "size", "probability", "alarms")[: 6 + several]
    left_out = len(inferred) - len(rows)
    only = f" The table has the {len(rows)} longest of {len(inferred)} rows." if left_out else ""
    process = PROCESS_REMARK if any(where == "process" for where, *_ in rows) else ""
    units = "".join(words for unit, words in UNIT_REMARKS.items() if any(each["unit"] == unit for each in longest))
    return FiguresTable(
        "findings",
        FINDINGS,
        columns,
        tuple(rows),
        FINDINGS_REMARK.format(pauses(hold)) + ALARMS_REMARK * several + units + process + only,
    )


def _timed(rows: Sequence[Row], step: float | None) -> Iterator[Row]:
    """Yield rows with as many decimals of the delay as the step needs: a delay of one step must not look like none."""
    decimals = -int(Decimal(f"{step:.2g}").as_tuple().exponent) if step else 0
    for label, key, form in rows:
        yield label, key, f"{{:.{max(2, decimals)}f}}" if key == "delay" else form


def _followed_by(form: str, unit: str) -> str:
    """Return a format with a unit behind the number."""
    return f"{form} {unit.replace('{', '{{').replace('}', '}}')}".rstrip()


def _of_sensors(
    sensors: Sequence[Mapping[str, Any]], step: float | None
) -> Iterator[tuple[str, tuple[Any, ...], str | tuple[str, ...]]]:
    units = [f"1/{unit if unit.isalpha() else f'({unit})'}²" if (unit := s["unit"]) else "" for s in sensors]
    one = units[0] if len({*units}) == 1 else ""
    missing = any(s["missing_share"] for s in sensors)
    for label, key, form in _timed(SENSOR_ROWS, step):
        if key in MISSING_ROWS and not missing:
            continue
        title, forms = label, (form,) * len(sensors)
        if key.startswith("precision"):
            title = with_unit(label, one)
            forms = forms if one else tuple(_followed_by(form, unit) for unit in units)
        elif key == "auc" and any(s["ranked_by"] == "beta" for s in sensors):
            title = "AUC of beta"
        yield title, tuple(s[key] for s in sensors), forms


class RunSummary(Mapping[str, "pd.DataFrame"]):
    """The figures of a run of a closed loop, as tables of pandas; printed, they are the tables of ``bayesftc run``.

    ``summary["errors"]`` has the root-mean-square errors by quantity and phase, ``summary["sensors"]`` the detection of faults by
    sensor. Where there are any, ``summary["findings"]`` has the faults that the controller infers, ``summary["inputs"]`` the
    faults of the plant's inputs, and ``summary["actuators"]`` the detection of faults by actuator.
    `bayesftc.cosim.Result.summary` makes it.

    Parameters
    ----------
    tables : iterable of FiguresTable
        The tables.
    notes : sequence of str
        Sentences above the tables: what a reader must know of them.

    Examples
    --------
    >>> from bayesftc.scenario import load_scenario
    >>> summary = load_scenario("cruise_control").simulate(duration=8.0).summary()
    >>> list(summary)
    ['errors', 'findings', 'sensors']
    >>> summary["sensors"].loc["share of time in fault", "sensor 0"].round(2)
    np.float64(0.25)
    """

    def __init__(self, tables: Iterable[FiguresTable], notes: Sequence[str] = ()):
        self._tables, self.notes = {each.key: each for each in tables}, tuple(notes)

    def __getitem__(self, name: str) -> pd.DataFrame:
        return self._tables[name].frame()

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __repr__(self) -> str:
        blocks = [
            "\n".join(filter(None, [each.heading, _aligned(each), each.remark]))
            for each in self._tables.values()
            if not each.empty
        ]
        return "\n\n".join([*self.notes, *blocks])

    def _repr_html_(self) -> str:
        """Return the tables for notebooks."""
        shown = [each.html() for each in self._tables.values() if not each.empty]
        return "\n".join([*(f"<p>{escape(note)}</p>" for note in self.notes), *shown])


def unrecorded(names: Sequence[str]) -> list[str]:
    """Return a sentence about signals that the tables need and that were not recorded; none if there are none."""
    if not names:
        return []
    rest = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return [
        f"Not recorded: {', '.join(names[:MOST_NAMES])}{rest}. The tables lack what needs them. A run without record= records "
        "all signals."
    ]


def _aligned(table: FiguresTable) -> str:
    """Return a table as text: labels to the left, numbers to the right."""
    rows = [("", *table.columns), *table.texts()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            [row[0].ljust(widths[0]), *(text.rjust(w) for text, w in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    )


__all__ = ["FiguresTable", "RunSummary", "findings_table", "tables_of", "unrecorded"]
