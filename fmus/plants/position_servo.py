"""The description of the position servo, on which a goal for the next step alone fails."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["POSITION_SERVO"]

_RAD = Unit("rad", rad=1)
_RAD_PER_S = Unit("rad/s", rad=1, s=-1)
_NM = Unit("N.m", kg=1, m=2, s=-2)
_KGM2 = Unit("kg.m2", kg=1, m=2)
_S = Unit("s", s=1)
_V = Unit("V", kg=1, m=2, s=-3, A=-1)
_A = Unit("A", A=1)

_SUBSTEP = Variable("max_substep", "parameter", "Longest substep of the integration, positive", _S, start=1e-3)

POSITION_SERVO = Model(
    name="PositionServo",
    description="A position servo: a voltage drives a current through a winding, the current a shaft with friction. "
    "With the shipped parameters the current follows within 0.05 s.",
    source=Path(__file__).with_name("PositionServo.c"),
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
