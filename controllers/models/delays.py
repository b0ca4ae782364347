"""Dead times of controls and sensors: past controls and past readings become states, so that the model has no delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import as_covariance, as_numbers, frozen
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats

MOST = 200
"""Largest number of states of delays; the time of a sample grows with the third power of the number of states."""


@dataclass(frozen=True, eq=False)
class Delays:
    """The delays of a model, and its states of past signals.

    Attributes
    ----------
    inputs, sensors : tuple of int
        Samples by which each control and each sensor is late.
    plant : int
        Number of the plant's states, which stand before those of past signals.
    present : ndarray, states of past signals x plant
        The present value of each past reading, as a row over the plant's states; 0 for past controls.
    rest : ndarray
        The past signals at rest: the control at the operating point; 0 for past readings, which follow from the state.
    labels : tuple of str
        Names of the past signals, such as ``u[-1]``.
    """

    inputs: tuple[int, ...]
    sensors: tuple[int, ...]
    plant: int
    present: Floats
    rest: Floats
    labels: tuple[str, ...]

    @property
    def states(self) -> int:
        """Number of the states of past signals."""
        return len(self.labels)

    @property
    def places(self) -> slice:
        """The places of these states."""
        return slice(self.plant, self.plant + self.states)

    def others(self, states: int) -> list[int]:
        """Return the places of the other ones of all states."""
        return [*range(self.plant), *range(self.plant + self.states, states)]


def with_delays(model: Any, inputs: int | Sequence[int], sensors: int | Sequence[int]) -> Any:
    """Return a `LinearModel` with delays; see `LinearModel.with_delays`."""
    late, old = (
        whole_delays(f"with_delays() has {name}", value, size, name[:-1], model.dt)
        for name, value, size in (
            ("inputs", inputs, model.controls),
            ("sensors", sensors, model.sensors),
        )
    )
    if not any((*late, *old)):
        return model
    if model.delays is not None:
        raise ModelError(
            "The model already has delays; apply with_delays() once, with those of inputs and sensors together. identify() "
            "and design() take both, too: input_delays= and sensor_delays=."
        )
    n, d = model.states - model.disturbances, model.disturbances
    A, B, C, Q = (model.matrix(name) for name in ("A", "B", "C", "process_covariance"))
    rows, chains = _rows(C[:, :n], old)
    k = sum(late) + sum(chains)
    if k > MOST:
        raise ModelError(
            f"The delays need {k} states, but at most {MOST} are possible. Give a longer sample time, with which they are fewer "
            "samples."
        )
    keep = [*range(n), *range(n + k, n + k + d)]  # the places of the given states
    new_A, new_B, new_C, new_Q = (
        np.zeros(shape)
        for shape in ((n + k + d, n + k + d), (n + k + d, B.shape[1]), (len(C), n + k + d), (n + k + d,) * 2)
    )
    new_A[np.ix_(keep, keep)], new_Q[np.ix_(keep, keep)] = A, Q
    new_B[keep], new_C[:, keep] = B, C
    present, rest, labels, at = np.zeros((k, n)), np.zeros(k), [], n
    operating = np.zeros(len(late)) if model.operating_control is None else model.operating_control
    controls, readings = _names(model)
    for j, steps in enumerate(late):
        if steps:
            new_A[keep, at + steps - 1], new_B[keep, j], new_B[at, j] = B[:, j], 0.0, 1.0
            _shift(new_A, at, steps)
            rest[at - n : at - n + steps] = operating[j]
            labels += [f"{controls[j]}[-{i}]" for i in range(1, steps + 1)]
            at += steps
    for row, steps in zip(rows, chains, strict=True):
        if steps:
            new_A[at, :n] = row
            _shift(new_A, at, steps)
            same = [i for i in range(len(C)) if old[i] and np.array_equal(C[i, :n], row)]
            for i in same:
                new_C[i, :n], new_C[i, at + old[i] - 1] = 0.0, 1.0
            present[at - n : at - n + steps] = row
            labels += [f"{readings[same[0]]}[-{i}]" for i in range(1, steps + 1)]
            at += steps
    delays = Delays(late, old, n, frozen(present), frozen(rest), tuple(labels))
    names = model.names and replace(model.names, states=(*model.names.states, *labels))
    return replace(model, A=new_A, B=new_B, C=new_C, process_covariance=new_Q, delays=delays, names=names)


def extended_covariance(model: Any, name: str, value: object) -> object:
    """Extend a covariance of the plant's states by the past signals; return one of all states, or without delays, unchanged.

    Past controls are known. Past readings are as uncertain as the present ones, and independent of them: the plant may have
    moved before. Other states get the variance of `value` if it is one number.
    """
    delays = model.delays
    if delays is None:
        return value
    given = as_numbers(name, value, "it must be a number, a list of numbers or a matrix")
    reduced = model.states - delays.states
    size = next((size for size in (reduced, delays.plant) if given.shape in {(size,), (size, size), ()}), None)
    if size is None:
        return value
    whole = np.zeros((model.states, model.states))
    keep = delays.others(model.states)[:size]
    covariance = as_covariance(name, value, size, singular=True)
    whole[np.ix_(keep, keep)] = covariance
    past = delays.present @ covariance[: delays.plant, : delays.plant] @ delays.present.T
    whole[delays.places, delays.places] = np.diag(np.diag(past))
    return whole


def extended_rows(model: Any, rows: Floats) -> Floats:
    """Return rows over the states without those of past signals as rows over all states; others unchanged."""
    delays = model.delays
    if delays is None or rows.ndim != 2 or rows.shape[1] != model.states - delays.states:
        return rows
    return np.insert(rows, [delays.plant] * delays.states, 0.0, axis=1)


def aligned(model: Any, y: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return samples and controls of a model with delays as ``model.undelayed`` has them: readings earlier, controls later.

    Of each sensor the last samples are missing, as they come after the recording. The controls before the recording are unknown,
    and the samples while one of them acts count as missing: the plant then begins in an unknown state. The controls that act
    after the last sample follow in further rows; one that is not known any more stays.
    """
    if model.delays is None:
        return y, u
    samples, controls = np.full_like(y, np.nan), np.repeat(u[-1:], len(u) + max(model.delays.inputs), axis=0)
    for i, old in enumerate(model.delays.sensors):
        samples[: max(len(y) - old, 0), i] = y[old:, i]
    for j, late in enumerate(model.delays.inputs):
        controls[:late, j], controls[late : late + len(u), j] = u[0, j], u[:, j]
    samples[: max(model.delays.inputs)] = np.nan
    return samples, controls


def whole_delays(title: str, value: object, size: int, what: str, dt: Any = None) -> tuple[int, ...]:
    """Return the samples by which each signal is late; one number stands for all. The error converts seconds by the step `dt`.

    Raises
    ------
    ModelError
        If they are no whole numbers from 0 to `MOST`, or their number is not `size`.
    """
    if isinstance(value, bool):
        raise ModelError(f"{title}={value}; it must be a number of samples or a list of them.")
    given = as_numbers(title, value, "it must be a number of samples or a list of them")
    counts = np.full(size, given) if given.ndim == 0 else given
    if counts.shape != (size,):
        raise ModelError(f"{title}={brief(value)}; give one number for all, or one for each {what} ({size}).")
    if not ((counts >= 0) & (counts == np.round(counts)) & (counts <= MOST)).all():
        raise ModelError(
            f"{title}={brief(value)}; a delay is a whole number of samples from 0 to {MOST}.{_as_samples(counts, dt)}"
        )
    return tuple(int(count) for count in counts)


def _as_samples(delays: Floats, dt: Any) -> str:
    """Return a sentence on delays that are a whole number of samples if they are seconds, else nothing."""
    for seconds in delays[delays != np.round(delays)] if dt is not None else ():
        samples = float(seconds) / float(dt)
        if 0 < samples <= MOST and abs(samples - round(samples)) < 1e-6 * samples:
            return f" {seconds:g} s are {round(samples)} sample{'s' * (round(samples) != 1)}."
    return ""


def _rows(C: Floats, old: Sequence[int]) -> tuple[list[Floats], list[int]]:
    """Return the distinct rows of C, and the longest delay of each; late sensors of one quantity share their past readings."""
    rows: list[Floats] = []
    longest: list[int] = []
    for row, steps in zip(C, old, strict=True):
        same = next((i for i, known in enumerate(rows) if np.array_equal(known, row)), None)
        if same is None:
            rows.append(row)
            longest.append(steps)
        else:
            longest[same] = max(longest[same], steps)
    return rows, longest


def _shift(A: Floats, first: int, steps: int) -> None:
    """Let each state of a chain take the value of the one before."""
    for i in range(1, steps):
        A[first + i, first + i - 1] = 1.0


def _names(model: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of controls and sensors; ``u``, ``y``, with several ``u0``, ``u1``, without names."""
    if model.names is not None:
        return model.names.controls, model.names.sensors
    sizes = (("u", model.controls), ("y", model.sensors))
    several = (tuple(f"{name}{i}" for i in range(size)) if size > 1 else (name,) for name, size in sizes)
    controls, sensors = several
    return controls, sensors


__all__ = ["Delays", "aligned", "extended_covariance", "extended_rows", "whole_delays", "with_delays"]
