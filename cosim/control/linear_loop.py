"""A closed loop as a linear system, and its figures by python-control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import schur, solve_sylvester

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.control.control_system import allowed
from bayesftc.cosim.control.delays import Matrices, delay_margin, late
from bayesftc.cosim.control.loop_parts import Parts, loop_parts
from bayesftc.cosim.control.margins import Margins, margins_of
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import without_brackets
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LASTING = 1e-9
"""A mode does not decay if its pole is nearer to the unit circle than this. A mode with less weight than this is invisible."""


SHOWN = 4
"""Number of poles in the table of a loop."""
MOST_STEPS = 200_000
"""A step response is simulated over at most so many steps."""


@dataclass(frozen=True)
class LinearLoop:
    """A closed loop without faults and noise as a linear system, at the sample time of its controller.

    `bayesftc.cosim.Diagram.linear` makes it, and describes the linearization.

    Parameters
    ----------
    parts : Parts
        Plant, sensors and controller.

    Examples
    --------
    >>> from bayesftc import controllers, cosim, fmus
    >>> servo = cosim.FMU(fmus.path("PositionServo"))
    >>> controller = controllers.design(servo, measured="angle", actuated="voltage")
    >>> linear = cosim.closed_loop(servo, controller, control="voltage", measured="angle", reference=1.0).linear()
    >>> float(abs(linear.poles()[0]).round(3)), round(float(linear.step_info()["RiseTime"]), 2)
    (0.949, 0.23)
    """

    parts: Parts

    @property
    def dt(self) -> float:
        """Sample time in seconds."""
        return float(self.parts.step)

    @property
    def closed(self) -> Any:
        """The closed loop, a `control.StateSpace`: from the goals to the tracked signals and the controls."""
        parts = self.parts
        opened, plant, m = self._opened, parts.plant, len(parts.sensors)
        goals, n = len(parts.goals), len(plant.A)
        solved = np.linalg.inv(np.eye(len(parts.controls)) - opened.D)
        C = solved @ opened.C  # u = C x + D goal
        D = solved @ parts.controller.D[:, m:]
        B_goal = np.vstack([np.zeros((n, goals)), parts.controller.B[:, m:]])
        A, B = opened.A + opened.B @ C, B_goal + opened.B @ D
        rows = np.reshape([row for _, row in parts.tracked.values()], (-1, len(plant.C)))
        C_tracked = rows @ np.hstack([plant.C, np.zeros((len(plant.C), len(A) - n))])
        whole = np.vstack([C_tracked + rows @ plant.D @ C, C]), np.vstack([rows @ plant.D @ D, D])
        return control.ss(
            A,
            B,
            *whole,
            self.dt,
            inputs=[allowed(name) for name in parts.goals],
            outputs=[allowed(name) for name in (*parts.tracked, *parts.controls)],
            states=[*(f"plant_{i}" for i in range(n)), *(f"controller_{i}" for i in range(len(A) - n))],
        )

    def open(self, at: str | None = None) -> Any:
        """Return the transfer function of the loop broken at an input of the plant, a `control.StateSpace`.

        The feedback is negative: the closed loop has its poles where this function is -1. The other controls stay connected.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input; needed if there are several controls.
        """
        j = self._number(self.parts.controls, at, "control", "at")
        name = allowed(self.parts.controls[j])
        return control.ss(*_broken(self._opened, j), self.dt, inputs=[name], outputs=[f"{name}_returned"])

    def bode(self, at: str | None = None, *, omega: ArrayLike | None = None, Hz: bool = False) -> Figure:
        """Return the Bode plot of the loop transfer function with its gain and phase margins.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input at which the loop is broken; needed if there are several controls.
        omega : array_like, optional
            Frequencies in rad/s, or the lowest and the highest one, as for `control.bode_plot`. By default up to half of the
            sampling frequency.
        Hz : bool
            Whether the axis shows Hz instead of rad/s; `omega` is in rad/s nonetheless.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it by itself. In a script, save it (``figure.savefig("bode.png")``) or call ``pyplot.show()``.
        """
        from bayesftc.cosim.control.loop_figures import bode_figure
        from bayesftc.cosim.judging.figures.panels import shown_figure

        margins = self.margins(at) if self._is_stable else None
        title = self._title("Loop transfer function", at)
        return bode_figure(self.open(at), margins, title, shown_figure(), omega, Hz)

    def root_locus(self, at: str | None = None) -> Figure:
        """Return the root locus: the closed loop's poles for a growing gain at the plant's input; crosses mark gain 0.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input whose gain changes; needed if there are several controls.

        Returns
        -------
        matplotlib.figure.Figure
            See `bode`.
        """
        from bayesftc.cosim.control.loop_figures import root_locus_figure
        from bayesftc.cosim.judging.figures.panels import shown_figure

        return root_locus_figure(self.open(at), self.poles(), self._title("Root locus", at), shown_figure())

    def margins(self, at: str | None = None) -> Margins:
        """Return the stability margins of the loop that is broken at a control.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input; needed if there are several controls.

        Raises
        ------
        ModelError
            If the closed loop is not stable.
        """
        if not self._is_stable:
            raise ModelError(f"{self._unstable()} So it has no margins; see bode() for the loop transfer function.")
        return margins_of(self.open(at), self._delay_margin(self._number(self.parts.controls, at, "control", "at")))

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles of the closed loop, the largest first: those of plant, control and belief together."""
        return _largest_first(np.linalg.eigvals(self.closed.A))

    def zeros(self, goal: str | None = None, output: str | None = None) -> NDArray[np.complex128]:
        """Return the zeros of the closed loop from a goal to its signal, the largest first.

        Parameters
        ----------
        goal, output : str, optional
            See `step_info`.
        """
        return _largest_first(control.zeros(self._response(goal, output)))

    def step_info(self, goal: str | None = None, output: str | None = None, **settings: Any) -> dict[str, float]:
        """Return the figures of the response to a step of a goal by 1: rise time, settling time, overshoot and so on.

        With a controller that has a ``preview`` the step is that of the early goal, so that the times contain the preview.

        Parameters
        ----------
        goal : str, optional
            Name of the tracked signal whose goal steps (``"angle"`` for ``"plant.angle"``); needed if there are several.
        output : str, optional
            Name of the tracked signal or control that responds; by default the signal whose goal steps.
        **settings : object
            Further arguments of ``control.step_info``, such as ``SettlingTimeThreshold``.

        Returns
        -------
        dict of str to float
            The results of ``control.step_info``; times in seconds.

        Raises
        ------
        ModelError
            If the closed loop is not stable, so that the response does not settle; or if the response never comes near its
            final value.
        """
        response = _settling(self._response(goal, output))
        if response is None:
            raise ModelError(
                f"{self._unstable()} So the step response does not settle and has no figures; change the controller, or the "
                "start values of the plant."
            )
        if not {"T", "timepts", "T_num", "timepts_num", "final_output"} & set(settings):
            settings["T"] = self.dt * np.arange(_steps_to_rest(response) + 1)
        try:
            info: dict[str, float] = control.step_info(response, **settings)
        except IndexError:  # python-control finds no sample at which the response has risen
            raise ModelError(
                "The step response does not come near its final value within the simulated time. Give a longer one in seconds, "
                "as T=[0.0, 0.1, ...]; it may also be that the goal has no lasting effect on this signal."
            ) from None
        return info

    def __repr__(self) -> str:
        states = len(self._opened.A)
        return (
            f"<LinearLoop of {states} states at {self.dt:g} s: goals for {', '.join(self.parts.tracked) or 'no signal'}; "
            f"controls {', '.join(self.parts.controls)}>"
        )

    def _repr_html_(self) -> str:
        """Return the loop's signals, its slowest poles and its figures as a table, for notebooks."""
        poles = self.poles()
        shown = ", ".join(f"{pole:.4g}" for pole in poles[:SHOWN])
        constant = int((np.abs(poles) > 1.0 - LASTING).sum())
        apart = f", apart from {counted(constant, 'mode')} without decay or growth" if constant else ""
        rows = [
            ("sample time", f"{self.dt:g} s"),
            ("goals for", ", ".join(self.parts.tracked) or "no signal"),
            ("controls", ", ".join(self.parts.controls)),
            ("stable", f"yes{apart}" if self._is_stable else "no"),
            (f"largest of {counted(len(poles), 'pole')}", shown),
            ("figures and numbers", "bode(), root_locus(), margins(), step_info(), poles(), zeros()"),
        ]
        return table("LinearLoop", rows)

    @property
    def _is_stable(self) -> bool:
        """Whether no mode grows. A constant mode, such as the position for a tracked speed, may be irrelevant to all goals."""
        return bool((np.abs(self.poles()) < 1.0 + LASTING).all())

    def _unstable(self) -> str:
        shown = ", ".join(f"{pole:.4g}" for pole in self.poles()[:3])
        return f"The closed loop is not stable: its largest poles are {shown}."

    def _delay_margin(self, j: int) -> float:
        """Return the delay margin at a control in seconds; its dead time counts as a part of the delay."""
        parts = self.parts
        delays = [Fraction(0) if i == j else delay for i, delay in enumerate(parts.delays)]
        loop = _broken(self._opened_with(late(parts.without_delay, delays, parts.within)), j)
        n = len(parts.without_delay.A)
        at_once = loop.B.copy()
        at_once[:n] -= parts.without_delay.B[:, [j]]

        def reached(part: float) -> Floats:
            effect = np.zeros(len(loop.A))
            effect[:n] = parts.within.reached(part)[:, j]
            return effect

        return self.dt * delay_margin(loop._replace(B=at_once), reached, float(parts.delays[j]))

    @property
    def _opened(self) -> Matrices:
        """The loop broken at all controls: from the inputs of the plant to the outputs of the controller."""
        return self._opened_with(self.parts.plant)

    def _opened_with(self, plant: Matrices) -> Matrices:
        law, S = self.parts.controller, self.parts.sensors
        m = len(S)
        By, Dy = law.B[:, :m], law.D[:, :m]
        A = np.block([[plant.A, np.zeros((len(plant.A), len(law.A)))], [By @ S @ plant.C, law.A]])
        B = np.vstack([plant.B, By @ S @ plant.D])
        return Matrices(A, B, np.hstack([Dy @ S @ plant.C, law.C]), Dy @ S @ plant.D)

    def _response(self, goal: str | None, output: str | None) -> Any:
        """Return the closed loop from a goal to a signal."""
        tracked = tuple(self.parts.tracked)
        if not tracked:
            raise ModelError(
                "No measured signal, and no output of the plant, has its own goal in this loop, so that there is no response "
                "from goal to signal. Give the plant an output for the goal, with the name that design(goal=...) has. The "
                "property closed has the response of the controls: linear.closed of linear = loop.linear(...)."
            )
        name = tracked[self._number(tracked, goal, "tracked signal", "goal")]
        signals = (*tracked, *self.parts.controls)
        row = self._number(signals, name if output is None else output, "signal", "output")
        return self.closed[row, self.parts.tracked[name][0]]

    def _number(self, names: Sequence[str], name: str | None, what: str, argument: str) -> int:
        if name is None:
            if len(names) > 1:
                raise ModelError(
                    f"The loop has {len(names)} {what}s: {', '.join(names)}. Name one of them: {argument}={names[0]!r}."
                )
            return 0
        given = name
        for spelling in (name.partition(".")[2], name):  # `plant.u` as in results; `u[0]` as in python-control
            if spelling and name not in names:
                name = spelling if spelling in names else without_brackets(spelling, names) or name
        if name not in names:
            raise UnknownNameError(f"The loop has no {what} {given!r}; {did_you_mean(given, names)}")
        return names.index(name)

    def _title(self, what: str, at: str | None) -> str:
        names = self.parts.controls
        others = [name for j, name in enumerate(names) if j != self._number(names, at, "control", "at")]
        closed = f"; the loop of {others[0]} stays closed" if len(others) == 1 else "; the other loops stay closed"
        return f"{what}, broken at the plant's input {names[0] if at is None else at}{closed * bool(others)}"


def _broken(opened: Matrices, j: int) -> Matrices:
    """Return the loop transfer function at one control, with the other controls connected, for negative feedback."""
    others = np.eye(len(opened.D))
    broken = others[:, [j]].copy()
    others[j, j] = 0.0
    solved = np.linalg.inv(np.eye(len(others)) - opened.D @ others)
    C, D = solved @ opened.C, solved @ opened.D @ broken
    A, B = opened.A + opened.B @ others @ C, opened.B @ (others @ D + broken)
    return Matrices(A, B, -C[[j]], -D[[j]])


def _settling(system: Any) -> Any:
    """Return a system without the modes that do not decay; None if such a mode is visible in the response.

    An integrator without a goal, such as the position for a tracked speed, is an invisible mode that does not decay.
    """
    A, Z, stable = schur(system.A, sort=lambda real, imaginary: np.hypot(real, imaginary) < 1.0 - LASTING)
    if stable == len(A):
        return system
    B, C = Z.T @ system.B, system.C @ Z
    # A change of coordinates decouples the stable modes from the others.
    Y = solve_sylvester(A[:stable, :stable], -A[stable:, stable:], -A[:stable, stable:])
    C_lasting, B_lasting = C[:, :stable] @ Y + C[:, stable:], B[stable:]
    if np.abs(C_lasting).max() * np.abs(B_lasting).max() > LASTING * max(
        np.abs(system.B).max() * np.abs(system.C).max(), 1e-300
    ):
        return None
    return control.ss(A[:stable, :stable], B[:stable] - Y @ B_lasting, C[:, :stable], system.D, system.dt)


def _steps_to_rest(system: Any) -> int:
    """Return the steps in which the slowest mode has decayed to a millionth; python-control takes too few for slow loops."""
    slowest = float(np.abs(system.poles()).max(initial=0.0))
    steps = np.log(1e-6) / np.log(slowest) if slowest > 0.0 else 0.0
    return int(min(max(np.ceil(steps), 100), MOST_STEPS))


def linear_loop(diagram: Any, plant: Any = None) -> LinearLoop:
    """Return a closed loop as a linear system; `bayesftc.cosim.Diagram.linear` describes the arguments."""
    return LinearLoop(loop_parts(diagram, plant))


def _largest_first(values: Any) -> NDArray[np.complex128]:
    array = np.asarray(values, dtype=np.complex128)
    return array[np.lexsort((-array.imag, -np.abs(array)))]


__all__ = ["LinearLoop", "Margins", "linear_loop"]
