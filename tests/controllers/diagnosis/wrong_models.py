"""Closed loops whose model is wrong in a known way, and right ones with every kind of sensor fault."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from math import inf
from typing import Any

import control
import numpy as np

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.ops import maximum, minimum
from bayesftc.cosim.ports import Port
from bayesftc.reproduce.experiments.models.car import TrueCar

LEARNERS: Mapping[str, controllers.PrecisionLearner] = {
    "fixed": controllers.FixedPrecision(),
    "gamma": controllers.GammaPrecision(forgetting=0.95),
    "SER": controllers.SERFDI(),
    "switching": controllers.SwitchingPrecision(),
}


def _arrive(u, y, sent, limit):
    last = sent.shape[0] - 1
    sent[last] = u[0]
    y[0] = maximum(minimum(sent[0], limit[0]), -limit[0])
    for k in range(last):
        sent[k] = sent[k + 1]


@dataclass(frozen=True)
class Actuator(Block):
    """Hands on a control `delay` samples late and within limits of which the controller does not know."""

    delay: int = 0
    limit: float = inf

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_arrive, state={"sent": np.zeros(self.delay + 1)}, parameters={"limit": self.limit})


@dataclass(frozen=True)
class Case:
    """A plant, how it is wrong, and the findings that name that."""

    plant: str
    wrong: str
    named: frozenset[str] = field(default_factory=frozenset)
    faults: tuple[cosim.Fault, ...] = ()

    @property
    def name(self) -> str:
        """What tests and tables call it."""
        return f"{self.plant}: {self.wrong}"


def _faults(size: float, start: float, stop: float) -> dict[str, cosim.Fault]:
    """Return one fault of each kind, for sensors of a given standard deviation."""
    when: Any = {"sensor": 0, "start": start, "stop": stop}
    return {
        "Freeze": cosim.Freeze(**when),
        "Stuck": cosim.Stuck(at=0.0, **when),
        "Injection": cosim.Injection(magnitude=3 * size, **when),
        "Bias": cosim.Bias(magnitude=2 * size, **when),
        "Drift": cosim.Drift(slope=size, **when),
        "GainFault": cosim.GainFault(factor=0.7, **when),
        "Dropout": cosim.Dropout(**when),
        "Spikes": cosim.Spikes(magnitude=10 * size, **when),
        "NoiseIncrease": cosim.NoiseIncrease(std=5 * size, **when),
        "NoiseGrowth": cosim.NoiseGrowth(slope=size, **when),
        "RandomFaults": cosim.RandomFaults(
            kinds=(cosim.Freeze(), cosim.Injection(magnitude=3 * size)),
            mean_time_to_fault=4.0,
            mean_time_to_recovery=2.0,
            sensor=0,
        ),
    }


PLANTS: Mapping[str, float] = {"car": 1.0, "servo": 0.01, "pendulum": 0.005, "turbine": 0.01, "heading": 0.02}
"""Standard deviation of the sensors of each plant."""

MASS = frozenset({"gain", "dt", "dynamics"})
"""Kinds whose sentences ask for masses and inertias: of a car mass and time scale are one and the same."""

FAR = {"far": frozenset({"nonlinear"})}

MOVED: Mapping[str, frozenset[str]] = {
    "sign": frozenset({"sign"}),
    "dt": frozenset({"dt"}),
    "heavier": MASS,
    "lighter": MASS,
    "limit": frozenset({"limit"}),
    "late": frozenset({"late"}),
    "loaded": frozenset({"onset"}),
}
"""What is wrong with the model of a plant that a force moves, and what it may be called."""

WRONG: Mapping[str, Mapping[str, frozenset[str]]] = {
    "car": {**MOVED, **FAR},
    "servo": MOVED,
    "pendulum": {**MOVED, **FAR, "noisy": frozenset({"noise"})},
    "turbine": FAR,
    "heading": {"biased": frozenset({"offset"}), "unequally biased": frozenset({"offset"})},
}
"""What is wrong with each plant's model, and what it may be called."""


def cases() -> list[Case]:
    """Return all cases: the wrong ones, and right models with healthy sensors and with a fault of each kind."""
    found = [Case(plant, wrong, named) for plant, its in WRONG.items() for wrong, named in its.items()]
    for plant, size in PLANTS.items():
        found.append(Case(plant, "right"))
        found += [Case(plant, f"right, {kind}", faults=(f,)) for kind, f in _faults(size, 6.0, 14.0).items()]
    return found


BIASED: Mapping[str, tuple[float, ...]] = {
    "heading: biased": (0.0, 0.02, 0.0, 0.02),
    "heading: unequally biased": (0.0, 0.02, 0.0, -0.012),
}
"""Offsets of the sensors, of which the model has none."""

LOADED: Mapping[str, float] = {"car": -0.02, "servo": 0.1, "pendulum": 0.05}
"""Load on each plant's noise input from 10 s on, in the input's unit."""

SCALE: Mapping[str, float] = {"heavier": 1.4, "lighter": 0.6}


def _car(case: Case, learner: controllers.PrecisionLearner) -> tuple[Any, ...]:
    b, m, c = 5.0, 100.0, 0.4 if case.wrong == "far" else 0.0
    model = controllers.LinearModel(
        [[1 - b / m * 0.02]], [[0.02 / m]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
    )
    if case.wrong == "far":  # right at 20 m/s, and led to 40
        slope = b + 2 * c * 20.0
        model = replace(model, A=[[1 - slope / m * 0.02]]).about([20.0], [b * 20.0 + c * 400.0], [20.0, 20.0])
    model = _wrong(model, case)
    reference = cosim.Sine(5.0, 8.0, offset=20.0) if case.wrong != "far" else cosim.Step(4.0, before=20.0, after=40.0)
    n = model.states
    controller = controllers.BayesianController(
        model, precision=learner, initial_mean=20.0 if n == 1 else (20.0, 1.0),
        initial_covariance=1.0 if n == 1 else (1.0, 0.0),
    )  # fmt: skip
    plant = TrueCar(20.0, SCALE.get(case.wrong, 1.0) * m, b, quadratic_drag=c)
    noise = {"disturbance": cosim.Gaussian(std=0.001**0.5)}
    return plant, controller, "force", ("v",), (1.0, 1.0), noise, reference, 400.0


def _wrong(model: controllers.LinearModel, case: Case) -> controllers.LinearModel:
    if case.wrong == "sign":
        return replace(model, B=-model.matrix("B"))
    return replace(model, dt=2.5 * float(model.step)) if case.wrong == "dt" else model


@cache
def _linear(
    name: str, measured: tuple[str, ...], control: str, std: tuple[float, ...], noise: tuple[tuple[str, float], ...],
    at: tuple[tuple[str, float], ...], goal: str,
) -> controllers.LQGController:  # fmt: skip
    plant = cosim.FMU(fmus.path(name))
    return controllers.design(
        plant, measured=measured, goal=goal, actuated=control, sensors=2 * len(measured), sensor_std=std,
        noise=dict(noise) or None, at=dict(at) or None,
    )  # fmt: skip


def _designed(
    case: Case, learner: controllers.PrecisionLearner, name: str, masses: tuple[str, float], control: str,
    measured: tuple[str, ...], goal: str, std: float, noise: Mapping[str, float], accept: tuple[float, float],
    reference: Block, limit: float, bounds: tuple[float, float], at: Mapping[str, float] = {},
) -> tuple[Any, ...]:  # fmt: skip
    stds = (std,) * len(measured)
    known = () if case.wrong == "noisy" else tuple(noise.items())  # else the model has noise on the control alone
    first = _linear(name, measured, control, stds, known, tuple(at.items()), goal)
    model = _wrong(first.model, case)
    controller = replace(
        first, model=model, precision=learner, goal_covariance=accept[0] ** 2, control_covariance=accept[1] ** 2,
        u_min=bounds[0], u_max=bounds[1],
    )  # fmt: skip
    parameters = {masses[0]: masses[1] * SCALE[case.wrong]} if case.wrong in SCALE else {}
    plant = cosim.FMU(fmus.path(name), parameters=parameters)
    means = dict(at)
    sources = {key: cosim.Gaussian(mean=means.get(key, 0.0), std=value) for key, value in noise.items()}
    return plant, controller, control, measured, stds * 2, sources, reference, limit


def _heading(learner: controllers.PrecisionLearner) -> tuple[Any, ...]:
    """A vehicle with compasses and gyros."""
    A, B, stds = [[1.0, 0.1], [0.0, 0.88]], [[0.002], [0.047]], (0.02, 0.01)
    Q, R = 25.0 * np.outer(B, B), np.diag(stds * 2) ** 2
    controller = controllers.LQGController(
        controllers.LinearModel(A, B, np.vstack([np.eye(2)] * 2), Q, R, dt=0.1), learner, [[1.0, 0.0]],
        goal_covariance=0.05**2, control_covariance=100.0, u_min=-40.0, u_max=40.0,
    )  # fmt: skip
    plant = cosim.StateSpace(
        control.ss(A, B, np.eye(2), 0, 0.1, outputs=["angle", "rate"], inputs=["torque"]), process_noise=Q
    )
    return plant, controller, "torque", ("angle", "rate"), stds * 2, {}, cosim.Sine(amplitude=0.5, period=8.0), 40.0


def parts(case: Case, learner: controllers.PrecisionLearner) -> tuple[Any, ...]:
    """Return plant, controller, control, measured, standard deviations, noise, reference and the limit of a case."""
    if case.plant == "car":
        return _car(case, learner)
    if case.plant == "servo":
        return _designed(
            case, learner, "PositionServo", ("J", 0.01), "voltage", ("angle",), "angle", 0.01, {"load": 0.02}, (0.1, 5.0),
            cosim.Sine(amplitude=0.5, period=4.0), 0.3, (-12.0, 12.0),
        )  # fmt: skip
    if case.plant == "pendulum":
        far = case.wrong == "far"
        return _designed(
            case, learner, "CartPendulum", ("M_cart", 0.5), "force", ("position", "angle"), "position", 0.005,
            {"torque": 0.02}, (0.1, 5.0), cosim.Step(time=2.0, after=3.0 if far else 0.3), 3.0, (-15.0, 15.0),
        )  # fmt: skip
    if case.plant == "heading":
        return _heading(learner)
    far = case.wrong == "far"
    return _designed(
        case, learner, "HydroTurbine", ("Tw", 1.0), "command", ("power",), "power", 0.01, {"head": 0.01}, (0.05, 0.1),
        cosim.Step(time=5.0, before=0.6, after=0.95 if far else 0.65), 0.1, (0.2, 1.0), {"head": 1.0},
    )  # fmt: skip


def loop(case: Case, learner: controllers.PrecisionLearner) -> cosim.Diagram:
    """Return the closed loop of a case under a learner."""
    plant, controller, control, measured, std, noise, reference, limit = parts(case, learner)
    step = controller.sample_time
    diagram = cosim.Diagram(step)
    goal = diagram.add(reference, "reference")
    node = diagram.add(plant, "plant")
    sensors = diagram.add(
        cosim.Sensors(len(std), std, signals=len(measured), bias=BIASED.get(case.name, 0.0)), "sensors"
    )
    diagram.connect([node[name] for name in measured], sensors["u"])
    signal = sensors["y"]
    for fault in case.faults:
        block = diagram.add(replace(fault, channels=len(std)), "fault")
        diagram.connect(signal, block["u"])
        signal = block["y"]
    node_of = diagram.add(controller, "controller")
    diagram.connect(signal, node_of["y"])
    diagram.connect(goal["y"], node_of["goal"])
    late = round(0.2 / float(step)) if case.wrong == "late" else 0
    actuator = diagram.add(Actuator(late, limit if case.wrong == "limit" else inf), "actuator")
    diagram.connect(node_of["u"], actuator["u"])
    diagram.connect(actuator["y"], node[control])
    for name, source in noise.items():
        signal = diagram.add(source, f"{name}_noise")["y"]
        if case.wrong == "loaded":
            both = diagram.add(cosim.Sum("++"), f"{name}_sum")
            diagram.connect(
                [signal, diagram.add(cosim.Step(time=10.0, after=LOADED[case.plant]), f"{name}_load")["y"]], both["u"]
            )
            signal = both["y"]
        diagram.connect(signal, node[name])
    return diagram.build()


def run(case: Case, learner: controllers.PrecisionLearner, seeds: Sequence[int], duration: float = 20.0) -> list[Any]:
    """Return the runs of a case (what was recorded of one that stopped early) for each seed."""
    diagram = loop(case, learner)
    results: list[Any] = []
    for seed in seeds:
        try:
            results.append(diagram.simulate(duration, seed=seed, record=["controller.*", "controller.y"]))
        except cosim.SimulationError as error:
            results.append(error.result)
    return results
