"""The description of the pendulum that stands on a cart, on which a goal for the next step alone fails."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["CART_PENDULUM"]

_RAD = Unit("rad", rad=1)
_RAD_PER_S = Unit("rad/s", rad=1, s=-1)
_M = Unit("m", m=1)
_M_PER_S = Unit("m/s", m=1, s=-1)
_N = Unit("N", kg=1, m=1, s=-2)
_NM = Unit("N.m", kg=1, m=2, s=-2)
_KG = Unit("kg", kg=1)
_KGM2 = Unit("kg.m2", kg=1, m=2)
_S = Unit("s", s=1)

_SUBSTEP = Variable("max_substep", "parameter", "Longest substep of the integration, positive", _S, start=1e-3)

CART_PENDULUM = Model(
    name="CartPendulum",
    description="A pendulum on a cart that a force pushes; it starts upright, from where it falls unless it is held.",
    source=Path(__file__).with_name("CartPendulum.c"),
    variables=(
        Variable("force", "input", "Force on the cart, held during a step", _N),
        Variable("torque", "input", "Torque on the pendulum from outside, held during a step", _NM),
        Variable("position", "output", "Place of the cart", _M, initial_dependencies=("position_0",)),
        Variable("angle", "output", "Angle of the pendulum from upright", _RAD, initial_dependencies=("angle_0",)),
        Variable("velocity", "output", "Velocity of the cart", _M_PER_S, initial_dependencies=("velocity_0",)),
        Variable("rate", "output", "Angular velocity of the pendulum", _RAD_PER_S, initial_dependencies=("rate_0",)),
        Variable("M_cart", "parameter", "Mass of the cart", _KG, start=0.5),
        Variable("m", "parameter", "Mass of the pendulum", _KG, start=0.2),
        Variable("l", "parameter", "Distance from the pivot to the pendulum's centre of mass", _M, start=0.3),
        Variable("I", "parameter", "Moment of inertia about the centre of mass", _KGM2, start=0.006),
        Variable("c", "parameter", "Viscous friction of the cart", Unit("N.s/m", kg=1, s=-1), start=0.1),
        Variable("b", "parameter", "Friction of the pivot", Unit("N.m.s/rad", kg=1, m=2, s=-1, rad=-1), start=1e-3),
        Variable("g", "parameter", "Gravity", Unit("m/s2", m=1, s=-2), start=9.81),
        Variable("position_0", "parameter", "Place of the cart at the start time", _M),
        Variable("angle_0", "parameter", "Angle of the pendulum at the start time", _RAD),
        Variable("velocity_0", "parameter", "Velocity of the cart at the start time", _M_PER_S),
        Variable("rate_0", "parameter", "Angular velocity of the pendulum at the start time", _RAD_PER_S),
        _SUBSTEP,
    ),
    step=0.02,
    libraries=("m",),
)
