"""Names and descriptions of the signals of controllers, estimators and monitors."""

from collections.abc import Sequence
from typing import Any

from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.ports import Port

MOST_NAMES = 12
"""Largest number of names in a description."""

_SIGNALS = {
    "y": "Samples of the sensors; NaN is a missing one",
    "goal": "Goal; NaN is no goal",
    "u": "Control",
    "u_covariance": "Covariance of the control given samples and goal; NaN where nothing determines it",
    "u_state_covariance": "Covariance of the control with the state; NaN where nothing determines it",
    "x_hat": "Mean of the belief about the state",
    "P": "Covariance of the belief about the state",
    "R": "Sensor covariance in use; infinite for a sensor that is left out",
    "innovation": "Samples minus their predictions; NaN for a missing one",
    "precision": "Precision in use of each sensor",
    "beta": "Rate of each sensor's precision, the beta residual; NaN where none is learned",
    "fault_probability": "Probability that each sensor is faulty; NaN where it is not inferred",
    "fault": "1 for each sensor that counts as faulty, else 0; NaN where it is not inferred",
    "detected": "1 for each sensor with a detected fault, else 0",
    "model_suspect": "Common disagreement of all sensors with the model; from 0.5 to 1 it is wrong; NaN if not checked",
    "precision_shape": "Shape of the gamma distribution of each precision",
    "precision_rate": "Rate of the gamma distribution of each precision",
    "precision_scale": "Scale matrix V of the Wishart distribution of the precision",
    "precision_degrees_of_freedom": "Degrees of freedom of the Wishart distribution of the precision",
    "precision_mean": "Mean of the precision",
    "precision_mode": "Mode of the precision",
    "precision_variance": "Variance of the precision",
    "precision_weight": "Weight of each sample; 1 is the model's nominal weight",
    "mode_probability": "Probability of each mode of each sensor, healthy first",
    "fault_kind": "Most probable mode of each sensor by its number, 0 for healthy",
    "fault_size": "Size of that mode's fault: an offset in the sensor's unit, other deviations in multiples of its noise; or NaN",
    "fault_onset": "Seconds from the first sample to the fault's onset; NaN for a healthy sensor",
    "log_density": "Log density of these samples given the earlier ones",
    "actuator_mode_probability": "Probability of each mode of each actuator, healthy first",
    "actuator_fault_probability": "Probability that each actuator is faulty",
    "actuator_fault_kind": "Most probable mode of each actuator by its number, 0 for healthy",
    "actuator_fault_size": "Size of that mode's fault; NaN where it has none",
    "process_mode_probability": "Probability of each mode of the process, healthy first; last: a mode has ended",
    "free_energy": "Free energy F at its minimum, or where the last gradient was taken",
    "eps_x": "mu - x_pred, the error of the state prior, where the last gradient was taken",
    "eps_u": "mu_u - f*(mu, goal), the error of the control, where the last gradient was taken",
}


def port(
    name: str,
    shape: tuple[int, ...] = (),
    *,
    feedthrough: bool = True,
    default: float | None = None,
    applied: bool = False,
    of: Sequence[str] = (),
    elements: Sequence[str] = (),
    numbered: Sequence[str] = (),
) -> Port:
    """Return the port of a signal of a controller.

    Parameters
    ----------
    name : str
        The signal.
    shape, feedthrough, default
        See `Port`.
    applied : bool
        Of an input ``u``: whether it is the input that the plant gets.
    of : sequence of str
        Names of the elements in the model, for the description.
    elements : sequence of str
        Names for the description of each element; by default `of`.
    numbered : sequence of str
        What the numbers 1, 2 and so on stand for, for the description.
    """
    description = "Input of the plant from this sample to the next" if applied else _SIGNALS.get(name, "")
    each = tuple(with_names(description, [name]) for name in (elements or of))
    if numbered:
        description = with_names(description, [f"{k} {name}" for k, name in enumerate(numbered, start=1)])
    if of:
        shown = [*of[:MOST_NAMES], *["..."] * (len(of) > MOST_NAMES)]
        description = with_names(description, shown)
    return Port(
        name, shape, feedthrough=feedthrough, default=default, description=description, element_descriptions=each
    )


def with_names(description: str, names: Sequence[str]) -> str:
    """Return a description with names behind its first part."""
    first, semicolon, rest = description.partition(";")
    return f"{first} ({', '.join(names)}){semicolon}{rest}"


def named(model: Any, which: str) -> Sequence[str]:
    """Return the names of a model's ``"sensors"``, ``"controls"`` or ``"states"``; none if it has no names."""
    names = getattr(model, "names", None)
    if names is None:
        return ()
    given: Sequence[str] = getattr(model, "state_names", names.states) if which == "states" else getattr(names, which)
    return () if given[:1] == ("x[0]",) else given


def summary_of(block: Any) -> str:
    """Return the kind, the sizes and the kind of learner of a controller or an estimator, in one line."""
    parts = [counted(block.port(name).size, kind) for name, kind in _SIZES.items()]
    if block.sample_time is not None:
        parts.append(f"dt = {float(block.sample_time):g} s")
    return f"{type(block).__name__} of {', '.join(parts)}, with {type(block.precision).__name__}"


_SIZES = {"x_hat": "state", "u": "control", "y": "sensor"}
"""The ports of the size of a model's states, controls and sensors."""
