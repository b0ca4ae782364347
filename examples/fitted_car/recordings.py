"""Recordings of a car whose parameters are known, by redundant sensors with faults and gaps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc import cosim, fmus

if TYPE_CHECKING:
    import pandas as pd

CAR = fmus.path("CruiseControl")
TRUE = {"m": 110.0, "b": 6.0, "v0": 3.0}
RANGES = {"m": (50.0, 200.0), "b": (1.0, 20.0), "v0": (-10.0, 10.0)}
NAMES: dict[str, Any] = {"inputs": {"force": "u"}, "outputs": {"v": ["v0", "v1"]}}
NOISE, DT = 0.5, 0.1


def recording(seed: int, rows: int, sensors: int = 2, colour: float = 0.0) -> pd.DataFrame:
    """Return the car's speed by several sensors with independent noise.

    Parameters
    ----------
    seed : int
        Seed of the noise.
    rows, sensors : int
        Size of the table.
    colour : float
        Autocorrelation of the noise from row to row; its variance stays the same.
    """
    import pandas as pd
    from scipy.signal import lfilter

    diagram = cosim.Diagram(dt=DT)
    car = diagram.add(cosim.FMU(CAR, parameters=TRUE), "car")
    force = diagram.add(cosim.PRBS(300.0, 4.0, offset=200.0), "force")
    diagram.connect(force["y"], car["force"])
    run = diagram.simulate((rows - 1) * diagram.step)
    noise = np.random.default_rng(seed).standard_normal((sensors, rows))
    noise = NOISE * lfilter([np.sqrt(1 - colour**2)], [1, -colour], noise)
    speeds = {f"v{i}": run["car.v"] + noise[i] for i in range(sensors)}
    return pd.DataFrame({"time": run.time, "u": run["force.y"], **speeds})


def with_faults(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Return a recording with a fault of one sensor for a sixth of the rows, and with a gap.

    Parameters
    ----------
    table : pandas.DataFrame
        A recording of two sensors.
    seed : int
        Seed of the places; the kind is an offset, a freeze, a drift or larger noise, in turns.
    """
    rng, rows, table = np.random.default_rng(seed), len(table), table.copy()
    length = rows // 6
    column, (begin, gap) = f"v{seed % 2}", rng.integers(rows // 15, rows - 2 * length, 2)
    fault = slice(begin, begin + length - 1)
    healthy, share = table.loc[fault, column].to_numpy(), np.arange(length) / length
    table.loc[fault, column] = (
        healthy + 4.0,
        np.full(length, healthy[0]),
        healthy + 10.0 * share,
        healthy + 4.0 * rng.standard_normal(length),
    )[seed % 4]
    table.loc[gap : gap + length // 2, "v0"] = np.nan
    return table
