"""A made-up drive in the form of the recorded one: wheels at about 83 samples per second, GNSS at 10, an accelerometer at 104.

``python -m bayesftc.examples.redundant_speed_sensors.synthetic FOLDER`` writes the three CSV files of ``data``. The numbers are
made up, with properties of a drive of comma2k19. Wheels read 0.15 m/s too little, in steps of 0.01 km/h, so one sample in 22
repeats its predecessor. Errors are lasting (correlation of .7 to .8 from one sample to the next) and partly common to the wheels
of an axle. Slip depends on the acceleration, and all wheels jitter at bumps. The time stamps of GNSS are late, and the
accelerometer has a bias.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesftc.examples.redundant_speed_sensors.command import sentences

Floats = NDArray[np.float64]
SECONDS = 40.0
SEED = 23
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
BUMPS = (3.0, 11.5, 19.0, 30.5)  # s
RESOLUTION = 0.01 / 3.6  # m/s


def speed(t: Floats) -> Floats:
    """Return the car's speed in m/s."""
    return 14.0 + 4.0 * np.sin(2 * np.pi * t / 37 - 1.2) + 1.2 * np.sin(2 * np.pi * t / 13 + 1.0)


def lasting(rng: np.random.Generator, t: Floats, std: float, time_constant: float) -> Floats:
    """Return an Ornstein-Uhlenbeck process with a constant standard deviation and a time constant."""
    decay = np.exp(-np.diff(t, prepend=t[0]) / time_constant)
    noise = std * rng.standard_normal(len(t))
    error = np.empty(len(t))
    error[0] = noise[0]
    for k in range(1, len(t)):
        error[k] = decay[k] * error[k - 1] + np.sqrt(1 - decay[k] ** 2) * noise[k]
    return error


def stamps(rng: np.random.Generator, interval: float, jitter: float) -> Floats:
    """Return time stamps with random intervals."""
    steps = np.clip(interval + jitter * rng.standard_normal(int(1.2 * SECONDS / interval)), 0.05 * interval, None)
    t = 0.08 + np.cumsum(steps)
    return np.round(t[t < SECONDS], 6)


def near_bumps(t: Floats) -> Floats:
    """Return the strength of the shaking, which is 1 in the middle of a bump."""
    return np.asarray(sum(np.exp(-(((t - bump) / 0.15) ** 2)) for bump in BUMPS))


def drive(seed: int = SEED) -> dict[str, dict[str, Floats]]:
    """Return the columns of each file."""
    rng = np.random.default_rng(seed)
    t = stamps(rng, 0.0121, 0.004)
    every = lasting(rng, t, 0.02, 30.0) - 0.15
    wheel: dict[str, Floats] = {"t": t}
    for axle, slip in (("front", 0.065), ("rear", 0.045)):
        shared = every + slip * np.gradient(speed(t), t) + lasting(rng, t, 0.02, 18.0) + lasting(rng, t, 0.012, 0.034)
        for side in ("left", "right"):
            single = lasting(rng, t, 0.018, 0.016) + 0.007 * rng.standard_normal(len(t))
            bumps = 0.15 * near_bumps(t) * rng.standard_normal(len(t))
            wheel[f"{axle}_{side}"] = np.round((speed(t) + shared + single + bumps) / RESOLUTION) * RESOLUTION
    late = stamps(rng, 0.1, 0.008)
    gnss = {"t": late, "speed": np.round(speed(late - 0.15) + 0.057 * rng.standard_normal(len(late)), 3)}
    s = stamps(rng, 0.0096, 1e-5)
    slope = lasting(rng, s, 0.15, 15.0) - 0.78
    shaking = (0.5 + 4.0 * near_bumps(s)) * rng.standard_normal(len(s))
    accelerometer = {"t": s, "accel_x": np.gradient(speed(s), s) - slope + shaking}
    return {"wheel_speed.csv": wheel, "gnss_speed.csv": gnss, "imu.csv": accelerometer}


def text(columns: dict[str, Floats]) -> str:
    """Return a file's text, with four decimals."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [f"{time:.4f}," + ",".join(f"{value:.4f}" for value in values) for time, *values in rows]
    return ",".join(columns) + "\n" + "\n".join(lines) + "\n"


def write(folder: Path) -> None:
    """Write the files into a folder, which is created if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, columns in drive().items():
        (folder / name).write_text(text(columns), encoding="utf-8", newline="\n")


def main(argv: Sequence[str] | None = None) -> None:
    """Write the files into the given folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="folder to write to")
    arguments = parser.parse_args(argv)
    with sentences(parser):
        write(arguments.folder)


if __name__ == "__main__":
    main()
