"""Where precision learning helps and where it does harm: tracking errors over many runs, by fault and reference.

Run it with ``python -m bayesftc.examples.cruise_control.where_it_helps [runs]``. All techniques get the same noise. A frozen
sensor on a constant reference is the bad case of `GammaPrecision`: its samples agree with each other and with the model better
than a healthy sensor's. So its precision rises, and the car drifts with it.
"""

import sys

import numpy as np

from bayesftc import cosim
from bayesftc.examples.cruise_control.cruise_control import FREEZE, LEARNERS, SINE, cruise_control

FAULTS = {
    "freeze": FREEZE,
    "injection of 5 m/s": cosim.Injection(sensor=0, start=6.0, stop=14.0, magnitude=5.0),
    "drift of 2 m/s per s": cosim.Drift(sensor=0, start=6.0, stop=14.0, slope=2.0),
}
REFERENCES = {"sine": SINE, "constant": cosim.Constant(20.0)}


def errors(loop: cosim.Diagram, runs: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the tracking error (RMSE in m/s, from 6 to 14 s) of each run, with seeds 0, 1, 2, ..."""
    during = slice(300, 700)
    rows = []
    for seed in range(runs):
        result = loop.simulate(20.0, seed=seed, record=["plant.v", "reference.y"])
        rows.append(np.sqrt(np.mean((result["plant.v"] - result["reference.y"])[during] ** 2)))
    return np.array(rows)


def main(runs: int = 100) -> dict[tuple[str, str], dict[str, float]]:
    """Print mean error and half the width of its 95 % interval for every case and technique; return the means."""
    names = [type(learner).__name__ for learner in LEARNERS]
    print(f"{'RMSE while faulty (m/s)':32}" + "".join(f"{name:>20}" for name in names))
    table: dict[tuple[str, str], dict[str, float]] = {}
    for fault_name, fault in FAULTS.items():
        for reference_name, reference in REFERENCES.items():
            cells = [errors(cruise_control(learner, fault, reference), runs) for learner in LEARNERS]
            shown = "".join(f"{cell.mean():13.3f} ± {1.96 * cell.std(ddof=1) / runs**0.5:4.2f}" for cell in cells)
            print(f"{fault_name + ', ' + reference_name:32}{shown}")
            table[fault_name, reference_name] = {n: float(c.mean()) for n, c in zip(names, cells, strict=True)}
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
