"""Measurements of a planar arm by a camera, as step functions for `Sensors` and for controllers that predict measurements.

Each factory returns a plain function ``function(x, y)`` that reads the array ``x`` and writes the array ``y``. So the same
function makes the measurements and predicts them::

    measure = cosim.arm_with_camera(lengths=(1.0, 1.0), distortion=(-1.5e-3, 5e-6, 0.0))
    sensors = cosim.Sensors(count=6, signals=4, function=measure, std=(1e-3,) * 4 + (1e-2,) * 2)

Equal settings give the same function, which is compiled once. A block with such a function cannot be pickled. To use it in
other processes, write a function in a module that calls it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import isfinite

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import cos, sin, square
from bayesftc.cosim.types import Kernel


def radial_distortion(k1: float, k2: float = 0.0, k3: float = 0.0) -> Kernel:
    """Return the step function of a lens: ``p_d = p_u (1 + k1 r^2 + k2 r^4 + k3 r^6)`` with ``r = |p_u|``.

    This is the radial part of the model of Brown (1966) and Conrady (1919), in the unit of the point instead of pixels.
    Negative coefficients give barrel distortion.

    Parameters
    ----------
    k1, k2, k3 : float
        Coefficients, in 1/m^2, 1/m^4 and 1/m^6 for a point in metres from the optical axis.

    Returns
    -------
    function
        ``function(x, y)``: from a planar point ``x`` of shape (2,) to its distorted position ``y`` of shape (2,).

    Raises
    ------
    ModelError
        If a coefficient is not a finite number.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> image = np.zeros(2)
    >>> cosim.radial_distortion(-0.1)(np.array([2.0, 0.0]), image)
    >>> image.tolist()
    [1.2, 0.0]
    """
    return _lens(_coefficients("radial_distortion", (k1, k2, k3)))


def planar_arm(lengths: Sequence[float]) -> Kernel:
    """Return the step function of a planar arm's forward kinematics.

    Parameters
    ----------
    lengths : sequence of float
        Length of each link, in metres, from the base on.

    Returns
    -------
    function
        ``function(x, y)``: from the joint angles to the position of the arm's end. The angles are the first elements of
        ``x``, in radians: the first from the horizontal, each other from the link before it. The position ``y`` has the
        shape (2,), in metres from the base: horizontal, then up.

    Raises
    ------
    ModelError
        If there is no link, or a length is not a positive number.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> end = np.zeros(2)
    >>> cosim.planar_arm((1.0, 0.5))(np.array([0.0, np.pi / 2]), end)
    >>> end.tolist()
    [1.0, 0.5]
    """
    return _arm(_lengths("planar_arm", lengths))


def arm_with_camera(lengths: Sequence[float], distortion: Sequence[float] = (0.0, 0.0, 0.0)) -> Kernel:
    """Return the step function of all sensors of an arm: an encoder and a tachometer at each joint, and a camera.

    The camera faces the arm's plane. Its optical axis goes through the base. It measures the position of the arm's end.

    Parameters
    ----------
    lengths : sequence of float
        Length of each of n links, in metres.
    distortion : sequence of three floats
        Coefficients of the camera's lens, see `radial_distortion`.

    Returns
    -------
    function
        ``function(x, y)``: from the state ``x`` of shape (2 n,), n joint angles in radians and their n velocities in
        rad/s, to the measurements ``y`` of shape (2 n + 2,): the state, and the distorted position of the end, in metres.

    Raises
    ------
    ModelError
        If a length is not a positive number, or there are not three finite coefficients.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> measure, y = cosim.arm_with_camera((1.0, 0.5)), np.zeros(6)
    >>> measure(np.array([0.0, np.pi / 2, 0.1, 0.2]), y)  # two angles, two velocities
    >>> y.round(3).tolist()
    [0.0, 1.571, 0.1, 0.2, 1.0, 0.5]
    """
    return _arm_with_camera(
        _lengths("arm_with_camera", lengths), _coefficients("arm_with_camera", tuple(distortion), "distortion")
    )


def _place(x, lengths, y, at):
    """Write the position of the arm's end into two elements of `y`."""
    angle, across, up = 0.0, 0.0, 0.0
    for i in range(len(lengths)):
        angle = angle + x[i]
        across = across + lengths[i] * cos(angle)
        up = up + lengths[i] * sin(angle)
    y[at] = across
    y[at + 1] = up


def _distort(k, y, at):
    """Distort the point in two elements of `y` as the lens does."""
    r2 = square(y[at]) + square(y[at + 1])
    scale = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))
    y[at] = y[at] * scale
    y[at + 1] = y[at + 1] * scale


@cache
def _lens(k: tuple[float, float, float]) -> Kernel:
    def radial_distortion(x, y):
        y[0] = x[0]
        y[1] = x[1]
        _distort(k, y, 0)

    return radial_distortion


@cache
def _arm(lengths: tuple[float, ...]) -> Kernel:
    def planar_arm(x, y):
        _place(x, lengths, y, 0)

    return planar_arm


@cache
def _arm_with_camera(lengths: tuple[float, ...], k: tuple[float, float, float]) -> Kernel:
    states = 2 * len(lengths)

    def arm_with_camera(x, y):
        for i in range(states):
            y[i] = x[i]
        _place(x, lengths, y, states)
        _distort(k, y, states)

    return arm_with_camera


def _lengths(caller: str, lengths: Sequence[float]) -> tuple[float, ...]:
    numbers = tuple(float(length) for length in lengths)
    if not numbers or not all(isfinite(length) and length > 0.0 for length in numbers):
        raise ModelError(
            f"{caller} has lengths={lengths!r}; give the length of each link, a positive number of metres."
        )
    return numbers


def _coefficients(caller: str, values: tuple[float, ...], name: str = "k1, k2, k3") -> tuple[float, float, float]:
    numbers = tuple(float(k) for k in values)
    if len(numbers) != 3 or not all(isfinite(k) for k in numbers):
        raise ModelError(
            f"{caller} has {name}={values!r}; give three finite coefficients (0 for those without effect)."
        )
    k1, k2, k3 = numbers
    return k1, k2, k3


__all__ = ["arm_with_camera", "planar_arm", "radial_distortion"]
