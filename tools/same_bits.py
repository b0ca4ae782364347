"""Check that a change of the code keeps the bits of all results, by hashes of results and of public signatures.

    python tools/same_bits.py write before.json     # on the commit before
    python tools/same_bits.py check before.json     # after each step: lists differences and exits with 1

Designed and identified models depend on the processor (LAPACK) and on versions, so the file is not for the repository.
A run takes minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from typer.testing import CliRunner

from bayesftc import controllers, cosim, fmus, monitoring
from bayesftc.cli import app
from bayesftc.cosim.errors import BayesFTCError

DT = 0.02
MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, DT)
SERVO = {"measured": "angle", "actuated": "voltage", "sensors": 2, "sensor_std": 0.01, "noise": {"load": 0.02}}
Case = tuple[str, Callable[[], object]]


def digest(value: object) -> str:
    """Return a short hash of the bits of arrays, numbers, texts, and containers of these."""
    sha = hashlib.sha256()

    def add(item: object) -> None:
        if isinstance(item, cosim.Result):
            item = {name: item[name] for name in sorted(item)}
        if isinstance(item, dict):
            for key in item:
                add(key)
                add(item[key])
        elif isinstance(item, list | tuple):
            for part in item:
                add(part)
        elif isinstance(item, np.ndarray | np.generic | float | int) and np.asarray(item).dtype.kind in "fiub":
            array = np.ascontiguousarray(item)
            if array.dtype.kind == "f":
                array = np.where(np.isnan(array), np.nan, array)
            sha.update(str((array.dtype, array.shape)).encode() + array.tobytes())
        else:
            sha.update(repr(item).encode())

    add(value)
    return sha.hexdigest()[:16]


def car(controller: cosim.Block, faults: tuple[cosim.Block, ...] = (), **plant: object) -> cosim.Diagram:
    """Return the README's loop."""
    fmu = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}, **plant)
    wiring = {"control": "force", "measured": "v", "sensors": cosim.Sensors(count=2, std=1.0)}
    noise, goal = cosim.Gaussian(std=np.sqrt(0.001)), cosim.Sine(amplitude=5.0, period=8.0, offset=20.0)
    return cosim.closed_loop(
        fmu, controller, **wiring, noise={"disturbance": noise}, faults=list(faults), reference=goal
    )


FREEZE = cosim.Freeze(sensor=0, start=1.0, stop=3.0)


def run(
    controller: cosim.Block, faults: tuple[cosim.Block, ...] = (FREEZE,), seconds: float = 5.0, **options: object
) -> object:
    """Return the result of the README's loop."""
    return car(controller, faults).simulate(seconds, seed=1, **options)


def of_learners() -> Iterator[Case]:
    """Run every learner in every controller, compiled and interpreted, and in the estimator."""
    for learner in controllers.LEARNERS:
        for name, make in {
            "BayesianController": lambda p: controllers.BayesianController(MODEL, precision=p, initial_mean=20.0),
            "LQGController": lambda p: controllers.LQGController(MODEL, precision=p, initial_mean=20.0),
            "UnbiasedActiveInference": lambda p: controllers.UnbiasedActiveInference(
                controllers.Modality("speed", matrix=[[1.0], [1.0]], std=1.0),
                controllers.Proportional(50.0),
                DT,
                0.02,
                0.02,
                precision=p,
                initial_mean=20.0,
            ),
        }.items():
            yield f"learner {learner.__name__} {name}", lambda learner=learner, make=make: run(make(learner()))
        yield (
            f"learner {learner.__name__} interpreted",
            lambda learner=learner: run(
                controllers.BayesianController(MODEL, precision=learner(), initial_mean=20.0),
                seconds=1.6,
                engine="interpreted",
            ),
        )

        def estimate(learner: type = learner) -> list[object]:
            step = controllers.StateEstimator(MODEL, precision=learner()).online(compiled=False)
            rng, outs = np.random.default_rng(1), []
            for k in range(120):
                y = [rng.normal(), None if k == 30 else 5.0 * (k > 60) + rng.normal()]
                outs.append([np.asarray(v) for v in step(y=y, u=[0.0])])
            return outs

        yield f"learner {learner.__name__} estimator", estimate


def of_faults() -> Iterator[Case]:
    """Run every fault with the default learner."""
    for fault in cosim.FAULTS:

        def one(fault: type = fault) -> object:
            needed = {
                name: 2.0
                for name, p in inspect.signature(fault).parameters.items()
                if p.default is p.empty and name not in ("sensor", "start", "stop")
            }
            return run(
                controllers.BayesianController(MODEL, initial_mean=20.0),
                (fault(sensor=1, start=1.0, stop=3.0, **needed),),
            )

        yield f"fault {fault.__name__}", one


def of_plants() -> Iterator[Case]:
    """Run every shipped plant of either FMI version with constant inputs, in this process and isolated."""
    for file in sorted(Path(fmus.path("CruiseControl")).parent.glob("*.fmu")):
        for isolate in (False, True):

            def alone(file: Path = file, isolate: bool = isolate) -> object:
                diagram = cosim.Diagram(0.01)
                plant = cosim.FMU(file, isolate=isolate)
                node = diagram.add(plant, "plant")
                for k, port in enumerate(plant.inputs):
                    diagram.connect(diagram.add(cosim.Constant(0.3), f"input_{k}")["y"], node[port.name])
                return diagram.simulate(2.0, seed=1)

            yield f"plant {file.stem} isolate={isolate}", alone

    def designed() -> object:
        servo = cosim.FMU(fmus.path("PositionServo"))
        wiring = {"control": "voltage", "measured": "angle", "sensors": cosim.Sensors(count=2, std=0.01)}
        faults, goal = [cosim.Injection(sensor=0, start=1.0, magnitude=0.5)], cosim.Step(time=0.5, after=0.5)
        loop = cosim.closed_loop(servo, controllers.design(servo, **SERVO), **wiring, faults=faults, reference=goal)
        return loop.simulate(2.0, seed=1)

    yield "plant PositionServo design", designed


def of_exports() -> Iterator[Case]:
    """Run controllers that were exported as an FMU of either version."""
    for learner in (controllers.GammaPrecision(), controllers.SwitchingPrecision(), controllers.SERFDI()):
        for version in ("2.0", "3.0"):

            def through(learner: controllers.PrecisionLearner = learner, version: str = version) -> object:
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / "controller.fmu"
                    block = controllers.BayesianController(MODEL, precision=learner, initial_mean=20.0)
                    cosim.export_fmu(block, path, fmi=version)
                    diagram = cosim.Diagram(DT)
                    fmu = diagram.add(cosim.FMU(path), "controller")
                    sine = diagram.add(cosim.Sine(amplitude=3.0, period=2.0), "sine")["y"]
                    for port in fmu.block.inputs:
                        diagram.connect([sine] * port.size, fmu[port.name])
                    return diagram.simulate(4.0, seed=1)

            yield f"export {type(learner).__name__} {version}", through


def of_campaigns() -> Iterator[Case]:
    """Run a campaign with every executor."""
    for name, executor in {"threads": cosim.Threads(2), "processes": cosim.Processes(2)}.items():

        def table(executor: object = executor) -> object:
            loop = car(
                controllers.BayesianController(MODEL, precision=controllers.GammaPrecision(), initial_mean=20.0),
                (FREEZE,),
            )
            rms = cosim.RMSE("plant.v", "reference.y", name="rmse")
            grid = {"freeze_0.stop": [2.0, 3.0]}
            campaign = cosim.Campaign(loop, duration=4.0, seeds=5, grid=grid, metrics=[rms])
            return campaign.run(executor=executor).table.to_csv()

        yield f"campaign {name}", table


def of_commands() -> Iterator[Case]:
    """Run commands: the examples, and the experiments with the fewest runs."""
    experiments = ("arm", "tracking", "detection", "bound", "models", "beliefs", "family --case freeze*")
    for line in (
        "run cruise_control --json",
        "run position_servo --json",
        "example cruise_control",
        "calibrate cruise_control --runs 2 --json",
        *(f"reproduce {name} --runs 1 --json" for name in experiments),
    ):

        def out(line: str = line) -> object:
            done = CliRunner().invoke(app, line.split())
            return [done.exit_code, done.stdout if done.exit_code == 0 else done.output]

        yield f"command {line}", out


def of_identification() -> Iterator[Case]:
    """Fit a model to samples, and linearise one."""

    def samples() -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(2)
        u, x, ys = rng.normal(size=(600, 1)), 0.0, []
        for k in range(600):
            ys.append([x + 0.1 * rng.normal(), x + 0.1 * rng.normal() + 3.0 * (k > 400)])
            x = 0.9 * x + 0.5 * u[k, 0] + 0.05 * rng.normal()
        return u, np.array(ys)

    def fitted() -> object:
        u, y = samples()
        data = pd.DataFrame({"u": u[:400, 0], "a": y[:400, 0], "b": y[:400, 1]})
        model = controllers.LinearModel.identify(data, inputs="u", outputs=["a", "b"], dt=DT, order=1).model
        return [model.A, model.B, model.C, model.process_covariance, model.sensor_covariance]

    yield "identification", fitted
    yield (
        "linearised",
        lambda: [
            getattr(
                controllers.LinearModel.from_fmu(fmus.path("PositionServo"), measured="angle", actuated="voltage"), name
            )
            for name in "ABC"
        ],
    )


def of_signatures() -> Iterator[Case]:
    """List every public name with its parameters."""
    for module in (controllers, cosim, cosim.ops, cosim.random, cosim.statistics, fmus, monitoring):
        for name in sorted(getattr(module, "__all__", [n for n in vars(module) if not n.startswith("_")])):

            def sign(thing: object = getattr(module, name)) -> object:
                if inspect.isclass(thing):
                    members = {n for n in dir(thing) if not n.startswith("_")}
                    return [
                        parameters(thing),
                        *((n, parameters(inspect.getattr_static(thing, n))) for n in sorted(members)),
                    ]
                return parameters(thing)

            yield f"signature {module.__name__}.{name}", sign


def parameters(thing: object) -> object:
    """Return the parameters of a callable with their kinds and the types of their defaults."""
    thing = getattr(thing, "__func__", thing)
    try:
        all_parameters = inspect.signature(thing).parameters.values()  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return type(thing).__name__
    return [(p.name, str(p.kind), "" if p.default is p.empty else type(p.default).__name__) for p in all_parameters]


ALL = (of_signatures, of_learners, of_faults, of_plants, of_exports, of_campaigns, of_identification, of_commands)


def hashes(part: str) -> dict[str, str]:
    """Return the hash of each case whose name contains `part`; a case with an error has the hash of the message."""
    found = {}
    for cases in ALL:
        for name, compute in cases():
            if part in name:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    try:
                        print(name, file=sys.stderr)
                        found[name] = digest(compute())
                    except (BayesFTCError, TypeError, ValueError) as error:
                        found[name] = f"refused {digest(str(error))}"
                        print(f"{name}: {type(error).__name__}: {str(error)[:200]}", file=sys.stderr)
    return found


def main() -> int:
    """Write or check the hashes; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("write", "check"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    given = parser.parse_args()
    found = hashes(given.only)
    if given.what == "write":
        given.file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        print(f"{len(found)} hashes")
        return 0
    before = {n: h for n, h in json.loads(given.file.read_text(encoding="utf-8")).items() if given.only in n}
    differ = sorted(n for n in before.keys() | found.keys() if before.get(n) != found.get(n))
    print(
        "\n".join(
            [f"{n}: {before.get(n, 'new')} -> {found.get(n, 'gone')}" for n in differ] or [f"all {len(found)} the same"]
        )
    )
    return 1 if differ else 0


if __name__ == "__main__":
    raise SystemExit(main())
