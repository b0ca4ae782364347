"""The signals of a run: access by name, files, figures, conversion to pandas, xarray and python-control."""

from __future__ import annotations

import json
import os
import pickle
import secrets
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from difflib import get_close_matches
from fractions import Fraction
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.paths import is_file
from bayesftc.cosim.diagram.roles import LoopRoles, known_roles, units_of
from bayesftc.cosim.errors import ModelError, ResultFileError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import labels, without_brackets
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import control
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.judging.figures.notebook import NotebookAnimation
    from bayesftc.cosim.judging.lost import Loss
    from bayesftc.cosim.judging.signals import LoopSignals
    from bayesftc.cosim.run.summary import RunSummary

FORMAT = "bayesftc-result-1"

_TABLES = frozenset({".csv", ".tsv", ".xlsx", ".parquet", ".json", ".mat"})
"""Endings of files that other programs read, which this format is not."""

DIAGNOSE = "controllers.diagnose(result, loop)"
"""The call that looks for an error of the model; its room is above this one, and it takes seconds."""
ESTIMATE_A_LOAD = (
    "Where nobody knows the error, let the controller estimate a load, or a larger one (disturbance in design, "
    "model.with_disturbance): it takes up much of what acts where the control does. For what acts elsewhere, give the plant that "
    "you design for an input there. Name this input in loads= if the load lasts, and in noise= if it changes at random."
)
"""What often helps where nobody knows the error."""

# What NumPy, zip and JSON raise for damaged files.
_DAMAGE = (
    OSError,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    SyntaxError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
    pickle.UnpicklingError,
    struct.error,
    tokenize.TokenError,
)


class _Signals:
    """Names, places, units and roles of the signals of a run; the pieces of a live run share one object."""

    def __init__(
        self,
        columns: dict[str, tuple[int, tuple[int, ...]]],
        units: dict[str, str],
        unrecorded: frozenset[str],
        parts: LoopRoles | Diagram | None,
    ):
        self.columns, self.unrecorded = columns, unrecorded
        self._units, self._parts = units, parts

    @property
    def roles(self) -> LoopRoles | None:
        self._read_diagram()
        return self._parts  # type: ignore[return-value]

    @property
    def units(self) -> dict[str, str]:
        self._read_diagram()
        return self._units

    def _read_diagram(self) -> None:
        parts = self._parts  # another thread may read another piece
        if parts is not None and not isinstance(parts, LoopRoles):
            known = {f"{block}.{port}": unit for (block, port), unit in units_of(parts).items()}
            self._units = {name: known[name] for name in self.columns if name in known}
            self._parts = known_roles(parts)

    def __getstate__(self) -> dict[str, Any]:
        self._read_diagram()
        return self.__dict__.copy()  # roles, because a copy in another process needs no blocks


class Result(Mapping[str, Floats]):
    """Named signals over time.

    ``result["plant.v"]`` is an array with a row for each recorded step: of shape (rows,) for a scalar port, (rows, n) for a
    vector port, (rows, n, m) for a matrix port. No signal is copied: all are views of one recording.

    Parameters
    ----------
    recording : ndarray, rows x scalars
        The recorded numbers; kept, not copied.
    columns : mapping of name to (int, tuple)
        The first column of each signal, and its shape.
    step : Fraction
        The base step in seconds.
    decimation : int
        Base steps between two rows.
    before : int
        Number of rows of the whole run before the first row here: 0, except for a later piece of a live run.
    parts : LoopRoles or Diagram, optional
        The roles of the signals in a closed loop, for `plot`; or the diagram, from which they are derived when needed.
    units : mapping of str to str, optional
        The unit of each signal that has one.
    unrecorded : iterable of str, optional
        Names of the other signals of the run, for messages.
    metadata : mapping, optional
        Properties of the run.
    stopped : str, optional
        Why the run ended early.

    Attributes
    ----------
    metadata : dict
        Properties of the run: seed, duration, step, engine, kinds of blocks, models and parameters of FMUs.
    stopped : str or None
        Why the run ended early; None if it did not.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.5)
    >>> ramp = diagram.add(cosim.Ramp(2.0, unit="m"), "ramp")
    >>> run = diagram.simulate(2.0, engine="interpreted")
    >>> run
    <Result: 1 signal, 5 rows to t = 2 s>
    >>> run["ramp.y"].tolist(), run.units
    ([0.0, 1.0, 2.0, 3.0, 4.0], {'ramp.y': 'm'})
    >>> run.to_pandas().reset_index().tail(2)
       time  ramp.y
    3   1.5     3.0
    4   2.0     4.0
    """

    def __init__(
        self,
        recording: Floats,
        columns: Mapping[str, tuple[int, tuple[int, ...]]],
        step: Fraction,
        *,
        decimation: int = 1,
        before: int = 0,
        parts: LoopRoles | Diagram | None = None,
        units: Mapping[str, str] | None = None,
        unrecorded: Iterable[str] = (),
        metadata: Mapping[str, Any] | None = None,
        stopped: str | None = None,
    ):
        self._recording = recording
        self._signals = _Signals(dict(columns), dict(units or {}), frozenset(unrecorded), parts)
        self.step, self.decimation, self.before = step, decimation, before
        self.metadata, self.stopped = dict(metadata or {}), stopped

    @property
    def _columns(self) -> dict[str, tuple[int, tuple[int, ...]]]:
        return self._signals.columns

    @property
    def roles(self) -> LoopRoles | None:
        """The roles of the signals in a closed loop; None if the diagram is no closed loop, or is not known."""
        return self._signals.roles

    @cached_property
    def units(self) -> dict[str, str]:
        """The unit of each signal that has one, or is connected to signals of one unit, as a control to an input of an FMU."""
        return dict(self._signals.units)

    @property
    def time(self) -> Floats:
        """Time of each row in seconds: the doubles nearest to k times the step."""
        rows = np.arange(self.before, self.before + len(self._recording), dtype=np.int64)
        k = rows * (self.decimation * self.step.numerator)
        return k / self.step.denominator

    @property
    def table(self) -> Floats:
        """All signals side by side, in their order: a column for each scalar, as in `to_pandas`. Not a copy."""
        return self._recording

    def __getitem__(self, name: str) -> Floats:
        place = self._place(name) if isinstance(name, str) else None
        if place is None:
            raise UnknownNameError(self._without(name))
        start, shape = place
        if not shape:
            return self._recording[:, start]
        values = self._recording[:, start : start + prod(shape)]
        return values.reshape(len(values), *shape) if len(shape) != 1 else values

    def _place(self, name: str) -> tuple[int, tuple[int, ...]] | None:
        """Return the first column and the shape of a signal, or of one element: ``u[0]``, which may also stand for ``u0``."""
        if name in self._columns:
            return self._columns[name]
        whole, bracket, _ = name.rpartition("[")
        if bracket and whole in self._columns:
            start, shape = self._columns[whole]
            if name in (elements := labels(whole, shape)):
                return start + elements.index(name), ()
        block, _, port = name.rpartition(".")
        known = [signal.removeprefix(f"{block}.") for signal in self._columns if signal.startswith(f"{block}.")]
        plain = without_brackets(port, known)
        return self._columns[f"{block}.{plain}"] if plain else None

    @property
    def unrecorded(self) -> frozenset[str]:
        """Names of the diagram's signals that were not recorded."""
        return self._signals.unrecorded

    def _without(self, name: object) -> str:
        """Return the message about a missing signal."""
        if isinstance(name, list | tuple):
            return f"A result gives one signal at a time, not {name!r}; use result.to_pandas()[{list(name)!r}] for several."
        if name in self.unrecorded:
            return (
                f"The signal {name!r} was not recorded. To record it, name it: simulate(..., record=['*', {name!r}])."
            )
        others = self.unrecorded
        near = get_close_matches(str(name), [*self._columns, *others])
        port = str(name).rpartition(".")[2]  # perhaps of another block
        hint = did_you_mean(name if near else port, self._columns, others=others)
        return f"The result has no signal {name!r}; {hint}"

    # Two results are compared signal by signal (np.array_equal); Mapping's == would raise on arrays.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        rows = len(self._recording)
        end = float(self.time[-1]) if rows else 0.0
        notes = "".join(f", {note}" for note in self._explained())
        return f"<Result: {counted(len(self), 'signal')}, {counted(rows, 'row')} to t = {end:g} s{notes}>"

    @property
    def notes(self) -> list[str]:
        """What a reader must know of a run: that it stopped, what speaks against the model, and controls at their limits."""
        return self._explained("")

    def _explained(self, why: str = f" ({DIAGNOSE} looks for the cause)") -> list[str]:
        """Return the notes, with `why` after each that a diagnosis explains."""
        notes, sound = ["stopped early"] if self.stopped else [], self._sound
        notes += [] if self._loss is None else [self._loss.note]
        wrong = [
            f"model of {block} suspect{sound._or_sensors(block, k)} from t = {self.time[k]:g} s"
            for block, k in sound._suspect.items()
        ]
        model, named, often = (sound._agreement[of] for of in ("model", "named", "often"))
        limited = [note for note, _ in self._limited]
        speaking = [*wrong, *model]
        speaking[-1:] = [f"{text}{why}" for text in speaking[-1:]]
        return [*notes, *speaking, *named, *([] if speaking else often), *limited]

    @property
    def suspicions(self) -> list[str]:
        """Sentences on evidence against a model: from when ``model_suspect`` is above one half, and blamed sensors that agree."""
        sound = self._sound
        suspect = [
            f"The model of {block} is suspect{sound._or_sensors(block, k)} from t = {self.time[k]:g} s."
            for block, k in sound._suspect.items()
        ]
        return [*suspect, *(f"{text[0].upper()}{text[1:]}." for text in sound._agreement["model"])]

    def _sentences(self) -> list[str]:
        """Return the notes as sentences."""
        notes, sound = ["The run stopped early."] if self.stopped else [], self._sound
        notes += [] if self._loss is None else [f"{self._loss.sentence} {self._loss.advice}"]
        wrong = self.suspicions
        named, often = ([f"{text[0].upper()}{text[1:]}." for text in sound._agreement[of]] for of in ("named", "often"))
        cause = (
            f"If it is wrong, sensors may be blamed because of it. {DIAGNOSE} looks for the cause; None means too little "
            f"evidence for any, not that the model is right. {ESTIMATE_A_LOAD}"
        )
        blamed = [] if wrong else [f"{text} {sound._advice}" for text in often]
        limited = [f"The {note}. {advice}" for note, advice in self._limited]
        wrong[-1:] = [f"{text} {cause}" for text in wrong[-1:]]
        return [*notes, *wrong, *named, *blamed, *limited]

    @cached_property
    def _loss(self) -> Loss | None:
        """From when the loop is lost, if it is."""
        from bayesftc.cosim.judging.lost import loss_in

        return loss_in(self)

    @cached_property
    def _sound(self) -> Result:
        """The rows before the loop was lost: later ones say nothing of its model and its noise."""
        from bayesftc.cosim.judging.lost import rows_before

        return rows_before(self, self._loss)

    @cached_property
    def _suspect(self) -> dict[str, int]:
        """The row from which on the sensors contradict the model, for each controller or estimator where they do."""
        from bayesftc.cosim.judging.signals import ALARM

        rows = {}
        for name in self:
            block, _, port = name.rpartition(".")
            if port == "model_suspect" and (raised := self[name] >= ALARM).any():
                rows[block] = int(raised.argmax())
        return rows

    def _or_sensors(self, block: str, k: int) -> str:
        """Return the other explanation of what speaks against the model: faults that the check cannot tell from a wrong model.

        These are faults of several sensors, also of one after another, because the check remembers some hundred samples, and one
        of the only sensor of a quantity. If all sensors are blamed, the model is the simpler explanation.
        """
        from bayesftc.cosim.judging.signals import ALARM, REMEMBERED

        probability = np.ravel(self.get(f"{block}.fault_probability", np.zeros((k + 1, 0)))[k])
        blamed = np.flatnonzero(probability >= ALARM).tolist()
        if not len(probability) or len(blamed) == len(probability) > 1 or self._agreement["model"]:
            return ""  # sensors that are blamed although they agree speak for a wrong model, too
        if len(blamed) > 1:
            return ", or several sensors are faulty,"
        quantities = () if self.roles is None or self.roles.controller != block else self.roles.quantities
        if blamed and any(quantity.sensors == (blamed[0],) for quantity in quantities):
            return f", or sensor {blamed[0]}, the only one of its quantity, is faulty,"
        lately = self[f"{block}.fault_probability"][max(0, k - REMEMBERED // self.decimation) : k + 1]
        so_far = lately.reshape(len(lately), -1) >= ALARM
        return ", or several sensors have failed, one after another," if so_far.any(axis=0).sum() > 1 else ""

    @cached_property
    def _agreement(self) -> dict[str, list[str]]:
        """Notes on healthy sensors that are blamed: all that agree (``"model"``, or ``"named"``: why), or one ``"often"``."""
        from bayesftc.cosim.judging.blame import blamed_together, often_blamed
        from bayesftc.cosim.judging.roles import signals_of

        roles = self.roles
        if roles is None or f"{roles.controller}.fault_probability" not in self:
            return {"named": [], "model": [], "often": []}
        signals = signals_of(roles, self, drawn=False)
        together = blamed_together(signals, self.decimation)
        if any(together.values()):  # the kinds of faults, which are not read before, may say why
            together = blamed_together(signals_of(roles, self), self.decimation)
        often = None if any(together.values()) else often_blamed(signals)
        return {**together, "often": [] if often is None else [often[1]]}

    @cached_property
    def _advice(self) -> str:
        """What to do about the healthy sensor that is blamed often."""
        from bayesftc.cosim.judging.blame import LOOK_AT_MODEL, advice_on, often_blamed
        from bayesftc.cosim.judging.roles import signals_of

        signals = None if self.roles is None else signals_of(self.roles, self)
        often = None if signals is None else often_blamed(signals)
        return LOOK_AT_MODEL if signals is None or often is None else advice_on(signals, often[0])

    @cached_property
    def _limited(self) -> list[tuple[str, str]]:
        """Notes and advice on controls at their limits."""
        from bayesftc.cosim.judging.metrics import limited
        from bayesftc.cosim.judging.roles import signals_of

        if self.roles is None or not list(limited(signals_of(self.roles, self, drawn=False))):
            return []
        return list(limited(signals_of(self.roles, self, drawn=True)))  # whether the belief is lost

    def _repr_html_(self) -> str:
        """Return a table of the signals with their ranges, for notebooks."""
        rows = []
        for name in self:
            values = self[name][np.isfinite(self[name])]
            ends = (f"{values.min():.4g}", f"{values.max():.4g}") if values.size else ("", "")
            size = " x ".join(map(str, self._columns[name][1])) or "1"
            rows.append((name, size, self.units.get(name, ""), *ends))
        title = repr(self)[1:-1] + (f": {self.stopped}" if self.stopped else "")
        return self._findings_html() + table(title, rows, ("signal", "size", "unit", "smallest", "largest"))

    def _findings_html(self) -> str:
        """Return the table of the inferred faults; nothing if there are none."""
        from bayesftc.cosim.judging.findings import plain_findings
        from bayesftc.cosim.judging.parts import usual_hold
        from bayesftc.cosim.run.summary import findings_table

        inferred = plain_findings(self._loop_signals()) if self.roles is not None else None
        hold = usual_hold(float(self.time[1] - self.time[0])) if len(self.time) > 1 else None
        return findings_table(inferred, hold).html() + "\n" if inferred else ""

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a column for each scalar (``y[0]``, ``y[1]``, ...) and time in seconds as its index."""
        import pandas as pd

        names = [label for name in self for label in labels(name, self._columns[name][1])]
        order = [start + i for start, shape in self._columns.values() for i in range(prod(shape))]
        return pd.DataFrame(self._recording[:, order], index=pd.Index(self.time, name="time"), columns=names)

    def to_xarray(self) -> xr.Dataset:
        """Return a dataset with a variable for each signal over the coordinate ``time`` (seconds)."""
        import xarray as xr

        variables = {}
        for name in self:
            dimensions = ["time", *(f"{name}_{axis}" for axis in range(len(self._columns[name][1])))]
            attributes = {"units": self.units[name]} if name in self.units else {}
            variables[name] = (dimensions, self[name], attributes)
        attributes = {"metadata": json.dumps(self.metadata), "stopped": self.stopped or ""}
        return xr.Dataset(variables, coords={"time": ("time", self.time, {"units": "s"})}, attrs=attributes)

    def to_control(
        self, outputs: Iterable[str] | None = None, *, inputs: Iterable[str] = ()
    ) -> control.TimeResponseData:
        """Return the signals as a time response of python-control, one output for each scalar (``y[0]``, ``y[1]``, ...).

        Parameters
        ----------
        outputs : iterable of str, optional
            Names of the signals to use as outputs; all by default.
        inputs : iterable of str
            Names of the signals to use as inputs.

        Raises
        ------
        UnknownNameError
            If there is no signal of that name.
        """
        import control

        rows, names = self._scalars(list(self) if outputs is None else outputs)
        input_rows, input_names = self._scalars(inputs)
        settings = {"inputs": input_rows, "input_labels": input_names} if input_names else {}
        return control.TimeResponseData(
            self.time, rows, output_labels=names, issiso=False, title="bayesftc", plot_inputs=False, **settings
        )

    def _scalars(self, signals: Iterable[str]) -> tuple[Floats, list[str]]:
        """Return the scalars of some signals, a row for each, and their names."""
        chosen = [signals] if isinstance(signals, str) else list(signals)
        columns = [self[name].reshape(len(self._recording), -1) for name in chosen]
        names = [label for name in chosen for label in labels(name, self[name].shape[1:])]
        return np.hstack([np.empty((len(self._recording), 0)), *columns]).T, names

    def summary(self) -> RunSummary:
        """Return the figures of a closed loop as tables: tracking and belief errors by phase, and the detection by sensor.

        ``print(result.summary())`` prints the tables of ``bayesftc run``; a notebook shows them as well.

        Raises
        ------
        ModelError
            If the diagram is no closed loop.
        """
        from bayesftc.cosim.judging.findings import numbers_of
        from bayesftc.cosim.run.summary import RunSummary, tables_of, unrecorded

        signals = self._loop_signals()
        return RunSummary(tables_of(numbers_of(signals)), [*self._sentences(), *unrecorded(signals.unrecorded)])

    def findings(self, *, threshold: float = 0.5, hold: float | None = None) -> pd.DataFrame:
        """Return the faults that the controller infers, a row for each alarm: where, kind, times, size and probability.

        Where the kind of an alarm changes, each kind that lasts has a row.

        The columns are ``where`` (sensor, actuator or process), ``kind`` (empty if the learner distinguishes no kinds), ``onset``
        (estimated begin of the fault), ``from`` and ``until`` (begin and end of the row), all in seconds, ``size`` with its
        ``unit``, and ``probability``, the largest one of the row. A number is NaN where nothing is estimated.

        Parameters
        ----------
        threshold : float
            Least fault probability of an alarm. Controllers without probabilities report their detections.
        hold : float, optional
            Seconds below the threshold after which an alarm ends; by default 1 s, but at least 10 and at most 200 samples.

        Raises
        ------
        ModelError
            If the diagram is no closed loop, `threshold` is no probability, or `hold` is negative.

        Examples
        --------
        >>> from bayesftc.scenario import load_scenario
        >>> load_scenario("cruise_control").simulate().findings()[["where", "kind", "from", "until"]]
              where    kind  from  until
        0  sensor 0  Frozen   6.0   14.0
        """
        from bayesftc.cosim.judging.findings import findings, findings_frame

        if not 0 < threshold < 1:
            raise ModelError(f"findings has threshold={threshold!r}; it must be a probability above 0 and below 1.")
        if hold is not None and not hold >= 0:
            raise ModelError(f"findings has hold={hold!r}; it must be a time in seconds, at least 0.")
        return findings_frame(findings(self._loop_signals(), threshold, hold))

    def _loop_signals(self) -> LoopSignals:
        from bayesftc.cosim.judging.roles import signals_of

        if (roles := self.roles) is None:
            raise ModelError(
                "Tables and findings need a run of a closed loop: a diagram with exactly one Sensors block and exactly one "
                "controller (a block with the inputs y and goal and the output u). Make the loop with cosim.closed_loop(...), or "
                "put all sensors into one block, such as cosim.Sensors(count=2, std=[1.0, 0.2], every=[1, 10])."
            )
        return signals_of(roles, self)

    def plot(self, signals: Iterable[str] | None = None) -> Figure:
        """Return the figure of a closed loop: signals, belief, control, expected noise and faults of its sensors.

        For a diagram that is no closed loop, or a run without recorded signals of its controller, it is the figure of
        `plot_signals`. A notebook shows the figure by itself; in a script call ``matplotlib.pyplot.show()``.

        Parameters
        ----------
        signals : iterable of str, optional
            Names of signals. With names, the figure is ``plot_signals(signals)``.
        """
        from bayesftc.cosim.judging.figures.loop_figure import plot_run
        from bayesftc.cosim.judging.figures.panels import shown_figure
        from bayesftc.cosim.judging.roles import signals_of

        roles = self.roles if signals is None else None
        if roles is None or not any(name.startswith(f"{roles.controller}.") for name in self):
            return self.plot_signals(signals)
        return plot_run(signals_of(roles, self), ", ".join(self._explained()), shown_figure())

    def plot_signals(self, signals: Iterable[str] | None = None) -> Figure:
        """Return a figure with one panel for each unit, and one for each signal without a unit.

        Parameters
        ----------
        signals : iterable of str, optional
            Names of signals; by default all scalars and vectors.

        Raises
        ------
        UnknownNameError
            If there is no signal of that name.
        """
        from bayesftc.cosim.judging.figures.panels import shown_figure
        from bayesftc.cosim.judging.figures.plotting import plot_signals

        return plot_signals(self, signals, shown_figure())

    def animate(self, *, frames: int = 100, speed: float = 1.0) -> NotebookAnimation:
        """Return an animation of the plant, with the signals and fault probabilities up to the shown instant.

        It draws the true values, the controller's belief and the readings of each sensor together. This shows when the
        controller ignores a sensor. Shipped plants have a picture; any other plant has a scale for each quantity. A notebook
        shows the animation by itself. ``animation.save("run.gif")`` writes a file; ``animation.to_jshtml()`` is a web page.

        Parameters
        ----------
        frames : int
            The number of pictures, evenly spread over the run.
        speed : float
            Seconds of the run for each second of the animation.

        Returns
        -------
        matplotlib.animation.FuncAnimation
            Keep it in a variable until it is shown or saved.

        Raises
        ------
        ModelError
            If the result has fewer than two rows or no scalar signal, or if a setting is wrong.
        """
        from bayesftc.cosim.judging.figures.animation import animate_run

        return animate_run(self, frames, speed)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the result to one file (a zip of NumPy arrays); it appears under its name only when it is complete.

        Raises
        ------
        ResultFileError
            If the file cannot be written, or its name is that of a table such as ``run.csv``.
        """
        path = Path(path)
        if path.suffix.lower() in _TABLES:
            raise ResultFileError(
                f"save() writes NumPy's arrays, not the {path.suffix} of {path.name!r}. Name the file {path.stem}.npz; or make a "
                "table: result.to_pandas() has to_csv(), to_parquet() and others."
            )
        header = {
            "format": FORMAT,
            "step": str(self.step),
            "decimation": self.decimation,
            "before": self.before,
            "columns": {name: [start, list(shape)] for name, (start, shape) in self._columns.items()},
            "units": self.units,
            "unrecorded": sorted(self._signals.unrecorded),
            "metadata": self.metadata,
            "stopped": self.stopped,
            "roles": self.roles and self.roles.to_dict(),
        }
        temporary = path.with_name(f"{path.name[:100]}.{secrets.token_hex(4)}.tmp")
        try:
            with open(temporary, "xb") as file:
                np.savez_compressed(file, header=np.array(json.dumps(header)), recording=self._recording)
            os.replace(temporary, path)
        except OSError as error:
            reason = error.strerror or error
            raise ResultFileError(f"The result cannot be written to {path}: {reason}; choose another folder.") from None
        finally:
            with suppress(OSError):  # it exists only if writing has failed
                temporary.unlink(missing_ok=True)
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read a result from a file of `save`.

        Raises
        ------
        ResultFileError
            If the file is missing, damaged, or not a result.
        """
        path = Path(path)
        if not is_file(path):
            raise ResultFileError(f"There is no result file {path}; check the path.")
        try:
            with np.load(path, allow_pickle=False) as archive:
                header = json.loads(str(archive["header"]))
                recording = archive["recording"]
            if header["format"] != FORMAT:
                raise KeyError(header["format"])
            columns = {name: (start, tuple(shape)) for name, (start, shape) in header["columns"].items()}
            ends = [start + prod(shape) for start, shape in columns.values()]
            if recording.dtype != np.float64 or recording.ndim != 2 or max(ends, default=0) > recording.shape[1]:
                raise ValueError(recording.shape)
            return cls(
                recording,
                columns,
                Fraction(header["step"]),
                decimation=header["decimation"],
                before=header.get("before", 0),  # files of earlier versions contain whole runs,
                parts=(roles := header.get("roles")) and LoopRoles.from_dict(roles),  # without roles
                units=header["units"],
                unrecorded=header.get("unrecorded", ()),
                metadata=header["metadata"],
                stopped=header["stopped"],
            )
        except PermissionError as error:
            raise ResultFileError(f"The result file {path} cannot be read: {error.strerror}.") from None
        except _DAMAGE:
            raise ResultFileError(
                f"{path} is not a result file of bayesftc, or it is damaged; run the simulation again."
            ) from None


def at_stop(result: Result) -> str:
    """Return sentences on what a closed loop did before its run had to stop."""
    from bayesftc.cosim.judging.stops import at_stop as of_loop

    return of_loop(result)


def with_rows(result: Result, metadata: dict[str, Any], recording: Floats, before: int, stopped: str | None) -> Result:
    """Return a result of the same signals with other rows and metadata: the next piece of a live run.

    It shares all else with ``result``, because a live run may make a piece at each step. The metadata are copied.
    """
    piece = Result.__new__(Result)
    piece._recording, piece._signals = recording, result._signals
    piece.step, piece.decimation, piece.before = result.step, result.decimation, before
    piece.metadata, piece.stopped = metadata.copy(), stopped
    return piece
