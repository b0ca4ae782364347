"""Four parameters of a servo fitted to a recording: by `cosim.fit`, and by scipy over fmpy without this package."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import Unpacked, unpacked_fmu
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

PLANT, STEP = "PositionServo", 0.02
TRUE = {"R": 1.2, "L": 0.06, "J": 0.012, "b": 0.025}
RANGES = {"R": (0.5, 2.0), "L": (0.02, 0.2), "J": (0.005, 0.05), "b": (0.001, 0.1)}
NAMES: dict[str, Any] = {"inputs": {"voltage": "u"}, "outputs": {"speed": ["w0", "w1", "w2"], "current": "i"}}
NOISE = {"w0": 0.5, "w1": 0.5, "w2": 0.5, "i": 0.1}


def recording(rows: int, *, faulty: bool) -> pd.DataFrame:
    """Return a recording of three speed sensors and the current; with faults, one sensor is biased and another freezes."""
    import pandas as pd

    from bayesftc import cosim, fmus

    diagram = cosim.Diagram(dt=STEP)
    servo = diagram.add(cosim.FMU(fmus.path(PLANT), parameters=TRUE), "servo")
    voltage = diagram.add(cosim.PRBS(5.0, 0.5), "voltage")
    diagram.connect(voltage["y"], servo["voltage"])
    run = diagram.simulate((rows - 1) * diagram.step)
    table = pd.DataFrame({"time": run.time, "u": run["voltage.y"]})
    for (name, std), noise in zip(NOISE.items(), np.random.default_rng(0).standard_normal((4, rows)), strict=True):
        table[name] = run["servo.current" if name == "i" else "servo.speed"] + std * noise
    if faulty:
        table.loc[rows // 5 : 2 * rows // 5, "w1"] += 3.0
        table.loc[rows // 2 : 3 * rows // 5, "w2"] = table["w2"][rows // 2]
    return table


def by_fmpy(servo: Unpacked, table: pd.DataFrame) -> Floats:
    """Return the parameters that scipy finds from the middle of the ranges, with noise that is known."""
    from scipy.optimize import least_squares

    low, high = np.array(list(RANGES.values())).T
    std, y = np.array(list(NOISE.values())), table[list(NOISE)].to_numpy()
    voltages, references = table["u"].tolist(), [servo.references[name] for name in ("speed", "current")]
    into = [servo.references["voltage"]]

    def residuals(place: Floats) -> Floats:
        outputs = []
        with servo.slave(**dict(zip(TRUE, (low + place * (high - low)).tolist(), strict=True))) as slave:
            get_real, set_real, do_step = slave.getReal, slave.setReal, slave.doStep
            for k, u in enumerate(voltages):
                outputs.append(get_real(references))
                set_real(into, [u])
                do_step(k * STEP, STEP)
        return np.asarray((y - np.array(outputs)[:, [0, 0, 0, 1]]) / std).ravel()

    return np.asarray(low + least_squares(residuals, np.full(4, 0.5), bounds=(0.0, 1.0)).x * (high - low))


def measure(quick: bool = False) -> Section:
    """Check that both find the same parameters, and measure them in turns."""
    from bayesftc import cosim, fmus

    rows, rounds = (500, 1) if quick else (10_000, 3)
    faulty, healthy, path = recording(rows, faulty=True), recording(rows, faulty=False), fmus.path(PLANT)
    cosim.fit(path, faulty, RANGES, **NAMES)  # compiles
    found: dict[str, Floats] = {}
    settings = cosim.FitSettings(screened=1, starts=1)
    with unpacked_fmu(PLANT) as servo:

        def with_learner() -> float:
            began = time.perf_counter()
            cosim.fit(path, faulty, RANGES, **NAMES)
            return time.perf_counter() - began

        def plain() -> float:
            began = time.perf_counter()
            fitted = cosim.fit(path, healthy, RANGES, **NAMES, held_out=0.0, weigh=None, settings=settings)
            found["here"], found["std"] = (np.array(list(of.values())) for of in (fitted.parameters, fitted.std))
            return time.perf_counter() - began

        def fmpy() -> float:
            began = time.perf_counter()
            found["fmpy"] = by_fmpy(servo, healthy)
            return time.perf_counter() - began

        seconds = in_turns({"learner": with_learner, "plain": plain, "fmpy": fmpy}, rounds)
    apart = [float(np.max(np.abs(found["here"] - found["fmpy"]) / found["std"]))]
    return Section(
        "fit",
        f"A fit of four parameters of {PLANT} to {rows:,} samples",
        (
            Figure("seconds", "with faults: several starts, the learner", "s", seconds["learner"], at_most=5.0),
            Figure("plain", "without faults: one start, no learner", "s", seconds["plain"]),
            Figure("fmpy", "the same by scipy over fmpy", "s", seconds["fmpy"]),
            Figure(
                "over_fmpy", "scipy over fmpy / one start", "", ratios(seconds["fmpy"], seconds["plain"]), at_least=1.0
            ),
            Figure("difference", "largest difference of both", "standard errors", apart, at_most=0.2),
        ),
    )
