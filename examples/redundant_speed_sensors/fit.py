"""Fit the parameters of ``data/model.toml``: maximum likelihood over the drive's first 20 s, which have no fault.

``python -m bayesftc.examples.redundant_speed_sensors.fit [FOLDER] [--start 0] [--stop 20]`` takes about a minute. The white
noise of the wheels stays at 0.02 m/s: with the largest likelihood all noise would be coloured, but the learner's offsets and
noise are multiples of the white noise. Smoothing and delay are not fitted, but compared in a grid.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from bayesftc.cosim.errors import RecordingError
from bayesftc.examples.redundant_speed_sensors.command import at_least, sentences
from bayesftc.examples.redundant_speed_sensors.study import DATA, FITTED, recorded
from bayesftc.monitoring import Integrator, Monitor, Recording, load_monitor, log_likelihood

BOUNDS = {"std": (1e-3, 1.0), "s": (1e-3, 100.0)}
"""Bounds of standard deviations and of time constants (s)."""

GRID = {"smooth": (0.1, 0.25, 0.5, 1.0), "delay": (0.1, 0.15, 0.2)}


def numbers(monitor: Monitor) -> dict[str, float]:
    """Return the fitted parameters by name."""
    values = {
        "model.std": monitor.plant.std,  # type: ignore[attr-defined]
        "inputs.acceleration.error_walk": monitor.inputs["acceleration"].error_walk,
        "sensors.gnss.std": monitor.sensors["gnss"].std,
    }
    for i in GROUPS:
        errors = monitor.errors[i[0]]
        values[f"errors[{i[0]}].std"] = float(np.max(errors.std))
        values[f"errors[{i[0]}].time_constant"] = float(np.max(errors.time_constant))
    return values


GROUPS = ((0,), (1, 2), (3, 4), (5,))
"""Groups of errors with equal parameters: the two axles have the same."""


def changed(monitor: Monitor, values: Mapping[str, float]) -> Monitor:
    """Return the monitor with other parameters."""
    errors = list(monitor.errors)
    for group in GROUPS:
        for i in group:
            std, time_constant = (values[f"errors[{group[0]}].{name}"] for name in ("std", "time_constant"))
            errors[i] = replace(errors[i], std=std, time_constant=time_constant)
    walk = values["inputs.acceleration.error_walk"]
    return replace(
        monitor,
        plant=Integrator(values["model.std"]),
        inputs={"acceleration": replace(monitor.inputs["acceleration"], error_walk=walk)},
        sensors={**monitor.sensors, "gnss": replace(monitor.sensors["gnss"], std=values["sensors.gnss.std"])},
        errors=errors,
    )


def likelihood(monitor: Monitor, recording: Recording) -> float:
    """Return the log-likelihood of the recording under the monitor's model."""
    model = monitor.model
    mean, covariance = monitor.start(recording, model)
    return log_likelihood(model, recording, initial_mean=mean, initial_covariance=covariance)


def part(monitor: Monitor, folder: Path, start: float, stop: float) -> Recording:
    """Return the steps of a recording between two times."""
    whole = monitor.read([folder])
    kept = (whole.time >= start) & (whole.time < stop)
    if not kept.any():
        raise RecordingError(
            f"The drive in {folder}, from {whole.time[0]:.1f} to {whole.time[-1]:.1f} s, has no samples between {start:g} and "
            f"{stop:g} s. Choose another part."
        )
    return replace(whole, start=float(whole.time[kept][0]), y=whole.y[kept], u=whole.u[kept])


def fit(monitor: Monitor, recording: Recording, iterations: int = 40) -> tuple[dict[str, float], float]:
    """Return the parameters with the largest likelihood, starting from the monitor's, and the log-likelihood."""
    names = list(numbers(monitor))
    limits = [np.log(BOUNDS["s" if name.endswith("time_constant") else "std"]) for name in names]

    def cost(logs: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        return -likelihood(changed(monitor, dict(zip(names, np.exp(logs).tolist(), strict=True))), recording)

    begin = np.log(list(numbers(monitor).values()))
    done = minimize(cost, begin, method="L-BFGS-B", bounds=limits, options={"maxiter": iterations})
    return dict(zip(names, np.exp(done.x).tolist(), strict=True)), -float(done.fun)


def main(argv: Sequence[str] | None = None) -> dict[str, float]:
    """Fit, print the parameters beside those of the file, and return them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", nargs="?", type=Path, default=recorded() or DATA, help="where the CSV files are")
    parser.add_argument("--start", type=float, default=0.0, help="seconds")
    parser.add_argument("--stop", type=float, default=FITTED, help="seconds")
    parser.add_argument("--iterations", type=at_least(1), default=40, help="of the optimiser, at most")
    arguments = parser.parse_args(argv)
    with sentences(parser):
        return _fit_and_print(arguments.folder, arguments.start, arguments.stop, arguments.iterations)


def _fit_and_print(folder: Path, start: float, stop: float, iterations: int) -> dict[str, float]:
    monitor = load_monitor(DATA / "model.toml")
    recording = part(monitor, folder, start, stop)
    fitted, best = fit(monitor, recording, iterations)
    print(f"{'':34} {'file':>9} {'fitted':>9}")
    for name, value in numbers(monitor).items():
        print(f"{name:34} {value:9.4g} {fitted[name]:9.4g}")
    print(f"{'log-likelihood':34} {likelihood(monitor, recording):9.1f} {best:9.1f}\n")
    alarms = len(changed(monitor, fitted).run(monitor.read([folder])).events)
    print(f"Alarms in the whole drive with the fitted parameters: {alarms}\n")
    print("Log-likelihood of the fitted parameters, by smoothing (down) and delay (across), in seconds")
    print(f"{'':8}" + "".join(f"{delay:10g}" for delay in GRID["delay"]))
    for smooth in GRID["smooth"]:
        row = []
        for delay in GRID["delay"]:
            other = changed(monitor, fitted)
            other = replace(
                other,
                inputs={"acceleration": replace(other.inputs["acceleration"], smooth=smooth)},
                sensors={**other.sensors, "gnss": replace(other.sensors["gnss"], delay=delay)},
            )
            row.append(likelihood(other, part(other, folder, start, stop)))
        print(f"{smooth:8g}" + "".join(f"{value:10.1f}" for value in row))
    return fitted


if __name__ == "__main__":
    main()
