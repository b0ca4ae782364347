"""The detection of faults of the drive's sensors: AUC by kind and size, delays, false alarms.

``python -m bayesftc.examples.redundant_speed_sensors.study [FOLDER] [--onsets 200] [--seed 0]``. FOLDER has the three CSV
files. By default it is the recorded drive, if the environment variable BAYESFTC_DATA names a folder with ``comma2k19`` in it,
otherwise the made-up drive.

The recording has no known faults, so faults are injected: into one sensor at a time, at random onsets, for 8 s. The first 20 s of
the drive have no faults, because the model was fitted to them. The fault probability of each sensor, also of the healthy ones, is
evaluated at each step of the 8 s before the onset and of the 8 s of the fault. Each onset gives an AUC. The intervals are of its
mean over the onsets: they cover other onsets in this drive, not other drives. The pooled AUC is of all samples of all onsets,
with one threshold for all.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit
from sklearn.metrics import roc_auc_score

from bayesftc.controllers import Burst, FixedPrecision, StateEstimator
from bayesftc.cosim.errors import ModelError, RecordingError
from bayesftc.examples.redundant_speed_sensors.command import at_least, sentences
from bayesftc.monitoring import Monitor, Monitored, Recording, Signal, align, default_precision, load_monitor

DATA = Path(__file__).parent / "data"
INJECTIONS, DRIFTS = (0.5, 1.0, 2.0), (0.2, 1.0)
CASES = (
    ("freeze", 0.0),
    *(("injection", size) for size in INJECTIONS),
    *(("drift", slope) for slope in DRIFTS),
    ("noise", 5.0),
)
UNITS = {"freeze": "", "injection": " m/s", "drift": " m/s per s", "noise": " times"}
KINDS = {"freeze": "Frozen", "injection": "Offset", "drift": "Drifting", "noise": "Noisier"}
FITTED, SPAN = 20.0, 8.0
"""Seconds to which the model was fitted, and seconds before and after an onset."""


@dataclass(frozen=True)
class Found:
    """The results of a kind and size of faults: means over the onsets, and the AUC with its interval."""

    kind: str
    size: float
    auc: float
    low: float
    high: float
    pooled: float
    missed: float
    delay: float
    named: float
    others: int


def recorded() -> Path | None:
    """Return the folder of the recorded drive, if BAYESFTC_DATA names it."""
    folder = Path(os.environ.get("BAYESFTC_DATA", ""), "comma2k19")
    return folder if "BAYESFTC_DATA" in os.environ and folder.is_dir() else None


def noise_of(monitor: Monitor, sensor: str) -> float:
    """Return the standard deviation of a sensor's noise: its white part and errors that last less than a second."""
    short = [e for e in monitor.errors if np.max(e.time_constant) < 1.0 and (e.sensors is None or sensor in e.sensors)]
    return float(np.sqrt(monitor.sensors[sensor].std ** 2 + sum(float(np.max(e.std)) ** 2 for e in short)))


def broken(
    signal: Signal, kind: str, size: float, noise: float, span: tuple[float, float], rng: np.random.Generator
) -> Signal:
    """Return a sensor's signal with a fault in a time span; its samples keep their resolution."""
    time, _ = signal.corrected
    values, during = np.array(signal.values), (time >= span[0]) & (time < span[1])
    if kind == "freeze":
        values[during] = values[time < span[0]][-1]
    elif kind == "injection":
        values[during] += size
    elif kind == "drift":
        values[during] += size * (time[during] - span[0])
    elif kind == "dropout":
        values[during] = np.nan
    else:
        values[during] += np.sqrt(size**2 - 1) * noise * rng.standard_normal(int(during.sum()))
    if signal.resolution:
        values[during] = np.round(values[during] / signal.resolution) * signal.resolution
    return replace(signal, values=values)


def until(recording: Recording, end: float) -> Recording:
    """Return the recording up to a time."""
    steps = round((end - recording.start) / float(recording.dt))
    return replace(recording, y=recording.y[:steps], u=recording.u[:steps])


def study(
    folder: Path, onsets: int = 200, seed: int = 0, model: Path = DATA / "model.toml"
) -> tuple[Monitored, list[Found]]:
    """Return the monitor's results for the drive without faults, and the detection of each kind and size of fault."""
    if onsets < 2:
        raise ModelError(f"A study with onsets={onsets} has no interval of its means. Use two or more.")
    monitor = load_monitor(model)
    sensors, inputs = monitor.signals([folder])
    recording = align(sensors, inputs, monitor.dt)
    first, last = max(FITTED, recording.time[0]) + SPAN, recording.time[-1] - SPAN
    if first >= last:
        raise RecordingError(
            f"The drive in {folder} ends at {recording.time[-1]:.1f} s. A study needs {FITTED:g} s without faults, and then more "
            f"than {2 * SPAN:g} s."
        )
    if monitor.precision is not None and monitor.precision.why_no_probability:
        raise ModelError(f"{model} gives no fault probability to study: {monitor.precision.why_no_probability}")
    healthy = monitor.run(recording, compiled=True)
    rows = []
    for number, (kind, size) in enumerate(CASES):
        rng = np.random.default_rng([seed, number])
        areas, truths, scores, delays, names, others = [], [], [], [], [], 0
        for k in range(onsets):
            i, onset = k % len(sensors), rng.uniform(first, last)
            name = list(sensors)[i]
            faulty = broken(sensors[name], kind, size, noise_of(monitor, name), (onset, onset + SPAN), rng)
            recording = until(align({**sensors, name: faulty}, inputs, monitor.dt), onset + SPAN)
            monitored = monitor.run(recording, compiled=True)
            window = monitored.time >= onset - SPAN
            truth = np.zeros((window.sum(), len(sensors)), dtype=bool)
            truth[monitored.time[window] >= onset, i] = True
            score = monitored.fault_probability[window]
            areas.append(roc_auc_score(truth.ravel(), score.ravel()))
            truths.append(truth.ravel())
            scores.append(score.ravel())
            alarms = [e for e in monitored.events if e.sensor == name and e.end >= onset]
            delays.append(max(alarms[0].start - onset, 0.0) if alarms else np.inf)
            names.append(bool(alarms) and alarms[-1].kind == KINDS[kind])
            others += sum(e.sensor != name and e.start >= onset - SPAN for e in monitored.events)
        half = stdtrit(onsets - 1, 0.975) * np.std(areas, ddof=1) / np.sqrt(onsets)
        low, high = np.mean(areas) - half, min(np.mean(areas) + half, 1.0)  # Student's interval is not limited to 1
        pooled = roc_auc_score(np.concatenate(truths), np.concatenate(scores))
        area, missed, delay = float(np.mean(areas)), float(np.isinf(delays).mean()), float(np.median(delays))
        interval, named = (float(low), float(high)), float(np.mean(names))
        rows.append(Found(kind, size, area, *interval, float(pooled), missed, delay, named, others))
    return healthy, rows


def otherwise(monitor: Monitor, recording: Recording) -> dict[str, Monitor]:
    """Return monitors with less knowledge of healthy sensors, or with wrong settings, by name."""
    total = {name: float(np.sqrt(variance)) for name, variance in _variances(monitor).items()}
    white = {name: replace(sensor, std=total[name]) for name, sensor in monitor.sensors.items()}
    default = default_precision(recording.loss, recording.resolution)
    calm = replace(default, modes=tuple(mode for mode in default.modes if not isinstance(mode, Burst)))
    monitors = {
        "lasting errors modelled as white noise of the same size": replace(monitor, sensors=white, errors=()),
        "no bursts": replace(monitor, precision=calm),
    }
    for factor in (0.2, 5.0):
        modes = [
            m if isinstance(m, Burst) else replace(m, time_to_fault=factor * m.time_to_fault) for m in default.modes
        ]
        monitors[f"times to a fault times {factor:g}"] = replace(monitor, precision=replace(default, modes=modes))
    for factor in (0.5, 2.0):
        sensors = {name: replace(sensor, std=factor * sensor.std) for name, sensor in monitor.sensors.items()}
        errors = [replace(error, std=factor * float(np.max(error.std))) for error in monitor.errors]
        monitors[f"all standard deviations of sensors times {factor:g}"] = replace(
            monitor, sensors=sensors, errors=errors
        )
    return monitors


def _variances(monitor: Monitor) -> dict[str, float]:
    """Return the total variance of each sensor's errors."""
    model = monitor.model
    covariance = np.asarray(StateEstimator(model, FixedPrecision()).initial_covariance)
    # Only the last states are errors of sensors; the plant's states and the inputs' errors come before.
    count = sum(1 if e.common else len(e.sensors or monitor.sensors) for e in monitor.errors)
    first = model.states - count
    C = model.matrix("C")[:, first:]
    total = np.diag(C @ covariance[first:, first:] @ C.T + model.matrix("sensor_covariance"))
    return dict(zip(monitor.sensors, total.tolist(), strict=True))


def table(healthy: Monitored, rows: Sequence[Found]) -> str:
    """Return the printed table."""
    fitted = sum(event.start < FITTED for event in healthy.events)
    lines = [
        f"Without a fault, {healthy.time[-1] - healthy.time[0]:.0f} s: {len(healthy.events)} alarms, {fitted} of them in the "
        f"first {FITTED:.0f} s, to which the model was fitted.",
        "",
        f"{'fault':22} {'AUC':>6} {'95 % interval':>15} {'pooled':>7} {'missed':>7} {'delay (s)':>9} {'named':>6} {'others':>7}",
    ]
    for r in rows:
        name = r.kind if r.kind == "freeze" else f"{r.kind}, {r.size:g}{UNITS[r.kind]}"
        lines.append(
            f"{name:22} {r.auc:6.3f} {f'{r.low:.3f} to {r.high:.3f}':>15} {r.pooled:7.3f} {r.missed:7.1%} {r.delay:9.2f} "
            f"{r.named:6.0%} {r.others:7d}"
        )
    lines.append(
        "\nDelay: median; named: the right kind at the end of the alarm; others: alarms of sensors without a fault."
    )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Run the study, print the table and return its rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", nargs="?", type=Path, default=recorded() or DATA, help="where the CSV files are")
    parser.add_argument("--model", type=Path, default=DATA / "model.toml", help="the model file")
    parser.add_argument(
        "--onsets", type=at_least(2), default=200, help="random onsets of each kind and size, at least two"
    )
    parser.add_argument("--seed", type=at_least(0), default=0, help="of the onsets and of the added noise")
    arguments = parser.parse_args(argv)
    with sentences(parser):
        healthy, rows = study(arguments.folder, arguments.onsets, arguments.seed, arguments.model)
        print(table(healthy, rows))
        monitor = load_monitor(arguments.model)
        print("\nAlarms in the drive without a fault, with other models:")
        for name, other in otherwise(monitor, healthy.recording).items():
            print(f"  {name}: {len(other.run(healthy.recording).events)}")
    return [asdict(row) for row in rows]


if __name__ == "__main__":
    main()
