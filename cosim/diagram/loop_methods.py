"""Methods of a diagram that is a closed loop: figures of the loop as a linear system."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from bayesftc.cosim.control.linear_loop import LinearLoop, Margins


class LoopMethods:
    """Figures of a closed loop as `closed_loop` makes it; for other diagrams they raise an error with the reason."""

    def linear(self, *, plant: Any = None) -> LinearLoop:
        """Return the closed loop as a linear system, which has methods for its figures.

        The loop has no faults, no noise and no limits of the control. The plant is linearized at its start values, with the
        controls of the operating point of the controller's model, if it has one. A Bayesian controller with a linear model is
        in steady state, with the sensor covariance of its model. Any other controller is linearized at its initial state and at
        the samples and the reference of the first step, with its precision learner stopped. If it has no ``model``, the inputs of
        the plant are those of the first step as well.

        Parameters
        ----------
        plant : system of python-control, optional
            A linear system in place of the plant: from the controls to the measured signals, or to the sensors. It is
            necessary for an FMU with hidden states: ``LinearModel.from_fmu(...).to_control()``.

        Raises
        ------
        ModelError
            If the diagram is not a closed loop of one plant, one block of sensors and one controller, or cannot be linearized.

        Warns
        -----
        UserWarning
            If a control has no effect on the plant where the loop begins, or does not depend on the samples there, as at a limit.

        Examples
        --------
        >>> from bayesftc import controllers, cosim, fmus
        >>> servo = cosim.FMU(fmus.path("PositionServo"))
        >>> controller = controllers.design(servo, measured="angle", actuated="voltage", sensors=2)
        >>> loop = cosim.closed_loop(
        ...     servo, controller, control="voltage", measured="angle", sensors=cosim.Sensors(2, 0.01), reference=1.0
        ... )
        >>> loop.linear()
        <LinearLoop of 6 states at 0.01 s: goals for angle; controls voltage>
        """
        from bayesftc.cosim.control.linear_loop import linear_loop

        return linear_loop(self, plant)

    def bode(self, at: str | None = None, *, omega: ArrayLike | None = None, Hz: bool = False) -> Figure:
        """Return the Bode plot of the loop transfer function, with its margins; see `LinearLoop.bode`.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input at which the loop is broken; needed if there are several controls.
        omega : array_like, optional
            Frequencies in rad/s, or the lowest and the highest one.
        Hz : bool
            Whether the axis shows Hz instead of rad/s.
        """
        return self.linear().bode(at, omega=omega, Hz=Hz)

    def root_locus(self, at: str | None = None) -> Figure:
        """Return the root locus over the gain at the plant's input; see `LinearLoop.root_locus`.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input whose gain changes; needed if there are several controls.
        """
        return self.linear().root_locus(at)

    def margins(self, at: str | None = None) -> Margins:
        """Return gain, phase and delay margin of the loop that is broken at the plant's input; see `LinearLoop.margins`.

        Parameters
        ----------
        at : str, optional
            Name of the plant's input; needed if there are several controls.
        """
        return self.linear().margins(at)

    def poles(self) -> NDArray[Any]:
        """Return the poles of the closed loop, the largest first; see `LinearLoop.poles`."""
        return self.linear().poles()

    def zeros(self, goal: str | None = None, output: str | None = None) -> NDArray[Any]:
        """Return the zeros of the closed loop from a goal to its signal; see `LinearLoop.zeros`.

        Parameters
        ----------
        goal, output : str, optional
            Names of the tracked signal of the goal, and of the signal that responds.
        """
        return self.linear().zeros(goal, output)

    def step_info(self, goal: str | None = None, output: str | None = None, **settings: Any) -> dict[str, float]:
        """Return rise time, settling time, overshoot and so on after a step of a goal; see `LinearLoop.step_info`.

        Parameters
        ----------
        goal, output : str, optional
            Names of the tracked signal whose goal steps, and of the signal that responds.
        **settings : object
            Further arguments of ``control.step_info``.
        """
        return self.linear().step_info(goal, output, **settings)
