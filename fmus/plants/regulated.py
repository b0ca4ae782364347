"""Four plants on which a goal for the next step alone fails: they need a controller that looks ahead."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["CART_PENDULUM", "HYDRO_TURBINE", "POSITION_SERVO", "TWO_MASSES"]

_RAD = Unit("rad", rad=1)
_RAD_PER_S = Unit("rad/s", rad=1, s=-1)
_M = Unit("m", m=1)
_M_PER_S = Unit("m/s", m=1, s=-1)
_N = Unit("N", kg=1, m=1, s=-2)
_NM = Unit("N.m", kg=1, m=2, s=-2)
_KG = Unit("kg", kg=1)
_KGM2 = Unit("kg.m2", kg=1, m=2)
_S = Unit("s", s=1)
_V = Unit("V", kg=1, m=2, s=-3, A=-1)
_A = Unit("A", A=1)

_SUBSTEP = Variable("max_substep", "parameter", "Longest substep of the integration, positive", _S, start=1e-3)


def _source(name: str) -> Path:
    return Path(__file__).with_name(f"{name}.c")


POSITION_SERVO = Model(
    name="PositionServo",
    description="A position servo: a voltage drives a current through a winding, the current a shaft with friction. "
    "With the shipped parameters the current follows within 0.05 s.",
    source=_source("PositionServo"),
    variables=(
        Variable("voltage", "input", "Voltage at the winding, held during a step", _V),
        Variable("load", "input", "Torque on the shaft from outside, held during a step", _NM),
        Variable("angle", "output", "Angle of the shaft", _RAD, initial_dependencies=("angle_0",)),
        Variable("speed", "output", "Angular velocity of the shaft", _RAD_PER_S),
        Variable("current", "output", "Current through the winding", _A),
        Variable("R", "parameter", "Resistance", Unit("Ohm", kg=1, m=2, s=-3, A=-2), start=1.0),
        Variable("L", "parameter", "Inductance", Unit("H", kg=1, m=2, s=-2, A=-2), start=0.05),
        Variable(
            "K",
            "parameter",
            "Torque per current, and voltage per speed",
            Unit("N.m/A", kg=1, m=2, s=-2, A=-1),
            start=0.1,
        ),
        Variable("J", "parameter", "Moment of inertia of the shaft", _KGM2, start=0.01),
        Variable("b", "parameter", "Viscous friction", Unit("N.m.s/rad", kg=1, m=2, s=-1, rad=-1), start=0.02),
        Variable("angle_0", "parameter", "Angle at the start time", _RAD),
        _SUBSTEP,
    ),
    step=0.01,
    libraries=("m",),
)

TWO_MASSES = Model(
    name="TwoMasses",
    description="Two masses on a rail with a spring and a damper between them, and a force on each.",
    source=_source("TwoMasses"),
    variables=(
        Variable("force1", "input", "Force on the first mass, held during a step", _N),
        Variable("force2", "input", "Force on the second mass, held during a step", _N),
        Variable("x1", "output", "Place of the first mass", _M, initial_dependencies=("x1_0",)),
        Variable("x2", "output", "Place of the second mass", _M, initial_dependencies=("x2_0",)),
        Variable("v1", "output", "Velocity of the first mass", _M_PER_S),
        Variable("v2", "output", "Velocity of the second mass", _M_PER_S),
        Variable("m1", "parameter", "First mass", _KG, start=1.0),
        Variable("m2", "parameter", "Second mass", _KG, start=1.0),
        Variable("k", "parameter", "Stiffness of the spring", Unit("N/m", kg=1, s=-2), start=100.0),
        Variable("d", "parameter", "Damping between the masses", Unit("N.s/m", kg=1, s=-1), start=1.0),
        Variable("x1_0", "parameter", "Place of the first mass at the start time", _M),
        Variable("x2_0", "parameter", "Place of the second mass at the start time", _M),
        _SUBSTEP,
    ),
    step=0.02,
    libraries=("m",),
)

CART_PENDULUM = Model(
    name="CartPendulum",
    description="A pendulum on a cart that a force pushes; it starts upright, from where it falls unless it is held.",
    source=_source("CartPendulum"),
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

HYDRO_TURBINE = Model(
    name="HydroTurbine",
    description="A water turbine at the end of a penstock, per unit: opening the gate first lowers the power. It starts in "
    "steady state.",
    source=_source("HydroTurbine"),
    variables=(
        Variable("command", "input", "Where the gate is to go, above zero, held during a step", start=0.6),
        Variable("head", "input", "Head of the water, held during a step", start=1.0),
        Variable("power", "output", "Power at the shaft", initial_dependencies=("gate_0", "head")),
        Variable("gate", "output", "Opening of the gate", initial_dependencies=("gate_0",)),
        Variable("flow", "output", "Flow of the water", initial_dependencies=("gate_0", "head")),
        Variable("Tw", "parameter", "Time in which the head brings the water to its rated flow", _S, start=1.0),
        Variable("Tg", "parameter", "Time constant of the gate", _S, start=0.2),
        Variable("gate_0", "parameter", "Opening of the gate at the start time, above zero", start=0.6),
        _SUBSTEP,
    ),
    step=0.05,
    libraries=("m",),
)
