"""Recordings of a car whose parameters are known."""

import numpy as np
import pandas as pd

from bayesftc import cosim, fmus

CAR = fmus.path("CruiseControl")
TRUE = {"m": 110.0, "b": 6.0, "v0": 3.0}
RANGES = {"m": (50, 200), "b": (1, 20), "v0": (-10, 10)}
NAMES = {"inputs": {"force": "u"}, "outputs": {"v": ["v0", "v1"]}}
NOISE, DT = 0.5, 0.1


def recording(seed, rows, sensors=2, colour=0.0):
    """Return a table of the car's speed by several sensors with independent noise, coloured by an autoregression."""
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


def with_faults(table, seed):
    """Return the table with a fault of one sensor, its kind by the seed, for a sixth of the rows, and a gap in another place."""
    rng, rows, table = np.random.default_rng(seed), len(table), table.copy()
    length = rows // 6
    column, begin, gap = f"v{seed % 2}", *rng.integers(rows // 15, rows - 2 * length, 2)
    fault = slice(begin, begin + length - 1)
    healthy = table.loc[fault, column]
    size = np.arange(length)
    kinds = (
        healthy + 4.0,
        np.full(length, healthy.iloc[0]),
        healthy + 10.0 * size / length,
        healthy + 4.0 * rng.standard_normal(length),
    )
    table.loc[fault, column] = kinds[seed % 4]
    table.loc[gap : gap + length // 2, "v0"] = np.nan
    return table
