"""The robot arm with two links of the paper's first experiment."""

import math
from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["TWO_LINK_ARM"]

_ANGLE = Unit("rad", rad=1)
_RATE = Unit("rad/s", rad=1, s=-1)
_TORQUE = Unit("N.m", kg=1, m=2, s=-2)
_FRICTION = Unit("N.m.s/rad", kg=1, m=2, s=-1, rad=-1)
_INERTIA = Unit("kg.m2", kg=1, m=2)
_MASS = Unit("kg", kg=1)
_LENGTH = Unit("m", m=1)
_TIME = Unit("s", s=1)
_GRAVITY = Unit("m/s2", m=1, s=-2)

_POSE = ("L1", "L2", "q1_0", "q2_0")

# The numbers are those of the arm in the authors' follow-up work: github.com/cpezzato/unbiased_aic, RealrobotDynamics.m.
TWO_LINK_ARM = Model(
    name="TwoLinkArm",
    description="A robot arm with two links in a vertical plane under gravity, with viscous friction, driven by a torque "
    "at each joint that is held during a step. Integrated by fourth-order Runge-Kutta substeps of at most max_substep.",
    source=Path(__file__).with_name("TwoLinkArm.c"),
    variables=(
        Variable("torque1", "input", "Torque at the first joint, held during a step", _TORQUE),
        Variable("torque2", "input", "Torque at the second joint, held during a step", _TORQUE),
        Variable("q1", "output", "Angle of the first link from the horizontal", _ANGLE, initial_dependencies=("q1_0",)),
        Variable("q2", "output", "Angle of the second link from the first", _ANGLE, initial_dependencies=("q2_0",)),
        Variable("dq1", "output", "Angular velocity of the first joint", _RATE, initial_dependencies=("dq1_0",)),
        Variable("dq2", "output", "Angular velocity of the second joint", _RATE, initial_dependencies=("dq2_0",)),
        Variable("x", "output", "Horizontal position of the arm's end", _LENGTH, initial_dependencies=_POSE),
        Variable("y", "output", "Vertical position of the arm's end", _LENGTH, initial_dependencies=_POSE),
        Variable("I1", "parameter", "Moment of inertia of link 1 about its centre of mass", _INERTIA, start=1.0209),
        Variable("I2", "parameter", "Moment of inertia of link 2 about its centre of mass", _INERTIA, start=1.0218),
        Variable("m1", "parameter", "Mass of link 1", _MASS, start=2.1368),
        Variable("m2", "parameter", "Mass of link 2", _MASS, start=2.2418),
        Variable("L1", "parameter", "Length of link 1", _LENGTH, start=1.0446),
        Variable("L2", "parameter", "Length of link 2", _LENGTH, start=1.0111),
        Variable("Lg1", "parameter", "Distance from joint 1 to the centre of mass of link 1", _LENGTH, start=0.5451),
        Variable("Lg2", "parameter", "Distance from joint 2 to the centre of mass of link 2", _LENGTH, start=0.5075),
        Variable("D1", "parameter", "Viscous friction of joint 1", _FRICTION, start=101.519),
        Variable("D2", "parameter", "Viscous friction of joint 2", _FRICTION, start=103.8566),
        Variable("g", "parameter", "Gravity", _GRAVITY, start=9.81),
        Variable("q1_0", "parameter", "q1 at the start time; by default the arm hangs", _ANGLE, start=-math.pi / 2),
        Variable("q2_0", "parameter", "q2 at the start time", _ANGLE),
        Variable("dq1_0", "parameter", "dq1 at the start time", _RATE),
        Variable("dq2_0", "parameter", "dq2 at the start time", _RATE),
        Variable("max_substep", "parameter", "Longest substep of the integration, positive", _TIME, start=1e-3),
    ),
    step=1e-3,
    stop_time=12.0,
    libraries=("m",),
)
