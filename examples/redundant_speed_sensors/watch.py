"""Four faults injected into a drive, and the faults that the monitor detects.

``python -m bayesftc.examples.redundant_speed_sensors.watch [FOLDER] [--figure FILE] [--write FOLDER]``. FOLDER has the three CSV
files; by default it is the made-up drive. ``--write`` writes the drive with its faults, as in the folder ``faulty``.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bayesftc.cosim.base.recordings.table_files import read_table_file
from bayesftc.examples.redundant_speed_sensors.command import sentences
from bayesftc.examples.redundant_speed_sensors.study import DATA, broken, noise_of
from bayesftc.monitoring import Monitor, Monitored, Signal, align, load_monitor

FAULTS = (
    ("front_left", "noise", 5.0, (5.0, 11.0)),
    ("rear_left", "freeze", 0.0, (14.0, 19.0)),
    ("gnss", "dropout", 0.0, (22.0, 26.0)),
    ("front_right", "drift", 0.2, (29.0, 36.0)),
)
"""Sensor, kind, size (multiple of its noise; m/s per second), start and stop (s)."""


COLUMNS = {
    "wheel_speed.csv": {name: name for name in ("front_left", "front_right", "rear_left", "rear_right")},
    "gnss_speed.csv": {"gnss": "speed"},
    "imu.csv": {},
}
"""The files of a drive, with the column of each sensor."""


def put_in(folder: Path) -> tuple[Monitor, dict[str, Signal], dict[str, Signal]]:
    """Return the monitor, the sensors' signals with the faults, and the inputs."""
    monitor, rng = load_monitor(DATA / "model.toml"), np.random.default_rng(3)
    sensors, inputs = monitor.signals([folder])
    for name, kind, size, span in FAULTS:
        sensors[name] = broken(sensors[name], kind, size, noise_of(monitor, name), span, rng)
    return monitor, sensors, inputs


def watch(folder: Path = DATA) -> Monitored:
    """Inject the faults into the drive and return the monitor's results."""
    monitor, sensors, inputs = put_in(folder)
    return monitor.run(align(sensors, inputs, monitor.dt))


def write(folder: Path, drive: Path = DATA) -> None:
    """Write the drive with its faults as CSV files; a missing sample is an empty cell."""
    _, sensors, _ = put_in(drive)
    folder.mkdir(parents=True, exist_ok=True)
    for file, columns in COLUMNS.items():
        table = read_table_file(drive / file)
        for name, column in columns.items():
            samples = pd.Series(np.asarray(sensors[name].values), index=np.asarray(sensors[name].time))
            table[column] = samples.reindex(table["t"]).to_numpy()  # missing samples have no row in a signal
        table.to_csv(folder / file, index=False, float_format="%.4f", lineterminator="\n")


def main(argv: Sequence[str] | None = None) -> Monitored:
    """Print the injected and the detected faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA, help="where the CSV files are")
    parser.add_argument("--figure", type=Path, help="file to draw into")
    parser.add_argument("--write", type=Path, help="folder for the drive with its faults")
    arguments = parser.parse_args(argv)
    with sentences(parser):
        monitored = watch(arguments.folder)
        if arguments.write is not None:
            write(arguments.write, arguments.folder)
        if arguments.figure is not None:
            try:
                monitored.plot().savefig(arguments.figure, dpi=150)
            except ValueError as error:
                parser.error(f"argument --figure: {error}")
    for name, kind, _, span in FAULTS:
        print(f"put in  {name:12} {kind:10} {span[0]:6.2f} to {span[1]:6.2f} s")
    for event in monitored.events:
        since = "" if event.onset is None else f", since {event.onset:.2f} s"
        print(f"found   {event.sensor:12} {event.kind:10} {event.start:6.2f} to {event.end:6.2f} s{since}")
    return monitored


if __name__ == "__main__":
    main()
